"""Which wheels of a car are driven, and how brakes are shared between them: keys of a vehicle file."""

from __future__ import annotations

from typing import Literal

from pydantic import Field

from vsense_ros.model.parameter import Part, parameter


class Drivetrain(Part):
    """Which wheels can be driven and how brakes act, for observers that do not measure the wheels' torques.

    The axles of a differential share its torque equally. While the car decelerates less than `engine_braking`, its
    brakes are taken to be released, and a wheel that is not driven rolls freely.
    """

    driven: Literal["front", "rear", "all"] | None = Field(
        description="the driven axle, or all; if not stated, each wheel may be driven by itself", default=None
    )
    front_share: float = parameter(
        "-", "share of the driving torque on the front axle of a car that drives all", ge=0, le=1, default=0.5
    )
    front_brake_share: float = parameter(
        "-", "share of the braking torque on the front axle (UN R13-H asks for more than the rear's)", ge=0, le=1,
        default=0.65,
    )  # fmt: skip
    engine_braking: float = parameter(
        "m/s²", "deceleration, beyond that by air and slope, that engine or recuperation and rolling resistance cause "
        "without brakes", ge=0, default=0.5,
    )  # fmt: skip
    uneven: float = parameter(
        "-", "standard deviation of the torque that a wheel has for itself, as a share of that of all "
        "(observer.force_errors.wheel_spin)", gt=0, le=1, default=0.1,
    )  # fmt: skip
    free_torque: float = parameter(
        "N m", "standard deviation of the torque on a wheel that is neither driven nor braked: bearings, pads that "
        "touch, rolling resistance of another tyre or road", gt=0, default=5.0,
    )  # fmt: skip
    release_time: float = parameter("s", "time within which brakes are released", gt=0, default=0.2)

    @property
    def driving_shares(self) -> tuple[float, float, float, float] | None:
        """Share of each wheel fl, fr, rl, rr in the driving torque; None if it is not known what is driven."""
        if self.driven is None:
            return None
        front = {"front": 1.0, "rear": 0.0, "all": self.front_share}[self.driven]
        return front / 2, front / 2, (1 - front) / 2, (1 - front) / 2

    @property
    def braking_shares(self) -> tuple[float, float, float, float]:
        """Share of each wheel fl, fr, rl, rr in the braking torque."""
        front = self.front_brake_share
        return front / 2, front / 2, (1 - front) / 2, (1 - front) / 2
