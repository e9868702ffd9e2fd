"""asammdf with what it lacks where a file is damaged."""

from __future__ import annotations

from contextlib import suppress
from typing import Any


def make_asammdf_careful() -> None:
    """Objects of asammdf whose file could not be read fall over when they are dropped: in their destructor, printing a
    traceback, or by looking for an attribute without end."""
    from asammdf import MDF
    from asammdf.blocks.mdf_v3 import MDF3
    from asammdf.blocks.mdf_v4 import MDF4

    def drop(self: Any) -> None:
        with suppress(Exception):
            self.close()

    for kind in (MDF3, MDF4):
        kind.__del__ = drop
    if "_mdf" not in vars(MDF):
        MDF._mdf = None
