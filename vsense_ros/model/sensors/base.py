"""What all sensors have in common, and what a kind of sensor says of itself to the rest of the project."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache
from math import inf
from typing import Annotated, Any, ClassVar, Literal

import casadi as ca
import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from vsense_ros.model.motion import Motion
from vsense_ros.model.parameter import Part, parameter
from vsense_ros.model.schema.observer_settings import Disturbances
from vsense_ros.model.schema.physics import NominalPhysics
from vsense_ros.model.sensors.simulated import Content, Sampling, SimulatedDrive

Vector = NDArray[np.float64]
Names = tuple[str, ...]  # of the joints in a JointState
Values = Mapping[str, Vector]  # fields of a message by name

Length = Annotated[float, Field(ge=-20, le=20)]
Angle = Annotated[float, Field(ge=-6.2832, le=6.2832)]
Deviation = Annotated[float, Field(gt=0)]
Position = tuple[Length, Length, Length]
Attitude = tuple[Angle, Angle, Angle]
Deviations = tuple[Deviation, Deviation, Deviation]
NoiseFromMessage = Annotated[
    bool, Field(description="covariances of messages count; of an inertial sensor, those that are larger than here")
]

# What a kind of sensor measures of the car, for whoever needs that from whichever kind:
# - rates and forces: three body rates [rad/s] and three specific forces [m/s²], in the axes of its mounting;
# - rolling speed: spin speeds of the wheels fl, fr, rl, rr [rad/s];
# - ground speed: how fast the car moves over ground;
# - course: velocity to the east and to the north [m/s], hence the direction of travel;
# - heading: direction of the car on the map; position: east and north [m];
# - tilt: roll and pitch of the body over the horizon [rad];
# - steering: road-wheel angle [rad], rear steering: that of the rear wheels;
# - torques: of the wheels fl, fr, rl, rr [N m];
# - articulation: angle from the car's heading to that of its trailer [rad].
MeasuredQuantity = Literal[
    "rates and forces",
    "rolling speed",
    "ground speed",
    "course",
    "heading",
    "tilt",
    "position",
    "height",
    "steering",
    "rear steering",
    "torques",
    "articulation",
]
_OF_THE_MAP: frozenset[MeasuredQuantity] = frozenset({"course", "heading", "position"})


@dataclass(frozen=True)
class Bias:
    """A slowly varying error of a sensor: a random walk, or a decaying one where `time_constant` is finite.

    `deviation` is the standard deviation at start, `drift` that of the change after one second (random walk), or
    ignored where a time constant [s] keeps the standard deviation at `deviation`.
    """

    name: str
    deviation: float
    drift: float
    time_constant: float = inf
    unit: str = "-"


@dataclass(frozen=True)
class Component:
    """One of the numbers that a sensor gives: a `name` in a list beside the sensor's own, in whole `words`, and its
    unit."""

    name: str
    words: str
    unit: str = ""


@dataclass(frozen=True)
class Quantity:
    """One of the numbers of a measurement for other programs: its `path` below the name of the sensor, as
    `angular_velocity.z`, its unit, and what it is about which axis."""

    path: str
    unit: str
    meaning: str


@dataclass(frozen=True)
class ComparedSignal:
    """What the search for missing physics compares between a recording and a simulation: `name`, its unit, and how it
    comes from a sensor's components (n, m) in the axes of the car, given the rolling radius [m].

    `floor` is the smallest standard deviation that is believed. A `drifting` signal is compared up to a constant and a
    slope in each window, because it depends on a heading that nothing measures. A `shaken` one has in it what an uneven
    road does to the body. From a `turning` one the integral of the yaw rate is taken off.
    """

    name: str
    unit: str
    make: Callable[[Vector, float], Vector]
    floor: float
    drifting: bool = False
    shaken: bool = False
    turning: bool = False


@dataclass(frozen=True)
class Response:
    """How a car answers an input, by which one that is frozen is distinguished from one that is held.

    `component` is that of the rates and forces which answers, `by_speed` whether it does so times the speed; `least` is
    the change [m/s²] that does not happen without one of the input. `words` name the input in a sentence.
    """

    component: int
    by_speed: bool
    least: float
    words: str


def component(index: int) -> Callable[[Vector, float], Vector]:
    """The signal that is one of a sensor's components."""
    return lambda value, radius: value[:, index]


class Transmission(Part):
    """How a simulated sensor's values come over a bus such as CAN, where that is not as usual for its kind: in steps,
    within a range, at a rate, late. Values are those of the messages, in their units; one number stands for all, or
    there is one for each."""

    period: float | None = parameter(
        "s", "time between two measurements, in whole milliseconds", ge=0.001, default=None
    )
    delay: float | None = parameter("s", "delay from measurement to arrival", ge=0, le=5, default=None)
    resolution: tuple[Deviation, ...] = parameter("SI", "steps of the values", default=())
    range: tuple[Deviation, ...] = parameter("SI", "largest amounts of the values, beyond which they stay", default=())

    def of(self, usual: Sampling) -> Sampling:
        """The sampling of a kind, changed by this."""
        changes: dict[str, Any] = {}
        if self.period is not None:
            period = max(1, round(self.period * 1e3))
            changes |= {"period": period, "phase": min(usual.phase, period - 1)}
        if self.delay is not None:
            changes["delay"] = round(self.delay * 1e3)
        if self.resolution:
            changes["quantum"] = self.resolution
        if self.range:
            changes["limit"] = self.range
        return replace(usual, **changes)


class SensorBase(Part):
    """Where a sensor's messages come from and how far they can be trusted; as a class, all that its kind is.

    A kind overrides what concerns it of the class attributes and methods. What it leaves out, nobody asks of it.
    """

    # Its messages.
    message: ClassVar[str] = ""  # message type
    joints: ClassVar[Names] = ()  # names of the joints that may be in a JointState
    geodetic: ClassVar[bool] = False  # True: `read` finds `east` and `north` [m] beside latitude and longitude
    # What it measures.
    place: ClassVar[int] = 100  # in lists of kinds, least first; those with the same by name
    words: ClassVar[str] = ""  # what it gives, after "it needs"
    measures: ClassVar[frozenset[MeasuredQuantity]] = frozenset()
    components: ClassVar[tuple[Component, ...]] = ()  # those that mean something one by one
    quantities: ClassVar[tuple[Quantity, ...]] = ()  # each number of a measurement that corrects, in their order
    signals: ClassVar[tuple[ComparedSignal, ...]] = ()
    # What it is to a filter.
    uses_acceleration: ClassVar[bool] = False  # True: the equation refers to the accelerations
    inputs: ClassVar[slice | None] = None  # of the model, which its values drive instead of correcting it
    of_trailer: ClassVar[bool] = False  # True: it measures what filters of the car alone do not know
    awaited: ClassVar[float] = 0.0  # [s] for which a filter that could start waits for the first message
    # How its errors look.
    noise_fields: ClassVar[Names] = ("noise",)  # that state its standard deviations; without them it has none
    states_noise: ClassVar[bool] = True  # False: its messages have no place for standard deviations
    # A message's standard deviation below this share of the vehicle file's does not count: a thousandth of it is a
    # number that somebody put there, no measurement.
    least_stated: ClassVar[float] = 1e-3
    sampling: ClassVar[Sampling | None] = None  # in a simulation; None: it gives nothing there
    noisy: ClassVar[bool] = False  # True: noise makes equal messages in a row impossible
    longest_still: ClassVar[float] = inf  # [s] for which a component may keep its value in a moving car …
    longest_still_if_coarse: ClassVar[float] = 10.0  # [s] … if it takes few values
    saturates: ClassVar[bool] = False  # True: components that stay at the end of their range are at its limit
    response: ClassVar[Response | None] = None  # of the car to this input

    kind: str = Field(description="what it is")
    topic: str = Field(description="topic of its messages")
    frame_id: str = Field(default="", description="expected frame of the messages; empty: any")
    latency: float = parameter("s", "age of a measurement at its stamp", ge=-1, le=5, default=0.0)
    gate: float = parameter(
        "-", "a measurement is rejected if its innovation exceeds this many standard deviations", gt=0, default=6.0
    )
    timeout: float = parameter("s", "silence after which the sensor counts as lost", gt=0, default=0.5)
    transmission: Transmission | None = Field(description="how its values come in a simulation", default=None)

    @property
    def simulated_sampling(self) -> Sampling | None:
        """When it measures in a simulation, and in which steps; None: it gives nothing there."""
        if self.sampling is None or self.transmission is None:
            return self.sampling
        return self.transmission.of(self.sampling)

    @property
    def is_input(self) -> bool:
        """True if its values drive the model instead of correcting it."""
        return self.inputs is not None

    @property
    def on_map(self) -> bool:
        """True if it measures something that refers to north."""
        return bool(self.measures & _OF_THE_MAP)

    @property
    def measures_speed(self) -> bool:
        """True if it measures the car's speed."""
        return not self.measures.isdisjoint({"rolling speed", "ground speed"})

    def longest(self, *, coarse: bool) -> float:
        """For how long a component may keep its value in a moving car [s]; `coarse` if it takes few values."""
        return max(self.longest_still, self.longest_still_if_coarse if coarse else 0.0)

    def of_car(self, physics: NominalPhysics) -> SensorBase:
        """The sensor with what it takes over from the car."""
        return self

    def of_surroundings(self, around: Disturbances) -> SensorBase:
        """The sensor with what it takes over from the observer's settings."""
        return self

    def biases(self) -> tuple[Bias, ...]:
        """Errors to be estimated along with the state."""
        return ()

    def mounting(self) -> Vector:
        """Constants of the sensor's equation, (k,)."""
        return np.zeros(0)

    def deviations(self) -> Vector:
        """Standard deviation of each component where a message does not give one, (m,)."""
        raise NotImplementedError

    def noise_in_words(self, deviations: Vector) -> str:
        """Standard deviations (m,) with their units: one number for those that are equal. Empty for a sensor without
        noise."""
        parts, first = [], 0
        for field in self.noise_fields:
            extra = type(self).model_fields[field].json_schema_extra if field in type(self).model_fields else None
            if not isinstance(extra, dict):
                continue
            value = getattr(self, field)
            count = len(value) if isinstance(value, tuple) else len(deviations) - first
            numbers = [f"{number:.3g}" for number in deviations[first : first + count]]
            parts.append(f"{' '.join(numbers if len(set(numbers)) > 1 else numbers[:1])} {extra['unit']}")
            first += count
        return ", ".join(parts)

    def offsets(self) -> Vector:
        """Known errors of the components, which whoever calls `read` takes off, (m,)."""
        return np.zeros(len(self.deviations()))

    def read(self, names: Names, values: Values, out: Vector, variance: Vector) -> None:
        """Fill `out` (m,) and `variance` (m,) from the fields of a message; NaN marks an absent component."""
        raise NotImplementedError

    def read_rows(self, names: Names, columns: Values, out: Vector, variance: Vector) -> None:
        """As `read`, of n messages at once: columns (n, length), `out` (n, m) and `variance` (n, m)."""
        for i in range(len(out)):
            self.read(names, {field: column[i] for field, column in columns.items()}, out[i], variance[i])

    def equation(self, motion: Motion, biases: ca.SX, mounting: ca.SX) -> ca.SX:
        """What the sensor would measure, (m,), as a function of a `Motion`."""
        raise NotImplementedError

    def simulated(self, drive: SimulatedDrive) -> Content:
        """Values of the sensor's messages on a simulated drive, errors included."""
        raise NotImplementedError

    def first_speed(self, value: Vector, physics: NominalPhysics) -> float | None:
        """Speed of a car at start [m/s] that a measurement (m,) gives, NaN if it is not known well; None if it gives
        none."""
        return None

    def first_velocities(self, value: Vector) -> dict[int, float]:
        """What a measurement (m,) says of the other velocities at start: values by their place in `u` (coordinates.py,
        rad/s or m/s)."""
        return {}

    def heading(self, value: Vector, variance: Vector) -> tuple[float, float] | None:
        """Direction of the car on the map [rad] that a measurement (m,) with its variance (m,) gives by itself, and its
        standard deviation."""
        return None

    def speeds(self, value: Vector, radii: Vector) -> Vector:
        """Speeds of the car [m/s] that measurements (n, m) give, (n,), NaN where absent; `radii` (4,) are the rolling
        radii of its wheels [m]. For kinds that measure a speed."""
        raise NotImplementedError

    def ages(self) -> Vector:
        """Age of each component at its stamp [s], (m,)."""
        return np.full(len(self.deviations()), self.latency)

    def mean_speed(self, value: Vector, radius: float) -> Vector:
        """Speeds of the car [m/s] that measurements (n, m) give with one rolling radius [m], (n,), NaN where any
        component is absent."""
        raise NotImplementedError

    def in_axes_of_car(self, value: Vector) -> Vector:
        """Measurements (n, m) with vectors in the axes of the car, where the sensor is mounted in others."""
        return value

    def message_in_axes_of_car(self, columns: Values) -> dict[str, Any]:
        """The columns of a recorded channel that change if its vectors are expressed in the axes of the car."""
        return {}


class JointSensor(SensorBase):
    """A sensor of as many numbers as it has `joints`, all in one field of a JointState; any of them may be absent."""

    message: ClassVar[str] = "sensor_msgs/msg/JointState"
    states_noise: ClassVar[bool] = False
    field: ClassVar[str]  # position, velocity or effort

    def read(self, names: Names, values: Values, out: Vector, variance: Vector) -> None:
        by_name(names, self.joints, values.get(self.field), out)

    def read_rows(self, names: Names, columns: Values, out: Vector, variance: Vector) -> None:
        if type(self).read is JointSensor.read:
            by_name(names, self.joints, columns[self.field].T, out.T)
        else:  # a kind that reads its messages otherwise
            super().read_rows(names, columns, out, variance)

    def simulated(self, drive: SimulatedDrive) -> Content:
        value = drive.truth if self.is_input else disturbed(self, drive)
        return joint_state(self.field, drive.digitized(value), self.joints)


def disturbed(sensor: SensorBase, drive: SimulatedDrive) -> Vector:
    """The truth of a simulated drive, (n, m), with biases and noise as the sensor states them, and the known errors
    that reading takes off."""
    value = drive.truth + sensor.offsets()
    for i, bias in enumerate(sensor.biases()):
        value[:, i] += drive.bias * bias.deviation * drive.rng.standard_normal()
    return value + sensor.deviations() * drive.rng.standard_normal(value.shape)


def joint_state(field: str, value: Vector, names: Names) -> Content:
    """The columns of a JointState with values (n, joints) in one field."""
    columns = {name: np.zeros((len(value), 0)) for name in ("position", "velocity", "effort")}
    return Content({**columns, field: value}, names)


def covariance_diagonal(flat: Vector | None, size: int) -> Vector | None:
    """Diagonal of a row-major covariance, or None where it is absent (-1) or unknown (zeros)."""
    return None if flat is None else _diagonal(flat.tobytes(), size)


@lru_cache(maxsize=64)
def _diagonal(flat: bytes, size: int) -> Vector | None:
    """Kept, because most sensors send the same covariance for ever."""
    covariance = np.frombuffer(flat)
    if len(covariance) == 0 or covariance[0] <= 0:
        return None
    diagonal = covariance[:: int(len(covariance) ** 0.5) + 1][:size]
    return diagonal if diagonal.min() > 0 else None


def by_name(names: Names, joints: Names, values: Vector | None, out: Vector) -> None:
    """Pick the elements of a JointState's field by joint name; NaN where a joint is missing."""
    if values is not None and names == joints and len(values) == len(names):
        out[:] = values
        return
    out[:] = np.nan
    if values is None or len(values) != len(names):
        return
    for i, name in enumerate(joints):
        if name in names:
            out[i] = values[names.index(name)]
