"""A recording on a runner, message by message, where the messages have been read in blocks."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from vsense_ros.estimation.timeline import Event
from vsense_ros.messages.recording import Channel, Recording, by_arrival
from vsense_ros.runner.runner import Runner


def play(runner: Runner, recording: Recording, topics: Sequence[str]) -> Iterator[None]:
    """Let a runner use the messages of a recording on these topics in order of arrival, ties in the order of the
    recording, and yield after each.

    The runner does what it would do if each were given to `Runner.add`.
    """
    channels = [channel.in_order() for topic, channel in recording.channels.items() if topic in topics]
    streams = [_read_ahead(runner, channel) for channel in channels]
    for stamp, received, readings in by_arrival([channel.received for channel in channels], streams):
        for index, reading in readings:
            runner.take(index, stamp, runner.intake.examine(index, stamp, received, reading))
        yield


def _read_ahead(runner: Runner, channel: Channel) -> Iterator[tuple[int, int, list[tuple[int, Event | str]]]]:
    """Stamp and time of arrival [ns] of each message, and what each sensor that listens reads in it, with its place."""
    places = runner.listeners[channel.topic]
    read = zip(*(runner.intake.read_channel(index, channel) for index in places), strict=True)
    for stamp, received, readings in zip(channel.stamp.tolist(), channel.received.tolist(), read, strict=True):
        yield stamp, received, list(zip(places, readings, strict=True))
