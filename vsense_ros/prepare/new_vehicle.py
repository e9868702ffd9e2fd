"""A vehicle file from the few numbers of a catalogue: what it does not say is filled by rules with a source."""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import ValidationError
from ruamel.yaml import YAML
from ruamel.yaml.comments import CommentedMap, CommentedSeq

from vsense_ros.errors import InputError
from vsense_ros.files.atomic import atomic_write
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.prepare.axle_rules import axles
from vsense_ros.prepare.body_rules import body
from vsense_ros.prepare.catalogue import CatalogueValues
from vsense_ros.prepare.estimated import GIVEN, Estimated
from vsense_ros.prepare.rules import CarKind, rules_for
from vsense_ros.prepare.sensor_rules import observer, sensors
from vsense_ros.prepare.tyre_rules import tyres


@dataclass(frozen=True)
class NewVehicle:
    """A vehicle with the kind of car whose rules filled it, and its uncertain numbers by dotted path."""

    vehicle: Vehicle
    kind: CarKind
    numbers: Mapping[str, Estimated]

    @property
    def from_catalogue(self) -> tuple[str, ...]:
        """Paths of the numbers that follow from the catalogue alone."""
        return tuple(path for path, number in self.numbers.items() if number.rule == GIVEN)

    def write(self, path: str | Path) -> None:
        """Write the vehicle file: each uncertain number with its standard deviation and the rule behind it."""
        write_new_vehicle(path, self)


def new_vehicle(car: CatalogueValues, topics: Collection[str] = ()) -> NewVehicle:
    """The vehicle with what the catalogue says, and the most likely value of everything else; the `topics` of its
    recordings say which sensors it has beyond the usual ones.

    Raises `InputError` where no car can have such values.
    """
    rules = rules_for(car.kind)
    numbers = body(car, rules)
    numbers |= axles(car, rules, numbers)
    models, scales = tyres(car, rules, numbers)
    numbers |= scales
    sensing, places = sensors(car, rules, topics)
    document: dict[str, Any] = {
        "name": car.name,
        "source": f"Catalogue values; all else by the rules for {car.kind} cars of `vsense new-vehicle`.",
    }
    values = {path: float(f"{number.value:.4g}") for path, number in numbers.items()}
    for path, value in _by_order({**values, **models}).items():
        _put(document, path, value)
    document |= {
        "drivetrain": {"driven": car.driven},
        "sensors": sensing,
        "observer": observer(car, rules, numbers),
        "uncertainty": {
            path: {"deviation": float(f"{number.deviation:.2g}"), "source": _cited(number)}
            for path, number in {**numbers, **places}.items()
        },
    }
    try:
        return NewVehicle(Vehicle.model_validate(document), car.kind, {**numbers, **places})
    except ValidationError as error:
        fault = error.errors()[0]
        message = str(fault["msg"]).removeprefix("Value error, ")
        raise InputError(f"there is no car with these values: {message}") from None


def write_new_vehicle(path: str | Path, new: NewVehicle) -> None:
    """Write the vehicle file: each uncertain number with its standard deviation, and the rule or `given`, behind it."""
    content = new.vehicle.model_dump(mode="json", exclude_unset=True)
    tree = _commented(content, new, ())
    tree.yaml_set_start_comment(
        f"A {new.kind} car from catalogue values. Behind each number: ± its standard deviation (the rule that it\n"
        "comes from, or `given`); the section `uncertainty` says the same with the sources; commands read it.\n"
        "`vsense check` says whether this is a car, `vsense calibrate` what an ordinary drive says of it."
    )
    yaml = YAML()
    yaml.width = 4096
    with atomic_write(path) as file:
        yaml.dump(tree, file)


def _cited(number: Estimated) -> str:
    return number.source if number.rule == GIVEN else f"rule {number.rule}: {number.source}"


def _by_order(values: Mapping[str, Any]) -> dict[str, Any]:
    """Values in the order in which the schema has the parts of `physics`, tyres behind the other numbers of an axle."""
    parts = ("chassis", "front", "rear", "steering", "aerodynamics")
    return dict(sorted(values.items(), key=lambda item: parts.index(item[0].split(".")[1])))


def _put(document: dict[str, Any], path: str, value: Any) -> None:
    *parents, last = path.split(".")
    for key in parents:
        document = document.setdefault(key, {})
    document[last] = value


def _commented(node: Mapping[str, Any], new: NewVehicle, above: tuple[str, ...]) -> CommentedMap:
    """A mapping as YAML, with its uncertain numbers explained; force curves and uncertainties on one line each."""
    tree = CommentedMap()
    for key, value in node.items():
        path = ".".join((*above, key))
        if isinstance(value, dict):
            tree[key] = _commented(value, new, (*above, key))
            if above[-1:] in (("longitudinal",), ("lateral",), ("uncertainty",)):
                tree[key].fa.set_flow_style()
        elif isinstance(value, list):
            tree[key] = CommentedSeq(value)
            tree[key].fa.set_flow_style()
        else:
            tree[key] = value
        if (number := new.numbers.get(path)) is not None:
            unit = new.vehicle.unit(path)
            unit = "" if unit == "-" else f" {unit}"
            tree.yaml_add_eol_comment(f"± {float(f'{number.deviation:.2g}'):g}{unit} ({number.rule})", key, column=44)
    return tree
