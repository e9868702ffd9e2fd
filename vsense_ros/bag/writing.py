"""Recordings and messages into bags that rosbag2 plays: a folder with MCAP files and `metadata.yaml`."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from itertools import repeat
from pathlib import Path
from tempfile import TemporaryDirectory
from types import TracebackType

from vsense_ros.bag.mcap_writer import COMPRESSORS, McapWriter
from vsense_ros.bag.metadata import FILE_NAME, FileSummary, TopicDescription, metadata_text
from vsense_ros.errors import InputError
from vsense_ros.messages import cdr
from vsense_ros.messages.recording import Channel, Recording, Sample, as_numbers, by_arrival

_ENCODED_AT_ONCE = 8192  # messages


class BagWriter:
    """Writes a bag folder `<name>/<name>_0.mcap` with `metadata.yaml`, as a context manager.

    The same calls write the same bytes: nothing in the file depends on clock, host or version of this package
    (with compression, on the version of the compression library). What has been written stands readable in the file
    chunk by chunk, also if the process dies before `close`.

    A file that has reached `split_size` [byte] or spans `split_duration` [s] is finished, and `<name>_1.mcap` begun;
    0: never. Raises `InputError` if the folder holds something already (`overwrite=True` replaces a bag).
    """

    def __init__(
        self,
        path: str | Path,
        *,
        compression: str = "zstd",
        overwrite: bool = False,
        metadata: Mapping[str, str] | None = None,
        split_size: int = 0,
        split_duration: float = 0.0,
    ) -> None:
        if compression not in COMPRESSORS:
            raise InputError(f"compression {compression!r} is unknown; expected one of 'zstd', 'lz4', ''")
        self.path = Path(path)
        self._compression = compression
        self._metadata = dict(metadata or {})
        self._split_size, self._split_duration = split_size, round(split_duration * 1e9)
        for old in _replaceable(self.path, overwrite):
            old.unlink()
        self.path.mkdir(parents=True, exist_ok=True)
        self._descriptions: dict[str, TopicDescription] = {}
        self._finished: list[FileSummary] = []
        self._closed = False
        self._begin_file()

    def _begin_file(self) -> None:
        name = f"{self.path.resolve().name}_{len(self._finished)}.mcap"
        self._file = McapWriter(self.path / name, self._compression)

    def describe_bag(self, metadata: Mapping[str, str]) -> None:
        """Add to the metadata of the bag, which are written at its end."""
        self._metadata.update(metadata)

    def write(self, sample: Sample) -> None:
        """Write a sample at its time of arrival, or of measurement if that is unknown."""
        time = sample.stamp if sample.received is None else sample.received
        self.write_raw(sample.topic, sample.kind, time, cdr.encode(sample))

    def describe(self, topic: str, description: TopicDescription) -> None:
        """Say before its first message what a topic is; those of the project's own types need not be described."""
        self._descriptions.setdefault(topic, description)

    def write_raw(self, topic: str, kind: str, log_time: int, data: bytes) -> None:
        """Write a message that is CDR bytes already; `log_time` [ns]."""
        description = self._descriptions.get(topic)
        if description is None:
            description = self._descriptions[topic] = TopicDescription.of(topic, kind)
        if kind != description.kind:
            raise InputError(f"{topic}: was {description.kind} so far, now {kind}; a topic has one type")
        if log_time < 0:
            raise InputError(
                f"{topic}: time {log_time} ns is before 1970; in a mapping, start of time is the date it counts from"
            )
        file = self._file
        if file.begun and (0 < self._split_size <= file.size or 0 < self._split_duration <= log_time - file.first):
            self.split()
        self._file.write(topic, description, log_time, data)

    def split(self) -> None:
        """Finish the file, and begin the next."""
        if self._file.begun:
            self._file.finish(self._metadata_text())
            self._finished.append(self._file.summary())
            self._begin_file()

    def flush(self) -> None:
        """Write what is pending: whatever happens to the process, it is in the file."""
        self._file.flush()

    def close(self) -> None:
        """Finish the file and write `metadata.yaml`."""
        if self._closed:
            return
        self._closed = True
        text = self._metadata_text()
        self._file.finish(text)
        (self.path / FILE_NAME).write_text(text, encoding="utf-8")

    def abandon(self) -> None:
        """Leave the file as far as it came, without an end, when it cannot be written any more."""
        self._closed = True
        self._file.abandon()

    def _metadata_text(self) -> str:
        return metadata_text([*self._finished, self._file.summary()], self._descriptions, self._metadata)

    def __enter__(self) -> BagWriter:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self.close()


def _replaceable(path: Path, overwrite: bool) -> list[Path]:
    """The files of an old bag in the way. Raises `InputError` where anything else is, or it must not be overwritten."""
    if not path.exists():
        return []
    if not path.is_dir():
        raise InputError(f"{path}: a bag is a folder, but a file of this name exists; choose another name")
    old = list(path.iterdir())
    if old and not overwrite:
        raise InputError(f"{path}: holds something already; choose another name or allow overwriting")
    if any(not (f.name == FILE_NAME or f.suffix == ".mcap") for f in old):
        raise InputError(f"{path}: holds files that are no bag, so it is not overwritten")
    return old


def write_bag(path: str | Path, recording: Recording, *, compression: str = "zstd", overwrite: bool = False) -> None:
    """Write a recording as a bag, in order of arrival. Its name, metadata and notes go into `custom_data`.

    It is written as by `write_pieces`.
    """
    write_pieces(path, [recording], compression=compression, overwrite=overwrite)


def write_pieces(
    path: str | Path, pieces: Iterable[Recording], *, compression: str = "zstd", overwrite: bool = False
) -> None:
    """Write recordings that follow each other as one bag, each in order of arrival, with the metadata of the first and
    the notes of all.

    It is written beside its place and renamed at the end: whatever ends the program before that, an old bag is as it
    was, and nothing half-written stands in its place.
    """
    path = Path(path)
    _replaceable(path, overwrite)
    target = path.resolve()
    target.parent.mkdir(parents=True, exist_ok=True)
    with TemporaryDirectory(prefix=f".{target.name}.", dir=target.parent) as folder:
        written = Path(folder) / target.name
        with _named(path), BagWriter(written, compression=compression) as writer:
            notes: dict[str, None] = {}
            for index, piece in enumerate(pieces):
                notes |= dict.fromkeys(piece.notes)
                in_lines = {"notes": "\n".join(notes)} if notes else {}
                writer.describe_bag({**({} if index else piece.metadata), **in_lines})
                _write(writer, piece)
        for old in _replaceable(path, overwrite):
            old.unlink()
        written.replace(target)


@contextmanager
def _named(path: Path) -> Iterator[None]:
    """Let errors of writing, as of a full disk, say what was to be written: the system does not."""
    try:
        yield
    except OSError as error:
        if error.filename is None:
            error.filename = str(path)
        raise


def _write(writer: BagWriter, recording: Recording) -> None:
    """Write the messages of a recording in order of arrival."""
    channels = [channel.in_order() for channel in recording.channels.values() if len(channel)]
    if not channels:
        return
    streams = [zip(repeat(c), as_numbers(c.received), _encoded(c), strict=False) for c in channels]
    try:
        for channel, time, data in by_arrival([channel.received for channel in channels], streams):
            writer.write_raw(channel.topic, channel.kind, time, data)
    except BaseException:
        writer.abandon()
        raise


def _encoded(channel: Channel) -> Iterator[bytes]:
    """The messages of a channel one after the other, encoded some thousands at a time."""
    for begin in range(0, len(channel), _ENCODED_AT_ONCE):
        rows = cdr.encode_channel(channel.select(slice(begin, begin + _ENCODED_AT_ONCE)))
        data, length = rows.tobytes(), rows.shape[1]
        for at in range(0, len(data), length):
            yield data[at : at + length]
