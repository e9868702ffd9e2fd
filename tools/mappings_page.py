"""The page about mappings: the keys of column mappings and of CAN mappings, made from the code that reads them."""

from __future__ import annotations

import types
from collections.abc import Iterable
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from vsense_ros.bag.importers import mapping as columns
from vsense_ros.bag.importers import topic_mapping
from vsense_ros.driver import can_mapped_signal, can_mapping
from vsense_ros.driver.can_motion import MOTION_OUTPUTS
from vsense_ros.messages import units

INTRODUCTION = """# Mappings

A mapping is a YAML file that says which column or signal of a recording becomes which [topic](../topics.md). This page
is made from the code that reads them.

- Tables of text, MATLAB and MDF files: `vsense import log.csv --guess > log.yaml` proposes one,
  `vsense import log.csv log --mapping log.yaml` uses it.
- Bags whose topics have other names: `vsense import foreign_bag --guess > topics.yaml` proposes one,
  `vsense import foreign_bag drive --mapping topics.yaml` uses it.
- CAN logs: `vsense can drive.blf --dbc car.dbc --output car.yaml` proposes one,
  `vsense import drive.blf drive --dbc car.dbc --mapping car.yaml` uses it, and so does the node `can_driver`.

Whatever the file has, messages are in SI units and the axes of ISO 8855: forward, left, up, turning left positive.
"""

_BELOW, _BY_NAME = "see below", ", by its name"


def page() -> str:
    """The page as Markdown."""
    parts = [
        INTRODUCTION,
        "## Tables and measurements\n",
        *_keys("The file", columns.ColumnMapping),
        *_keys("`time`", columns.Time),
        *_keys("`rows`", columns.Rows),
        *_keys("`origin`", columns.Origin),
        *_keys("A signal", columns.Signal),
        "### Topics and their fields\n",
        *_fields(),
        "### An example\n",
        *_example(),
        "## Bags\n",
        *_prose(topic_mapping.__doc__),
        *_keys("The file", topic_mapping.TopicMapping),
        *_keys("An entry of `topics`", topic_mapping.TopicSource),
        "## CAN\n",
        *_keys("The file", can_mapping.CanMapping),
        *_keys("An entry of `messages`", can_mapping.MessageCheck),
        *_keys("`counter`", can_mapping.CounterCheck),
        *_keys("`checksum`", can_mapping.ChecksumCheck),
        *_keys("An output of `kind: joint_state`", can_mapping.JointStateOutput),
        *_keys("An output of `kind: imu`", can_mapping.ImuOutput),
        *(line for output in MOTION_OUTPUTS for line in _keys(f"An output of `kind: {output.kinds()[0]}`", output)),
        *_keys("A signal", can_mapped_signal.Signal),
        *_keys("`sign`", can_mapped_signal.SignBit),
        *_keys("`valid`", can_mapped_signal.Valid),
        "[`config/can/toyota_rav4_2017.yaml`](../../config/can/toyota_rav4_2017.yaml) is one with its reasons.\n",
        "## Units\n",
        "Spellings such as `kph`, `deg/sec` or `Grad/s` are understood, too.\n",
        *_table(("quantity", "units"), ((name, _codes(known)) for name, known in units.QUANTITIES.items())),
    ]
    return "\n".join(parts)


def _keys(title: str, model: type[BaseModel]) -> list[str]:
    """A section with the keys of a part of a file."""
    rows = [
        (f"`{name}`", _words(field.annotation), _default(field), field.description or "")
        for name, field in model.model_fields.items()
    ]
    about = " ".join((model.__doc__ or "").split("\n\n")[0].split())
    return [f"### {title}\n", f"{about}\n", *_table(("key", "value", "default", "meaning"), rows)]


def _fields() -> list[str]:
    rows = []
    for topic, fields in columns.QUANTITIES.items():
        known = columns.TOPICS[topic]
        for name, quantity in fields.items():
            rows.append((f"`{topic}`", f"`{name}`", quantity, _codes(known.names) if known.names else ""))
    return _table(("topic", "field", "quantity", "names of its signals"), rows)


def _example() -> list[str]:
    """The file of a table that the module's docstring shows, and what it says about it."""
    return _prose(columns.__doc__)


def _prose(text: str | None) -> list[str]:
    """What a module says of a file below its first line, with the example that it shows."""
    text = (text or "").partition("\n\n")[2].strip("\n")
    lines = []
    for paragraph in text.split("\n\n"):
        if paragraph.startswith("    "):
            code = "\n".join(line.removeprefix("    ") for line in paragraph.splitlines())
            lines.append(f"```yaml\n{code}\n```\n")
        else:
            lines.append(f"{paragraph}\n")
    return lines


def _default(field: FieldInfo) -> str:
    if field.is_required():
        return "required"
    value = field.get_default(call_default_factory=True)
    if value is None or value == () or value == {} or isinstance(value, BaseModel):
        return ""
    return f"`{str(value).lower() if isinstance(value, bool) else value}`"


def _words(kind: Any) -> str:
    """What a value may be, in words."""
    origin, inner = get_origin(kind), get_args(kind)
    if origin is Annotated:
        return _words(inner[0])
    if origin is Literal:
        return _codes(str(value) for value in inner)
    if origin in (Union, types.UnionType):
        parts = dict.fromkeys(_words(one) for one in inner if one is not type(None))
        return " or ".join(parts) if not any(part.startswith(_BELOW) for part in parts) else _BELOW
    if origin is dict:
        return f"{_words(inner[1]).removesuffix(_BY_NAME)}{_BY_NAME}"
    if origin in (tuple, list):
        items = [one for one in inner if one is not Ellipsis]
        if origin is tuple and Ellipsis not in inner and len(items) > 1:
            return f"{len(items)} numbers"
        return f"{_words(items[0])}, or a list"
    names = {str: "text", int: "whole number", float: "number", bool: "`true` or `false`"}
    if kind in names:
        return names[kind]
    return "date and time" if getattr(kind, "__name__", "") == "datetime" else _BELOW


def _codes(words: Iterable[str]) -> str:
    return ", ".join(f"`{word}`" for word in words)


def _table(head: tuple[str, ...], rows: Iterable[tuple[str, ...]]) -> list[str]:
    lines = [f"| {' | '.join(head)} |", f"|{'---|' * len(head)}"]
    lines += [f"| {' | '.join(cell.replace('|', chr(92) + '|') for cell in row)} |" for row in rows]
    return [*lines, ""]
