"""What a kernel for the errorEKF's covariance would gain: a model of its clocks, beside counted operations.

There are no sources of this kernel. Its schedule is that of the units of hw/rtl: P lanes, each with a product and a sum
of binary32 in every clock and every P-th column of the covariance in a memory of its own. The covariance stays there. A
step sends what changes it; each sensor sends the rows of its Jacobian, its innovation and variances, and gets the error
of the state, and for the parameters of an SPI the gain. After the last sensor the covariance is read for what is
published. What is missing: sources and their bits, resources by Yosys, the clock by place and route, and the estimates
with a covariance in binary32 beside the rest in double precision.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from vsense_ros.assess.flop import flop_of_covariance
from vsense_ros.assess.partition import Device, profile
from vsense_ros.model.coordinates import COORDINATES, ROAD, SURFACE
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.observer.sensors import sensors_of
from vsense_ros.observer.state import FOLLOWED, GAIN_COLUMNS, U, layout


@dataclass(frozen=True)
class Request:
    """Products of the processor, each with its sum, that a request is in place of; clocks of the kernel, and words."""

    products: float
    clocks: float
    words: int


@dataclass(frozen=True)
class CovarianceModel:
    """A step with and without the kernel [µs]; `accelerator_us` is within the former, and `processor_us` the rest."""

    lanes: int
    alone_us: float
    processor_us: float
    accelerator_us: float
    covariance_us: float  # what the processor needs for the covariance, where it has no kernel
    clocks: int
    words: int
    requests: int

    @property
    def step_us(self) -> float:
        return self.processor_us + self.accelerator_us


@dataclass(frozen=True)
class Lanes:
    """How many columns there are in a clock, and clocks until a sum may be used (a product, a sum, and the memory)."""

    count: int = 15
    latency: int = 14
    division: int = 16  # clocks of a quotient; those of a root are taken to be twice as many
    half: float = 0.5  # of what is symmetric
    filled: int = 20  # columns of a Jacobian that are not zero, of a sensor without accelerations

    def rows(self, rows: int, terms: int, width: int, share: float = 1.0) -> Request:
        """`rows` rows of so many columns, each a sum of terms: as many sums at once as the latency hides. The processor
        makes a `share` of the products: half of what is symmetric, and none with zeros."""
        slots = rows * terms * -(-width // self.count)
        return Request(share * rows * terms * width, max(slots, terms * self.latency) + self.latency, 0)


def step_requests(n: int, lanes: Lanes) -> list[Request]:
    """The parts of a step of the covariance, as `propagate` of observer/car_blocks.c has them."""
    q, gain, slow = COORDINATES, len(GAIN_COLUMNS), n - U.stop
    road, followed = ROAD.stop - ROAD.start, len(FOLLOWED)
    pose = 3 + 6 + SURFACE.stop - SURFACE.start  # attitude, velocities, form of the road
    words = q * gain + 6 * pose + road * followed + 2 * slow + 8
    velocities = [lanes.rows(q, gain, n), lanes.rows(q, gain, q, lanes.half)]  # with all, then with themselves
    coordinates = [lanes.rows(6, pose, width) for width in (n, q)] + [lanes.rows(q - 6, 1, width) for width in (n, q)]
    surface = [lanes.rows(road, followed, n), lanes.rows(road, followed, road, lanes.half)]
    return [*velocities, *coordinates, *surface, lanes.rows(slow, 1, n, lanes.half), Request(0, 0, words)]


def correction_requests(n: int, size: int, columns: int, learns: bool, lanes: Lanes) -> list[Request]:
    """The parts of a correction by a sensor with so many components, whose Jacobian has so many columns."""
    triangle = size * (size + 1) // 2
    factored = size * (3 * lanes.division + size * lanes.latency)  # one element after the other
    words = size * (columns + 2) + 2 + n + size + triangle + 2 + (size * n if learns else 0)
    share = 1.0 if columns >= len(GAIN_COLUMNS) else lanes.filled / columns
    return [
        lanes.rows(size, columns, n, share), lanes.rows(size, size, n, lanes.half), Request(size**3 / 6, factored, 0),
        lanes.rows(size, (size + 1) // 2, n), lanes.rows(1, size, n), lanes.rows(n, size, n, lanes.half),
        *([lanes.rows(size, (size + 1) // 2, n)] if learns else []), Request(0, 0, words),
    ]  # fmt: skip


def requests(vehicle: Vehicle, lanes: Lanes) -> Iterator[Request]:
    """The requests of a step with every sensor once: the step, each sensor, and the covariance that is read."""
    sensors, learns = sensors_of(vehicle), bool(vehicle.observer.parameters)
    n = layout(sensors).size
    yield _together(step_requests(n, lanes))
    for sensor in sensors.values():
        if not sensor.is_input:
            columns = len(GAIN_COLUMNS) if sensor.uses_acceleration else len(GAIN_COLUMNS) - COORDINATES
            columns += bool(sensor.biases())
            yield _together(correction_requests(n, len(sensor.deviations()), columns, learns, lanes))
    yield Request(0, 0, n * (n + 1) // 2)


def _together(parts: list[Request]) -> Request:
    return Request(*(sum(getattr(part, name) for part in parts) for name in ("products", "clocks", "words")))


def model_of(vehicle: Vehicle, device: Device, iterations: float, lanes: Lanes | None = None) -> CovarianceModel:
    """A step of the simplified car's observer, of an SPI where the vehicle lists parameters, with every sensor in it.

    What the processor does for the covariance is counted as observer/car_blocks.c does it without vectors, which is
    less than `flop_of_covariance`, of whole matrices. Processor and kernel never work at the same time.
    """
    chosen = lanes or Lanes()
    every = list(requests(vehicle, chosen))
    clocks, words = round(sum(one.clocks for one in every)), sum(one.words for one in every)
    covariance = 2.0 * sum(one.products for one in every)
    rest = profile(vehicle, False, iterations).flop - flop_of_covariance(vehicle)
    per_clock = max(1, device.stream_bits // 32)
    accelerator = len(every) * device.setup_us + (clocks + words / per_clock) / device.clock_mhz
    processor, spent = device.processor_us(rest), device.processor_us(covariance)
    return CovarianceModel(chosen.count, processor + spent, processor, accelerator, spent, clocks, words, len(every))
