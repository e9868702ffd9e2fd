"""Formats that no maintained library reads, and what converts them to one that is read here."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path

_CONVERTERS: Mapping[str, str] = {
    r".*\.ldx?": "a log of MoTeC: i2 exports it as CSV, which is read with a mapping (--guess)",
    r".*[rq]log(\.(bz2|zst))?": (
        "a log of openpilot: its LogReader (tools/lib/logreader.py) reads it; write the messages 'can' as candump or "
        "the values as CSV, or give the folder of a segment of comma2k19"
    ),
    r".*\.(ncom|rd)": "a log of an OXTS system: NAVsolve exports it as CSV, which is read with a mapping (--guess)",
}


def converter_of(path: Path) -> str:
    """What a file is by its name and what converts it; empty where that is not known."""
    name = path.name.lower()
    return next((text for pattern, text in _CONVERTERS.items() if re.fullmatch(pattern, name)), "")
