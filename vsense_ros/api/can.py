"""What is on a CAN bus: what the command `vsense can` does."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from vsense_ros.bag.can_proposal import proposal
from vsense_ros.bag.can_roles import Roles, recognize
from vsense_ros.bag.can_survey import CanSurvey, survey
from vsense_ros.bag.can_table import show
from vsense_ros.evaluate.printable import Printable

if TYPE_CHECKING:
    from rich.console import Console


@dataclass(frozen=True, repr=False)
class CanContent(Printable):
    """What was heard in a log (`survey`), and which signals measure the motion of the car (`roles`)."""

    survey: CanSurvey
    roles: Roles

    @property
    def title(self) -> str:
        """Name of the log, and how many identifiers were heard."""
        return f"{self.survey.name}, {len(self.survey.messages)} identifiers"

    def show(self, out: Console) -> None:
        """Print identifiers, and which signals measure the motion of the car."""
        show(self.survey, self.roles, out, every=False)

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
    frames = survey(log, databases)
    return CanContent(frames, recognize(frames))
