"""A recording on a runner, message by message, where the messages have been read in blocks."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import repeat

from vsense_ros.estimation.timeline import Event
from vsense_ros.messages.recording import Channel, Recording, as_numbers, by_arrival
from vsense_ros.runner.runner import Runner


def play(runner: Runner, recording: Recording, topics: Sequence[str]) -> Iterator[None]:
    """Let a runner use the messages of a recording on these topics in order of arrival, ties in the order of the
    recording, and yield after each.

    The runner does what it would do if each were given to `Runner.add`.
    """
    channels = [channel.in_order() for topic, channel in recording.channels.items() if topic in topics]
    streams = [_read_ahead(runner, channel) for channel in channels]
    examine, take = runner.intake.examine, runner.take
    for stamp, received, places, readings in by_arrival([channel.received for channel in channels], streams):
        if len(places) == 1:  # which is usual, and needs no loop
            index = places[0]
            take(index, stamp, examine(index, stamp, received, readings[0]))
        else:
            for index, reading in zip(places, readings, strict=True):
                take(index, stamp, examine(index, stamp, received, reading))
        yield


def _read_ahead(runner: Runner, channel: Channel) -> Iterator[tuple[int, int, list[int], tuple[Event | str, ...]]]:
    """Stamp and time of arrival [ns] of each message, the sensors that listen, and what each of them reads in it."""
    places = runner.listeners[channel.topic]
    read = zip(*(runner.intake.read_channel(index, channel) for index in places), strict=True)
    return zip(as_numbers(channel.stamp), as_numbers(channel.received), repeat(places), read, strict=False)
