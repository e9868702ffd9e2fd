"""The parameters of a vehicle file, from the one schema: a Markdown table for people, JSON schema for editors.

`python -m vsense_ros.files.schema > docs/vehicle_parameters.md` writes the page of parameters anew.
"""

from __future__ import annotations

import re
import types
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from itertools import groupby
from typing import Annotated, Any, Literal, Union, get_args, get_origin

from pydantic import BaseModel
from pydantic.fields import FieldInfo

from vsense_ros.model.vehicle import Vehicle


@dataclass(frozen=True, slots=True)
class ParameterRow:
    """One key of a vehicle file, in words."""

    key: str
    unit: str
    allowed: str
    default: str
    description: str


def json_schema() -> dict[str, Any]:
    """The JSON schema (draft 2020-12) that an editor can check vehicle files with."""
    return {"$schema": "https://json-schema.org/draft/2020-12/schema", **Vehicle.model_json_schema()}


def parameter_rows() -> list[ParameterRow]:
    """All keys in the order of declaration; `<name>` stands for a key that the file's author chooses.

    Keys with the same content stand together: `{front, rear}.track` is `front.track` and `rear.track`.
    """
    return list(_rows(Vehicle, ""))


def markdown_table(rows: Iterable[ParameterRow] | None = None) -> str:
    """A Markdown table of some rows, by default of all."""
    lines = ["| key | unit | allowed | default | meaning |", "|---|---|---|---|---|"]
    for row in parameter_rows() if rows is None else rows:
        cells = (f"`{row.key}`", row.unit, row.allowed, row.default, row.description)
        lines.append("| " + " | ".join(cell.replace("|", "\\|") for cell in cells) + " |")
    return "\n".join(lines) + "\n"


def section_of(row: ParameterRow) -> str:
    """The heading below which a key stands on the page: the section of the file, and of `physics` the part below it."""
    parts = row.key.replace("`", "").split(".")
    model = re.search(r"\.tyre \((\w+)\)\.", row.key)
    if model:
        return f"Tyre model {model[1]}"
    if parts[0] == "physics":
        return f"physics.{parts[1]}"
    return " ".join(parts[0:2]).replace("<name> ", "") if parts[0] == "sensors" else parts[0]


def page() -> str:
    """The tables of all sections, with a few words for those who write a vehicle file."""
    sections: dict[str, list[ParameterRow]] = {}
    for row in parameter_rows():
        sections.setdefault(section_of(row) if "." in row.key else "Name and source", []).append(row)
    tables = "\n".join(f"## {name}\n\n{markdown_table(rows)}" for name, rows in sections.items())
    return (
        "# Vehicle files\n\n"
        "A vehicle file describes a car, its sensors and the settings of the observer in YAML. The files of this\n"
        "package are in [config/vehicles](../config/vehicles); `vsense new-vehicle` writes one from catalogue values,\n"
        "and `vsense check` checks one. Units are SI. Positions are relative to `cog`, the centre of gravity in the\n"
        "design position, with x forward, y left, z up. `<name>` is a name of your choice. A key with a default may\n"
        "be left out. `vsense schema --json` prints a JSON schema for editors.\n\n"
        "This page is made from the schema by `python -m vsense_ros.files.schema`.\n\n" + tables
    )


def _rows(model: type[BaseModel], prefix: str) -> Iterator[ParameterRow]:
    for shape, fields in groupby(model.model_fields.items(), key=lambda item: _shape(*item)):
        names = [name for name, _ in fields]
        field = model.model_fields[names[0]]
        if shape.startswith("="):
            yield _row(prefix + names[0], field)
            continue
        key, annotation = prefix + (names[0] if len(names) == 1 else "{" + ", ".join(names) + "}"), field.annotation
        if get_origin(annotation) is dict:
            key, annotation = f"{key}.<name>", get_args(annotation)[1]
        models = list(models_of(annotation))
        for choice in models:
            yield from _rows(choice, f"{key} ({tag_of(choice)})." if len(models) > 1 else f"{key}.")


def _shape(name: str, field: FieldInfo) -> str:
    """Equal for neighbours that hold the same model and can share their rows; starts with "=" for plain values."""
    annotation = get_args(field.annotation)[1] if get_origin(field.annotation) is dict else field.annotation
    return repr(field.annotation) if any(True for _ in models_of(annotation)) else f"={name}"


def models_of(annotation: Any) -> Iterator[type[BaseModel]]:
    """The models that an annotation admits: itself, or the members of a union."""
    if isinstance(annotation, type) and issubclass(annotation, BaseModel):
        yield annotation
    elif get_origin(annotation) is Annotated:
        yield from models_of(get_args(annotation)[0])
    elif get_origin(annotation) in (Union, types.UnionType):
        for member in get_args(annotation):
            yield from models_of(member)


def tag_of(model: type[BaseModel]) -> str:
    """The value of the key that distinguishes the members of a union."""
    for field in model.model_fields.values():
        if get_origin(field.annotation) is Literal:
            return str(get_args(field.annotation)[0])
    return ""


def unit_of(field: FieldInfo) -> str:
    """The unit of a field, empty if it is no quantity."""
    extra = field.json_schema_extra if isinstance(field.json_schema_extra, dict) else {}
    return str(extra.get("unit", ""))


def _row(key: str, field: FieldInfo) -> ParameterRow:
    default = "required" if field.is_required() else _value(field.get_default(call_default_factory=True))
    if isinstance(field.json_schema_extra, dict):  # of one that follows from others
        default = str(field.json_schema_extra.get("rule", default))
    return ParameterRow(key, unit_of(field), allowed(field), default, field.description or "")


def _value(value: Any) -> str:
    if isinstance(value, float):
        return f"{value:.6g}"
    if isinstance(value, tuple | list):
        return "[" + ", ".join(_value(item) for item in value) + "]"
    return "" if value in ("", None) else str(value)


def allowed(field: FieldInfo) -> str:
    """The values that a field may have, in signs: choices or limits; of each component, for several."""
    if get_origin(field.annotation) is Literal:
        return ", ".join(f"`{choice}`" for choice in get_args(field.annotation))
    words = _limits(field.metadata)
    if get_origin(field.annotation) is tuple:
        members = get_args(field.annotation)
        rows = f"{len(members)} rows of " if get_origin(members[0]) is tuple else ""
        count = "rows of numbers" if members[-1] is Ellipsis else f"{rows}{len(members)} numbers"
        words = [count, *_limits(getattr(members[0], "__metadata__", ()))]
    return ", ".join(words)


def _limits(metadata: Iterable[Any]) -> list[str]:
    words = []
    for constraint in metadata:
        for part in getattr(constraint, "metadata", (constraint,)):
            for name, sign in (("gt", ">"), ("ge", "≥"), ("lt", "<"), ("le", "≤")):
                limit = getattr(part, name, None)
                if limit is not None:
                    words.append(f"{sign} {limit:g}")
    return words


if __name__ == "__main__":
    print(page(), end="")
