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

from pydantic import BaseModel, ConfigDict, Field, ValidationError

from vsense_ros.accelerator.kernels import KERNELS, Kernel
from vsense_ros.accelerator.link import Link
from vsense_ros.assess.flop import Operations, flop_of_full, flop_of_simplified
from vsense_ros.errors import InputError
from vsense_ros.files.installed import shared_folder
from vsense_ros.messages import yaml_text
from vsense_ros.model.car.full_car import FullCar
from vsense_ros.model.coordinates import WHEELS
from vsense_ros.model.vehicle import Vehicle

RESOURCES = ("dsp", "lut", "ff", "bram")
WORTH = 0.005  # share of a step below which a gain is none: the estimates are no better


class Device(BaseModel):
    """Resources, clocks and link of a device, as its file says."""

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
    """Use that an observer has for a kernel in a step."""

    kernel: Kernel
    calls: float  # in a step
    flop: float  # of a call, that the processor is rid of; negative where it has more to do


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
    """Recommended kernels of an observer on a device."""

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


@dataclass(frozen=True)
class Profile:
    """An observer's step: its operations, iterations in double precision, evaluations of the equations beside those of
    the iterations, by how much single precision makes iterations more, and the kernels there are for it."""

    operations: Operations
    iterations: float
    evaluations: float
    more_iterations: float
    kernels: dict[str, float]  # requests in a step
    solver: str

    @property
    def flop(self) -> float:
        """Operations of a step on the processor alone."""
        return self.operations.processor(self.iterations, self.evaluations)

    def uses(self) -> list[Use]:
        """What the kernels would do in a step. What the processor has left of a part, requests and checks, counts
        against it."""
        ops, uses = self.operations, []
        for name, count in self.kernels.items():
            if name == self.solver:
                work = ops.factor + self.iterations * ops.solve
            else:
                left = (ops.mass_matrix - ops.check_mass, ops.update_motion - ops.check_motion)
                work = self.evaluations * left[name == "suspension_motion"]
            uses.append(Use(KERNELS[name], count, work / count))
        return uses


def profile(vehicle: Vehicle, full: bool, iterations: float, more_iterations: float = 1.0) -> Profile:
    """Step of the observer with the simplified car or, in steps of 4 ms, with the full one. Raises `InputError` where
    the vehicle file lacks the tables or linkages for it."""
    if full:
        bodies = sum(len(linkage.bodies) for linkage in FullCar(vehicle).mechanism.branches)
        kernels, substeps = {"solve56": iterations, "body_mass": iterations * bodies}, 4
        counted = flop_of_full(vehicle, substeps)
        return Profile(counted, iterations, iterations + substeps, more_iterations, kernels, "solve56")
    if vehicle.suspension is None:
        raise InputError(f"{vehicle.name} has no tables of its suspensions; make them with vsense suspension")
    kernels = {
        "solve14": iterations,
        "body_mass": (iterations + 1) * len(WHEELS),
        "suspension_motion": iterations + 1,
    }
    return Profile(flop_of_simplified(vehicle), iterations, iterations + 1, more_iterations, kernels, "solve14")


def recorded_resources() -> dict[str, dict[str, int]]:
    """Resources of each kernel and variant, as Yosys counted them last (make hw)."""
    text = resources.files("vsense_ros").joinpath("accelerator/resources.json").read_text(encoding="utf-8")
    used: dict[str, dict[str, int]] = json.loads(text)
    return used


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
