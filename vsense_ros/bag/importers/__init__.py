"""Recordings of any format, one module each. A new one is a module in this folder with NAME, DESCRIPTION,
`matches(path)`, and `read(path, **options)`; with `pieces(path, size, **options)` files of any size are read in bounded
memory. The other modules here, which have no NAME, are what several share."""

from __future__ import annotations

import inspect
from collections.abc import Callable, Collection, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from pkgutil import iter_modules
from types import ModuleType
from typing import Any

from vsense_ros.bag.clocks import with_steady_clocks
from vsense_ros.bag.held import without_repeats
from vsense_ros.bag.importers.elsewhere import converter_of
from vsense_ros.errors import InputError
from vsense_ros.extras import MissingExtra, explained
from vsense_ros.messages.recording import Recording

_LAST = 2**63 - 1  # [ns]
_OWN = ("rosbag2", "mcap")  # bags of ROS 2, for which the libraries of no other format are loaded
_MOST_MEMORY, _MOST_OF_FILE = 768 << 20, 24  # [byte], and times the size of a file, that reading it may take


@dataclass(frozen=True)
class LargeFiles:
    """How files are read that are too large for the memory."""

    from_size: int = 512 << 20  # [byte] of a file, from which on it is read in pieces
    piece: int = 64 << 20  # [byte] of a file that are read at once
    most_back: int = 10_000_000_000  # [ns] that times may go back from one piece to the next


LARGE = LargeFiles()


@dataclass(frozen=True)
class Importer:
    """A format: its name, what it is, how it is recognised, and how it is read."""

    name: str
    description: str
    matches: Callable[[Path], bool]
    read: Callable[..., Recording]
    needs: tuple[str, ...] = ()  # options without which another importer of the same file is meant
    pieces: Callable[..., Iterator[Recording]] | None = None  # what `read` gives, one piece after the other

    @property
    def options(self) -> tuple[str, ...]:
        """Names of the keyword options of `read`."""
        return tuple(inspect.signature(self.read).parameters)[1:]


def importers() -> list[Importer]:
    """The importers of this folder in the order in which they are asked: by name, some before the
    others (FIRST = True), and those that judge by a file's ending alone (LAST = True) after them."""
    formats = [module for module in _modules()[0] if hasattr(module, "NAME")]
    formats.sort(key=lambda module: (getattr(module, "LAST", False), not getattr(module, "FIRST", False)))
    return list(map(_of_module, formats))


def _of_module(module: ModuleType) -> Importer:
    return Importer(
        module.NAME,
        module.DESCRIPTION,
        module.matches,
        module.read,
        getattr(module, "NEEDS", ()),
        getattr(module, "pieces", None),
    )


def _modules() -> tuple[list[ModuleType], set[str]]:
    """The modules of this folder that can be imported, and for the others which extra of the installation they lack."""
    modules, lacking = [], set()
    for module in iter_modules(__path__):
        try:
            with explained():
                modules.append(import_module(f"{__name__}.{module.name}"))
        except MissingExtra as error:
            lacking.add(str(error))
    return modules, lacking


def find_importer(path: str | Path, options: Collection[str] = ()) -> Importer:
    """The importer for what `path` holds, of several the first that takes the `options`.

    Raises `InputError` if there is none.
    """
    path = Path(path)
    if not path.exists():
        raise InputError(f"{path}: no such file or folder")
    if not (path.is_file() or path.is_dir()):
        raise InputError(f"{path}: neither a regular file nor a folder; expected a recording")
    for name in _OWN:
        own = _of_module(import_module(f"{__name__}.{name}"))
        if set(options) <= set(own.options) and _matches(own, path):
            return own
    known = importers()
    matching = [importer for importer in known if _matches(importer, path)]
    matching.sort(key=lambda importer: not set(importer.needs) <= set(options))
    for importer in matching:
        if set(options) <= set(importer.options):
            return importer
    if matching:
        return matching[0]
    if path.is_dir() and not any(path.iterdir()):
        raise InputError(f"{path}: the folder is empty; expected a recording")
    if converter := converter_of(path):
        raise InputError(f"{path}: {converter}")
    names = "".join(f"\n  {importer.name}: {importer.description}" for importer in known)
    lacking = "".join(f"\n{sentence}" for sentence in sorted(_modules()[1]))
    raise InputError(f"{path}: no importer knows this. Known are{names}{lacking}")


def _matches(importer: Importer, path: Path) -> bool:
    """True if an importer knows what a path holds; one whose library stumbles over a damaged file does not."""
    try:
        return importer.matches(path)
    except Exception:
        return False


def import_recording(path: str | Path, **options: Any) -> Recording:
    """Read a recording of any known format; `options` go to its importer.

    Raises `InputError` if nothing knows the format or an option is not one of its importer.
    """
    importer = _with_options(path, options)
    with bounded_memory(Path(path)), _one_sentence(path, importer):
        return without_repeats(with_steady_clocks(importer.read(Path(path), **options).compact()))


def import_pieces(path: str | Path, **options: Any) -> Iterator[Recording]:
    """Read a recording piece by piece, in memory that does not grow with a large file where its importer can do so.

    The pieces follow each other in time. Raises `InputError` as `import_recording`, and where a clock goes back from
    one piece to the next.
    """
    path = Path(path)
    importer = _with_options(path, options)
    if importer.pieces is None or not is_large(path):
        yield import_recording(path, **options)
        return
    latest: dict[str, int] = {}
    with _one_sentence(path, importer):
        for piece in importer.pieces(path, LARGE.piece, **options):
            for topic, channel in piece.channels.items():
                if channel.received.min(initial=_LAST) < latest.get(topic, 0) - LARGE.most_back:
                    raise InputError(
                        f"{path}: {topic}: its clock goes back; a file of this size needs times that go on"
                    )
                latest[topic] = int(channel.received.max(initial=latest.get(topic, 0)))
            yield without_repeats(with_steady_clocks(piece.compact()))


def is_large(path: Path) -> bool:
    """True if a recording is a file or folder that is read in pieces where its importer can do so."""
    return _size(path) >= LARGE.from_size


def _size(path: Path) -> int:
    """Size of a file, or of all files in a folder [byte]."""
    return path.stat().st_size if path.is_file() else sum(f.stat().st_size for f in path.rglob("*") if f.is_file())


def _with_options(path: str | Path, options: Mapping[str, Any]) -> Importer:
    """The importer for a file. Raises `InputError` for an option that it does not have."""
    importer = find_importer(path, options)
    unknown = [name for name in options if name not in importer.options]
    if unknown:
        allowed = ", ".join(importer.options) or "none"
        raise InputError(f"{path}: importer {importer.name} has no option {unknown[0]!r}; it has: {allowed}")
    return importer


@contextmanager
def _one_sentence(path: str | Path, importer: Importer) -> Iterator[None]:
    """Whatever a library raises over a damaged file becomes an `InputError`."""
    try:
        with explained():
            yield
    except (InputError, MemoryError):
        raise
    except Exception as error:
        text = f"{path}: cannot be read as {importer.name} ({importer.description}): {type(error).__name__}: {error}"
        raise InputError(text) from error


@contextmanager
def bounded_memory(path: Path) -> Iterator[None]:
    """Bound what a reader may take: of a few kilobytes, compressed data can promise to fill any memory.

    Raises `InputError` where the bound is reached. Systems without such limits have none.
    """
    try:
        import resource
    except ImportError:
        yield
        return
    size = _size(path)
    soft, hard = resource.getrlimit(resource.RLIMIT_DATA)
    bound = _used() + _MOST_MEMORY + _MOST_OF_FILE * size
    if soft != resource.RLIM_INFINITY:
        bound = min(bound, soft)
    resource.setrlimit(resource.RLIMIT_DATA, (bound, hard))
    try:
        yield
    except MemoryError:
        raise InputError(
            f"{path}: reading its {size} bytes would take more than {(_MOST_MEMORY + _MOST_OF_FILE * size) >> 20} MiB "
            "of memory; what it promises to hold cannot be in it"
        ) from None
    finally:
        resource.setrlimit(resource.RLIMIT_DATA, (soft, hard))


def _used() -> int:
    """Data of this process [byte]."""
    try:
        for line in Path("/proc/self/status").read_text(encoding="ascii").splitlines():
            if line.startswith("VmData:"):
                return int(line.split()[1]) * 1024
    except (OSError, ValueError, IndexError):
        pass
    return 1 << 30
