"""What may be wrong with a model: the parameters that are always fitted, and the effects that may be missing."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

from vsense_ros.identification.free_parameter import Change, FreeParameter, added, scaled
from vsense_ros.identification.parameter_set import Values
from vsense_ros.mismatch.road import point
from vsense_ros.model.effects import BY_ID, EVERY
from vsense_ros.model.effects.base import RoadEffect, bounds, role
from vsense_ros.model.sensors import words_of
from vsense_ros.model.vehicle import Vehicle

ALONG_ROAD = "along the road"  # where an effect is that has a profile: a size for every place


def _relative(name: str, deviation: float, *parameters: str, starts: tuple[float, ...] = (0.0,)) -> FreeParameter:
    """Physical parameters that grow by the same share."""
    return FreeParameter(name, "-", deviation, -0.6, 1.5, scaled(*parameters), starts=starts)


def _forward(values: Values, offset: float) -> dict[str, float]:
    """The centre of gravity, forward by an offset over the wheelbase."""
    front, rear = values["chassis.cog_to_front_axle"], values["chassis.cog_to_rear_axle"]
    by = offset * (front + rear)
    return {"chassis.cog_to_front_axle": front - by, "chassis.cog_to_rear_axle": rear + by}


GRIP = (0.0, 0.2, -0.2)  # offsets of all grip from which to begin: a car that slides has a local minimum of its own

# What a vehicle file never knows exactly. Deviations are what catalogues, scales and tyre tests leave open; those of a
# vehicle file that states them replace these.
BASE = (
    _relative("mass", 0.1, "chassis.mass"),
    FreeParameter("centre of gravity, forward over wheelbase", "-", 0.03, -0.15, 0.15, _forward),
    _relative("height of the centre of gravity", 0.1, "chassis.cog_height"),
    _relative("yaw inertia", 0.1, "chassis.yaw_inertia"),
    _relative("roll inertia", 0.15, "chassis.roll_inertia"),
    _relative("cornering stiffness, front", 0.15, "front.cornering_scale"),
    _relative("cornering stiffness, rear", 0.15, "rear.cornering_scale"),
    _relative("longitudinal stiffness, front", 0.15, "front.longitudinal_scale"),
    _relative("longitudinal stiffness, rear", 0.15, "rear.longitudinal_scale"),
    _relative("grip, front", 0.15, "front.grip_scale", starts=GRIP),
    _relative("grip, rear", 0.15, "rear.grip_scale", starts=GRIP),
    _relative("roll stiffness, front", 0.15, "front.suspension_stiffness", "front.antiroll_stiffness"),
    _relative("roll stiffness, rear", 0.15, "rear.suspension_stiffness", "rear.antiroll_stiffness"),
    _relative("damping, front", 0.2, "front.suspension_damping"),
    _relative("damping, rear", 0.2, "rear.suspension_damping"),
    _relative("tyre radius", 0.01, "front.unloaded_radius", "rear.unloaded_radius"),
)

# Share of the front wheels in the torque that drives and in the torque that brakes, where no torques are measured.
TORQUE_SHARES = ("torque.driving_front", "torque.braking_front")


def torque_shares(vehicle: Vehicle) -> dict[str, float]:
    """`TORQUE_SHARES` as the vehicle file says; half of the driving where it does not say which axle is driven."""
    driving = vehicle.drivetrain.driving_shares
    front = 0.5 if driving is None else sum(driving[:2])
    return dict(zip(TORQUE_SHARES, (front, vehicle.drivetrain.front_brake_share), strict=True))


def unknown_torques(vehicle: Vehicle) -> tuple[FreeParameter, ...]:
    """Offsets of these shares. Wheel speeds may say that another axle is driven than the vehicle file states."""
    deviations = (0.1 if vehicle.drivetrain.driven else 0.5, 0.1)
    return tuple(
        FreeParameter(f"share of the front wheels in {what}", "-", deviation, -start, 1 - start, added(name))
        for (name, start), what, deviation in zip(
            torque_shares(vehicle).items(), ("driving", "braking"), deviations, strict=True
        )
    )


def base_parameters(
    vehicle: Vehicle, beyond: Collection[str] = (), kinds: Collection[str] = ("wheel_torques",),
    known: Mapping[tuple[str, str], float] = MappingProxyType({}),
) -> tuple[FreeParameter, ...]:  # fmt: skip
    """What is always fitted: `BASE`; which wheels drive and brake, if the `kinds` of sensors measure wheel speeds but
    not wheel torques; what every car has a little of, except for the effects `beyond` reach of the sensors; and sizes
    of effects that are `known` beforehand, by effect and field, with their standard deviations."""
    values = vehicle.values()
    usual = {
        (effect, field): deviation
        for effect, kind in BY_ID.items()
        if effect not in beyond
        for field, deviation in kind.prior(vehicle).items()
        if deviation > 0
    }
    common = [
        replace(_size(effect, field, values), deviation=deviation)
        for (effect, field), deviation in {**usual, **known}.items()
    ]
    shared = unknown_torques(vehicle) if "wheel_speeds" in kinds and "wheel_torques" not in kinds else ()
    stated = vehicle.deviations()
    return (*(_as_stated(parameter, values, stated) for parameter in BASE), *shared, *common)


def _as_stated(parameter: FreeParameter, values: Values, stated: Values) -> FreeParameter:
    """A base parameter with the deviation that the vehicle file states for the first of its numbers."""
    name = parameter.names(values)[0]
    if name not in stated:
        return parameter
    whole = values[name]
    if parameter.apply is _forward:
        whole = values["chassis.cog_to_front_axle"] + values["chassis.cog_to_rear_axle"]
    return replace(parameter, deviation=stated[name] / abs(whole)) if whole else parameter


@dataclass(frozen=True)
class Candidate:
    """An effect that may be missing, at one place of the car: its sizes, which are fitted together."""

    effect: str
    where: str  # the wheel, axle, axis or sensor; empty where the effect has one size
    free_parameters: tuple[FreeParameter, ...]
    sentence: str  # what the model leaves out, in words

    @property
    def name(self) -> str:
        return f"{self.effect} {self.where}".strip()

    @property
    def along_road(self) -> bool:
        """True if it has a profile: a size for every place of the road."""
        return bool(self.places)

    @property
    def places(self) -> tuple[FreeParameter, ...]:
        """What its size is at each place of the road, beyond what it is everywhere."""
        return tuple(parameter for parameter in self.free_parameters if parameter.place is not None)


def _size(effect: str, field: str, values: Values, form: str = "") -> FreeParameter:
    """What is added to a number of an effect, in one of its forms, beyond the `values` that a car has already."""
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
    """What is fitted besides its sizes once an effect is found: the numbers that give it its shape."""
    id, kind = candidate.effect, EVERY[candidate.effect]
    return tuple(_size(id, name, values) for name, field in kind.model_fields.items() if role(field) == "shape")


def out_of_reach(kinds: Collection[str]) -> dict[str, str]:
    """Effects by id that recordings of these kinds of sensors can say nothing about, with the reason."""
    missing = {id: [kind for kind in effect.needs if kind not in kinds] for id, effect in BY_ID.items()}
    return {
        id: f"it needs {' and '.join(words_of(kind) for kind in lacking)}, which these recordings do not have"
        for id, lacking in missing.items()
        if lacking
    }


def terms(values: Values) -> tuple[Candidate, ...]:
    """Forces that stand for no known physics, beyond the `values` that a car has already: each alone, and lateral
    forces together with their yaw moments."""
    offered = []
    for effect in EVERY.keys() - BY_ID.keys():
        free_parameters = {field: _size(effect, field, values) for field in EVERY[effect].model_fields}
        words = {field: str(info.description) for field, info in EVERY[effect].model_fields.items()}
        offered += [
            Candidate(effect, field, (parameter,), words[field]) for field, parameter in free_parameters.items()
        ]
        for field, parameter in free_parameters.items():
            if (moment := field.replace("lateral_force", "yaw_moment")) != field and moment in free_parameters:
                offered.append(
                    Candidate(effect, f"{field} and {moment}", (parameter, free_parameters[moment]), words[field])
                )
    return tuple(offered)


def size_of(effect: str) -> str:
    """The dotted name of the first size of an effect."""
    return next(f"effects.{effect}.{name}" for name, f in EVERY[effect].model_fields.items() if role(f) == "size")


def at_places(parameter: FreeParameter, abscissae: Sequence[float]) -> Iterator[FreeParameter]:
    """What a size is at places with these abscissae [m], beyond what it is everywhere: one alone is changed on a road
    that is known at all of them. With their deviations a likely size at all of them costs as much as a likely size
    everywhere."""
    deviation = parameter.deviation * len(abscissae) ** 0.5
    names = [point(parameter.name, abscissa) for abscissa in abscissae]
    for name, abscissa in zip(names, abscissae, strict=True):
        yield replace(
            parameter, name=name, apply=_among(names, name), place=(parameter.name, abscissa), deviation=deviation,
            step=parameter.deviation,
        )  # fmt: skip


def _among(names: Sequence[str], name: str) -> Change:
    """A number that an offset is added to, of several that are zero if they are not there yet."""
    others = [other for other in names if other != name]
    return lambda values, offset: {name: values.get(name, 0.0) + offset, **{o: values.get(o, 0.0) for o in others}}


def candidates(abscissae: Sequence[float] = (), values: Values = MappingProxyType({})) -> tuple[Candidate, ...]:
    """Each size of each known effect by itself, the sizes of an effect that has no more than two together, and, for
    effects of the road, a profile with points at these abscissae [m]; beyond the `values` that a car has already."""
    every = []
    for effect, kind in BY_ID.items():
        sizes = [name for name, field in kind.model_fields.items() if role(field) == "size"]
        if len(sizes) > 1:
            every += [Candidate(effect, name, (_size(effect, name, values),), kind.sentence) for name in sizes]
        if len(sizes) <= 2:
            where = "" if len(sizes) == 1 else " and ".join(sizes)
            every.append(Candidate(effect, where, tuple(_size(effect, name, values) for name in sizes), kind.sentence))
        for form in ("", *kind.variants):
            free_parameters = tuple(_size(effect, name, values, form) for name in sizes)
            if form:
                every.append(Candidate(effect, form, free_parameters, kind.sentence))
            if abscissae and issubclass(kind, RoadEffect):
                points = (point for parameter in free_parameters for point in at_places(parameter, abscissae))
                where = f"{form}, {ALONG_ROAD}".strip(", ")
                every.append(Candidate(effect, where, (*free_parameters, *points), kind.sentence))
    return tuple(every)
