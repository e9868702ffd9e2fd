"""Memory that is not needed any more."""

from __future__ import annotations

import ctypes
import os


def give_back() -> None:
    """Return to the system what has been freed: glibc keeps it in pieces, after large tables several times what is in
    use. Other C libraries do so by themselves."""
    trim = getattr(ctypes.CDLL(None), "malloc_trim", None) if os.name == "posix" else None
    if trim is not None:
        trim(0)
