"""What a filter offers to its runner, beyond `Filter`: how it starts, what it can leave out, move and publish."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import singledispatch
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from vsense_ros.errors import InputError
from vsense_ros.estimation.filter import Filter, Given, Innovation
from vsense_ros.estimation.intake import Intake
from vsense_ros.estimation.timeline import Channel, Event, Timeline
from vsense_ros.messages.diagnostic import Diagnostic
from vsense_ros.messages.recording import Sample
from vsense_ros.model.sensors import MeasuredQuantity, SensorBase
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.observer.monitor import Limits, Monitor
from vsense_ros.runner.guard import Vitals
from vsense_ros.runner.inertial_axes import InertialAxes

Array = NDArray[np.float64]


MakeFilter = Callable[[Vehicle, dict[str, SensorBase]], Filter]  # of a vehicle with these sensors
Report = Callable[[int, Array], None] | None  # of statistics, as `Monitor` makes them


class Move(NamedTuple):
    """A jump of an element of the state: its place, by how much, and the standard deviation of its error afterwards."""

    element: int
    by: float
    deviation: float


class Placing(NamedTuple):
    """Put an element of the state where it is known to be, whatever it was; `deviation` is its new one."""

    element: int
    value: float
    deviation: float
    known: float = 1.0  # which distinguishes it from a `Move` where both are numbers alone


class Widening(NamedTuple):
    """An element of the state whose variance grows by so much, as its error may have changed meanwhile."""

    element: int
    variance: float


class Apart(NamedTuple):
    """How far apart the motions are that sensors in an open contradiction measure, as standard deviations."""

    ahead: float = 0.0  # of the velocity [m/s]
    across: float = 0.0  # of the velocity [m/s]
    yaw_rate: float = 0.0  # [rad/s]
    place: float = 0.0  # [m] east and north
    heading: float = 0.0  # [rad]
    along: float = 0.0  # of the place, in the direction in which the car points [m]


class Adapter(ABC):
    """One filter of one vehicle, as the runner works with it.

    A subclass overrides what its filter has. The defaults are those of a filter without it: no axis is left out and
    nothing is moved.
    """

    filter: Filter
    sensors: dict[str, SensorBase]  # that the filter can use, by name
    merge: float = 0.0  # [s] within which readings of a sensor that is faster are averaged
    in_one_call: bool = False  # True: readings that are repeated may act without `correct`, in one call of the filter
    has_position: bool = False  # True: it estimates where the car is on the map
    monitor: Monitor | None = None  # of the fit of its model, once somebody watches it
    left_out: str = ""  # effects of the vehicle file that the filter does not have, as a sentence
    heading_known: bool = True  # False while the direction of the car on the map is not
    knows_car: bool = False  # True: it has all axles, so that whole sensors can be left out
    lateral_force_error: float = (
        0.0  # [m/s²] deviation stated of the lateral force that the model lacks; 0: not estimated
    )
    heading_element: int | None = None  # of the state, where velocities alone show the heading, and resets may turn it
    steering_error: int | None = None  # element of the state that is the error of the measured steering angle

    def __init__(self, filter: Filter, vehicle: Vehicle, inertial: InertialAxes | None = None) -> None:
        self.filter, self.vehicle = filter, vehicle
        self.inertial = inertial or InertialAxes(filter)
        self.name: str = getattr(filter, "name", type(filter).__name__)  # what to call the filter in a message

    def attach(self, intake: Intake[SensorBase], timeline: Timeline) -> None:
        """Take note of the intake and the timeline that the runner has made for this filter."""
        self.intake, self.timeline = intake, timeline

    def measures(self, index: int) -> frozenset[MeasuredQuantity]:
        """What the sensor at a place measures."""
        return self.intake.sensors[index].measures

    def uses(self, sensor: str) -> bool:
        """True if readings of this sensor do anything."""
        return True

    @abstractmethod
    def channels(self) -> list[Channel]:
        """What the readings of each sensor are to the filter, in the order of `sensors`."""

    def timed(self, event: Event) -> Event:
        """The reading at the time for which the filter takes it."""
        return event

    @property
    def forward_speed(self) -> float:
        """Speed of the car, forward [m/s]; 0 where it is not estimated."""
        return 0.0

    @property
    def lateral_speed(self) -> float:
        """Speed of the car's centre of gravity, to the left [m/s]; 0 where it is not estimated."""
        return 0.0

    @property
    def yaw_rate(self) -> float:
        """Yaw rate of the car, to the left [rad/s]; 0 where it is not estimated."""
        return 0.0

    @property
    def first_speeds_apart(self) -> float:
        """By how much the speeds contradicted each other from which the filter has started [m/s]."""
        return 0.0

    @property
    def velocity_deviations(self) -> tuple[float, float]:
        """Standard deviations of a velocity over ground in the axes of the car, along and across: of the speeds, and of
        the heading that turns them [m/s]; 0 where they are not estimated."""
        return 0.0, 0.0

    @property
    def heading(self) -> float:
        """Direction of the car on the map [rad]; 0 where it is not known."""
        return 0.0

    @property
    def missing_lateral_force(self) -> float:
        """Lateral force that the filter has found the model to lack, over the mass [m/s²]."""
        return 0.0

    @property
    @abstractmethod
    def moving(self) -> bool:
        """True while the car moves so fast that no sensor may repeat its value."""

    # Start

    @abstractmethod
    def gather(self, event: Event) -> int | None:
        """Keep a reading from before the start; the time [ns] to start at, once the readings suffice."""

    @abstractmethod
    def start(self, stamp: int) -> None:
        """Start the filter with the readings that were gathered."""

    @abstractmethod
    def stop(self, valid: bool) -> None:
        """Forget the readings that were gathered, to start anew; the state is spoilt if it is not `valid`."""

    @abstractmethod
    def waiting(self) -> str:
        """What the filter lacks before it can start, in words."""

    def contradicts_start(self, event: Event) -> bool:
        """True for a reading that contradicts the others while the filter is still unsure; it is then refused."""
        return False

    # Readings

    def measured(self, event: Event) -> None:  # noqa: B027
        """Take note of a reading before it acts on the filter."""

    def accepts(self, event: Event) -> bool:
        """False for a reading that cannot correct the filter yet, because the heading is not known."""
        return True

    def give(self, channel: Channel, event: Event) -> None:
        """Set the inputs that a reading consists of."""
        assert channel.first_input is not None
        self.filter.give(Given(channel.first_input, event.value))

    def correct(self, channel: Channel, event: Event) -> Innovation:
        """Let a reading correct the filter."""
        return self.filter.correct(channel.name, event.value, event.variance, channel.limit)

    def pull(self, channel: Channel, event: Event, nis: float) -> None:
        """Draw the filter towards a reading that is refused, as far as one at the edge of its gate would."""
        self.filter.correct(channel.name, event.value, event.variance, 2 * channel.limit, nis / channel.limit)

    def after_event(self) -> None:  # noqa: B027
        """Do what follows on every reading that has acted."""

    def bias(self, sensor: int, axis: int, jump: float) -> tuple[int, float] | None:
        """Element of the state that is the bias of an axis which is believed again, and its standard deviation then;
        None to keep what is known of it. Readings have differed by `jump` from what was expected, on average."""
        return None

    # The steering

    def steering_offset(self) -> float:
        """Measured road-wheel angle over the actual one, as estimated [rad]; 0 where it is not."""
        return 0.0

    def place(self, placing: Placing) -> None:
        """Put an element of the state where it is known to be."""
        raise NotImplementedError

    def usual_deviation(self, element: int) -> float:
        """Standard deviation of the error of an element of the state at start."""
        raise NotImplementedError

    def widen(self, widening: Widening) -> None:
        """Let the variance of an element of the state grow."""
        raise NotImplementedError

    def doubted_motion(self, apart: Apart, way: float) -> list[Widening]:
        """What is to be widened where velocities may be wrong by so much, and the place by `way` [m]."""
        return []

    def place_antennas(self, ahead: float, bend: float) -> list[Widening]:
        """Take GNSS antennas to sit so much further ahead than the vehicle file says [m]; what is to be widened then,
        as it was wrong in bends of a curvature [1/m]."""
        return []

    # Resets

    def difference(self, event: Event, innovation: Innovation) -> tuple[Array, Array] | None:
        """What a refused place or velocity has beyond the filter's, east and north (2,), and its standard deviation
        (2,); None if the filter does not compare them on the map."""
        return None

    def moves(self, sensor: SensorBase, difference: Array, deviation: Array) -> list[Move]:
        """Jumps that bring the filter to where a sensor says the car is, or as fast as it says; empty if it has none.
        `difference` (2,) is east and north."""
        return []

    def move(self, move: Move) -> None:
        """Let an element of the state jump; its error has no correlation afterwards."""
        raise NotImplementedError

    def turn_around(self, turned: bool) -> None:
        """The car goes the other way, and points there if it is `turned`: begin anew so."""
        raise NotImplementedError

    def begin_anew(self, event: Event) -> bool:
        """Start from a reading that shows the heading to be wrong; False if it does not."""
        return False

    # Results

    @abstractmethod
    def converged(self, seconds: float) -> bool:
        """True if the estimates may be used, this long after the start [s]."""

    @abstractmethod
    def condition(self, converged: bool) -> str:
        """How far the filter has converged, in words."""

    @abstractmethod
    def snapshot(self, stamp: int) -> Any:
        """The newest state, to be kept."""

    def widen_published(self, snapshot: Any, apart: Apart) -> None:  # noqa: B027
        """Add to the covariances of a state that is to be published what an open contradiction leaves undecided."""

    @abstractmethod
    def vitals(self, snapshot: Any) -> Vitals:
        """What shows whether the filter has diverged."""

    def aged(self, seconds: float) -> None:  # noqa: B027
        """The state is now one of so many seconds before: widen what has changed since."""

    def watch(self, snapshot: Any, converged: Callable[[], bool]) -> None:  # noqa: B027
        """Look at a newest state for what diagnostics report."""

    def complete(self) -> None:  # noqa: B027
        """Fill in what states that were looked at still lack, because it is computed for many at once."""

    @abstractmethod
    def messages(self, snapshot: Any) -> Iterable[Sample]:
        """One state as the messages of the output topics, the odometry first."""

    @abstractmethod
    def columns(self, snapshots: Sequence[Any]) -> list[Sample]:
        """States as the messages of the output topics, whose fields have one row for each."""

    @abstractmethod
    def parameters(self, snapshot: Any) -> dict[str, tuple[float, float]]:
        """Slow quantities by name: value and standard deviation."""

    def monitored(
        self, gates: Sequence[float], ready: Callable[[], bool], limits: Limits | None, report: Report
    ) -> Monitor:
        """A monitor of how well the model fits. Raises `InputError` for a filter without a model of the car."""
        raise InputError(f"the filter {self.name!r} has no model of the car to be judged")

    def doubt(self, sensor: str) -> str:
        """What is doubtful about a sensor that is in use, in words; empty for nothing."""
        return ""

    @property
    def doubts(self) -> list[str]:
        """What the drive shows to be wrong in the vehicle file, in words, for the observer's own line of
        diagnostics."""
        return []

    @property
    def details(self) -> Mapping[str, str]:
        """What the observer's own line of diagnostics lists besides."""
        return {}

    def diagnostics(self) -> list[Diagnostic]:
        """Lines besides those of the observer and the sensors."""
        return []

    @property
    def steering_angle(self) -> float:
        """Road-wheel angle that drives the filter [rad]; 0 if it has no such input."""
        return 0.0


@singledispatch
def adapter_of(filter: Filter, vehicle: Vehicle, sensors: dict[str, SensorBase]) -> Adapter:
    """The adapter of a filter. Raises `InputError` for a filter that none is registered for."""
    raise InputError(
        f"the filter {type(filter).__name__} does not say how it starts and what it publishes: register an Adapter for "
        "it with vsense_ros.runner.adapter.adapter_of"
    )
