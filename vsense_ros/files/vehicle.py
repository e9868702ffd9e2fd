"""Vehicle files: reading one, with errors that name the line and the key, and writing one."""

from __future__ import annotations

import json
from collections.abc import Iterable
from functools import lru_cache
from pathlib import Path
from typing import Any, get_args, get_origin

from pydantic import BaseModel, ValidationError
from pydantic.fields import FieldInfo
from ruamel.yaml import YAML
from ruamel.yaml.comments import Comment, CommentedMap, CommentedSeq, Format
from ruamel.yaml.error import MarkedYAMLError, YAMLError

from vsense_ros.errors import InputError
from vsense_ros.files.atomic import atomic_write
from vsense_ros.files.schema import allowed, models_of, tag_of, unit_of
from vsense_ros.files.tir import read_tir
from vsense_ros.messages import yaml_text
from vsense_ros.model.schema.suspension_tables import SuspensionTables
from vsense_ros.model.vehicle import Vehicle


def load_vehicle(path: str | Path) -> Vehicle:
    """Read and validate a vehicle file.

    A tyre `{model: magic_formula, tir: FILE}` is read from a `.tir` file, its name relative to the vehicle file. Other
    keys beside `tir` replace what the file says; `axes: adapted_sae` says that y points to the right in it.

    Raises `InputError` that names file, line, key, what was found and what is allowed, one line for each fault.
    """
    path = Path(path)
    tree = _tree(path)
    try:
        # As JSON, where strict means that a number is a number but a list may stand for a tuple.
        return Vehicle.model_validate_json(json.dumps(_resolved(path, tree), default=str), strict=True)
    except ValidationError as error:
        raise InputError("\n".join(_fault(path, tree, fault) for fault in error.errors())) from None


def load_content(path: str | Path) -> dict[str, Any]:
    """The content of a vehicle file, whether or not there can be such a car. Raises `InputError` for what is no YAML,
    or has no such tyre file."""
    path = Path(path)
    content: dict[str, Any] = _resolved(path, _tree(path))
    return content


def _tree(path: Path) -> CommentedMap:
    """A vehicle file as YAML with its lines. Raises `InputError` for what is none."""
    if not path.exists():
        raise InputError(
            f"{path}: no such vehicle file; give the path of one, or the name without .yaml of one in config/vehicles"
        )
    text = yaml_text.read_text(path)
    yaml_text.check(text, str(path))
    try:
        tree = _parsed(text)
    except MarkedYAMLError as error:
        line = error.problem_mark.line + 1 if error.problem_mark else "?"
        raise InputError(f"{path}:{line}: not valid YAML: {error.problem}") from None
    except (YAMLError, ValueError, RecursionError, OverflowError, TypeError) as error:
        raise InputError(f"{path}: not valid YAML: {error}") from None
    if not isinstance(tree, CommentedMap):
        raise InputError(f"{path}: expected a mapping with the keys {', '.join(Vehicle.model_fields)}")
    return tree


@lru_cache(maxsize=16)
def _parsed(text: str) -> Any:
    """The YAML of a text, which nobody changes: to parse it takes longer than all else that loads a vehicle, and many
    commands load the same one several times."""
    return YAML().load(text)


def save_vehicle(path: str | Path, vehicle: Vehicle) -> None:
    """Write a vehicle file with all its values spelt out."""
    yaml = YAML()
    yaml.width = 120
    yaml.default_flow_style = None
    with atomic_write(path) as file:
        yaml.dump(vehicle.model_dump(mode="json"), file)


def save_tables(source: str | Path, target: str | Path, tables: SuspensionTables) -> None:
    """Write the vehicle file `source` with these suspension tables to `target`; everything else stays as it is written,
    comments included."""
    yaml, tree = _as_written(source)
    content = tables.model_dump(mode="json")
    for axle in ("front", "rear"):
        for rows in content[axle].values():
            rows[:] = [_in_one_line(row) for row in rows]
    content["travel"] = _in_one_line(content["travel"])
    if "suspension" in tree:
        tree["suspension"] = content
    else:
        keys = list(tree)
        before = max(keys.index(key) for key in ("physics", "linkage") if key in tree)
        tree.insert(before + 1, "suspension", content)
    with atomic_write(target) as file:
        yaml.dump(tree, file)


def save_changes(source: str | Path, target: str | Path, vehicle: Vehicle, paths: Iterable[str]) -> None:
    """Write the vehicle file `source` to `target`, with what `vehicle` has at these dotted paths (lists by index), and
    its uncertainty there, which also stands as a comment behind the number. Everything else stays as it is written,
    comments included, but for anchors in the parts that have such paths: what two places share, one place cannot
    change."""
    yaml, tree = _as_written(source)
    content, paths = vehicle.model_dump(mode="json"), list(paths)
    for part in tree.keys() & {path.split(".")[0] for path in paths}:
        tree[part] = _spelt_out(tree[part])
    for path in paths:
        node, value = tree, content
        *parents, last = path.split(".")
        for i, key in enumerate(parents):
            value = value[key]
            if key not in node:  # left to its default so far
                node[key] = _in_one_line(value) if isinstance(value, list) else CommentedMap()
                node[key].fa.set_flow_style() if i > 0 else node[key].fa.set_block_style()
            node = node[key]
        index = int(last) if isinstance(value, list) else last
        node[index] = value[index]
        _state_uncertainty(tree, path, vehicle)
    with atomic_write(target) as file:
        yaml.dump(tree, file)


def _state_uncertainty(tree: CommentedMap, path: str, vehicle: Vehicle) -> None:
    """Write what a vehicle says of the uncertainty of a number into the section `uncertainty`, and behind it."""
    stated = vehicle.uncertainty.get(path)
    if stated is None:
        return
    entry = CommentedMap(stated.model_dump())
    entry.fa.set_flow_style()
    tree.setdefault("uncertainty", CommentedMap())[path] = entry
    *parents, last = path.split(".")
    if last.isdigit():  # behind the list
        *parents, last = parents
    node = tree
    for key in parents:
        node = node[key]
    if not node.fa.flow_style():
        unit = vehicle.unit(path)
        node.yaml_add_eol_comment(
            f"± {stated.deviation:g}{'' if unit == '-' else ' ' + unit} ({stated.source})", last, column=44
        )


def _as_written(source: str | Path) -> tuple[YAML, CommentedMap]:
    """A vehicle file as its author wrote it, and what writes it the same way."""
    yaml = YAML()
    yaml.width = 4096
    yaml.preserve_quotes = True
    yaml.indent(mapping=2, sequence=4, offset=2)
    return yaml, yaml.load(Path(source).read_text(encoding="utf-8"))


def _spelt_out(node: Any) -> Any:
    """A copy with its own of everything that aliases and merges stand for; what is merged comes first, as comments
    behind the last key stay there."""
    if isinstance(node, CommentedMap):
        own_items = dict(node.non_merged_items())
        merged = {key: value for key, value in node.items() if key not in own_items}
        copy: Any = CommentedMap({key: _spelt_out(value) for key, value in (merged | own_items).items()})
    elif isinstance(node, CommentedSeq):
        copy = CommentedSeq(map(_spelt_out, node))
    else:
        return node
    for attribute in (Comment.attrib, Format.attrib):
        if hasattr(node, attribute):
            setattr(copy, attribute, getattr(node, attribute))
    return copy


def _in_one_line(values: list[float]) -> CommentedSeq:
    result = CommentedSeq(values)
    result.fa.set_flow_style()
    return result


def _resolved(path: Path, tree: CommentedMap) -> Any:
    """The file's content, with the parameters of `.tir` files in the place of their names, and the deviations that the
    section `uncertainty` has of parameters that the observer estimates."""
    plain = _plain(tree)
    _fill_deviations(plain)
    physics = plain.get("physics")
    for axle in ("front", "rear"):
        part = physics.get(axle) if isinstance(physics, dict) else None
        tyre = part.get("tyre") if isinstance(part, dict) else None
        if not isinstance(tyre, dict) or "tir" not in tyre or not isinstance(part, dict):
            continue
        data = tree["physics"][axle]["tyre"].lc.data or {}
        line = data["tir"][0] + 1 if "tir" in data else "?"
        place = f"{path}:{line}: physics.{axle}.tyre.tir"
        if tyre.get("model") != "magic_formula":
            raise InputError(f"{place}: only a tyre of `model: magic_formula` is read from a .tir file")
        axes = tyre.get("axes", "iso")
        if axes not in ("iso", "adapted_sae"):
            raise InputError(f"{place}: axes: expected iso or adapted_sae, found {axes!r}")
        changes = {key: value for key, value in tyre.items() if key not in ("tir", "axes")}
        try:
            part["tyre"] = read_tir(path.parent / str(tyre["tir"]), axes, changes).model_dump()
        except InputError as error:
            raise InputError(f"{place}: {error}") from None
    return plain


def _fill_deviations(plain: Any) -> None:
    """Let `observer.parameters` leave out a deviation that the section `uncertainty` has."""
    uncertainty, observer = plain.get("uncertainty"), plain.get("observer")
    parameters = observer.get("parameters") if isinstance(observer, dict) else None
    if not isinstance(parameters, dict) or not isinstance(uncertainty, dict):
        return
    for name, settings in parameters.items():
        stated = uncertainty.get(f"physics.{name}")
        if isinstance(settings, dict) and isinstance(stated, dict) and "deviation" in stated:
            settings.setdefault("deviation", stated["deviation"])


def _plain(node: Any) -> Any:
    if isinstance(node, dict):
        return {str(key): _plain(value) for key, value in node.items()}
    if isinstance(node, list):
        return [_plain(value) for value in node]
    if isinstance(node, bool) or node is None or isinstance(node, str):
        return node
    if isinstance(node, int):
        return int(node)
    return float(node) if isinstance(node, float) else node


def _fault(path: Path, tree: CommentedMap, fault: Any) -> str:
    """Message of one line for one fault: file, line and key, what was expected and what was found."""
    line, keys = _place(tree, fault)
    place = f"{path}:{line}: {'.'.join(keys) or 'file'}"
    model, field = _field(fault["loc"])
    value = _shown(fault["input"])
    if fault["type"] == "missing":
        expected = field.description if field and field.description else "a value"
        return f"{place}: missing; expected {expected}{_range(field)}"
    if fault["type"] == "extra_forbidden":
        known_keys = f"; known here: {', '.join(model.model_fields)}" if model else ""
        return f"{place}: unknown key, found {value}{known_keys}"
    message = fault["msg"].removeprefix("Value error, ")
    inside = "" if isinstance(fault["input"], dict) else f", found {value}"
    return f"{place}: {message[:1].lower() + message[1:]}{inside}{_range(field)}"


def _place(tree: CommentedMap, fault: Any) -> tuple[int, list[str]]:
    """Line and keys of a fault in a file. The location of a tagged union carries the tag, which is no key of the file;
    for a fault of several values, the message begins with the key of the wrong one."""
    node: Any = tree
    line = tree.lc.line + 1
    keys: list[str] = []
    for step in fault["loc"]:
        names = {str(key): key for key in node} if isinstance(node, CommentedMap) else {}
        if step in names:
            line = _line(node.lc.data, names[step], line)
            node = node[names[step]]
        elif isinstance(node, CommentedSeq) and isinstance(step, int) and step < len(node):
            line = _line(node.lc.data, step, line)
            node = node[step]
        elif fault["type"] != "missing" or step != fault["loc"][-1]:
            continue
        keys.append(str(step))
    if fault["type"] == "value_error":
        for step in fault["msg"].removeprefix("Value error, ").split()[0].split("."):
            if not isinstance(node, CommentedMap) or step not in node:
                break
            line = _line(node.lc.data, step, line)
            node = node[step]
            keys.append(step)
    return line, keys


def _line(places: Any, key: Any, default: int) -> int:
    """Line of a key or an item; `default` where it has none of its own, as after a YAML merge."""
    return places[key][0] + 1 if places and key in places else default


def _shown(value: Any) -> str:
    if isinstance(value, dict | list):
        return "a mapping" if isinstance(value, dict) else f"a list of {len(value)}"
    return "nothing" if value is None else repr(value)


def _field(location: tuple[Any, ...]) -> tuple[type[BaseModel] | None, FieldInfo | None]:
    """The schema's field at a location, or None, and the model that has it or should have it."""
    annotation: Any = Vehicle
    model: type[BaseModel] | None = None
    field: FieldInfo | None = None
    for step in location:
        if get_origin(annotation) is dict:
            annotation, field = get_args(annotation)[1], None
            continue
        choices = list(models_of(annotation))
        tagged = [choice for choice in choices if len(choices) > 1 and tag_of(choice) == step]
        if tagged:
            annotation = tagged[0]
            continue
        if not choices:  # a component of a tuple
            continue
        model = choices[0]
        field = model.model_fields.get(step)
        if field is None:
            break
        annotation = field.annotation
    return model, field


def _range(field: FieldInfo | None) -> str:
    """The range of a field, in brackets."""
    if field is None:
        return ""
    unit, limits = unit_of(field), allowed(field)
    words = [f"a number in {unit}" if unit else "", limits]
    text = ", ".join(word for word in words if word)
    return f" ({text})" if text else ""
