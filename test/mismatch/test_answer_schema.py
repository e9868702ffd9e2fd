"""The content of explain.json: that it is what its schema says, and that another one is refused with what to do."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from pydantic import BaseModel, ValidationError

from synthetic_findings import effect, finding
from vsense_ros.errors import InputError
from vsense_ros.files.schema import models_of, unit_of
from vsense_ros.mismatch.answer_schema import Answer, parsed, read_answer
from vsense_ros.mismatch.words import BADGES

DOCS = Path(__file__).parents[2] / "docs"
ANSWERS = Path(__file__).parent / "answers"  # the first ones that had a version, as they were published
# Digests of their content before it had a version (SHA-256 of the JSON with sorted keys).
FIRST = {
    "genesis": "85a4a32f8b59d23b04d4964057a43cba988ebc5c74255004ae47e234e5f86d8f",
    "rav4": "517d4212de011dec3ede8a3a165d39115bee25d87308040a063bb6e7e80c62d9",
}


@pytest.mark.parametrize("name", FIRST)
def test_the_first_answers_of_a_version_are_read_and_lose_nothing(name):
    """What was written when the version was young, by whoever has kept it."""
    text = (ANSWERS / name / "explain.json").read_text(encoding="utf-8")
    content = json.loads(text)
    assert content.pop("version") == 1
    digest = hashlib.sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()
    assert digest == FIRST[name]
    assert read_answer(ANSWERS / name).written() == text


@pytest.mark.parametrize("name", ["genesis", "rav4"])
def test_a_published_answer_is_what_would_be_written_of_it_today(name):
    text = (DOCS / "examples" / name / "explain.json").read_text(encoding="utf-8")
    assert read_answer(DOCS / "examples" / name).written() == text


@pytest.mark.parametrize("verdict", BADGES)
def test_an_answer_is_read_as_it_was_written(verdict, tmp_path):
    found = finding(verdict)
    found.write(tmp_path)
    assert read_answer(tmp_path) == found


def test_of_what_there_is_nothing_to_say_there_is_no_key():
    content = finding("named", held_out=False).as_json()
    roll, bias, *_ = content["effects"]
    assert "axis" not in roll
    assert bias["axis"] == "y"
    assert "misfit" not in content
    assert all("held_out" not in errors for errors in content["fit"].values())
    assert content["would_separate"] is None


def test_figures_that_are_no_numbers_are_not_written():
    with pytest.raises(ValueError, match="not JSON compliant"):
        finding("named", misfit=float("nan")).written()


def test_an_answer_knows_no_other_keys_and_cannot_be_changed():
    with pytest.raises(ValidationError, match="verdikt"):
        finding("named", verdikt="ambiguous")
    with pytest.raises(ValidationError, match="frozen"):
        finding("named").verdict = "ambiguous"


def fields(model: type[BaseModel], seen: set[type[BaseModel]]) -> Iterator[tuple[str, Any]]:
    """All fields of a model and of the models in it, by dotted name."""
    seen.add(model)
    for name, field in model.model_fields.items():
        yield f"{model.__name__}.{name}", field
        for part in parts_of(field.annotation):
            if part not in seen:
                yield from fields(part, seen)


def parts_of(annotation: Any) -> Iterator[type[BaseModel]]:
    """The models in an annotation, whatever they are in."""
    yield from models_of(annotation)
    for member in getattr(annotation, "__args__", ()):
        yield from parts_of(member)


def test_every_key_has_a_meaning_and_every_quantity_a_unit():
    found = dict(fields(Answer, set()))
    assert {"Answer.cpu_s", "ProfilePoint.latitude", "Errors.after", "NextTest.d_prime"} <= found.keys()
    assert [name for name, field in found.items() if not field.description] == []
    quantities = [name for name, field in found.items() if "float" in str(field.annotation)]
    assert [name for name in quantities if not unit_of(found[name])] == []


def test_what_is_in_the_answer_is_what_is_named_or_cannot_be_told_apart():
    assert [one.id for one in finding("named").in_answer] == ["imu_roll_misalignment"]
    assert [one.id for one in finding("ambiguous").in_answer] == ["imu_roll_misalignment", "accelerometer_bias"]
    assert finding("unknown").in_answer == ()


def test_the_place_of_an_effect_is_told_with_its_form():
    assert effect("brake_drag", 0.1, wheel="fl").place == "fl"
    assert effect("road_bank", 0.1, form="on a plane").place == "on a plane"
    assert effect("aero_drag", 0.1).place == ""


@pytest.mark.parametrize(
    ("changes", "said"),
    [
        ({"version": None}, "of an earlier version, without a number; expected version 1: run vsense explain again"),
        ({"version": 2}, "of version 2; expected version 1: run vsense explain again"),
        ({"verdict": "certain"}, "verdict: Input should be 'named'"),
        ({"threshold": "high"}, "threshold: Input should be a valid number"),
        ({"effects": [{"id": "brake_drag"}]}, "effects.0.sentence: Field required"),
    ],
)
def test_another_content_is_refused_with_what_is_wrong_and_what_to_do(changes, said):
    content = finding("named").as_json() | changes
    if content["version"] is None:
        del content["version"]
    with pytest.raises(InputError) as refused:
        parsed(content, "out/explain.json")
    assert str(refused.value).startswith("out/explain.json: ")
    assert said in str(refused.value)
    assert "run vsense explain again" in str(refused.value)
