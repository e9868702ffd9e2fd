"""Clocks that begin anew or are set while they are recorded: counted on, or cut to the longer part, with a sentence.

Loggers count microseconds or milliseconds in 16 or 32 bits; local time goes back by an hour when summer time ends; a
computer without a battery begins in 1970 until its date is set.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from vsense_ros.messages.recording import Channel, Recording

Stamps = NDArray[np.int64]
_SECOND = 1_000_000_000  # [ns]
_HOUR = 3600 * _SECOND
_WRAPS: Mapping[str, int] = {  # [ns] after which a counter begins anew, by its description
    f"{bits} bits of {name}": (1 << bits) * unit
    for bits in (12, 16, 24, 32)
    for name, unit in (("microseconds", 1000), ("milliseconds", 1_000_000))
}


@dataclass(frozen=True)
class ClockSettings:
    """When a step of a clock is one that was set: decisions of this project."""

    least_back: float = 10.0  # [s] back that are no disorder
    least_ahead: float = 86_400.0  # [s] ahead that are no pause
    least_rows_per_turn: int = 4  # rows from one wrap to the next
    slack: float = 20.0  # usual steps by which the step at a wrap or at the end of summer time may differ from them
    hour_slack: float = 5.0  # [s] by which the step at the end of summer time may differ in any case
    together: float = 2.0  # [s] by which the steps of arrival may differ from usual where only the stamps were set


SETTINGS = ClockSettings()


def with_steady_clocks(recording: Recording) -> Recording:
    """The recording with times that go on where their clock began anew or was set; notes say what was done.

    Wraps of counters and the end of summer time are counted on. A clock that was set is followed by arrival where
    arrivals go on; else each topic keeps the part that lasts longest in the one that has the most messages.
    """
    notes: list[str] = []
    channels = {topic: _counted_on(channel, notes) for topic, channel in recording.channels.items()}
    cuts = {topic: cut for topic, channel in channels.items() if len(cut := _cuts(channel.stamp)) > 2}
    if cuts:
        channels |= _longest_parts({topic: channels[topic] for topic in cuts}, cuts, notes)
    if not notes:
        return recording
    return replace(recording, channels=channels, notes=(*recording.notes, *dict.fromkeys(notes)))


def _usual(step: Stamps) -> int:
    ahead = step[step > 0]
    return int(np.median(ahead)) if len(ahead) else 1


def _counted_on(channel: Channel, notes: list[str]) -> Channel:
    """A channel whose stamps go on over wraps and the end of summer time, and where arrivals do."""
    same = channel.stamp is channel.received or np.array_equal(channel.stamp, channel.received)
    stamp = _unwrapped(channel.stamp, notes)
    received = stamp if same else _unwrapped(channel.received, notes)
    if not same:
        stamp = _by_arrival(channel.topic, stamp, received, notes)
    if stamp is channel.stamp and received is channel.received:
        return channel
    return replace(channel, stamp=stamp, received=received)


def _unwrapped(stamp: Stamps, notes: list[str]) -> Stamps:
    if len(stamp) < 3:
        return stamp
    step = np.diff(stamp)
    back = np.flatnonzero(step < 0)
    if not len(back):
        return stamp
    usual = _usual(step)
    slack = SETTINGS.slack * usual
    span = int(stamp.max() - stamp.min())  # of a counter never more than a turn
    added = np.zeros(len(stamp), np.int64)
    for row in back:
        for name, turn in _WRAPS.items():
            if turn < span:
                continue
            near = min(slack, 0.1 * turn)
            if turn >= SETTINGS.least_rows_per_turn * usual and -near <= step[row] + turn - usual <= near:
                added[row + 1] = turn
                notes.append(f"the times are a counter of {name}, which began anew; counted on")
                break
        else:
            if abs(step[row] + _HOUR - usual) <= max(SETTINGS.hour_slack * _SECOND, slack):
                added[row + 1] = _HOUR
                notes.append("the clock goes back by an hour, as when summer time ends; counted on")
    return stamp + np.cumsum(added) if added.any() else stamp


def _jumps(stamp: Stamps) -> NDArray[np.intp]:
    """Rows after which the clock was set."""
    step = np.diff(stamp)
    back = np.maximum(SETTINGS.least_back * _SECOND, SETTINGS.slack * _usual(step)) if len(step) else 0
    return np.flatnonzero((step < -back) | (step > SETTINGS.least_ahead * _SECOND))


def _by_arrival(topic: str, stamp: Stamps, received: Stamps, notes: list[str]) -> Stamps:
    """Stamps whose clock was set while the messages went on arriving go on as they arrived."""
    arrival = np.diff(received)
    for row in _jumps(stamp):
        if 0 <= arrival[row] <= SETTINGS.together * _SECOND:
            shift = int(stamp[row + 1] - stamp[row] - arrival[row])
            stamp = np.concatenate([stamp[: row + 1], stamp[row + 1 :] - shift])
            notes.append(f"{topic}: its clock was set by {shift / _SECOND:+.1f} s; its times go on as it arrived")
    return stamp


def _cuts(stamp: Stamps) -> NDArray[np.intp]:
    """Where the parts between jumps of a clock begin, and the end."""
    return np.concatenate([[0], _jumps(stamp) + 1, [len(stamp)]])


def _longest_parts(
    channels: Mapping[str, Channel], cuts: Mapping[str, NDArray[np.intp]], notes: list[str]
) -> dict[str, Channel]:
    """Keep one part of each channel: the one whose times overlap those of the longest part of the largest channel."""
    leading = max(channels, key=lambda topic: len(channels[topic]))

    def length(topic: str, part: int) -> float:
        stamp = channels[topic].stamp[cuts[topic][part] : cuts[topic][part + 1]]
        return float(stamp[-1] - stamp[0]) / _SECOND

    lengths = [length(leading, part) for part in range(len(cuts[leading]) - 1)]
    chosen = int(np.argmax(lengths))
    begin, end = cuts[leading][chosen], cuts[leading][chosen + 1]
    first, last = channels[leading].stamp[begin], channels[leading].stamp[end - 1]
    longest = {}
    for topic, channel in channels.items():
        parts = list(zip(cuts[topic][:-1], cuts[topic][1:], strict=True))
        if len(parts) == len(lengths):
            low, high = parts[chosen]
        else:
            common = [float(min(last, channel.stamp[b - 1]) - max(first, channel.stamp[a])) for a, b in parts]
            low, high = parts[int(np.argmax(common))]
        longest[topic] = channel.select(slice(int(low), int(high)))
    at = cuts[leading][1]
    step = (channels[leading].stamp[at] - channels[leading].stamp[at - 1]) / _SECOND
    notes.append(
        f"the clock was set by {step:+.1f} s in the recording, which has {len(lengths)} parts by it "
        f"({', '.join(f'{seconds:.1f}' for seconds in lengths)} s): the longest is used"
    )
    return longest
