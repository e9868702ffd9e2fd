"""Names from files of the user, where they are written into sources, paths, tables and pages.

A name is what somebody else wrote: in a comment of C a backslash at the end of a line, in a spreadsheet a sign of
equality, in a path a slash mean something of their own.
"""

from __future__ import annotations

import unicodedata

_LONGEST = 80


def harmless(text: str) -> str:
    """A name on one line that means nothing to a compiler, a shell or a spreadsheet: letters and digits of any
    language, spaces and . , _ - ( ) stay, all else becomes an underscore, none of the signs that begin formulas begin
    it, and it has at most 80 characters."""
    kept = "".join(c if c.isalnum() or c in " .,_-()" else "_" for c in unicodedata.normalize("NFC", text))
    return kept.strip(" .").lstrip("-+=@")[:_LONGEST].strip(" .") or "unnamed"
