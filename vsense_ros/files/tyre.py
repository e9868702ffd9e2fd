"""A tyre on its own, from a `.tir` file or as YAML with the keys that the tyre of a vehicle file has."""

from __future__ import annotations

from pathlib import Path

from pydantic import TypeAdapter, ValidationError

from vsense_ros.errors import InputError
from vsense_ros.files.tir import read_tir
from vsense_ros.messages import yaml_text
from vsense_ros.model.tyres import AnyTyre, Tyre


def load_tyre(path: str | Path) -> Tyre:
    """Raises `InputError` that names file, key, what was found and what is allowed, one line for each fault."""
    path = Path(path)
    if path.suffix.lower() == ".tir":
        return read_tir(path)
    content = yaml_text.load_file(path)
    adapter: TypeAdapter[Tyre] = TypeAdapter(AnyTyre)
    try:
        return adapter.validate_python(content)
    except ValidationError as error:
        raise InputError(
            "\n".join(f"{path}: {'.'.join(map(str, fault['loc']))}: {fault['msg']}" for fault in error.errors())
        ) from None
