"""Which kernels of an observer are worth a given device: what Rodríguez 2020 left as future work.

A call of a kernel gains what the processor would have spent on it, less link and clocks of the hardware. The time of
the processor is counted in floating-point operations, by the cycles that one takes with its loads and stores.
All variants of all kernels that fit together are compared; where none gains anything, none is recommended.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from importlib import resources
from itertools import product
from pathlib import Path

import casadi as ca
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from vsense_ros import codegen
from vsense_ros.accelerator.kernels import KERNELS, Kernel
from vsense_ros.accelerator.link import Link
from vsense_ros.errors import InputError
from vsense_ros.files.installed import shared_folder
from vsense_ros.messages import yaml_text
from vsense_ros.model.car import steps
from vsense_ros.model.car.car import car_of
from vsense_ros.model.car.steps import sensor_function
from vsense_ros.model.coordinates import WHEELS
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.observer.observer import sensors_of
from vsense_ros.observer.state import layout

RESOURCES = ("dsp", "lut", "ff", "bram")
WORTH = 0.005  # share of a step below which a gain is none: the estimates are no better


class Device(BaseModel):
    """What a device has."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    name: str
    dsp: int = Field(ge=0)
    lut: int = Field(ge=0)
    ff: int = Field(ge=0)
    bram: int = Field(ge=0)
    clock_mhz: float = Field(gt=0)  # of the hardware
    stream_bits: int = Field(ge=32)
    setup_us: float = Field(ge=0)  # of a transfer
    processor_mhz: float = Field(gt=0)
    cycles_per_flop: float = Field(gt=0)

    @property
    def link(self) -> Link:
        return Link(self.clock_mhz, self.stream_bits, self.setup_us)

    def processor_us(self, flop: float) -> float:
        """Time of so many operations on the processor [µs]."""
        return flop * self.cycles_per_flop / self.processor_mhz


def load_device(text: str) -> Device:
    """A device by the path of its file, or the name of one in config/devices. Raises `InputError` by key."""
    path = Path(text)
    if not path.exists() and not path.suffix:
        folder = shared_folder("config") / "devices"
        known = sorted(file.stem for file in folder.glob("*.yaml"))
        if text not in known:
            raise InputError(f"no device {text!r}: neither a file nor one of {', '.join(known)}")
        path = folder / f"{text}.yaml"
    try:
        return Device.model_validate(yaml_text.load_file(path))
    except ValidationError as error:
        faults = "; ".join(f"{'.'.join(map(str, f['loc']))}: {f['msg']}" for f in error.errors())
        raise InputError(f"{path}: {faults}") from None


@dataclass(frozen=True)
class Use:
    """What an observer has to do with a kernel in a step."""

    kernel: Kernel
    calls: float  # in a step
    flop: float  # of a call, on the processor


@dataclass(frozen=True)
class Choice:
    """A variant of a kernel on a device."""

    use: Use
    variant: str
    cycles: int
    resources: dict[str, int]
    gain_us: float  # of a step; negative: a loss


@dataclass(frozen=True)
class Partition:
    """What is recommended."""

    device: Device
    step_us: float  # of the whole observer on the processor
    best: dict[str, Choice]  # the best variant of each kernel alone, whether it gains or not
    chosen: tuple[Choice, ...]

    @property
    def gain_us(self) -> float:
        return sum(choice.gain_us for choice in self.chosen)

    @property
    def speed_up(self) -> float:
        return self.step_us / (self.step_us - self.gain_us)


def flop_of_observer(vehicle: Vehicle) -> float:
    """Operations of a step of the errorEKF with every sensor once, counted in the expressions and the algebra."""
    return flop_of_filter(vehicle) + operations(steps.advance_function(car_of(vehicle)))


def flop_of_filter(vehicle: Vehicle) -> float:
    """The same but for what moves the car itself: linearisation, covariance, corrections."""
    car, sensors = car_of(vehicle), sensors_of(vehicle)
    functions = [steps.linearize_function(car), steps.kinematics_function(car), steps.force_function(car)]
    correcting = [s for s in sensors.values() if not s.is_input]
    functions += [sensor_function(car, s) for s in correcting]
    n, model = layout(sensors).size, 14
    gained = 2 * model**3 * 3 + 2 * model * 39 * model  # the inverse, and its products
    moved = 2 * model * (39 + n) * n  # rows of the velocities, and of the coordinates that follow them
    corrected = sum(2 * len(s.deviations()) * n * (n + 20) for s in correcting)
    return float(sum(map(operations, functions)) + gained + moved + corrected)


def operations(function: ca.Function) -> int:
    """Floating-point operations of a function, without moving numbers."""
    moves = {ca.OP_INPUT, ca.OP_OUTPUT, ca.OP_CONST, ca.OP_ASSIGN}
    scalar = codegen.expanded(function)
    return sum(scalar.instruction_id(k) not in moves for k in range(scalar.n_instructions()))


def uses(vehicle: Vehicle, iterations: float = 3.0) -> list[Use]:
    """What the kernels would do in a step of the simplified car: one system and one update of the suspensions for each
    iteration, the matrices of chassis, hubs and wheels once."""
    n = 14
    found = [Use(KERNELS["solve14"], iterations, 2 / 3 * n**3 + 2 * n**2)]
    found.append(Use(KERNELS["body_mass"], 1 + 2 * len(WHEELS), 93))
    if vehicle.suspension is not None:
        found.append(Use(KERNELS["suspension_motion"], iterations, 2 * (12 * 36 + 24 * 15 + 24)))
    return found


def recorded_resources() -> dict[str, dict[str, int]]:
    """Of each kernel and variant, as Yosys counted them last (make hw)."""
    text = resources.files("vsense_ros").joinpath("accelerator/resources.json").read_text(encoding="utf-8")
    found: dict[str, dict[str, int]] = json.loads(text)
    return found


def partition(device: Device, step_us: float, wanted: list[Use], more_iterations: float = 1.0) -> Partition:
    """The kernels that gain most and fit together. `more_iterations` is by how much single precision makes iterations
    more."""
    known = recorded_resources()
    options: list[list[Choice | None]] = []
    best: dict[str, Choice] = {}
    for use in wanted:
        choices: list[Choice | None] = [None]
        for variant, parameters in use.kernel.variants.items():
            needed = known.get(f"{use.kernel.name}/{variant}")
            if needed is None:
                continue
            cycles = use.kernel.cycles(**parameters)
            each = 1e6 * device.link.seconds(cycles + device.link.cycles(use.kernel))
            gain = use.calls * (device.processor_us(use.flop) - more_iterations * each)
            choice = Choice(use, variant, cycles, {r: needed[r] for r in RESOURCES}, gain)
            if use.kernel.name not in best or gain > best[use.kernel.name].gain_us:
                best[use.kernel.name] = choice
            choices.append(choice)
        options.append(choices)
    chosen: tuple[Choice, ...] = ()
    for combination in product(*options):
        together = tuple(choice for choice in combination if choice is not None)
        fits = all(sum(c.resources[r] for c in together) <= getattr(device, r) for r in RESOURCES)
        if fits and sum(c.gain_us for c in together) > sum(c.gain_us for c in chosen) + 1e-9:
            chosen = together
    if sum(c.gain_us for c in chosen) < WORTH * step_us:
        chosen = ()
    return Partition(device, step_us, best, chosen)
