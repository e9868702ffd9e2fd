"""What is read of the tool's `explain.json`: the one place that knows its keys.

`verdict`; `effects`: ranked, each with `id`, `parameters` (`name`, `value`, `interval_90`), `gain_training`,
`gain_held_out`, and `accepted` where several are there at once; `answer_set`: ids within reach of the best; `fit`: for
each signal `held_out` with the error `before` and `after`; `driven_s`; `misfit`.
"""

from __future__ import annotations

from collections.abc import Mapping

PLACES = ("wheel", "axle", "sensor")


def verdict(explain: Mapping) -> str:
    return explain.get("verdict", "no_answer")


def ranked(explain: Mapping) -> list[str]:
    return [effect["id"] for effect in explain.get("effects", [])]


def accepted(explain: Mapping) -> list[str]:
    """What the tool says is there: the effects marked so, or else the first."""
    if verdict(explain) != "named":
        return []
    return [effect["id"] for effect in explain["effects"] if effect.get("accepted")] or ranked(explain)[:1]


def answer_set(explain: Mapping) -> list[str]:
    """Of the whole answer, or where each effect has its own, of the first."""
    if "answer_set" in explain:
        return list(explain["answer_set"])
    effects = explain.get("effects", [])
    return list(effects[0].get("answer_set", [])) if effects else []


def parameters(effect: Mapping) -> dict[str, float]:
    """Values by name; a single one of an effect that says its wheel, axle or sensor goes by that."""
    return _of_parameters(effect, "value")


def intervals(effect: Mapping) -> dict[str, tuple[float, float]]:
    """90 % intervals by the same names."""
    return {name: tuple(limits) for name, limits in _of_parameters(effect, "interval_90").items()}


def _of_parameters(effect: Mapping, key: str) -> dict:
    found = {entry["name"]: entry[key] for entry in effect.get("parameters", [])}
    place = next((effect[kind] for kind in PLACES if effect.get(kind)), None)
    return {place: next(iter(found.values()))} if place and len(found) == 1 else found


def driven(explain: Mapping) -> float:
    """Of all recordings, held out or not, what is looked at [s]."""
    return explain.get("driven_s", 0.0)


def misfit(explain: Mapping) -> float | None:
    """Root mean square of what the refitted model leaves over in training, in standard deviations of a good model."""
    return explain.get("misfit")


def gain(effect: Mapping) -> float:
    """The smaller of the gains on training and on held-out manoeuvres."""
    return min(effect["gain_training"], effect["gain_held_out"])


def errors(explain: Mapping) -> dict[str, tuple[float, float]]:
    """Of each signal on held-out manoeuvres, before and after."""
    return {
        signal: (found["held_out"]["before"], found["held_out"]["after"])
        for signal, found in explain.get("fit", {}).items()
        if found.get("held_out")
    }
