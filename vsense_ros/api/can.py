"""What is on a CAN bus: what the command `vsense can` does."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from vsense_ros.bag.can_proposal import proposal
from vsense_ros.bag.can_roles import Roles, recognize
from vsense_ros.bag.can_survey import CanSurvey, survey


@dataclass(frozen=True)
class CanContent:
    """What was heard in a log (`survey`), and which signals measure the motion of the car (`roles`)."""

    survey: CanSurvey
    roles: Roles

    def mapping(self) -> str:
        """A proposed mapping as YAML with comments, which `vsense import` and `read` take as it is.

        Raises `InputError` if nothing was recognized.
        """
        return proposal(self.survey, self.roles)


def survey_can(log: str | Path, databases: Sequence[str | Path] = ()) -> CanContent:
    """Look at all frames of a CAN log (candump, .asc, .blf, .trc, GVRET .csv, .mf4), and decode what databases know.

        content = vs.survey_can("drive.blf", ["car.dbc"])
        content.roles.steering_wheel.signal.label  # STEER_ANGLE_SENSOR.STEER_ANGLE
        Path("car.yaml").write_text(content.mapping())
        recording = vs.read("drive.blf", dbc="car.dbc", mapping="car.yaml")

    Raises `InputError` for a log or a database that cannot be read.
    """
    found = survey(log, databases)
    return CanContent(found, recognize(found))
