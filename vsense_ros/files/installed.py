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
    package = Path(__file__).resolve().parents[1]
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


def vehicle_path(text: str) -> Path:
    """The vehicle file that is meant: a path, or the name of one in config/vehicles.

    Raises `InputError` that lists the known names.
    """
    path = Path(text)
    if path.exists() or path.suffix or len(path.parts) > 1:
        return path
    folder = shared_folder("config") / "vehicles"
    names = sorted(file.stem for file in folder.glob("*.yaml"))
    if text not in names:
        raise InputError(
            f"no vehicle file {text!r}: neither a path nor one of {', '.join(names) or 'none'} in {folder}"
        )
    return folder / f"{text}.yaml"
