"""CAN frames to samples: a DBC says where the signals are, a mapping says what they mean."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from pathlib import Path

import can
from cantools.database import Database, Message

from vsense_ros.checks.watch import PlausibilityWatch
from vsense_ros.driver.can_container import Container
from vsense_ros.driver.can_database import CanDatabase, read_database
from vsense_ros.driver.can_mapping import CanMapping, MessageCheck, load_mapping, suggestion
from vsense_ros.driver.can_receiver import Receiver
from vsense_ros.driver.monitor import LATEST, NANO
from vsense_ros.errors import InputError
from vsense_ros.messages.diagnostic import Diagnostic, Level
from vsense_ros.messages.recording import Sample


def _pgn(identifier: int) -> int:
    """The parameter group of an identifier of J1939: without priority, source, and where it is one, destination."""
    format_ = identifier >> 16 & 0xFF
    return identifier >> 8 & (0x3FF00 if format_ < 240 else 0x3FFFF)


class CanDecoder:
    """Decodes the frames of one bus.

    `database` and `mapping` are files or what was loaded from them. With `channel`, frames of other channels (as in a
    log of several buses) are passed over.

    Raises `InputError` if the mapping asks for messages or signals that the database does not have.
    """

    def __init__(
        self,
        database: str | Path | Database | CanDatabase,
        mapping: str | Path | CanMapping,
        channel: str | int | None = None,
    ) -> None:
        if isinstance(database, str | Path):
            read = read_database(database)
        else:
            read = database if isinstance(database, CanDatabase) else CanDatabase(database)
        self.database = read.database
        self.mapping = mapping if isinstance(mapping, CanMapping) else load_mapping(mapping)
        self.channel = channel
        self._receivers: dict[tuple[int, bool], Receiver] = {}
        self._by_pgn: dict[int, Receiver] = {}
        self._containers: dict[tuple[int, bool], Container] = {}
        notes = list(read.notes)
        for name in dict.fromkeys(output.message for output in self.mapping.outputs):
            container, message = self._message(name, read.notes)
            receiver = self._listen(name, message, container)
            notes += receiver.notes
        self.notes: tuple[str, ...] = tuple(notes)
        self._database_ids = {(m.frame_id, m.is_extended_frame) for m in self.database.messages}
        self._ignored: dict[tuple[int, bool], str] = {}  # why, by identifier
        self.watch = PlausibilityWatch("can")
        self._listeners: dict[tuple[int, bool], Receiver | Container] = {}  # those that do not change
        self._frames = 0
        self._passed: Counter[tuple[int, bool]] = Counter()  # frames that nobody listens to
        self._counts = dict.fromkeys(
            ("not mapped", "not in the database", "error frames", "broken frames", "without time stamp"), 0
        )
        self._other_channels: set[str] = set()
        self._last_frame: int | None = None
        self._last_error: int | None = None
        self._last_broken: int | None = None

    def _message(self, name: str, notes: Sequence[str]) -> tuple[Message | None, Message]:
        """The message of the database that the mapping calls by its name, or by name@identifier if there are several
        of one name, behind the container in which it travels, if it does; `notes` say which were left out."""
        alike = [message for message in self.database.messages if message.name == name]
        if len(alike) == 1:
            self._must_have_signals(alike[0])
            return None, alike[0]
        inside = [(m, part) for m in self.database.messages for part in m.contained_messages or () if part.name == name]
        if not alike and inside:
            return inside[0]
        if alike:
            choices = ", ".join(f"{name}@0x{message.frame_id:X}" for message in alike)
            raise InputError(f"{self._where}: the database has {len(alike)} messages {name!r}; say which: {choices}")
        for message in self.database.messages:
            if name == f"{message.name}@0x{message.frame_id:X}":
                return None, message
        names = [message.name for message in self.database.messages]
        left_out = next((note for note in notes if f" {name} left out" in note), "")
        raise InputError(
            f"{self._where}: the database has no message {name!r}{suggestion(name, names)}; "
            f"it has {len(names)} messages" + (f" ({left_out})" if left_out else "")
        )

    def _must_have_signals(self, message: Message) -> None:
        if message.is_container:
            parts = ", ".join(part.name for part in message.contained_messages or ())
            raise InputError(f"{self._where}: {message.name} is a container; name the message in it: {parts}")

    def _listen(self, name: str, message: Message, container: Message | None) -> Receiver:
        """Listen to a message that the mapping calls by `name`, by itself or in its container."""
        outputs = [output for output in self.mapping.outputs if output.message == name]
        check = self.mapping.messages.get(name, MessageCheck())
        # The null address, which never sends, stands in databases of J1939 for any.
        said_so = message.protocol == "j1939" or message.frame_id & 0xFF == 0xFE
        of_j1939 = message.is_extended_frame and (said_so if check.j1939 is None else check.j1939)
        receiver = Receiver(message, check, outputs, self._where, of_j1939=of_j1939 and container is None)
        if container is not None:
            key = (container.frame_id, container.is_extended_frame)
            self._containers.setdefault(key, Container(container)).add(message, receiver)
            return receiver
        self._receivers[message.frame_id, message.is_extended_frame] = receiver
        if of_j1939:
            self._by_pgn[_pgn(message.frame_id)] = receiver
        return receiver

    @property
    def _where(self) -> str:
        return f"CAN mapping {self.mapping.name}"

    def feed(self, message: can.Message, received: int | None = None) -> list[Sample]:
        """Samples of one frame; none if it is of no interest or not believed.

        The frame's time stamp [s] is the clock of the measurements. `received` [ns] is the time of arrival in the
        clock given to `diagnostics`, where that is another one.
        """
        if self.channel is not None and message.channel is not None and message.channel != self.channel:
            if len(self._other_channels) < 16:
                self._other_channels.add(str(message.channel))
            return []
        arrival = message.timestamp * NANO
        if not 0.0 <= arrival < LATEST:
            self._counts["without time stamp"] += 1
            return []
        arrival = round(arrival)
        at = arrival if received is None else received
        if message.is_error_frame:
            self._counts["error frames"] += 1
            self._last_error = at
            return []
        self._frames += 1
        self._last_frame = at
        if message.is_remote_frame:
            return []
        key = (message.arbitration_id, message.is_extended_id)
        listener = self._listeners.get(key) or self._listener(key)
        if listener is None:
            return []
        made = listener.feed(bytes(message.data), arrival, received)
        for sample in made:
            self.watch.add(sample)
        return made

    def _listener(self, key: tuple[int, bool]) -> Receiver | Container | None:
        """Who listens to an identifier of which nobody knows yet; if it is nobody, the frame is counted."""
        ignored = self._ignored.get(key)  # most frames are for others
        if ignored is not None:
            self._counts[ignored] += 1
            self._passed[key] += 1
            return None
        receiver = self.receiver(*key)
        if receiver is not None:
            if not receiver.by_group:
                self._listeners[key] = receiver
            return receiver
        container = self._containers.get(key)
        if container is not None:
            self._listeners[key] = container
            return container
        reason = "not mapped" if key in self._database_ids else "not in the database"
        self._counts[reason] += 1
        self._passed[key] += 1
        if not self._by_pgn:  # whose sender may change
            self._ignored[key] = reason
        return None

    def listens(self, identifier: int, is_extended: bool) -> bool:
        """True if frames with this identifier are of use."""
        key = (identifier, is_extended)
        return key in self._receivers or key in self._containers or (is_extended and _pgn(identifier) in self._by_pgn)

    def container(self, identifier: int, is_extended: bool) -> Container | None:
        """The container with an identifier, if messages in it are listened to."""
        return self._containers.get((identifier, is_extended))

    def receiver(self, identifier: int, is_extended: bool) -> Receiver | None:
        """Who listens to an identifier: by itself, or by its parameter group where that is of J1939."""
        key = (identifier, is_extended)
        receiver = self._receivers.get(key)
        if receiver is None and is_extended and key not in self._database_ids:
            receiver = self._by_pgn.get(_pgn(identifier))
        if receiver is None or not receiver.by_group:
            return receiver
        source = identifier & 0xFF
        if receiver.source is None or (key in self._receivers and not receiver.source_is_given):
            receiver.source = source  # several units may send a group: that of the database, else the first one heard
        return receiver if receiver.source == source else None

    def broken(self, at: int) -> None:
        """What arrived at `at` [ns] was no frame that the interface could read."""
        self._counts["broken frames"] += 1
        self._last_broken = at

    def diagnostics(self, now: int) -> list[Diagnostic]:
        """Health of the bus, then of each message that is listened to, at `now` [ns]."""
        for (identifier, is_extended), receiver in self._receivers.items():
            receiver.monitor.absence = self._absence(identifier, is_extended)
        inside = [receiver for container in self._containers.values() for receiver in container.receivers]
        health = [receiver.diagnostic(now) for receiver in (*self._receivers.values(), *inside)]
        return [self._bus(now), *health, *self.watch.diagnostics(now)]

    def passed(self) -> str:
        """Identifiers that came and that nothing listens to, the most frequent first; empty if there were none."""
        listed = [
            f"0x{identifier:X}{' (29 bits)' if is_extended else ''} × {count}"
            for (identifier, is_extended), count in self._passed.most_common(12)
        ]
        more = len(self._passed) - len(listed)
        return ", ".join(listed) + (f" and {more} more" if more > 0 else "")

    def _absence(self, identifier: int, is_extended: bool) -> str:
        """Why a message may never have come."""
        if (identifier, not is_extended) in self._passed:
            return f"frames with this identifier come with {11 if is_extended else 29} bits: is the database right?"
        if self._other_channels and not self._frames:
            return f"frames come from {', '.join(sorted(self._other_channels))}, expected channel {self.channel}"
        passed = self.passed()
        return f"of what comes nothing has its identifier: {passed}" if passed else ""

    def _bus(self, now: int) -> Diagnostic:
        values = {"frames": str(self._frames), **{name: str(count) for name, count in self._counts.items()}}
        passed = self.passed()
        if passed:
            values["identifiers that nothing listens to"] = passed
        if self.notes:
            values["notes"] = "; ".join(self.notes)
        level, text = Level.OK, "ok"
        if self._last_frame is None:
            level, text = Level.STALE, "no frame received: is the bus connected, and the bit rate right?"
        elif now - self._last_frame > self.mapping.bus_timeout * NANO:
            level, text = Level.STALE, f"bus silent for {(now - self._last_frame) / NANO:.2f} s"
        elif self._last_error is not None and abs(now - self._last_error) <= 2 * NANO:
            level, text = Level.WARN, "error frames on the bus"
        elif self._last_broken is not None and now - self._last_broken <= 2 * NANO:
            level, text = Level.WARN, "broken frames: is the line to the adapter disturbed?"
        return Diagnostic(f"can: bus ({self.mapping.name})", level, text, values)
