"""What may be wrong: the parameters that are fitted anyway, and the effects that may be missing."""

from __future__ import annotations

from collections.abc import Callable, Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

from vsense_ros.mismatch.road import point
from vsense_ros.model.effects import BY_ID, EVERY
from vsense_ros.model.effects.base import Effect, RoadEffect, bounds, role
from vsense_ros.model.sensors import words_of
from vsense_ros.model.vehicle import Vehicle

Values = Mapping[str, float]

ALONG_ROAD = "along the road"  # where an effect is that has another size at every place


@dataclass(frozen=True)
class FreeParameter:
    """One number that a fit may change: zero where the vehicle file is right, `deviation` what is likely."""

    name: str
    unit: str
    deviation: float
    low: float
    high: float
    turn: Callable[[Values, float], dict[str, float]]  # parameters by name, amount → changed parameters
    form: str = ""  # of the effect
    place: tuple[str, float] | None = None  # what is turned at one place on the road alone: size and abscissa [m]
    step: float = (
        0.0  # a likely amount of a free parameter that is one of many, of which each costs less; else the deviation
    )

    @property
    def likely(self) -> float:
        """An amount that shows what the free parameter does."""
        return self.step or self.deviation


def _relative(name: str, deviation: float, *parameters: str) -> FreeParameter:
    def turn(values: Values, offset: float) -> dict[str, float]:
        return {p: values[p] * (1 + offset) for p in parameters}

    return FreeParameter(name, "-", deviation, -0.6, 1.5, turn)


def _shifted(values: Values, offset: float) -> dict[str, float]:
    front, rear = values["chassis.cog_to_front_axle"], values["chassis.cog_to_rear_axle"]
    by = offset * (front + rear)
    return {"chassis.cog_to_front_axle": front - by, "chassis.cog_to_rear_axle": rear + by}


def _added(name: str) -> Callable[[Values, float], dict[str, float]]:
    return lambda values, offset: {name: values.get(name, 0.0) + offset}


# What a vehicle file is never sure of. Deviations are what catalogues, scales and tyre tests leave open.
BASE = (
    _relative("mass", 0.1, "chassis.mass"),
    FreeParameter("centre of gravity, forward over wheelbase", "-", 0.03, -0.15, 0.15, _shifted),
    _relative("height of the centre of gravity", 0.1, "chassis.cog_height"),
    _relative("yaw inertia", 0.1, "chassis.yaw_inertia"),
    _relative("roll inertia", 0.15, "chassis.roll_inertia"),
    _relative("cornering stiffness, front", 0.15, "front.cornering_scale"),
    _relative("cornering stiffness, rear", 0.15, "rear.cornering_scale"),
    _relative("longitudinal stiffness, front", 0.15, "front.longitudinal_scale"),
    _relative("longitudinal stiffness, rear", 0.15, "rear.longitudinal_scale"),
    _relative("grip, front", 0.15, "front.grip_scale"),
    _relative("grip, rear", 0.15, "rear.grip_scale"),
    _relative("roll stiffness, front", 0.15, "front.suspension_stiffness", "front.antiroll_stiffness"),
    _relative("roll stiffness, rear", 0.15, "rear.suspension_stiffness", "rear.antiroll_stiffness"),
    _relative("damping, front", 0.2, "front.suspension_damping"),
    _relative("damping, rear", 0.2, "rear.suspension_damping"),
    _relative("tyre radius", 0.01, "front.unloaded_radius", "rear.unloaded_radius"),
)

# Share of the front wheels in the torque that drives and in the torque that brakes, where no torques are measured, and
# what is expected of a car of which nobody knows: driven anywhere, and braked at the front for the most part.
TORQUE_SHARES = {"torque.driving_front": 0.5, "torque.braking_front": 0.65}
UNKNOWN_TORQUES = tuple(
    FreeParameter(f"share of the front wheels in {what}", "-", deviation, -start, 1 - start, _added(name))
    for (name, start), what, deviation in zip(TORQUE_SHARES.items(), ("driving", "braking"), (0.5, 0.1), strict=True)
)


# Share of how fast a road tilts, from place to place, that the body of the car tilts by as well: all of it on a road,
# nothing where gravity alone is tilted, in a simulation or by a sensor. Found once a road is.
FOLLOWED = "road.followed"
FOLLOWING = FreeParameter("share of the road's tilting in the body's", "-", 0.5, 0.0, 1.0, _added(FOLLOWED))


def base_parameters(
    vehicle: Vehicle, beyond: Collection[str] = (), kinds: Collection[str] = ("wheel_torques",)
) -> tuple[FreeParameter, ...]:
    """What is fitted before anything is said to be missing: `BASE`, which wheels drive and brake if the `kinds` of
    sensors tell their speeds but not their torques, and what every car has a little of, except for effects out of
    reach."""
    values = vehicle.values()
    usual = [
        replace(_knob(effect, field, values), deviation=deviation)
        for effect, kind in BY_ID.items()
        if effect not in beyond
        for field, deviation in kind.usual(vehicle).items()
        if deviation > 0
    ]
    shared = UNKNOWN_TORQUES if "wheel_speeds" in kinds and "wheel_torques" not in kinds else ()
    return (*BASE, *shared, *usual)


@dataclass(frozen=True)
class Candidate:
    """An effect at one place: the sizes that are fitted together, by dotted name."""

    effect: str
    where: str  # the wheel, axle, axis or sensor; empty where the effect has one size
    free_parameters: tuple[FreeParameter, ...]
    sentence: str  # what the model leaves out, in words

    @property
    def name(self) -> str:
        return f"{self.effect} {self.where}".strip()

    @property
    def along_road(self) -> bool:
        """Whether sizes may be others at every place."""
        return any(parameter.place for parameter in self.free_parameters)


def _knob(effect: str, field: str, values: Values, form: str = "") -> FreeParameter:
    """What is added to the value that a car has already."""
    info = EVERY[effect].model_fields[field]
    extra = info.json_schema_extra
    assert isinstance(extra, dict)
    dotted = f"effects.{effect}.{field}"
    present = values.get(dotted, float(info.default))
    low, high = bounds(info)
    values_of_form = {f"effects.{effect}.{n}": value for n, value in EVERY[effect].variants.get(form, {}).items()}
    return FreeParameter(
        dotted, str(extra["unit"]), float(str(extra["typical"])), low - present, high - present,
        lambda values, offset: {dotted: min(max(values[dotted] + offset, low), high), **values_of_form}, form,
    )  # fmt: skip


def shapes(candidate: Candidate, values: Values) -> tuple[FreeParameter, ...]:
    """What else of an effect may be another, once it has a size: turned from what it is."""
    id, kind = candidate.effect, EVERY[candidate.effect]
    found = tuple(_knob(id, name, values) for name, field in kind.model_fields.items() if role(field) == "shape")
    return (*found, FOLLOWING) if candidate.along_road and kind.slope is not Effect.slope else found


def out_of_reach(kinds: Collection[str]) -> dict[str, str]:
    """Effects by id of which nothing can be said with these kinds of sensors, with the reason."""
    missing = {id: [kind for kind in effect.needs if kind not in kinds] for id, effect in BY_ID.items()}
    return {
        id: f"it needs {' and '.join(words_of(kind) for kind in lacking)}, which these recordings do not have"
        for id, lacking in missing.items()
        if lacking
    }


def terms(values: Values) -> tuple[Candidate, ...]:
    """Forces for which no physics is known, beyond what a car has of them: each alone, and lateral forces with a lever
    arm."""
    found = []
    for effect in EVERY.keys() - BY_ID.keys():
        free_parameters = {field: _knob(effect, field, values) for field in EVERY[effect].model_fields}
        words = {field: str(info.description) for field, info in EVERY[effect].model_fields.items()}
        found += [Candidate(effect, field, (parameter,), words[field]) for field, parameter in free_parameters.items()]
        for field, parameter in free_parameters.items():
            if (moment := field.replace("lateral_force", "yaw_moment")) != field and moment in free_parameters:
                found.append(
                    Candidate(effect, f"{field} and {moment}", (parameter, free_parameters[moment]), words[field])
                )
    return tuple(found)


def size_of(effect: str) -> str:
    """The dotted name of the first size of an effect."""
    return next(f"effects.{effect}.{name}" for name, f in EVERY[effect].model_fields.items() if role(f) == "size")


def at_places(parameter: FreeParameter, abscissae: Sequence[float]) -> Iterator[FreeParameter]:
    """What a size is at places, beyond what it is everywhere. Each place has its share of the data set: a likely size
    at all of them costs as much as a likely size everywhere."""
    deviation = parameter.deviation * len(abscissae) ** 0.5
    for abscissa in abscissae:
        name = point(parameter.name, abscissa)
        yield replace(
            parameter, name=name, turn=_added(name), place=(parameter.name, abscissa), deviation=deviation,
            step=parameter.deviation,
        )  # fmt: skip


def candidates(abscissae: Sequence[float] = (), values: Values = MappingProxyType({})) -> tuple[Candidate, ...]:
    """Each size of each known effect by itself, the sizes of an effect that has no more than two together, and what
    belongs to the road at places with these abscissae [m]; beyond the `values` that a car has already."""
    found = []
    for effect, kind in BY_ID.items():
        sizes = [name for name, field in kind.model_fields.items() if role(field) == "size"]
        if len(sizes) > 1:
            found += [Candidate(effect, name, (_knob(effect, name, values),), kind.sentence) for name in sizes]
        if len(sizes) <= 2:
            where = "" if len(sizes) == 1 else " and ".join(sizes)
            found.append(Candidate(effect, where, tuple(_knob(effect, name, values) for name in sizes), kind.sentence))
        for form in ("", *kind.variants):
            free_parameters = tuple(_knob(effect, name, values, form) for name in sizes)
            if form:
                found.append(Candidate(effect, form, free_parameters, kind.sentence))
            if abscissae and issubclass(kind, RoadEffect):
                points = (point for parameter in free_parameters for point in at_places(parameter, abscissae))
                where = f"{form}, {ALONG_ROAD}".strip(", ")
                found.append(Candidate(effect, where, (*free_parameters, *points), kind.sentence))
    return tuple(found)
