"""Recordings put together: the parts of a split one, and several of one drive with clocks of their own."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from vsense_ros.checks.offset import clock_offset
from vsense_ros.errors import InputError
from vsense_ros.messages.recording import Channel, Recording


def concatenated(parts: Sequence[Recording]) -> dict[str, Channel]:
    """The channels of a recording that was split: rows one behind the other."""
    joined_channels: dict[str, Channel] = {}
    for part in parts:
        for topic, channel in part.channels.items():
            first = joined_channels.get(topic)
            if first is None:
                joined_channels[topic] = channel
            elif (first.kind, first.names, first.frame_id) == (channel.kind, channel.names, channel.frame_id):
                joined_channels[topic] = replace(
                    first,
                    stamp=np.concatenate([first.stamp, channel.stamp]),
                    received=np.concatenate([first.received, channel.received]),
                    columns={
                        name: np.concatenate([first.columns[name], channel.columns[name]]) for name in first.columns
                    },
                )
    return joined_channels


def joined(recordings: Sequence[Recording], *, keep_times: bool = False) -> Recording:
    """One recording of several that were made of the same drive by loggers with clocks of their own; with `keep_times`,
    by loggers with one clock, whose times stay as they are.

    The time of the first counts. By how much the clock of each other one differs is found from the motion that both
    tell (turning and speed), and stands in the notes. Raises `InputError` where two have a topic in common, or no
    motion by which their clocks could be compared.
    """
    first, *others = recordings
    channels = dict(first.channels)
    notes, damage, lost = list(first.notes), list(first.damage), first.messages_lost
    metadata = dict(first.metadata)
    for other in others:
        twice = sorted(channels.keys() & other.channels.keys())
        if twice:
            raise InputError(
                f"{other.name}: has {', '.join(twice)}, which {first.name} has, too; a topic has one source: leave it "
                "out of one of the mappings"
            )
        clock = (0.0, 1.0) if keep_times else clock_offset(replace(first, channels=channels), other)
        if clock is None:
            raise InputError(
                f"{other.name}: nothing in it measures the same motion as {first.name} (a speed or a turning rate in "
                "both), so that the difference of their clocks cannot be found; if they have one clock: --keep-times"
            )
        offset, alike = clock
        if not keep_times:
            notes.append(
                f"{other.name}: its times are put {offset:+.3f} s to those of {first.name}, by the motion that both "
                f"tell (correlation {alike:.3f})"
            )
        shift = round(offset * 1e9)
        channels |= {
            topic: replace(channel, stamp=channel.stamp + shift, received=channel.received + shift)
            for topic, channel in other.channels.items()
        }
        notes += other.notes
        damage += other.damage
        lost += other.messages_lost
        metadata = {**other.metadata, **metadata}
    return Recording(channels, first.name, tuple(dict.fromkeys(notes)), lost, metadata, tuple(dict.fromkeys(damage)))
