"""Cars whose files are off as those of strangers are: no right sensor is left out for longer than a moment."""

from __future__ import annotations

from typing import Any

import pytest
from click.testing import CliRunner

from studies.commands import main
from studies.fault_outcomes import LONGEST_OUT
from studies.healthy import times_out
from vsense_ros.bag.importers import import_recording
from vsense_ros.files.installed import shared_folder, vehicle_path
from vsense_ros.files.vehicle import load_vehicle
from vsense_ros.model.vehicle import Vehicle


def stranger(*, mass: float = 1.0, height: float = 1.0, stiffness: tuple[float, float], sure: float = 1.0) -> Vehicle:
    """The observer's car of the bags with so many times its mass, height of cog and cornering stiffness of the axles,
    and with errors of its lateral forces that are stated so many times smaller."""
    vehicle = load_vehicle(vehicle_path("prototype_model"))
    physics, errors = vehicle.physics, vehicle.observer.force_errors
    changed = {"mass": mass * physics.chassis.mass, "cog_height": height * physics.chassis.cog_height}
    front, rear = (
        axle.model_copy(update={"cornering_scale": scale * axle.cornering_scale})
        for axle, scale in zip((physics.front, physics.rear), stiffness, strict=True)
    )
    parts = {"chassis": physics.chassis.model_copy(update=changed), "front": front, "rear": rear}
    stated = errors.model_copy(update={"lateral": errors.lateral / sure, "yaw": errors.yaw / sure})
    observer = vehicle.observer.model_copy(update={"force_errors": stated})
    return vehicle.model_copy(update={"physics": physics.model_copy(update=parts), "observer": observer})


@pytest.mark.parametrize(
    ("bag", "numbers"),
    [
        ("brake_in_turn", {"stiffness": (0.8, 1.2)}),
        ("brake_in_turn", {"stiffness": (1.2, 0.8), "mass": 1.1}),
        ("brake_in_turn", {"stiffness": (0.8, 0.8), "height": 1.2}),
        ("double_lane_change", {"stiffness": (0.8, 1.2), "sure": 10.0}),
    ],
    ids=["understeers more", "understeers less, heavier", "softer, higher", "understeers more, with few doubts"],
)
def test_no_right_sensor_of_a_car_whose_file_is_off_by_a_share_is_left_out(bag: str, numbers: dict[str, Any]) -> None:
    times = times_out(import_recording(shared_folder("bags") / bag), stranger(**numbers))
    assert all(time.longest <= LONGEST_OUT for time in times.values()), times


def test_the_command_lists_what_is_left_out() -> None:
    done = CliRunner().invoke(main, ["healthy", "prototype_model", str(shared_folder("bags") / "double_lane_change")])
    assert done.exit_code == 0
    assert "double_lane_change" in done.output
    assert done.output.split()[-1] == "0.0"
