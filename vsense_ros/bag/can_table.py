"""What is on a CAN bus, as tables for the terminal."""

from __future__ import annotations

from rich.console import Console
from rich.table import Table

from vsense_ros.bag.can_names import WHEEL_SIDES
from vsense_ros.bag.can_roles import Recognized, Roles
from vsense_ros.bag.can_survey import CanSurvey

_MOST_SIGNALS = 8  # of a message that are named in one line


def show(survey: CanSurvey, roles: Roles, out: Console, *, every: bool) -> None:
    """Print identifiers and what was recognized; the signals of all messages if `every`."""
    known = [message for message in survey.messages if message.name]
    frames = sum(message.count for message in survey.messages)
    out.print(
        f"{survey.name}: {frames} frames in {survey.duration:.1f} s, {len(survey.messages)} identifiers, "
        f"{len(known)} of them in the databases"
    )
    out.print(_identifiers(survey))
    if every:
        out.print(_signals(survey))
    if known:
        out.print(_roles(roles))
        missing = _missing(roles)
        if missing:
            out.print(f"Not recognized: {', '.join(missing)}.")
    else:
        out.print("Without a database (--dbc FILE) nothing says what the bytes mean; opendbc has those of many cars.")
    for note in survey.notes:
        out.print(f"Note: {note}")


def _table(*headings: str, right: tuple[str, ...] = ()) -> Table:
    table = Table(box=None, pad_edge=False, header_style="bold", padding=(0, 2))
    for heading in headings:
        table.add_column(heading, justify="right" if heading in right else "left", overflow="fold")
    return table


def _identifiers(survey: CanSurvey) -> Table:
    numbers = ("frames", "rate", "bytes")
    table = _table("identifier", "bus", *numbers, "message", "signals", right=numbers)
    for message in survey.messages:
        names = [signal.name for signal in message.signals]
        more = f" and {len(names) - _MOST_SIGNALS} more" if len(names) > _MOST_SIGNALS else ""
        width = 8 if message.is_extended else 3
        table.add_row(
            f"0x{message.identifier:0{width}X}",
            ", ".join(message.channels),
            str(message.count),
            f"{message.rate:.4g} Hz" if message.rate else "–",
            str(message.length),
            message.name or "–",
            ", ".join(names[:_MOST_SIGNALS]) + more,
        )
    return table


def _signals(survey: CanSurvey) -> Table:
    table = _table("signal", "unit", "least", "largest", "rate", right=("least", "largest", "rate"))
    for signal in survey.signals:
        table.add_row(signal.label, signal.unit, f"{signal.low:.4g}", f"{signal.high:.4g}", f"{signal.rate:.4g} Hz")
    return table


def _all(roles: Roles) -> dict[str, Recognized | None]:
    return {
        **{f"wheel {side}": roles.wheels.get(side) for side in WHEEL_SIDES},
        "steering wheel angle": roles.steering_wheel,
        "yaw rate": roles.yaw_rate,
        "lateral acceleration": roles.lateral_acceleration,
        "longitudinal acceleration": roles.longitudinal_acceleration,
        "speed": roles.speed,
    }


def _missing(roles: Roles) -> list[str]:
    return [name for name, recognized in _all(roles).items() if recognized is None]


def _roles(roles: Roles) -> Table:
    table = _table("it measures", "signal", "unit", "least", "largest", "agrees", right=("least", "largest", "agrees"))
    for name, recognized in _all(roles).items():
        if recognized is None:
            continue
        signal = recognized.signal
        agrees = "–" if recognized.correlation != recognized.correlation else f"{abs(recognized.correlation):.2f}"
        sign = f" with {recognized.sign.name}" if recognized.sign is not None else ""
        unit = recognized.unit if recognized.factor == 1.0 else f"{recognized.factor:g} {recognized.unit}"
        table.add_row(name, signal.label + sign, unit, f"{signal.low:.4g}", f"{signal.high:.4g}", agrees)
    for signal in roles.gnss[:_MOST_SIGNALS]:
        table.add_row("satellite receiver", signal.label, signal.unit, f"{signal.low:.4g}", f"{signal.high:.4g}", "–")
    return table
