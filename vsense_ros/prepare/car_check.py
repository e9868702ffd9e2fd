"""Is this a car? Figures of a vehicle file against the ranges of real cars, and which mistake explains one outside."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

from vsense_ros.model.vehicle import Vehicle
from vsense_ros.prepare.features import Feature
from vsense_ros.prepare.features_axle import of_axles
from vsense_ros.prepare.features_car import of_body, of_handling
from vsense_ros.prepare.features_sensors import of_observer, of_sensors
from vsense_ros.prepare.mistakes import Mistake, mistakes

GROUPS = (of_body, of_axles, of_handling, of_sensors, of_observer)


@dataclass(frozen=True)
class CarFinding:
    """Figures that no real car has, and the mistake in the file that explains most of them, if there is one."""

    features: tuple[Feature, ...]
    mistake: Mistake | None = None

    @property
    def keys(self) -> tuple[str, ...]:
        """Keys of the file that are wrong, or one of which is."""
        return self.mistake.keys if self.mistake is not None else self.features[0].keys


def features(car: Vehicle) -> Iterator[Feature]:
    """All figures of a car."""
    for group in GROUPS:
        yield from group(car)


def check_car(car: Vehicle) -> list[CarFinding]:
    """What no real car has. Each mistake is reported once, with all the figures that it puts right; what no single
    mistake explains is reported figure by figure."""
    implausible = [feature for feature in features(car) if feature.off]
    explained_findings: list[CarFinding] = []
    while implausible:
        best: tuple[int, Mistake, Vehicle, list[Feature]] | None = None
        document = car.model_dump()
        for mistake in mistakes({key for feature in implausible for key in feature.keys}):
            if (mended := mistake.mended(document)) is None:
                continue
            remaining = [feature for feature in features(mended) if feature.off]
            if len(remaining) < len(implausible) and (best is None or len(remaining) < best[0]):
                best = len(remaining), mistake, mended, remaining
        if best is None:
            return [*explained_findings, *(CarFinding((feature,)) for feature in implausible)]
        _, mistake, car, remaining = best
        names = {(feature.name, feature.place) for feature in remaining}
        explained = tuple(feature for feature in implausible if (feature.name, feature.place) not in names)
        explained_findings.append(CarFinding(explained or (implausible[0],), mistake))
        implausible = remaining
    return explained_findings


def check_document(document: Any) -> list[CarFinding]:
    """The mistake that explains best why there can be no car with the content of a vehicle file: with it put right
    there is one, with the fewest figures that no real car has. Empty where no single mistake explains it."""
    keys = [key for key in _keys(document) if not key.startswith("uncertainty.")]
    possible = [
        (sum(feature.off for feature in features(mended)), order, mistake)
        for order, mistake in enumerate(mistakes(keys))
        if (mended := mistake.mended(document)) is not None
    ]
    return [CarFinding((), min(possible)[2])] if possible else []


def _keys(node: Any, above: str = "") -> Iterator[str]:
    """Dotted paths of all that stands in the content of a file."""
    for name, value in node.items() if isinstance(node, dict) else ():
        yield f"{above}{name}"
        yield from _keys(value, f"{above}{name}.")


def in_words(finding: CarFinding) -> str:
    """One sentence: what is out of range, of how much, and what was probably meant."""
    mistake = finding.mistake
    keys = ", ".join(finding.keys if mistake is not None else _short(finding.keys))
    parts = "; ".join(_figure(feature) for feature in finding.features)
    return f"{keys}: {mistake.words}? {parts}".strip() if mistake is not None else f"{keys}: {parts}"


def _short(keys: tuple[str, ...]) -> tuple[str, ...]:
    return keys if len(keys) <= 3 else (*keys[:3], "…")


def _figure(feature: Feature) -> str:
    limits = feature.limits
    unit = "" if limits.unit == "-" else f" {limits.unit}"
    low, high = limits.range
    place = f" ({feature.place})" if feature.place else ""
    return f"{limits.meaning}{place} is {feature.value:.3g}{unit}, real cars have {low:g} to {high:g}{unit}"
