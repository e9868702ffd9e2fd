"""Names from files of the user, where they are written into sources, paths, tables and pages.

A name is what somebody else wrote: in a comment of C a backslash at the end of a line, in a spreadsheet a sign of
equality, in a path a slash, on a terminal an escape mean something of their own.
"""

from __future__ import annotations

import unicodedata

_LONGEST = 80
_TURNING = "\u202a\u202b\u202c\u202d\u202e\u2066\u2067\u2068\u2069"
_FORMULA = ("=", "+", "-", "@", "\t", "\r")


def harmless(text: str) -> str:
    """A name on one line that means nothing to a compiler, a shell or a spreadsheet: letters and digits of any
    language, spaces and . , _ - ( ) stay, all else becomes an underscore, none of the signs that begin formulas begin
    it, and it has at most 80 characters."""
    plain = "".join(c if c.isalnum() or c in " .,_-()" else "_" for c in unicodedata.normalize("NFC", text))
    return plain.strip(" .").lstrip("-+=@")[:_LONGEST].strip(" .") or "unnamed"


def printable(text: str) -> str:
    """A text for a terminal or a log: lines and tabs stay; what else steers a terminal, or turns the direction of
    writing, becomes a question mark in a box."""
    if text.isprintable() and text.isascii():
        return text
    return "".join(c if c in "\n\t" or not _steers(c) else "\ufffd" for c in text)


def _steers(character: str) -> bool:
    """Control characters, and the formatting ones by which a text is shown in another order than it is written."""
    return unicodedata.category(character) in ("Cc", "Cs") or character in _TURNING


def cell(text: str) -> str:
    """A text for a table that a spreadsheet reads: an apostrophe before what it would take for a formula."""
    return f"'{text}" if text.startswith(_FORMULA) else text


def drawn(text: str) -> str:
    """A text in a picture, in which matplotlib would set what stands between dollar signs as a formula."""
    return printable(text).replace("$", r"\$")
