"""What estimates look like in three dimensions: the way that the car came, and at each tyre its force in the circle of
what it could have."""

from __future__ import annotations

from dataclasses import dataclass
from math import atan2, cos, hypot, isfinite, pi, sin

import numpy as np
from foxglove.messages import (
    ArrowPrimitive,
    Color,
    LinePrimitive,
    LinePrimitiveLineType,
    Point3,
    Pose,
    Quaternion,
    SceneEntity,
    SceneUpdate,
    Timestamp,
    Vector3,
)

from vsense_ros.messages.recording import Sample
from vsense_ros.messages.topics import WHEELS
from vsense_ros.model.constants import GRAVITY
from vsense_ros.model.vehicle import Vehicle

PATH, TYRES = "vsense/view/path", "vsense/view/tyres"


@dataclass(frozen=True)
class SceneSettings:
    """How often and how large a car is drawn: decisions of this project."""

    tyres_every: int = 40_000_000  # [ns]
    path_every: int = 1_000_000_000  # [ns]
    path_step: float = 0.5  # [m]
    longest_path: int = 20_000  # points; then every second one goes
    usual_load: float = 4000.0  # [N] drawn as one metre where the car is not known
    near_the_limit: float = 0.85  # share of the circle from which on a force is red


SETTINGS = SceneSettings()

_CIRCLE = [(cos(2 * pi * i / 48), sin(2 * pi * i / 48)) for i in range(48)]
_BLUE, _GREY, _RED = (
    Color(r=0.1, g=0.45, b=0.9, a=1.0),
    Color(r=0.6, g=0.6, b=0.6, a=1.0),
    Color(r=0.9, g=0.1, b=0.1, a=1.0),
)
_NOWHERE = Pose(position=Vector3(), orientation=Quaternion(w=1.0))


class Scene:
    """Arrows and shapes that show one car; a length of one metre is the load of a wheel at rest, or 4000 N where the
    car is not known."""

    def __init__(self, vehicle: Vehicle | None = None, prefix: str = "") -> None:
        """`prefix` stands before the names of the car's frames."""
        self._prefix = prefix
        self._friction = None if vehicle is None else vehicle.physics.road.friction
        load = SETTINGS.usual_load if vehicle is None else vehicle.physics.chassis.mass * GRAVITY / 4
        self._scale = 1.0 / load
        self.forget()

    def forget(self) -> None:
        """The recording is shown from another place on."""
        self._path: list[tuple[float, float, float]] = []
        self._path_stamp = self._tyres_stamp = -(2**62)
        self._forces: dict[str, tuple[float, float, float]] = {}

    def add(self, sample: Sample) -> list[tuple[str, SceneUpdate]]:
        """What a message changes, with the topic to draw it on."""
        if sample.topic.endswith("vsense/odometry"):
            return self._on_odometry(sample)
        head, _, wheel = sample.topic.rpartition("/")
        if head.endswith("vsense/wheel_force") and wheel in WHEELS:
            return self._on_force(sample, wheel)
        return []

    def _on_odometry(self, sample: Sample) -> list[tuple[str, SceneUpdate]]:
        place = sample.values["position"].tolist()
        if not isfinite(place[0] + place[1]):  # the filter estimates none
            return []
        height = place[2] if isfinite(place[2]) else 0.0
        last = self._path[-1] if self._path else None
        if last is None or hypot(place[0] - last[0], place[1] - last[1]) > SETTINGS.path_step:
            self._path.append((place[0], place[1], height))
            if len(self._path) > SETTINGS.longest_path:
                del self._path[1::2]
        if len(self._path) < 2 or 0 <= sample.stamp - self._path_stamp < SETTINGS.path_every:
            return []
        self._path_stamp = sample.stamp
        line = LinePrimitive(
            type=LinePrimitiveLineType.LineStrip,
            pose=_NOWHERE,
            thickness=2.0,
            scale_invariant=True,
            points=[Point3(x=x, y=y, z=z) for x, y, z in self._path],
            color=_BLUE,
        )
        entity = SceneEntity(timestamp=_time(sample.stamp), frame_id=sample.frame_id, id="path", lines=[line])
        return [(PATH, SceneUpdate(entities=[entity]))]

    def _on_force(self, sample: Sample, wheel: str) -> list[tuple[str, SceneUpdate]]:
        x, y, z = np.nan_to_num(sample.values["force"]).tolist()  # a component that is absent is not drawn
        self._forces[wheel] = (x, y, z)
        if len(self._forces) < len(WHEELS) or wheel != WHEELS[-1]:
            return []
        if 0 <= sample.stamp - self._tyres_stamp < SETTINGS.tyres_every:
            return []
        self._tyres_stamp = sample.stamp
        entities = [self._tyre(sample.stamp, name) for name in WHEELS]
        return [(TYRES, SceneUpdate(entities=entities))]

    def sizes(self, wheel: str) -> tuple[float, float, float | None]:
        """Sizes that show a tyre: length of its force [m], that force's direction from ahead to the left [rad], and the
        radius of the circle of what it could have [m]; None where the car is not known."""
        x, y, z = self._forces[wheel]
        radius = None if self._friction is None else self._scale * self._friction * max(z, 0.0)
        return self._scale * hypot(x, y), atan2(y, x), radius

    def _tyre(self, stamp: int, wheel: str) -> SceneEntity:
        length, turned, radius = self.sizes(wheel)
        lines, color = [], _BLUE
        if radius is not None:
            color = _RED if length > SETTINGS.near_the_limit * radius else _BLUE
            lines = [
                LinePrimitive(
                    type=LinePrimitiveLineType.LineLoop,
                    pose=_NOWHERE,
                    thickness=2.0,
                    scale_invariant=True,
                    points=[Point3(x=radius * c, y=radius * s) for c, s in _CIRCLE],
                    color=_GREY,
                )
            ]
        head = min(0.15, 0.5 * length)
        arrow = ArrowPrimitive(
            pose=Pose(position=Vector3(), orientation=Quaternion(z=sin(turned / 2), w=cos(turned / 2))),
            shaft_length=length - head,
            shaft_diameter=0.04,
            head_length=head,
            head_diameter=0.1,
            color=color,
        )
        return SceneEntity(
            timestamp=_time(stamp),
            frame_id=f"{self._prefix}contact_{wheel}",
            id=f"tyre {wheel}",
            frame_locked=True,
            arrows=[arrow],
            lines=lines,
        )


def _time(stamp: int) -> Timestamp:
    return Timestamp(*divmod(stamp, 1_000_000_000))
