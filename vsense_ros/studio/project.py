"""The project folder of the workbench: what was opened and computed, so that a closed tab or a killed process loses
nothing."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from hashlib import sha256
from pathlib import Path
from threading import RLock
from typing import Any

from vsense_ros.errors import InputError
from vsense_ros.files.atomic import atomic_write
from vsense_ros.files.installed import shared_folder
from vsense_ros.files.names import harmless

STATE = "state.json"
_BLOCK = 1 << 20  # [bytes] read at once


@dataclass
class Drive:
    """A recording of the project: its `path`, the `key` of the result of reading it, and whether it serves for
    validation only (`held_out`)."""

    path: str
    key: str = ""
    held_out: bool = False
    mapping: str = ""
    database: str = ""

    @property
    def name(self) -> str:
        """Name of the file or folder."""
        return Path(self.path).name


@dataclass
class State:
    """What the project remembers. `results` maps stages to the keys of their results, the newest first."""

    vehicle: str = ""
    drives: list[Drive] = field(default_factory=list)
    results: dict[str, list[str]] = field(default_factory=dict)
    settings: dict[str, Any] = field(default_factory=dict)


class Project:
    """A project in a folder. `folders` are those whose files the page may read; the examples of the package are among
    them, for reading."""

    def __init__(self, folder: Path, folders: Sequence[Path] = ()) -> None:
        self.folder = folder.resolve()
        self._lock = RLock()
        for part in ("results", "cars", "recordings", "uploads"):
            (self.folder / part).mkdir(parents=True, exist_ok=True)
        self.folders = [self.folder, *(one.resolve() for one in folders)]
        self.examples = [shared_folder("config") / "vehicles", shared_folder("bags")]
        self.state = self._load()

    def _load(self) -> State:
        path = self.folder / STATE
        if not path.exists():
            return State()
        try:
            content = json.loads(path.read_text(encoding="utf-8"))
            drives = [Drive(**one) for one in content.pop("drives", [])]
            return State(drives=drives, **content)
        except (ValueError, TypeError):
            broken = path.with_suffix(".unreadable.json")
            path.replace(broken)
            return State(settings={"notice": f"The state of the project could not be read; it was kept as {broken}."})

    def save(self) -> None:
        """Write the state; the earlier one stays if that fails."""
        with self._lock, atomic_write(self.folder / STATE) as file:
            json.dump(asdict(self.state), file, indent=1)

    @property
    def version(self) -> int:
        """A number that changes whenever the state is saved, by this page or another one."""
        path = self.folder / STATE
        return path.stat().st_mtime_ns if path.exists() else 0

    def inside(self, path: str | Path) -> Path:
        """The path, if it lies in a folder that was opened. Raises `InputError` for any other, and for none."""
        given = Path(path).expanduser()
        resolved = (given if given.is_absolute() else Path.cwd() / given).resolve()
        if not any(resolved.is_relative_to(one.resolve()) for one in (*self.folders, *self.examples)):
            known = ", ".join(map(str, self.folders))
            raise InputError(
                f"{path}: not in a folder that was opened ({known}); start `vsense studio` with a file of that folder"
            )
        if not resolved.exists():
            raise InputError(f"{path}: no such file; it may have been moved or deleted")
        return resolved

    def cars(self) -> dict[str, str]:
        """Vehicle files that can be chosen: paths and the names to show, those of the project first."""
        own = sorted((self.folder / "cars").glob("*.yaml"))
        opened = [path for one in self.folders[1:] for path in sorted(one.glob("*.yaml")) if _is_car(path)]
        shipped = sorted(self.examples[0].glob("*.yaml"))
        names = {str(path): path.stem for path in (*own, *opened)}
        return names | {str(path): f"{path.stem} (example)" for path in shipped}

    def recordings(self) -> dict[str, str]:
        """Recordings in the folders that were opened: paths and the names to show."""
        places = [self.folder / "recordings", self.folder / "uploads", *self.folders[1:]]
        names: dict[str, str] = {}
        for place in places:
            try:
                entries = sorted(place.iterdir())
            except OSError:  # a folder without rights offers nothing
                continue
            names |= {str(path): path.name for path in entries if _is_recording(path)}
        shipped = (path for path in sorted(self.examples[1].iterdir()) if path.is_dir())
        return names | {str(path): f"{path.name} (example)" for path in shipped}

    def upload_path(self, name: str) -> Path:
        """Where an uploaded file is kept in the project, by a name that cannot lead elsewhere."""
        return self.folder / "uploads" / harmless(Path(name).name)

    def result_folder(self, key: str) -> Path:
        """Folder of the result with a key. Raises `InputError` for what is no key."""
        if not (key.isalnum() and len(key) <= 64):
            raise InputError(f"{key!r} is not the key of a result")
        return self.folder / "results" / key

    def remember(self, stage: str, key: str) -> None:
        """Put a result first among those of its stage."""
        with self._lock:
            others = [one for one in self.state.results.get(stage, []) if one != key]
            self.state.results[stage] = [key, *others][:20]
            self.save()


def _is_recording(path: Path) -> bool:
    if path.is_dir():
        return (path / "metadata.yaml").exists()
    endings = (".mcap", ".mat", ".mf4", ".mdf", ".csv", ".vbo", ".vbb", ".blf", ".asc", ".log", ".trc", ".bag", ".db3",
               ".ubx", ".nmea", ".tsv", ".txt")  # fmt: skip
    return path.suffix.lower() in endings


def _is_car(path: Path) -> bool:
    try:
        return "physics:" in path.read_text(encoding="utf-8", errors="replace")
    except OSError:
        return False


def fingerprint(path: Path) -> str:
    """A hash of the names, sizes and times of change of a file or of all files of a folder: other content has another
    one, and it is there at once. Raises `InputError` for what cannot be read."""
    return sha256(json.dumps([str(path), _files(path)]).encode()).hexdigest()


def _files(path: Path) -> list[tuple[str, int, int]]:
    files = [path] if path.is_file() else sorted(one for one in path.rglob("*") if one.is_file())
    try:
        return [(str(one), one.stat().st_size, one.stat().st_mtime_ns) for one in files]
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from None


def content_hash(path: Path, project: Path) -> str:
    """SHA-256 of a file, or of all files of a folder with their names; kept in the folder of the project until a file
    changes. Raises `InputError` for what cannot be read."""
    kept = project / "hashes" / fingerprint(path)
    if kept.exists():
        return kept.read_text(encoding="ascii")
    digest = sha256()
    try:
        for name, size, _ in _files(path):
            digest.update(f"{name.removeprefix(str(path))}:{size}\n".encode())
            with Path(name).open("rb") as file:
                while block := file.read(_BLOCK):
                    digest.update(block)
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror})") from None
    kept.parent.mkdir(exist_ok=True)
    with atomic_write(kept) as target:
        target.write(digest.hexdigest())
    return digest.hexdigest()
