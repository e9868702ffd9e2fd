"""A tyre with too little pressure."""

from __future__ import annotations

from typing import ClassVar

from vsense_ros.model.coordinates import WHEELS
from vsense_ros.model.effects.base import Effect, shape, size
from vsense_ros.model.schema.physics import Axle

STIFFNESS_SHARE = 0.75  # of the vertical stiffness that the pressure carries, the rest is the carcass
RESISTANCE = 0.8  # relative growth of rolling resistance per relative loss of pressure


class TyreUnderinflation(Effect):
    """Less pressure: softer, so that the wheel rolls on a smaller radius, with more resistance, and corners less (as
    the Magic Formula has it with pressure; Besselink, Schmeitz & Pacejka 2010).
    """

    id: ClassVar[str] = "tyre_underinflation"
    sentence: ClassVar[str] = "a tyre with too little pressure"
    mistaken_for: ClassVar[tuple[str, ...]] = ("wheel_radius", "brake_drag")
    needs: ClassVar[tuple[str, ...]] = ("wheel_speeds",)

    fl: float = size("-", "relative loss of pressure, front left", typical=0.3, low=-0.5, high=0.9)
    fr: float = size("-", "relative loss of pressure, front right", typical=0.3, low=-0.5, high=0.9)
    rl: float = size("-", "relative loss of pressure, rear left", typical=0.3, low=-0.5, high=0.9)
    rr: float = size("-", "relative loss of pressure, rear right", typical=0.3, low=-0.5, high=0.9)

    cornering: float = shape(
        "-", "relative loss of cornering stiffness per relative loss of pressure", default=0.3, typical=0.2, low=-0.5,
        high=1.0,
    )  # fmt: skip

    def wheel(self, wheel: int, axle: Axle) -> Axle:
        loss = getattr(self, WHEELS[wheel])
        return axle.model_copy(
            update={
                "tyre_stiffness": axle.tyre_stiffness * (1 - STIFFNESS_SHARE * loss),
                "rolling_resistance": axle.rolling_resistance * (1 + RESISTANCE * loss),
                "cornering_scale": axle.cornering_scale * (1 - self.cornering * loss),
            }
        )
