"""YAML from anywhere, bounded before it is loaded: a text of a kilobyte can stand for more than any memory holds.

What may be long (the text), deep (its nesting), multiplied (aliases) or slow (numbers of thousands of digits) is looked
at in the events of the parser, which are as many as the text is long.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ruamel.yaml import YAML
from ruamel.yaml.error import YAMLError
from ruamel.yaml.events import AliasEvent, CollectionEndEvent, CollectionStartEvent, ScalarEvent

from vsense_ros.errors import InputError


@dataclass(frozen=True)
class YamlLimits:
    """Bounds on what a YAML file may make its reader allocate: decisions of this project."""

    largest_text: int = 4 << 20  # [byte]
    deepest: int = 60  # levels
    most_nodes: int = 200_000  # with each alias counted as what it stands for
    longest_number: int = 100  # characters


LIMITS = YamlLimits()


_INDENT = re.compile(r"^[ \-?]*", re.MULTILINE)
_LONG_NUMBER = re.compile(rf"[-+0-9_.:xobXOBa-fA-F]{{{LIMITS.longest_number + 1},}}")


def read_text(path: str | Path, largest: int = LIMITS.largest_text) -> str:
    """The text of a file of the user. Raises `InputError` for what is missing, no regular file, too long or no text."""
    path = Path(path)
    try:
        if not path.exists():
            raise InputError(f"{path}: no such file")
        if not path.is_file():
            raise InputError(f"{path}: not a regular file; expected a text file")
        with path.open("rb") as file:
            data = file.read(largest + 1)
    except OSError as error:
        raise InputError(f"{path}: cannot be read: {error.strerror or error}") from None
    if len(data) > largest:
        raise InputError(f"{path}: longer than {largest >> 20} MiB, which no such file is; is it another file?")
    try:
        return data.decode("utf-8")
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: no UTF-8 text at byte {error.start}; expected YAML") from None


def load_file(path: str | Path) -> Any:
    """The plain content of a YAML file (mappings, lists, texts, numbers). Raises `InputError` with file and line."""
    return load(read_text(path), str(path))


def load(text: str, place: str) -> Any:
    """The plain content of a YAML text; `place` begins the message of the `InputError` that is raised for what is no
    YAML or more than anybody would write."""
    check(text, place)
    try:
        return YAML(typ="safe", pure=True).load(text)
    except YAMLError as error:
        raise InputError(f"{place}{_place(error)}: not valid YAML: {_problem(error)}") from None
    except (RecursionError, ValueError, OverflowError, TypeError, ArithmeticError) as error:
        raise InputError(f"{place}: not valid YAML: {error}") from None


def check(text: str, place: str) -> None:
    """Raise `InputError` for a text that would be too much to load, whatever loads it."""
    if len(text) > LIMITS.largest_text:
        raise InputError(
            f"{place}: longer than {LIMITS.largest_text >> 20} MiB; expected a YAML file that people write"
        )
    if "&" not in text and _shallow(text) and not _LONG_NUMBER.search(text):
        return
    try:
        _measure(text, place)
    except YAMLError as error:
        raise InputError(f"{place}{_place(error)}: not valid YAML: {_problem(error)}") from None
    except RecursionError:
        raise InputError(f"{place}: nested more than {LIMITS.deepest} levels deep") from None


def _measure(text: str, place: str) -> None:
    """Count the nodes of a text with its aliases spelt out. Raises `InputError` if it is too large or too deep."""
    sizes: dict[str, int] = {}  # of anchors: nodes below them
    open_: list[tuple[str | None, int]] = []  # anchors and nodes so far of the collections around
    total = 0
    for event in YAML(typ="safe", pure=True).parse(text):
        line = event.start_mark.line + 1 if event.start_mark else 0
        if isinstance(event, CollectionStartEvent):
            open_.append((event.anchor, total))
            if len(open_) > LIMITS.deepest:
                raise InputError(f"{place}:{line}: nested more than {LIMITS.deepest} levels deep")
            total += 1
        elif isinstance(event, CollectionEndEvent):
            anchor, before = open_.pop()
            if anchor is not None:
                sizes[anchor] = total - before
        elif isinstance(event, AliasEvent):
            if event.anchor in {anchor for anchor, _ in open_}:
                raise InputError(f"{place}:{line}: *{event.anchor} stands within what it stands for")
            total += sizes.get(event.anchor, 1)
        elif isinstance(event, ScalarEvent):
            total += 1
            if event.anchor is not None:
                sizes[event.anchor] = 1
            if event.implicit[0] and _LONG_NUMBER.fullmatch(event.value):
                raise InputError(f"{place}:{line}: a number of {len(event.value)} characters")
        if total > LIMITS.most_nodes:
            raise InputError(f"{place}:{line}: stands for more than {LIMITS.most_nodes} values, aliases spelt out")


def _shallow(text: str) -> bool:
    """True if a text cannot be nested too deeply, by its open brackets and its indents."""
    depth = 0
    for character in re.findall(r"[\[\]{}]", text):
        depth += 1 if character in "[{" else -1
        if depth > LIMITS.deepest // 2:
            return False
    return max(map(len, _INDENT.findall(text)), default=0) <= LIMITS.deepest


def _place(error: YAMLError) -> str:
    mark = getattr(error, "problem_mark", None)
    return f":{mark.line + 1}" if mark is not None else ""


def _problem(error: YAMLError) -> str:
    return str(getattr(error, "problem", None) or str(error).splitlines()[0])
