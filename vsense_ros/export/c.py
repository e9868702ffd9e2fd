"""The observer of one vehicle as C99 sources."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from vsense_ros.codegen.c99 import c_function, wrapped
from vsense_ros.codegen.forms import number
from vsense_ros.errors import InputError
from vsense_ros.estimation.filter import largest_nis
from vsense_ros.estimation.reading import Map
from vsense_ros.export.entries import FIELDS, INPUT_ENTRIES, STATE_ENTRIES, Entry
from vsense_ros.export.sources import (
    PREFIX,
    identifier,
    in_single_precision,
    packaged,
    require_prefix,
    templates,
    write_all,
)
from vsense_ros.files.names import harmless
from vsense_ros.model.car import steps
from vsense_ros.model.car.car import Car, car_of
from vsense_ros.model.constants import GRAVITY
from vsense_ros.model.coordinates import COORDINATES, DISTURBANCES, INPUTS
from vsense_ros.model.effects.base import SPACING, RoadEffect
from vsense_ros.model.parameter import units
from vsense_ros.model.sensors import SensorBase
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.observer.car_memory import SURVEYED
from vsense_ros.observer.catalogue import FILTERS, spi, with_parameters
from vsense_ros.observer.parameter_ekf import ParameterEkf
from vsense_ros.observer.parameter_filter import ParameterFilter
from vsense_ros.observer.road_map import (
    JOINED,
    LOOK_EVERY,
    NEAR,
    PLACED,
    SAME_WAY,
    RoadMap,
    slope_by_size,
    with_changes,
)
from vsense_ros.observer.sensors import sensors_of
from vsense_ros.observer.spi import FILTERS as PARAMETER_FILTERS
from vsense_ros.observer.state import SLOPES, SPIN_FORCES, Layout, Prior, U, largest_state, layout, rolling_state
from vsense_ros.observer.wheel_torques import BRAKING, PAIRS, STANDING

Array = NDArray[np.float64]

_EXAMPLE_SPEED, _EXAMPLE_STEP = 20.0, 0.004  # [m/s], [s]

# What the functions' arguments are in C, and the names of their results.
_ARGUMENTS = {
    "q": "v->state",
    "u": "v->state + MODEL",
    "force": "v->state + 2 * MODEL",
    "disturbances": "v->state + 3 * MODEL",
    "inputs": "v->inputs",
    "p": "v->parameters",
    "internal_state": "v->effects",
    "h": "filter->length",
    "inverse": "filter->model.inverse",
    "by_q": "v->by_q",
    "udot": "v->udot",
    "acceleration": "filter->model.error + SLOW",
}
_LINEARIZATION = ("udot", "by_q", "by_u", "by_disturbances", "by_q_rates")
_RESULTS = {
    "dynamics": ("acceleration", "by_wheel"),
    "linearize": tuple(f"v->{name}" for name in _LINEARIZATION),
    "advance": ("filter->coordinates", "filter->velocities"),
    "kinematics": tuple(
        f"filter->model.{name}"
        for name in ("by_angles", "by_velocity", "by_road", "road_rate", "road_by_velocity", "road_by_road")
    ),
    "force": ("filter->added",),
    "internal_state": ("filter->remembered",),
    "parameters_effect": ("v->by_estimates",),
}
_SENSED = ("expected", "by_q", "by_u", "by_udot", "by_disturbances", "by_biases")


@dataclass(frozen=True)
class Observer:
    """What is exported: a vehicle with the sensors it names."""

    vehicle: Vehicle
    sensors: dict[str, SensorBase]  # complete

    @classmethod
    def of(cls, vehicle: Vehicle) -> Observer:
        """Raises `InputError` where the sensors' names are equal in C, or cannot determine a parameter."""
        sensors = sensors_of(vehicle)
        names = [identifier(name) for name in sensors]
        if twice := sorted({name for name in names if names.count(name) > 1}):
            raise InputError(f"{vehicle.name}: sensors {', '.join(twice)} have the same name in C; rename one")
        if vehicle.observer.parameters:
            spi(vehicle, sensors)  # refuses what cannot be estimated
        return cls(vehicle, sensors)

    @property
    def estimated(self) -> tuple[str, ...]:
        """Names of the parameters that are estimated."""
        return tuple(self.vehicle.observer.parameters)

    @property
    def correcting(self) -> dict[str, SensorBase]:
        """Sensors with an innovation, by name."""
        return {name: sensor for name, sensor in self.sensors.items() if not sensor.is_input}

    @property
    def profiles(self) -> tuple[RoadEffect, ...]:
        """Effects for which the vehicle file has a profile along the road, where a sensor measures the place."""
        if RoadMap.of(self.vehicle, Map(None)) is None:
            return ()
        present = self.vehicle.physics.effects.present()
        return tuple(effect for effect in present if isinstance(effect, RoadEffect) and effect.profile)

    @property
    def map_origin(self) -> tuple[float, float, float] | None:
        """Latitude, longitude [deg] and height [m] of the map's origin where there are profiles: their first place."""
        return (*self.profiles[0].profile[0][:2], 0.0) if self.profiles else None

    def fields(self) -> dict[str, int]:
        """Arrays of the struct and their lengths, in order, at first that of `CarBlocks` and of an SPI."""
        car, size, count = car_of(self.vehicle), layout(self.sensors).size, len(self.estimated)
        learned = {
            "estimates": count,
            "parameter_covariance": count * count,
            "sensitivity": size * count,
            "information": count * count,
            "by_estimates": COORDINATES * count,
        }
        linearize = steps.linearize_function(car)
        return {
            "state": size,
            "inputs": len(INPUTS),
            "covariance": size * size,
            **({"effects": car.internal_state.numel()} if car.internal_state.numel() else {}),
            **{name: linearize.nnz_out(i) for i, name in enumerate(_LINEARIZATION)},
            "parameters": len(car.parameter_names),
            **(learned if count else {}),
            "reversion_mean": size - U.stop,
            **({"surveyed": SURVEYED} if self.map_origin is not None else {}),
            "process_kind": 1,
            "decay": size - U.stop,
            "noise": size - U.stop + len(PAIRS),
        }


def with_sensors(vehicle: Vehicle, names: Sequence[str]) -> Vehicle:
    """The vehicle with some of its sensors alone. Raises `InputError` for one that it does not have."""
    if unknown := [name for name in names if name not in vehicle.sensors]:
        raise InputError(f"{vehicle.name} has no sensor {', '.join(unknown)}; it has {', '.join(vehicle.sensors)}")
    kept = {name: sensor for name, sensor in vehicle.sensors.items() if name in names}
    return vehicle.model_copy(update={"sensors": kept})


_REFERENCE = "it is a reference to compare with, whose steps NumPy makes with full matrices"
_LINKAGES = "its model are 29 bodies, whose joints NumPy closes by iteration in each step"
_NOT_WRITTEN = {
    "dekf": _REFERENCE,
    "cekf": _REFERENCE,
    "ukf": _REFERENCE,
    "full_error_ekf": _LINKAGES,
    "full_spi": _LINKAGES,
}


def with_filter(vehicle: Vehicle, name: str) -> Vehicle:
    """The vehicle as this filter of the catalogue observes it. Raises `InputError` for one that is not written as C, or
    that does not fit the vehicle."""
    family = FILTERS[name]
    if family.name in _NOT_WRITTEN:
        raise InputError(
            f"{name} exists in Python alone: {_NOT_WRITTEN[family.name]}; error_ekf and spi are written as C"
        )
    if family.name == "spi":
        return with_parameters(vehicle)
    return vehicle.model_copy(update={"observer": vehicle.observer.model_copy(update={"parameters": {}})})


def write(
    vehicle: Vehicle,
    folder: Path,
    measured: dict[str, str] | None = None,
    *,
    single: bool = False,
    prefix: str = PREFIX,
) -> list[Path]:
    """Write the sources into `folder`, which is made where it is missing; returns the files.

    `measured` are the figures for the README, as `measuring.measure` returns them. With `single` every number is
    binary32. Names of files, types and functions begin with `prefix`. Raises `InputError` where names in C cannot.
    """
    require_prefix(prefix)
    contents = Contents(Observer.of(vehicle))
    environment = templates()
    values = contents.values() | {"measured": measured}
    texts = {name: environment.get_template(f"{name}.j2").render(values) for name in _TEMPLATES}
    texts |= packaged(("estimation/algebra.c", "observer/car_blocks.c"))
    texts["model.c"] = contents.model()
    if single:
        texts = {name: text if name == "Makefile" else in_single_precision(text) for name, text in texts.items()}
    return write_all(folder, texts, prefix)


_TEMPLATES = ("vsense.h", "vsense.c", "example.c", "Makefile", "README.md")


class Contents:
    """What stands in the sources."""

    def __init__(self, observer: Observer) -> None:
        self.observer, self.vehicle = observer, observer.vehicle
        self.car: Car = car_of(observer.vehicle)
        self.layout: Layout = layout(observer.sensors)
        alike = self.car.corners_alike
        self.functions, self.corners = steps.functions_of(alike), steps.corners_of(alike)
        kinds = {sensor.kind: sensor for sensor in observer.correcting.values()}
        self.sensing = {kind: steps.sensor_function(self.car, sensor) for kind, sensor in kinds.items()}
        columns = [self.car.parameter_names.index(name) for name in observer.estimated]
        kind_of_filter = PARAMETER_FILTERS[self.vehicle.observer.parameter_filter]
        self.filter: ParameterFilter | None = None
        self.learning: list[ca.Function] = []
        if columns:
            self.filter = filter = kind_of_filter(self.car, columns, self.layout.size)
            if isinstance(
                filter, ParameterEkf
            ):  # only the car's own arguments: what is alike at corners becomes a loop
                self.functions.append(steps.sensitivity_function(alike, columns))
            else:
                self.learning.append(filter.effect())
            self.learning += [filter.predict(), filter.learn()]
            for name, sensor in observer.correcting.items():
                self.learning.append(filter.seen(f"seen_{identifier(name)}", sensor, self._biases(name)))

    def model(self) -> str:
        """Source of the functions made from expressions."""
        head = "/* The car and its sensors with exact Jacobians, column-major. Written by `vsense export c`. */\n"
        sources = [c_function(f, [f"r{i}" for i in range(f.n_out())], corners=self.corners) for f in self.functions]
        others = [*self.sensing.values(), *self.learning]
        sources += [c_function(f, [f"r{i}" for i in range(f.n_out())]) for f in others]
        return "\n".join([head, "#include <math.h>\n", *sources])

    def values(self) -> dict[str, object]:
        """What the templates refer to."""
        fields = self.observer.fields()
        prior = Prior.of(self.vehicle, self.observer.sensors)
        start, moving = (rolling_state(self.vehicle, speed) for speed in (0.0, 1.0))
        tables = [start, moving, self.vehicle.parameter_vector(), prior.deviation]
        tables += [prior.rate[U.stop :], prior.density[U.stop :], prior.reversion_mean[U.stop :]]
        tables += [prior.levers, prior.roughness, largest_state(self.layout.size)]
        torques = prior.torques
        together = [torques.covariance[BRAKING, i, j] for i, j in PAIRS]
        variance = prior.deviation**2
        variance[SPIN_FORCES] = torques.covariance[BRAKING].diagonal()
        tables += [torques.rate, torques.covariance, np.array(together)]
        tables += [np.array(effect.profile) for effect in self.observer.profiles]
        return {
            "vehicle": harmless(self.vehicle.name),
            "forces_determined": torques.determine_forces,
            "states": self.states(),
            "inputs": INPUT_ENTRIES,
            "parameters": [
                Entry(identifier(name).upper(), unit, description)
                for name, unit, description in units(self.vehicle.physics)
            ],
            "estimates": self.estimates(),
            "fields": [{"name": k, "size": size, "meaning": FIELDS[k]} for k, size in fields.items()],
            "sensors": [self._sensor(name) for name in self.observer.correcting],
            "latencies": [
                {"name": identifier(name), "latency": number(sensor.latency)}
                for name, sensor in self.observer.sensors.items()
            ],
            "calls": self._learning_calls() | {f.name(): self._call(f, _RESULTS[f.name()]) for f in self.functions},
            "gamma": number(steps.GAMMA),
            "longest_step": self.vehicle.observer.longest_step,
            "start": _table(start),
            "start_by_speed": _table(moving - start),
            "values": _table(self.vehicle.parameter_vector()),
            "start_variance": _table(np.append(variance, together)),
            "torques": {
                "standing": number(STANDING),
                "gravity": number(GRAVITY),
                "drag": number(torques.drag),
                "engine_braking": number(torques.engine_braking),
                "rate": [_table(row) for row in torques.rate],
                "covariance": [_table(matrix.ravel()) for matrix in torques.covariance],
            },
            "decay_rate": _table(prior.rate[U.stop :]),
            "density": _table(prior.density[U.stop :]),
            "reversion_mean": _table(prior.reversion_mean[U.stop :]),
            "levers": _table(prior.levers),
            "roughness": _table(prior.roughness.ravel()),
            "largest": _table(largest_state(self.layout.size)),
            "survey": self._survey(prior),
            "example_speed": number(_EXAMPLE_SPEED),
            "example_step": number(_EXAMPLE_STEP),
            "struct_doubles": sum(fields.values()),
            "struct_kb": f"{sum(fields.values()) * 8 / 1024:.1f}",
            "tables_kb": f"{sum(table.size for table in tables) * 8 / 1024:.1f}",
        }

    def _survey(self, prior: Prior) -> dict[str, Any] | None:
        """What the templates refer to where the vehicle file knows roads from place to place."""
        origin = self.observer.map_origin
        if origin is None:
            return None
        profiles = []
        for effect in self.observer.profiles:
            name = f"effects.{effect.id}.{effect.size_name()}"
            known = name in self.car.parameter_names and name not in self.observer.estimated
            profiles.append(
                {
                    "name": effect.id,
                    "rows": [", ".join(map(number, row)) for row in with_changes(effect.profile, Map(origin)).tolist()],
                    "slopes": [number(slope) if slope else "" for slope in slope_by_size(effect).tolist()],
                    "parameter": f"VSENSE_P_{identifier(name).upper()}" if known else "",
                    "size": number(getattr(effect, effect.size_name())),
                }
            )
        return {
            "origin": [number(value) for value in origin],
            "profiles": profiles,
            "slopes": [number(float(slope)) for slope in prior.reversion_mean[SLOPES]],
            "look_every": number(LOOK_EVERY),
            "placed": number(PLACED**2),
            "near": number(NEAR),
            "same_way": number(SAME_WAY),
            "spacing": number(SPACING),
            "joined": number(JOINED),
        }

    def states(self) -> list[Entry]:
        entries = list(STATE_ENTRIES)
        for name, sensor in self.observer.sensors.items():
            for bias in sensor.biases():
                c_name = identifier(name)
                entries.append(Entry(f"{c_name}_{bias.name}".upper(), bias.unit, f"error of {c_name}"))
        return entries

    def _biases(self, name: str) -> slice:
        """Where the biases of a sensor stand in the state."""
        return self.layout.biases[list(self.observer.sensors).index(name)]

    def estimates(self) -> dict[str, Any] | None:
        """What the templates refer to where parameters are estimated."""
        if self.filter is None:
            return None
        settings = self.vehicle.observer.parameters
        values = self.vehicle.values()
        bounds = np.array([one.bounds(values[name]) for name, one in settings.items()])
        entries = {name: Entry(identifier(name).upper(), *rest) for name, *rest in units(self.vehicle.physics)}
        drift = np.array([one.drift for one in settings.values()]) ** 2
        return {
            "entries": [entries[name] for name in settings],
            "columns": [f"VSENSE_P_{entries[name].name}" for name in settings],
            "variance": _table(np.array([one.deviation for one in settings.values()]) ** 2),
            "drift": _table(drift),
            "drifts": bool(drift.any()),
            "lower": _table(bounds[:, 0]),
            "upper": _table(bounds[:, 1]),
            "width": self.filter.width,
        }

    def _learning_calls(self) -> dict[str, str]:
        """Calls of the functions of the parameter filter, but for those of single sensors."""
        if self.filter is None:
            return {}
        predicted = "v->sensitivity, v->parameter_covariance, v->by_estimates, drift, to->gain"
        kinematics = ", ".join(f"filter->model.{name}" for name in ("by_angles", "by_velocity", "by_road", "road_map"))
        predicted += f", {kinematics}, filter->length, to->decay"
        used = ", ".join(f"sensor->{name}" for name in ("projected", "gained", "right", "spread"))
        used += ", v->information, v->estimates, lower, upper"
        made = ", ".join(f"results->{name}" for name in ("estimates", "covariance", "sensitivity", "information"))
        made += ", sensor->change, sensor->accelerations"
        arguments = self._filter_arguments()
        return {
            "parameters_effect": wrapped(f"parameters_effect({arguments}, v->by_estimates);", "    "),
            "spread": wrapped(f"parameters_predict({predicted}, to->moved, to->grown, to->added);", "    "),
            "learn": wrapped(f"parameters_learn({arguments}, v->by_estimates, {used}, {made});", "    "),
        }

    def _filter_arguments(self) -> str:
        """The `ParameterFilter.arguments` in C."""
        names = ("q", "u", "force", "disturbances", "inputs", "p")
        linearized = [f"v->{name}" for name in _LINEARIZATION[:4]]
        memory = _ARGUMENTS["internal_state"] if self.car.internal_state.numel() else "0"
        places = [_ARGUMENTS[name] for name in names]
        return ", ".join([*places, *linearized, "v->sensitivity", "v->parameter_covariance", memory])

    def _call(self, function: ca.Function, results: tuple[str, ...], indent: str = "    ", **special: str) -> str:
        places = _ARGUMENTS | ({} if self.car.internal_state.numel() else {"internal_state": "0"}) | special
        names = (function.name_in(i) for i in range(function.n_in()))
        arguments = [places[name] for name in names if name not in self.corners.known]
        return wrapped(f"{function.name()}({', '.join([*arguments, *results])});", indent)

    def _sensor(self, name: str) -> dict[str, Any]:
        sensor = self.observer.sensors[name]
        function = self.sensing[sensor.kind]
        where = self._biases(name)
        mounting, deviations = sensor.mounting(), sensor.deviations()
        c_name = identifier(name)
        constants = f"sensor_{c_name}_mounting" if mounting.size else "0"
        limit = largest_nis(sensor.gate, len(deviations))
        biases = f"v->state + {where.start}"
        results = tuple(f"to->{result}" for result in _SENSED)
        sensed = ", ".join(f"sensed->{result}" for result in _SENSED[1:])
        seen = f"seen_{c_name}({self._filter_arguments()}, v->by_estimates, {biases}, {constants}, "
        seen += f"sensor->variance, model->whitened, model->factor, {sensed}, "
        seen += "sensor->weighted, sensor->gained, sensor->right, sensor->spread);"
        return {
            "name": c_name,
            "meaning": (type(sensor).__doc__ or "").strip().splitlines()[0],
            "size": len(deviations),
            "gate": sensor.gate,
            "limit": number(limit),
            "mounting": _table(mounting) if mounting.size else "",
            "offset": _table(sensor.offsets()),
            "variance": _table(deviations**2),
            "least_stated": number(sensor.least_stated**2),
            "uses_acceleration": int(sensor.uses_acceleration),
            "first_bias": where.start,
            "biases": where.stop - where.start,
            "call": self._call(function, results, " " * 12, biases=biases, mounting=constants),
            "seen": wrapped(seen, " " * 12),
            "example": _table(self._expected(function, mounting, where.stop - where.start)),
        }

    def _expected(self, function: ca.Function, mounting: Array, biases: int) -> Array:
        """Measurement of a sensor on a car that rolls straight ahead."""
        state = rolling_state(self.vehicle, _EXAMPLE_SPEED)
        values = function(
            state[:14],
            state[14:],
            np.zeros(14),
            np.zeros(len(DISTURBANCES)),
            np.zeros(len(INPUTS)),
            np.zeros(biases),
            mounting,
        )
        return np.asarray(values[0], dtype=float)[:, 0]


def _table(values: Array) -> str:
    """An initializer, wrapped."""
    lines, line = [], "   "
    for value in values:
        text = f" {number(float(value))},"
        if len(line) + len(text) > 118:
            lines.append(line)
            line = "   "
        line += text
    return "\n".join(["{", *lines, line, "}"])
