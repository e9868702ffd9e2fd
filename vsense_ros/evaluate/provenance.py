"""Where a result comes from: software, command, and the files with their hashes, for the top of a report."""

from __future__ import annotations

import shlex
import subprocess
import sys
from collections.abc import Mapping
from hashlib import sha256
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

_SHOWN = 12  # digits of a hash
_BLOCK = 1 << 20  # [bytes] read at once
_PATIENCE = 5.0  # [s] for git


def software() -> str:
    """Version of this package, and the commit of its sources where they are a clone."""
    try:
        number = version("vsense_ros")
    except PackageNotFoundError:
        number = "from its sources"
    root = Path(__file__).resolve().parents[2]
    if not (root / ".git").exists():
        return f"vsense_ros {number}"
    command = ["git", "-C", str(root), "describe", "--always", "--dirty", "--abbrev=12"]
    try:
        commit = subprocess.run(command, capture_output=True, text=True, timeout=_PATIENCE, check=True).stdout.strip()
    except (OSError, subprocess.SubprocessError):
        return f"vsense_ros {number}"
    return f"vsense_ros {number}, commit {commit}"


def file_hash(path: Path) -> str:
    """The first digits of the SHA-256 of a file, or of all files of a folder with their names."""
    digest = sha256()
    for member in [path] if path.is_file() else sorted(part for part in path.rglob("*") if part.is_file()):
        if member != path:
            digest.update(member.relative_to(path).as_posix().encode())
        with member.open("rb") as file:
            while block := file.read(_BLOCK):
                digest.update(block)
    return digest.hexdigest()[:_SHOWN]


def provenance(*, vehicle: Path, recording: Path, filter: str) -> Mapping[str, str]:
    """Software, command, vehicle file, filter and recording, by name."""
    return {
        "software": software(),
        "command": shlex.join(["vsense", *sys.argv[1:]]),
        "vehicle file": f"{vehicle}, SHA-256 {file_hash(vehicle)}",
        "filter": filter or "as the vehicle file says",
        "recording": f"{recording}, SHA-256 {file_hash(recording)}",
    }
