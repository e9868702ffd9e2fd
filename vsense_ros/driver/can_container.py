"""Frames that contain several messages (AUTOSAR container PDUs): each is taken out and given to who listens to it."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np
from cantools.database import Message
from numpy.typing import NDArray

from vsense_ros.driver.can_receiver import Receiver
from vsense_ros.driver.can_signal import Frames
from vsense_ros.messages.recording import Sample

_HEADER = 4  # [byte]: three of the identifier in the container, and one of the length


def contained(data: bytes) -> Iterator[tuple[int, bytes]]:
    """Identifier and data of each message in a container, in their order; one that is cut off is left out."""
    at = 0
    while at + _HEADER <= len(data):
        identifier, length = int.from_bytes(data[at : at + 3], "big"), data[at + 3]
        content = data[at + _HEADER : at + _HEADER + length]
        if len(content) < length:
            return
        if identifier or length:  # else the rest is padding
            yield identifier, content
        at += _HEADER + length


class Container:
    """One container of the bus, and the messages in it that are listened to."""

    def __init__(self, message: Message) -> None:
        self.message = message
        self._receivers: dict[int, Receiver] = {}

    @property
    def receivers(self) -> tuple[Receiver, ...]:
        """Who listens to messages in it."""
        return tuple(self._receivers.values())

    def add(self, part: Message, receiver: Receiver) -> None:
        """Listen to a message in it."""
        self._receivers[part.header_id or 0] = receiver

    def feed(self, data: bytes, arrival: int, received: int | None) -> list[Sample]:
        """Samples of all messages in one frame that are listened to; times as in `Receiver.feed`."""
        made = []
        for identifier, content in contained(data):
            receiver = self._receivers.get(identifier)
            if receiver is not None:
                made += receiver.feed(content, arrival, received)
        return made

    def parts(self, frames: Frames, lengths: NDArray[np.int64]) -> Iterator[tuple[Receiver, NDArray[np.intp], Frames]]:
        """Unpack all frames of a log, (n, bytes) with lengths (n,).

        Yields each receiver that a frame has a message for, the places of these frames, and the data of the messages;
        one that is shorter than its receiver expects is left out.
        """
        gathered: dict[int, tuple[list[int], list[bytes]]] = {identifier: ([], []) for identifier in self._receivers}
        for row, (frame, length) in enumerate(zip(frames, lengths.tolist(), strict=True)):
            for identifier, data in contained(frame[:length].tobytes()):
                if identifier in gathered and len(data) >= self._receivers[identifier].length:
                    gathered[identifier][0].append(row)
                    gathered[identifier][1].append(data[: self._receivers[identifier].length])
        for identifier, (rows, content) in gathered.items():
            receiver = self._receivers[identifier]
            if rows:
                table = np.frombuffer(b"".join(content), np.uint8).reshape(len(rows), receiver.length)
                yield receiver, np.array(rows, np.intp), table
