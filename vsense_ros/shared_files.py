"""Where the files beside the code are: vehicles, DBC mappings, launch files, generated bags."""

from __future__ import annotations

import sys
from pathlib import Path

from vsense_ros.errors import InputError

PACKAGE = "vsense_ros"


def shared_folder(name: str) -> Path:
    """The folder `config`, `launch` or `bags`: of the sources, of a colcon workspace or of a Python environment.

    Raises `InputError` where it was not installed.
    """
    package = Path(__file__).resolve().parent
    candidates = [package.parent / name]
    # colcon installs into <prefix>/lib/python3.x/site-packages and <prefix>/share, pip likewise below sys.prefix.
    candidates += [parent / "share" / PACKAGE / name for parent in package.parents]
    candidates.append(Path(sys.prefix) / "share" / PACKAGE / name)
    for candidate in candidates:
        if candidate.is_dir():
            return candidate
    raise InputError(
        f"the folder {name!r} of {PACKAGE} is not installed; looked for it as {candidates[0]} and below share"
    )
