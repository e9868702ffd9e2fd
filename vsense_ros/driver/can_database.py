"""CAN databases: reading a DBC, and using the rest of one of which a part is wrong."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import cantools
from cantools.database import Database

from vsense_ros.errors import InputError


@dataclass(frozen=True)
class DatabaseLimits:
    """Bounds on a database of CAN messages: decisions of this project."""

    largest: int = 64 * 2**20  # [byte] of a file that is read at all
    most_bits: int = 64  # of a signal
    most_bytes: int = 4096  # of a message; those of J1939 have up to 1785


LIMITS = DatabaseLimits()

# What cantools raises of a database that it does not understand.
_LOADING = (
    cantools.Error,
    cantools.database.UnsupportedDatabaseFormatError,
    ValueError,
    LookupError,
    TypeError,
    AttributeError,
    SyntaxError,
    RecursionError,
)
_EXTENDED = 0x8000_0000  # marks identifiers of 29 bits in a DBC
_INDEPENDENT = "VECTOR__INDEPENDENT_SIG_MSG"  # message that holds signals of no message

_BLOCK = re.compile(r"^BO_[ \t]+(\d+)[ \t]+(\S+?)[ \t]*:[ \t]*(\d+)", re.MULTILINE)
_SIGNAL = re.compile(r"^[ \t]*SG_[ \t]+([^\s:]+)[^:\n]*:[ \t]*(-?\d+)\|(-?\d+)@", re.MULTILINE)
_NAME = re.compile(r"[A-Za-z_]\w*")
# Statements beside messages that say how signals are decoded.
_DECODING = re.compile(r"^(SIG_VALTYPE_|SG_MUL_VAL_)[ \t]+(\d+)[ \t]+(\S+)[^;]*;", re.MULTILINE)
_PREFIX = 'VERSION ""\nNS_ :\nBS_:\nBU_: Vector__XXX\n'


@dataclass(frozen=True)
class CanDatabase:
    """A database, and what had to be left out or mended to read it."""

    database: Database
    notes: tuple[str, ...] = ()


def read_database(path: str | Path) -> CanDatabase:
    """Read a DBC (or another format that cantools knows); overlapping signals are allowed.

    Where something in a DBC is wrong, the messages and signals that are intact are read, and the notes say which are
    not. `InputError` if the file is missing or nothing in it can be understood.
    """
    path = Path(path)
    if not path.is_file():
        raise InputError(f"{path}: no such file; expected a CAN database (.dbc, .arxml, .kcd, .sym)")
    if path.stat().st_size > LIMITS.largest:
        raise InputError(f"{path}: {path.stat().st_size} bytes, which is no CAN database (at most {LIMITS.largest})")
    try:
        if path.suffix.lower() == ".dbc":
            return _read_dbc(path)
        database = cantools.database.load_file(path, strict=False)
    except (*_LOADING, OSError) as error:
        raise InputError(f"{path}: not a CAN database that can be read: {error}") from None
    if not isinstance(database, Database):
        raise InputError(f"{path}: expected a CAN database, found diagnostic descriptions (CDD)")
    return CanDatabase(database)


def _read_dbc(path: Path) -> CanDatabase:
    data = path.read_bytes()
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError:
        text = data.decode("cp1252", errors="replace")
    text = text.replace("\r\n", "\n").replace("\r", "\n")
    blocks = list(_BLOCK.finditer(text))
    bounded = all(int(b[3]) <= LIMITS.most_bytes for b in blocks) and _signals_are_bounded(text)
    why = "a signal or a message is larger than any can be, or begins where none can"
    if bounded:
        try:
            return CanDatabase(_load(text))
        except (cantools.Error, ValueError, KeyError) as error:
            why = str(error).replace("DBC: ", "").strip('"')
    if not blocks:
        raise InputError(f"{path}: not a CAN database that can be read: no message (BO_) in it; {why}")
    mended = _mend(text, blocks)
    if not mended.database.messages:
        raise InputError(f"{path}: not a CAN database that can be read: none of its messages is intact; {why}")
    first = " ".join(why.split())
    return CanDatabase(
        mended.database, (f"{path.name}: not a correct DBC ({first}); what is intact is used", *mended.notes)
    )


def _signals_are_bounded(text: str) -> bool:
    """True if all signals begin and end where data can be: cantools makes room for whatever it reads."""
    return all(
        0 <= int(s[2]) < 8 * LIMITS.most_bytes and 0 < int(s[3]) <= LIMITS.most_bits for s in _SIGNAL.finditer(text)
    )


def _load(text: str) -> Database:
    try:
        database = cantools.database.load_string(text, "dbc", strict=False)
    except cantools.database.UnsupportedDatabaseFormatError as error:
        raise ValueError(str(error)) from None
    if not isinstance(database, Database):
        raise ValueError("not a CAN database")
    return database


def _mend(text: str, blocks: list[re.Match[str]]) -> CanDatabase:
    """The messages that are intact, each with its signals that are."""
    notes: list[str] = []
    kept: list[str] = []
    names: dict[int, str] = {}  # identifier in the file → in the mended text
    seen: set[str] = set()
    decoding: dict[int, list[str]] = {}
    for statement in _DECODING.finditer(text):
        decoding.setdefault(int(statement[2]), []).append(statement[0])
    for block in blocks:
        identifier, name, size = int(block[1]), block[2], int(block[3])
        line = text.count("\n", 0, block.start()) + 1
        if name == _INDEPENDENT:
            continue
        if name in seen:
            notes.append(f"line {line}: message {name} stands twice; the first is used")
            continue
        if not _NAME.fullmatch(name) or size > LIMITS.most_bytes:
            notes.append(
                f"line {line}: message {name} left out: " + ("its name" if size <= LIMITS.most_bytes else "its size")
            )
            continue
        number = identifier
        if 0x7FF < identifier < 0x2000_0000:
            number = identifier | _EXTENDED
            notes.append(f"line {line}: message {name}: identifier {identifier:#x} is taken for one of 29 bits")
        elif identifier > 0x7FF and not _EXTENDED <= identifier < _EXTENDED + 0x2000_0000:
            notes.append(f"line {line}: message {name} left out: {identifier} is no identifier")
            continue
        rows = []
        for offset, row in enumerate(text[block.end() :].split("\n")[1:], 1):
            if not row.lstrip().startswith("SG_"):
                if row.strip():
                    break
                continue
            rows.append((line + offset, row))
        head = f"BO_ {number} {name}: {size} Vector__XXX\n"
        more = [s.replace(str(identifier), str(number), 1) for s in decoding.get(identifier, ())]
        good = _intact(head, rows, more, name, notes)
        if good is not None:
            seen.add(name)
            names[identifier] = name
            kept.append(good)
    statements = []
    body = []
    for part in kept:
        message, _, rest = part.partition("\0")
        body.append(message)
        statements.append(rest)
    return CanDatabase(_load(_PREFIX + "\n".join(body) + "\n" + "\n".join(statements) + "\n"), tuple(notes))


def _intact(head: str, rows: list[tuple[int, str]], more: list[str], name: str, notes: list[str]) -> str | None:
    """A message with those of its signals that can be read, and behind a NUL the statements about them."""

    def can_be_read(lines: list[str], statements: list[str]) -> bool:
        if not _signals_are_bounded("\n".join(lines)):
            return False
        try:
            _load(_PREFIX + head + "\n".join(lines) + "\n\n" + "\n".join(statements) + "\n")
        except (cantools.Error, ValueError, KeyError):
            return False
        return True

    lines = [row for _, row in rows]
    if can_be_read(lines, more):
        return head + "\n".join(lines) + "\n\0" + "\n".join(more)
    if not can_be_read([], []):
        notes.append(f"message {name} left out: it cannot be read")
        return None
    good: list[str] = []
    for number, row in rows:
        # A multiplexed signal is nothing without its selector, so that the ones before it stay with it.
        if can_be_read([*good, row], []) or can_be_read([row], []):
            good.append(row)
        else:
            signal = _SIGNAL.match(row)
            notes.append(f"line {number}: signal {signal[1] if signal else row.strip()[:40]} of {name} left out")
    if not can_be_read(good, []):
        notes.append(f"message {name} left out: its signals contradict each other")
        return None
    said = [s for s in more if can_be_read(good, [s])]
    return head + "\n".join(good) + "\n\0" + "\n".join(said)
