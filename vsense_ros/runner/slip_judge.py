"""Is the side slip one at which tyres hold the force that is felt? Else the car slides, or the estimate is astray.

A filter that believes a wrong gyro turns the measured velocity over ground by a heading that is wrong: what it has too
little across the car it takes for side slip, of many metres per second, and the forces that are missing for bank and
biases. The tyres of the rear axle tell it without the filter: up to where they slide, the lateral force on them makes
them slip by an angle in proportion (Riekert & Schunck 1940). An accelerometer feels that force. With a yaw rate r and
the distance b of the rear axle from cog, the lateral velocity there is

    v_y - b r = -c a_y v,    c the slip of the rear axle per lateral acceleration.

Where the estimate is elsewhere for longer than a transient lasts, the published lateral velocity is as uncertain as the
two are apart, and the estimate is no good one: a car that slides on ice is rare, and hard to tell from it, as is an
accelerometer that is wrong. Large accelerations say nothing, as tyres may slide there.
"""

from __future__ import annotations

from dataclasses import dataclass
from math import exp, isfinite

from vsense_ros.estimation.timeline import Event, Timeline
from vsense_ros.model.handling.base import car_numbers
from vsense_ros.model.sensors import place_of
from vsense_ros.runner.adapter import Adapter, Apart
from vsense_ros.runner.car_fit import axle_slips
from vsense_ros.runner.judge import Judge


@dataclass(frozen=True)
class SlipSettings:
    """When a side slip is none of this force: decisions of this project. On drives without a fault the lateral velocity
    of the rear axle stays within a third of these margins."""

    smoothing: float = 0.3  # [s] in which transients of slip and force are averaged
    linear: float = 4.0  # [m/s²] lateral acceleration up to which tyres do not slide, until
    remembered: float = 1.0  # [s] time constant after which the largest one is forgotten
    softer: float = 2.0  # [-] times the slip of the vehicle file, that other tyres may have
    bias: float = 1.0  # [m/s²] of the accelerometer, of which bank is a part
    least: float = 0.15  # [m/s] that the lateral velocities differ by in any case, and
    share: float = 0.01  # [-] of the speed: toe, mounting, heading
    slowest: float = 4.0  # [m/s] below which slip angles say little
    answered: float = 1.0  # [s] time constant with which a difference that is gone is forgotten


SLIP = SlipSettings()


class SlipJudge(Judge):
    """Watches the side slip of the rear axle of one car; it leaves nobody out."""

    def __init__(self, adapter: Adapter) -> None:
        super().__init__()
        self._adapter = adapter
        self.hears: frozenset[int] = frozenset()
        sensors = tuple(adapter.sensors.values())
        self.judged = adapter.knows_car and place_of(sensors, "rates and forces") >= 0
        if self.judged:
            accelerations, _, rear = axle_slips(adapter.vehicle)
            self._slip = float(rear[1] / accelerations[1])  # [rad s²/m] of the rear axle
            self._to_rear = car_numbers(adapter.vehicle)["to_rear"]
        self.forget(0)

    def forget(self, stamp: int) -> None:
        self._across = self._lateral = self._largest = 0.0  # [m/s] of the rear axle, [m/s²]
        self._apart_by = 0.0  # [m/s]

    @property
    def apart(self) -> Apart | None:
        return Apart(across=self._apart_by) if self._apart_by else None

    @property
    def doubts(self) -> list[str]:
        if not self._apart_by:
            return []
        return [f"lateral velocity is {self._apart_by:.1f} m/s from what the lateral force that is felt allows"]

    def hear(self, event: Event) -> None:
        """Nothing is heard."""

    def feel(self, stamp: int, h: float, felt: list[float]) -> None:
        adapter, lateral = self._adapter, felt[4]
        speed = adapter.forward_speed
        fade = exp(-h / SLIP.answered)
        self._apart_by = self._apart_by * fade if self._apart_by * fade > 0.5 * SLIP.least else 0.0
        if not isfinite(lateral) or not adapter.heading_known:
            return
        weight = 1 - exp(-h / SLIP.smoothing)
        self._across += weight * (adapter.lateral_speed - self._to_rear * adapter.yaw_rate - self._across)
        self._lateral += weight * (lateral - self._lateral)
        self._largest = max(self._largest * exp(-h / SLIP.remembered), abs(lateral))
        if abs(speed) < SLIP.slowest or self._largest > SLIP.linear:
            return
        per_force = self._slip * abs(speed)
        held = -SLIP.softer * per_force * self._lateral
        margin = SLIP.least + SLIP.share * abs(speed) + SLIP.bias * per_force
        beyond = max(self._across - max(held, 0.0), min(held, 0.0) - self._across) - margin
        if beyond > 0:
            self._apart_by = max(self._apart_by, beyond + margin)

    def settle(self, timeline: Timeline) -> None:
        """Nothing follows."""
