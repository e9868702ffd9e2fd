"""Which sensors follow another convention of axes and signs than ISO 8855 and east, north, up.

Hypotheses about all sensors at once are compared as wholes: by how many relations between sensors each leaves broken,
and then by how few conventions it changes. Two that mend the same with as few changes are a tie: then nothing is
mended, and both are reported. Gravity decides where a left and a right cannot, as a housing has right-handed axes.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product

import numpy as np
from numpy.typing import NDArray

from vsense_ros.checks.aligned import INERTIAL_FIELDS
from vsense_ros.checks.consistency import SIDES
from vsense_ros.checks.correcting import mended
from vsense_ros.checks.finding import Confidence, Exchange, Finding, Kind, Matrix, Scale, Turn
from vsense_ros.checks.frames import FORMS
from vsense_ros.checks.motion import GYRO, ROAD_WHEEL, STEERING_WHEEL, WHEELS
from vsense_ros.checks.reason import Reason
from vsense_ros.checks.relations import (
    POSITION,
    SETTINGS,
    TURNING,
    VELOCITY,
    Relations,
    key,
    relations,
    signed_permutations,
)  # fmt: skip
from vsense_ros.checks.roles import Role, Topics
from vsense_ros.checks.subject import Subject

Array = NDArray[np.float64]

_USUAL, _ON_GROUND = np.eye(3), np.eye(2)
_NORTH_EAST = np.array([[0.0, 1.0], [1.0, 0.0]])
_EXCHANGED = "exchanged"  # latitude and longitude, in place of a matrix: their metres are not those of one another
# What takes a position to what is read of it, with the exchange of latitude and longitude.
_POSITIONS: Mapping[str, Array] = {
    "": _ON_GROUND,
    "longitude": np.diag([-1.0, 1.0]),
    "latitude": np.diag([1.0, -1.0]),
    _EXCHANGED: _NORTH_EAST,
}
# Axes that sensors are known to have, by the matrix that takes them to forward, left, up.
_NAMED_AXES: Mapping[tuple[float, ...], str] = {
    key(np.diag([1.0, -1.0, -1.0])): ": its axes are forward, right, down, as in SAE J670, aerospace and NED",
    key(np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])): (
        ": its axes are right, forward, up, as of a phone that lies along the car, or ENU"
    ),
    key(np.array([[0.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, 0.0, -1.0]])): ": its axes are right, forward, down",
}
_PLAIN_SIGNS: Mapping[tuple[float, ...], tuple[Reason, str]] = {
    key(np.diag([1.0, -1.0, 1.0])): (Reason.LATERAL_REVERSED, "linear_acceleration.y"),
    key(np.diag([-1.0, 1.0, 1.0])): (Reason.LONGITUDINAL_REVERSED, "linear_acceleration.x"),
    key(np.diag([-1.0, -1.0, 1.0])): (Reason.FORCES_REVERSED, "linear_acceleration"),
    key(-np.eye(3)): (Reason.FORCES_ALL_REVERSED, "linear_acceleration"),
}


@dataclass(frozen=True)
class Hypothesis:
    """Conventions that all sensors of a recording are taken to have.

    `forces` and `rates` (3, 3) take the accelerometer and the gyro to forward, left, up; `velocity` (2, 2) is what a
    velocity to the east and north is turned by in what is read; `position` names what is wrong with the position;
    `sides` is -1 where left and right wheels are exchanged, and `rolling` where their sign is; `steering` has the sign
    of each steered joint. `changes` counts the conventions that differ from the expected ones.
    """

    forces: Array
    rates: Array
    velocity: Array
    position: str
    sides: int
    rolling: int
    steering: tuple[tuple[str, int], ...]
    changes: int

    @cached_property
    def turns(self) -> Mapping[str, int]:
        """By which each source of a turning rate has to be multiplied."""
        return {
            VELOCITY: round(float(np.linalg.det(self.velocity))),
            POSITION: round(float(np.linalg.det(_POSITIONS[self.position]))),
            WHEELS: self.sides * self.rolling,
            **dict(self.steering),
        }

    def broken(self, known: Relations) -> int:
        """How many relations contradict each other still with these conventions."""
        turns = self.turns
        count = sum(turns[one] * turns[other] != agrees for (one, other), agrees in known.turns.items())
        count += sum(not np.array_equal(turns[source] * axis, self.rates[2]) for source, axis in known.yaw_axes.items())
        count += sum(turns[source] * agrees != self.forces[1, 1] for source, agrees in known.lateral.items())
        count += 2 * (known.up is not None and not np.array_equal(self.forces[2], known.up))
        if known.reference:
            push = self.rolling if known.by_wheels else 1
            count += 2 * (not known.explained(self.forces, turns[known.reference], push))
        count += known.wheel_push * self.rolling < 0
        if known.turns or known.yaw_axes or known.force_errors or known.wheel_push:  # else a car may drive backwards
            count += known.wheels_forward * self.rolling < 0
        if known.form is not None:
            count += 2 * (not np.array_equal(self.velocity, known.form @ _POSITIONS[self.position]))
        return count

    def support(self, known: Relations) -> int:
        """How many relations more support than contradict these conventions, of those that are sure enough between two
        that are as good: how the body rolls and pitches, and whether it becomes faster as it accelerates. Where the
        gyro lies as usual, so that the housing is not turned, one sign of the accelerometer, or that of all its axes,
        is likelier than two of three."""
        # A car leans to the right in a bend to the left, and its nose dives when it brakes.
        roll, pitch = known.tilts(self.rates[0], self.forces[1]), -known.tilts(self.rates[1], self.forces[0])
        gains = known.gains_speed(self.forces[0])
        plain = _PLAIN_SIGNS.get(key(self.forces), (Reason.SENSOR_TURNED, ""))[0]
        single = plain in (Reason.LATERAL_REVERSED, Reason.LONGITUDINAL_REVERSED, Reason.FORCES_ALL_REVERSED)
        return 2 * (roll + pitch + gains) + (single and np.array_equal(self.rates, _USUAL) and roll > 0)

    @property
    def parts(self) -> frozenset[tuple[str, tuple[float, ...] | str]]:
        """What differs from the expected conventions, a part for each sensor."""
        assumptions: list[tuple[str, tuple[float, ...] | str]] = [
            ("forces", key(self.forces)),
            ("rates", key(self.rates)),
        ]
        assumptions += [(VELOCITY, key(self.velocity)), (POSITION, self.position), ("sides", (self.sides,))]
        assumptions += [("rolling", (self.rolling,)), *((name, (sign,)) for name, sign in self.steering)]
        return frozenset(assumptions)


def decided(subject: Subject) -> list[Finding]:
    """The findings about conventions of axes and signs: with mends only if these leave nothing of them wrong."""
    axes = list(conventions(subject))
    if not any(finding.mend is not None for finding in axes):
        return axes
    again = Subject(mended(subject.recording, axes), subject.topics, subject.radius)
    return [] if any(finding.mend is not None for finding in conventions(again)) else axes


def conventions(subject: Subject) -> Iterator[Finding]:
    """Findings of the sensors whose convention is another one, with what mends each; without a mend, and of all that
    may be wrong, where two explanations are as good."""
    known = relations(subject)
    if known is None:
        return
    as_it_is = _usual(known)
    broken = as_it_is.broken(known)
    if not broken:
        return
    ranked = [((h.broken(known), h.changes), h) for h in _hypotheses(known, subject)]
    least = min(rank for rank, _ in ranked)
    if least[0] >= broken:
        return
    equal = [h for rank, h in ranked if rank == least]
    support = [h.support(known) for h in equal]
    best = equal[int(np.argmax(support))]
    distinct = list({h.parts: h for h, count in zip(equal, support, strict=True) if count == max(support)}.values())
    if len(distinct) == 1:
        yield from _findings(best, known, subject.topics)
        return
    yield from _undecided(distinct, known, subject.topics)


def _usual(known: Relations) -> Hypothesis:
    joints = [name for name in (STEERING_WHEEL, ROAD_WHEEL) if name in known.motion.turns]
    steering = tuple((name, 1) for name in joints)
    return Hypothesis(_USUAL, _USUAL, _ON_GROUND, "", 1, 1, steering, 0)


def _hypotheses(known: Relations, subject: Subject) -> Iterator[Hypothesis]:
    """All conventions that the sensors of a recording may have."""
    joints = [name for name, _ in _usual(known).steering]
    velocities = _velocities(known)
    positions = _positions(known, subject)
    has_wheels = WHEELS in known.motion.turns or known.wheels_forward
    wheels = list(product((1, -1), repeat=2)) if has_wheels else [(1, 1)]
    for (forces, rates, inertial), velocity, position, (sides, rolling), signs in product(
        _inertial(known), velocities, positions, wheels, product((1, -1), repeat=len(joints))
    ):
        changes = inertial + (not np.array_equal(velocity, _ON_GROUND)) + bool(position)
        changes += (sides < 0) + (rolling < 0) + sum(sign < 0 for sign in signs)
        steering = tuple(zip(joints, signs, strict=True))
        yield Hypothesis(forces, rates, velocity, position, sides, rolling, steering, changes)


def _velocities(known: Relations) -> list[Array]:
    """Axes that the GNSS velocity may have; without a position only those that turn the other way are of interest, of
    which north, east, down are usual."""
    if known.form is not None:
        return signed_permutations(2)
    return (
        [_ON_GROUND, _NORTH_EAST] if any(VELOCITY in pair for pair in (*known.turns, known.yaw_axes)) else [_ON_GROUND]
    )


def _positions(known: Relations, subject: Subject) -> list[str]:
    """What may be wrong with the position."""
    if any(finding.reason is Reason.POSITION_EXCHANGED for finding in subject.frame_findings):
        return [_EXCHANGED]
    if known.form is not None:
        return ["", "longitude", "latitude"]
    return ["", _EXCHANGED] if known.has_turn(POSITION) else [""]


def _inertial(known: Relations) -> Iterator[tuple[Array, Array, int]]:
    """How the accelerometer and the gyro may lie, each with the number of conventions that this changes: one where they
    share a housing that is turned, or where one of them differs. One that shows right for left on both, and has
    gravity upwards, would be left-handed: that is two changes, and improbable for a third."""
    axes = list(known.yaw_axes.values())
    ups = [*axes, *(-axis for axis in axes)]
    for forces in _forces(known):
        turned = not np.array_equal(forces, _USUAL)
        proper = np.linalg.det(forces) > 0
        candidates = {key(_USUAL): _USUAL}
        if proper and turned:
            if np.array_equal(forces[2], _USUAL[2]) and not _gyro_lies_as_usual(known, forces):
                candidates.clear()  # of two that have the same axis upwards, the one that shares the housing
            candidates[key(forces)] = forces
        for up in ups:
            rates = _bringing_up(known, up, forces)
            if not any(np.array_equal(rates[2], other[2]) for other in candidates.values()):
                candidates[key(rates)] = rates
        for rates in candidates.values():
            rates_turned = not np.array_equal(rates, _USUAL)
            if turned and proper and np.array_equal(rates, forces):
                yield forces, rates, 1
            elif turned and rates_turned and np.array_equal(rates[2], -_USUAL[2]) and forces[2, 2] > 0:
                mirrored = key(forces) == key(np.diag([1.0, -1.0, 1.0]))
                yield forces, rates, 1 if mirrored and known.up is None else 3
            else:
                yield forces, rates, int(turned) + int(rates_turned)


def _gyro_lies_as_usual(known: Relations, forces: Array) -> bool:
    """True if the body rolls and pitches as its accelerations make it, with a gyro as it is."""
    return known.tilts(_USUAL[0], forces[1]) - known.tilts(_USUAL[1], forces[0]) > 0


def _forces(known: Relations) -> Iterable[Array]:
    """How the accelerometer may lie: as it is, or so that gravity is upwards and the motion goes along with others."""
    yield _USUAL
    signs = tuple(product((1, -1), repeat=2))
    for forces in signed_permutations(3)[1:]:
        if known.up is not None and not np.array_equal(forces[2], known.up):
            continue
        if known.up is None and forces[2, 2] != 1.0:
            continue
        if known.force_errors:
            if any(known.explained(forces, turn, push) for turn, push in signs):
                yield forces
        elif known.up is not None or (known.lateral and np.array_equal(forces, np.diag([1.0, -1.0, 1.0]))):
            yield forces


def _bringing_up(known: Relations, up: Array, forces: Array) -> Array:
    """The orientation (3, 3) of a gyro of which one axis is upwards; the others are those of the accelerometer, as the
    body is seen to roll and pitch."""
    axis = int(np.argmax(np.abs(up)))
    if axis != 2:
        first = np.zeros(3)
        first[(axis + 1) % 3] = 1.0
        return np.array([first, np.cross(up, first), up])
    # Without a body that is seen to roll or pitch: turned about x.
    roll, pitch = known.tilts(_USUAL[0], forces[1]), -known.tilts(_USUAL[1], forces[0])
    return np.diag([roll or 1.0, pitch or up[2], up[2]])


def _findings(hypothesis: Hypothesis, known: Relations, topics: Topics) -> Iterator[Finding]:
    """What differs from the expected conventions, with what mends it."""
    yield from _of_imu(hypothesis, known, topics[Role.IMU])
    yield from _of_velocity(hypothesis, known, topics[Role.VELOCITY])
    if hypothesis.position:
        yield _of_position(hypothesis.position, known, topics)
    wheels = topics[Role.WHEELS]
    if hypothesis.rolling < 0:
        evidence = {"ratio": known.motion.radius or -1.0}
        mend = Scale("velocity", -1.0)
        yield Finding(wheels, Kind.SIGN, Reason.WHEELS_BACKWARDS, against=GYRO, evidence=evidence, mend=mend)
    if hypothesis.sides < 0:
        yield Finding(wheels, Kind.AXES, Reason.WHEEL_SIDES, against=_other(known, WHEELS), mend=SIDES)
    for name, sign in hypothesis.steering:
        if sign < 0:
            mend, against = Scale("position", -1.0, name), _other(known, name)
            yield Finding(topics[Role.STEERING], Kind.SIGN, Reason.TURNS_AGAINST, name, against, mend=mend)


def _other(known: Relations, name: str) -> str:
    """A source that contradicts another one."""
    names = {VELOCITY: "gnss", POSITION: "gnss"}
    for pair, agrees in known.turns.items():
        if name in pair and agrees < 0:
            other = pair[0] if pair[1] == name else pair[1]
            return names.get(other, other)
    return GYRO


def _of_imu(hypothesis: Hypothesis, known: Relations, topic: str) -> Iterator[Finding]:
    forces, rates = hypothesis.forces, hypothesis.rates
    rate_field, force_field = INERTIAL_FIELDS
    if np.array_equal(forces, rates):
        if not np.array_equal(forces, _USUAL):
            names = {"convention": _NAMED_AXES.get(key(forces), "")}
            mend = Turn((rate_field, force_field), _rows(forces))
            signal = f"{rate_field} {force_field}"
            yield Finding(topic, Kind.AXES, Reason.SENSOR_TURNED, signal, names=names, mend=mend)
        return
    if not np.array_equal(forces, _USUAL):
        turned = Reason.FORCE_AXES_TURNED if np.linalg.det(forces) > 0 else Reason.FORCE_AXES_EXCHANGED
        reason, signal = _PLAIN_SIGNS.get(key(forces), (turned, force_field))
        kind = Kind.SIGN if reason in (Reason.LATERAL_REVERSED, Reason.LONGITUDINAL_REVERSED) else Kind.AXES
        yield Finding(topic, kind, reason, signal, mend=Turn((force_field,), _rows(forces)))
    if not np.array_equal(rates, _USUAL):
        against = next((source for source in TURNING if source in known.yaw_axes), "")
        against = "gnss" if against in (VELOCITY, POSITION) else against
        mend = Turn((rate_field,), _rows(rates))
        if rates[2, 2] != 0.0:
            signal = f"{rate_field}.z"
            yield Finding(topic, Kind.SIGN, Reason.TURNS_AGAINST, signal, against, mend=mend)
        else:
            yield Finding(topic, Kind.AXES, Reason.RATE_AXES, rate_field, mend=mend)


def _rows(matrix: Array) -> Matrix:
    return tuple(tuple(float(v) for v in row) for row in matrix)


def _of_velocity(hypothesis: Hypothesis, known: Relations, topic: str) -> Iterator[Finding]:
    for reason, kind, form in FORMS:
        if np.array_equal(hypothesis.velocity, form):
            back = np.eye(3)
            back[:2, :2] = np.array(form).T
            back[2, 2] = _vertical(known, exchanged=form[0][0] == 0.0)
            against = topic if known.form is None else "gps/fix"
            if known.form is None:
                reason = Reason.COURSE_AGAINST
                against = _other(known, VELOCITY)
            yield Finding(topic, kind, reason, against=against, mend=Turn(("linear",), _rows(back)))


def _vertical(known: Relations, *, exchanged: bool) -> float:
    """-1 where the vertical velocity is positive downwards: as the height changes, or else where north comes first."""
    signals = known.motion.signals
    if "up" in signals and "height" in signals:
        climb = signals.rate_of_change(signals.signals["height"], known.motion.gnss_span)
        vertical = known.motion.smooth(signals.signals["up"])
        matched = known.motion.compare(vertical, climb)
        if matched is not None and abs(matched.correlation) > SETTINGS.climbing:
            return 1.0 if matched.correlation > 0 else -1.0
    return -1.0 if exchanged else 1.0


def _of_position(name: str, known: Relations, topics: Topics) -> Finding:
    position, velocity = topics[Role.POSITION], topics[Role.VELOCITY]
    if name == _EXCHANGED:
        exchange = Exchange(("latitude", "longitude"))
        if VELOCITY in known.motion.turns or "east" in known.motion.signals:
            return Finding(position, Kind.AXES, Reason.POSITION_EXCHANGED, against=velocity, mend=exchange)
        against = _other(known, POSITION)
        return Finding(position, Kind.AXES, Reason.POSITION_COURSE_AGAINST, against=against, mend=exchange)
    reason = Reason.LONGITUDE_REVERSED if name == "longitude" else Reason.LATITUDE_REVERSED
    return Finding(position, Kind.SIGN, reason, name, against=velocity, mend=Scale(name, -1.0))


def _undecided(equal: Sequence[Hypothesis], known: Relations, topics: Topics) -> Iterator[Finding]:
    """A finding for each sensor that is wrong by some of the explanations that are as good, without a mend."""
    explanations = [list(_findings(one, known, topics)) for one in equal]
    first, second = (" and ".join(map(_in_short, explanation)) for explanation in explanations[:2])
    concerned = dict.fromkeys(finding.topic for explanation in explanations for finding in explanation)
    for topic in concerned:
        own = [finding for explanation in explanations for finding in explanation if finding.topic == topic]
        plain = next((finding for finding in own if finding.kind is Kind.SIGN), own[0])
        undecided = replace(plain, confidence=Confidence.UNDECIDED, mend=None)
        if all(any(finding.topic == topic for finding in explanation) for explanation in explanations):
            yield undecided  # it is wrong by all of them, though not in which way
            continue
        others = ", ".join(other for other in concerned if other != topic)
        names = {"others": others, "one": first, "other": second}
        yield replace(undecided, reason=Reason.CONVENTION_UNDECIDED, names=names)


def _in_short(finding: Finding) -> str:
    what = {Scale: "the sign", Turn: "the axes", Exchange: "the order"}.get(type(finding.mend), "the sides")
    return f"{what} of {finding.topic}{f' {finding.signal}' if finding.signal else ''}"
