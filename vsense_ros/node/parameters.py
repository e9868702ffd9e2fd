"""Parameters of nodes: a pydantic model is their only description.

From it come the declared ROS parameters with description and range, their validation, `--help` and the table in the
README.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from difflib import get_close_matches
from itertools import pairwise
from typing import Any, ClassVar, TypeVar

from pydantic import BaseModel, ConfigDict, Field, ValidationError
from rcl_interfaces.msg import FloatingPointRange, IntegerRange, ParameterDescriptor
from rclpy.node import Node
from rclpy.parameter import Parameter

from vsense_ros.errors import InputError
from vsense_ros.messages import yaml_text

_OF_ROS = ("use_sim_time", "start_type_description_service")


def path_parameter(description: str, default: str = "", **constraints: Any) -> Any:
    """A field that names a file, a folder or a device: read only, so that nobody but who starts the node tells it what
    to open, and where to write."""
    return Field(default, description=description, json_schema_extra={"path": True}, **constraints)


class NodeParameters(BaseModel):
    """What every node has. Units stand in `json_schema_extra`, as in vehicle files."""

    model_config = ConfigDict(extra="forbid", frozen=True, allow_inf_nan=False)

    unavailable: ClassVar[tuple[str, ...]] = ()  # sentences about extensions whose parameters are therefore unknown

    autostart: bool = Field(True, description="configure and activate at start; otherwise wait for lifecycle services")
    lock_memory: bool = Field(
        False, description="keep the process's memory from being paged out (mlockall), from start on"
    )
    summary: str = path_parameter("file for counts of messages, written at the end as JSON; empty: none")


Model = TypeVar("Model", bound=NodeParameters)


def parameter(default: Any, unit: str, description: str, *, live: bool = False, **constraints: Any) -> Any:
    """A field with a unit; `live` parameters may change while the node is active."""
    return Field(default, description=description, json_schema_extra={"unit": unit, "live": live}, **constraints)


def _extra(model: type[NodeParameters], name: str, key: str) -> Any:
    extra = model.model_fields[name].json_schema_extra
    return extra.get(key) if isinstance(extra, Mapping) else None


def _bounds(model: type[NodeParameters], name: str) -> tuple[float | None, float | None]:
    """Lowest and highest allowed value; an exclusive bound counts as a bound here, pydantic knows the difference."""
    lowest = highest = None
    for constraint in model.model_fields[name].metadata:
        for key in ("ge", "gt"):
            lowest = getattr(constraint, key, lowest)
        for key in ("le", "lt"):
            highest = getattr(constraint, key, highest)
    return lowest, highest


def _descriptor(model: type[NodeParameters], name: str) -> ParameterDescriptor:
    info = model.model_fields[name]
    unit = _extra(model, name, "unit")
    descriptor = ParameterDescriptor(
        name=name,
        read_only=bool(_extra(model, name, "path")),
        description=f"{info.description}{f' [{unit}]' if unit else ''}",
        # pydantic judges types, and takes 2 for 2.0, which `--ros-args -p rate:=2` means.
        dynamic_typing=True,
    )
    lowest, highest = _bounds(model, name)
    if lowest is None and highest is None:
        return descriptor
    if isinstance(info.default, float):
        low, high = float("-inf" if lowest is None else lowest), float("inf" if highest is None else highest)
        descriptor.floating_point_range = [FloatingPointRange(from_value=low, to_value=high)]
    elif isinstance(info.default, int):
        low, high = int(-(2**62) if lowest is None else lowest), int(2**62 if highest is None else highest)
        descriptor.integer_range = [IntegerRange(from_value=low, to_value=high)]
    return descriptor


def declare(node: Node, model: type[NodeParameters], shared: Collection[str] = ()) -> None:
    """Declare all fields of `model` as parameters of `node`.

    Raises `InputError` for an override that is no parameter of the node or cannot be one of its values, but for names
    in `shared`, which were meant for all nodes. If an extension of the node could not be imported, an unknown name may
    be a parameter of it: then a warning says that it has no effect, and the node goes on.
    """
    overrides: Mapping[str, Parameter] = node._parameter_overrides  # rclpy has no public way to ask for these
    unknown = [n for n in overrides if n not in model.model_fields and n not in _OF_ROS and not n.startswith("qos_")]
    foreign = [name for name in unknown if name not in shared]
    if foreign and model.unavailable:
        node.get_logger().warning(
            f"no parameter {', '.join(map(repr, foreign))} is known; it has no effect. It may be one of an extension: "
            f"{'; '.join(model.unavailable)}"
        )
    elif foreign:
        raise InputError(f"no parameter {', '.join(map(repr, foreign))}; expected {', '.join(model.model_fields)}")
    for name in unknown:
        if alike := get_close_matches(name, model.model_fields, 1, 0.85):
            node.get_logger().warning(f"no parameter {name!r} here, of those for all nodes; is {alike[0]!r} meant?")
    _validated(model, {name: p.value for name, p in overrides.items() if name in model.model_fields})
    for name, info in model.model_fields.items():
        default = list(info.default) if isinstance(info.default, tuple) else info.default
        node.declare_parameter(name, default, _descriptor(model, name))


def shared_names(arguments: Sequence[str]) -> set[str]:
    """Names of parameters that files give to any node that wants them (`/**`), and nobody to one node by name.

    Raises `InputError` for a file that cannot be read.
    """
    shared: set[str] = set()
    own: set[str] = set()
    for flag, value in pairwise(arguments):
        if flag in ("-p", "--param"):
            own.add(value.partition(":=")[0].rpartition(":")[2])
        elif flag == "--params-file":
            content = yaml_text.load_file(value)
            for node, entry in content.items() if isinstance(content, dict) else ():
                keys = _leaves(entry.get("ros__parameters")) if isinstance(entry, dict) else set()
                (shared if "*" in str(node) else own).update(keys)
    return shared - own


def _leaves(content: object, prefix: str = "") -> set[str]:
    if not isinstance(content, dict):
        return set()
    leaves: set[str] = set()
    for key, value in content.items():
        name = f"{prefix}{key}"
        leaves |= _leaves(value, f"{name}.") if isinstance(value, dict) else {name}
    return leaves


def read(node: Node, model: type[Model]) -> Model:
    """The parameters' present values; `InputError` names each that is wrong, what was found and what is allowed."""
    return _validated(model, {name: _value(node.get_parameter(name)) for name in model.model_fields})


def changed(node: Node, model: type[Model], changes: list[Parameter]) -> Model:
    """The parameters as they would be after `changes`; `InputError` as `read`."""
    values = {name: _value(node.get_parameter(name)) for name in model.model_fields}
    return _validated(model, values | {p.name: _value(p) for p in changes if p.name in model.model_fields})


def is_live(model: type[NodeParameters], name: str) -> bool:
    """True if a parameter may change while the node is active."""
    return bool(_extra(model, name, "live"))


def _value(parameter: Parameter) -> Any:
    return tuple(parameter.value) if parameter.type_.name.endswith("ARRAY") else parameter.value


def _validated(model: type[Model], values: Mapping[str, Any]) -> Model:
    # An empty list (`-p topics:=[]`) has no type for ROS and arrives as None.
    given = {name: value for name, value in values.items() if value is not None}
    try:
        return model.model_validate(given)
    except ValidationError as error:
        faults = [
            f"parameter {'.'.join(map(str, fault['loc']))} is {fault['input']!r}: {fault['msg'][:1].lower()}"
            f"{fault['msg'][1:]}"
            for fault in error.errors()
        ]
        raise InputError("; ".join(faults)) from None


def _range_text(constraints: list[Any]) -> str:
    signs = {"gt": ">", "ge": "≥", "lt": "<", "le": "≤"}
    bounds = [(sign, getattr(c, key, None)) for c in constraints for key, sign in signs.items()]
    return ", ".join(f"{sign} {bound:.12g}" for sign, bound in bounds if bound is not None)


def rows(model: type[NodeParameters]) -> list[tuple[str, str, str, str, str]]:
    """Name, default, unit, range and description of each parameter."""
    table = []
    for name, info in model.model_fields.items():
        schema = model.model_json_schema()["properties"][name]
        allowed = ", ".join(map(str, schema["enum"])) if "enum" in schema else _range_text(info.metadata)
        default = f"{info.default:.6g}" if isinstance(info.default, float) else str(info.default)
        default = default.lower() if isinstance(info.default, bool) else "" if info.default == () else default
        table.append((name, default, _extra(model, name, "unit") or "", allowed, info.description or ""))
    return table


def markdown_table(model: type[NodeParameters]) -> str:
    """The parameters as a table in Markdown."""
    lines = ["| parameter | default | unit | allowed | what |", "|---|---|---|---|---|"]
    for name, default, unit, allowed, description in rows(model):
        live = " *(live)*" if is_live(model, name) else ""
        lines.append(f"| `{name}` | {f'`{default}`' if default else ''} | {unit} | {allowed} | {description}{live} |")
    return "\n".join(lines) + "\n"


def help_text(model: type[NodeParameters]) -> str:
    """The parameters for `--help`."""
    lines = []
    for name, default, unit, allowed, description in rows(model):
        notes = [f"default {default!s}" if default else "", f"[{unit}]" if unit else "", allowed and f"({allowed})"]
        lines.append(f"  {name:<20} {description}{'; ' if any(notes) else ''}{' '.join(filter(None, notes))}")
    return "\n".join(lines)
