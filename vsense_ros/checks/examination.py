"""All checks of a recording, one after the other: what later ones make of it depends on what earlier ones found."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence

from vsense_ros.checks import clocks, consistency, reference, units, values
from vsense_ros.checks.conventions import decided
from vsense_ros.checks.correcting import mended
from vsense_ros.checks.finding import Confidence, Finding, Kind
from vsense_ros.checks.frames import position_steps
from vsense_ros.checks.reason import Reason
from vsense_ros.checks.roles import USUAL_TOPICS, Role, Topics
from vsense_ros.checks.subject import Subject
from vsense_ros.messages.recording import Recording

Check = Callable[[Subject, Sequence[Finding]], Iterable[Finding]]

_OF_A_FRAME = (Kind.FRAME, Kind.AXES, Kind.UNIT, Kind.SIGN)
_OF_A_CONVENTION = (Kind.AXES, Kind.SIGN, Kind.FRAME)
_OF_A_SIGNAL = (Reason.SIGNAL_JUMPS, Reason.SIGNAL_JUMPS_OFTEN)
_OF_A_RANGE = (Reason.POSITION_RANGE, Reason.POSITION_ZERO)
RECORDING = "recording"  # in place of a topic, for what concerns all of it


def usable(subject: Subject, _: Sequence[Finding]) -> Iterator[Finding]:
    """A recording in which there is nothing to be read, or of which something is lost."""
    recording, certain = subject.recording, Confidence.CERTAIN
    if not any(len(recording[topic]) for topic in subject.topics.values() if topic in recording):
        names = {"topics": ", ".join(sorted(recording.channels)) or "nothing"}
        yield Finding(RECORDING, Kind.MISSING, Reason.NO_KNOWN_TOPIC, confidence=certain, names=names)
    if recording.messages_lost:
        evidence = {"count": float(recording.messages_lost)}
        yield Finding(RECORDING, Kind.CUT, Reason.MESSAGES_LOST, confidence=certain, evidence=evidence)
    for damage in recording.damage:
        yield Finding(RECORDING, Kind.CUT, Reason.DAMAGED, confidence=certain, names={"damage": damage})


def frames(subject: Subject, _: Sequence[Finding]) -> Iterator[Finding]:
    """The frame of the GNSS velocity, and the position, against each other and how the car turns."""
    yield from subject.frame_findings
    blamed = {finding.topic for finding in subject.frame_findings}
    if subject.aligned is not None and not blamed & {subject.topics[r] for r in (Role.POSITION, Role.VELOCITY)}:
        yield from position_steps(subject.aligned)
    yield from subject.course_findings


# Units and sizes of single signals, and of those that GNSS shows.
OF_UNITS: tuple[Check, ...] = (
    units.gravity, units.yaw_rate, units.rolling, units.steering_range, units.steering_size, units.position_range,
    values.position_jumps, units.brake_pressure,
)  # fmt: skip
OF_MOTION: tuple[Check, ...] = (
    frames, values.frozen_steering, consistency.turning, consistency.gyro_axes, consistency.axes_in_plane,
    consistency.wheel_ratios, values.frozen_wheels, clocks.lags,
)  # fmt: skip
OF_VALUES: tuple[Check, ...] = (
    usable, values.held, values.jumps, values.quantised, values.frozen_gnss, clocks.apart, clocks.running,
    clocks.repeated, reference.contradictions,
)  # fmt: skip


def findings(recording: Recording, topics: Topics = USUAL_TOPICS, radius: float | None = None) -> list[Finding]:
    """All that cannot be right in a recording with the `topics` of a vehicle; its rolling `radius` [m], if it is known.

    A check that raises becomes a finding itself, and the others go on.
    """
    subject = Subject(recording, topics, radius)
    of_values, of_units = run(OF_VALUES, subject), run(OF_UNITS, subject)
    units = [f for f in (*of_units, *subject.frame_findings) if f.kind is Kind.UNIT and f.mend is not None]
    of_conventions = run((conventions,), Subject(mended(recording, units), topics, radius))
    with_mend = [f for f in of_conventions if f.mend is not None]
    wrong = {f.topic for f in of_conventions}
    of_units = [f for f in of_units if f.topic not in wrong or f.kind is not Kind.SIGN]
    # What is wrong besides is sought with the right axes and signs: a sensor that is mended contradicts nobody.
    besides = run(OF_MOTION, Subject(mended(recording, with_mend), topics, radius), of_units)
    if not with_mend:
        besides = [f for f in besides if f.topic not in wrong or not _is_of_a_convention(f)]
    return without_repetitions(_consistent([*of_conventions, *besides, *of_values], subject))


def _is_of_a_convention(finding: Finding) -> bool:
    """True for findings that an undecided convention says already; where gravity is remains certain."""
    return finding.kind in _OF_A_CONVENTION and finding.reason is not Reason.GRAVITY_AXIS


def conventions(subject: Subject, _: Sequence[Finding]) -> Iterable[Finding]:
    """Sensors that follow another convention of axes and signs."""
    return decided(subject)


def run(checks: Iterable[Check], subject: Subject, earlier: Sequence[Finding] = ()) -> list[Finding]:
    """The findings of checks after some earlier ones, which come first."""
    result = list(earlier)
    for check in checks:
        try:
            result += check(subject, tuple(result))
        except Exception as error:  # whatever a check stumbles over, the others still say something
            names = {"check": check.__name__, "error": f"{type(error).__name__}: {error}"}
            result.append(Finding(RECORDING, Kind.FAILED, Reason.CHECK_FAILED, names=names))
    return result


def _consistent(findings: Sequence[Finding], subject: Subject) -> Iterator[Finding]:
    """Findings without those that follow from others: topics by another clock do not go with the rest, what a frozen or
    repeating source measures is late, and a GNSS velocity in another frame shows no jumps of the position."""
    gnss = {subject.topics[role] for role in (Role.VELOCITY, Role.POSITION)}
    other_clock = {f.topic for f in findings if f.kind is Kind.CLOCK}
    frozen = {f.topic for f in findings if f.kind is Kind.FROZEN and f.topic in gnss}
    turned = any(f.topic in gnss and f.kind in _OF_A_FRAME and f.reason not in _OF_A_RANGE for f in findings)
    repeats = bool(other_clock) or any(f.kind is Kind.HELD for f in findings)

    def follows(finding: Finding) -> bool:
        by_gnss = finding.against in gnss and finding.kind in (Kind.UNIT, Kind.SIGN, Kind.JUMP)
        by_frozen = finding.kind in (Kind.FRAME, Kind.JUMP) and finding.reason not in _OF_A_SIGNAL
        return (
            (finding.kind is Kind.LAG and (repeats or bool(frozen)))
            or (bool(frozen) and by_frozen)
            or (turned and finding.reason is Reason.POSITION_JUMPS)
            or (by_gnss and bool(other_clock & {*gnss, finding.topic}))
        )

    return (finding for finding in findings if not follows(finding))


def without_repetitions(findings: Iterable[Finding]) -> list[Finding]:
    """Findings without those that say again of a topic that a sign, a unit or a jump is wrong."""
    result: list[Finding] = []
    for finding in findings:
        once = finding.kind in (Kind.SIGN, Kind.UNIT, Kind.JUMP)
        if not (once and any((f.topic, f.kind) == (finding.topic, finding.kind) for f in result)):
            result.append(finding)
    return result
