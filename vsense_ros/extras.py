"""Optional packages: which extra of the installation brings each of them.

Modules import an optional package as any other. What runs them on behalf of a user (a command, a node, an importer)
does so within `explained`, which makes one sentence of an import that fails.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

from vsense_ros.errors import InputError

# Each extra has a file of the same name in requirements/; here stand the modules that its packages provide.
MODULES = {
    "reports": ("matplotlib", "plotly"),
    "formats": ("asammdf", "h5py", "rosbags", "pyarrow", "pooch", "pysbf2", "pyrtcm", "libxrk"),
    "fleet": ("distributed", "dask", "cryptography"),
    "foxglove": ("foxglove",),
    "fmu": ("fmpy",),
    "studio": ("nicegui",),
    "tables": ("pandas", "polars", "xarray"),
}


class MissingExtra(InputError):
    """An optional package is not installed; the message says which extra brings it."""


def missing_extra(error: ModuleNotFoundError) -> MissingExtra | None:
    """The sentence for a failed import of an optional package, or None if the module belongs to no extra."""
    module = (error.name or "").partition(".")[0]
    for extra, modules in MODULES.items():
        if module in modules:
            return MissingExtra(f"this needs {module}, which is not installed: pip install 'vsense_ros[{extra}]'")
    return None


@contextmanager
def explained() -> Iterator[None]:
    """Turn the failed import of an optional package into `MissingExtra`; other exceptions pass unchanged."""
    try:
        yield
    except ModuleNotFoundError as error:
        missing = missing_extra(error)
        if missing is None:
            raise
        raise missing from error
