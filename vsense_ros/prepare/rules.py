"""The rules by which a vehicle file is filled, from the file `rules.yaml` beside this one."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import Literal, get_args

from pydantic import BaseModel, ConfigDict, TypeAdapter, ValidationError

from vsense_ros.errors import InputError
from vsense_ros.messages import yaml_text
from vsense_ros.prepare.estimated import Estimated

FILE = Path(__file__).with_suffix(".yaml")
CarKind = Literal["compact", "saloon", "suv", "van", "formula-student"]
KINDS: tuple[CarKind, ...] = get_args(CarKind)


class Rule(BaseModel):
    """One rule: what it is about, where it comes from, and [value, standard deviation] by kind of car; what is said of
    `all` kinds holds for those that are not named."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    unit: str
    meaning: str
    source: str
    values: dict[CarKind | Literal["all"], tuple[float, float]]

    def of(self, name: str, kind: CarKind) -> Estimated:
        """What the rule of this name says of a kind of car."""
        value, deviation = self.values[kind] if kind in self.values else self.values["all"]
        return Estimated(value, deviation, name, self.source)


@dataclass(frozen=True)
class Rules:
    """All rules, as they are for one kind of car."""

    kind: CarKind
    every: dict[str, Rule]

    def __getitem__(self, name: str) -> Estimated:
        return self.every[name].of(name, self.kind)


@cache
def read(path: Path = FILE) -> dict[str, Rule]:
    """The rules in a file by name. Raises `InputError` where one has not all of its keys, or not for all kinds."""
    try:
        rules = TypeAdapter(dict[str, Rule]).validate_python(yaml_text.load_file(path))
    except ValidationError as error:
        raise InputError(f"{path}: {error}") from None
    for name, rule in rules.items():
        lacking = [kind for kind in KINDS if kind not in rule.values and "all" not in rule.values]
        if lacking:
            raise InputError(f"{path}: {name}: expected a value for {', '.join(lacking)}, found none")
    return rules


def rules_for(kind: CarKind) -> Rules:
    """The rules for a kind of car."""
    return Rules(kind, read())
