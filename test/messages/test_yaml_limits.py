"""The bounds of a YAML text, just within and just beyond each, with PyYAML as the oracle of what it means."""

from __future__ import annotations

import pytest

from vsense_ros.errors import InputError
from vsense_ros.messages import yaml_text
from vsense_ros.messages.yaml_text import LIMITS, YamlLimits

pyyaml = pytest.importorskip("yaml", reason="PyYAML is not installed")


def nested(levels: int, opening: str, closing: str) -> str:
    return opening * levels + "1" + closing * levels


@pytest.mark.parametrize(
    "text",
    [
        nested(LIMITS.deepest, "[", "]"), nested(LIMITS.deepest, "{a: ", "}"),
        nested(LIMITS.deepest // 2 + 1, "[", "]"),
        "\n".join(" " * i + "a:" for i in range(LIMITS.deepest)), "a: " + "9" * LIMITS.longest_number,
        "[" + "[], " * 40 + "1]",
        "a: &x [1, 2]\nb: [*x, *x]\n", "'" + "9" * 300 + "'", "a: &n 3\nb: *n\n", "{a: &x {b: 1}, c: *x}",
    ],
)  # fmt: skip
def test_a_text_within_the_bounds_is_what_pyyaml_makes_of_it(text):
    assert yaml_text.load(text, "file") == pyyaml.safe_load(text)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (nested(LIMITS.deepest + 1, "[", "]"), "file:1: nested more than 60 levels deep"),
        (nested(LIMITS.deepest + 1, "{a: ", "}"), "nested more than 60 levels deep"),
        ("a: 1\nb: " + "9" * (LIMITS.longest_number + 1), "file:2: a number of 101 characters"),
        ("a: 1\nb: &x [*x]", r"file:2: \*x stands within what it stands for"),
        ("a: 1\nb: [1, 2", "file:2: not valid YAML"),
        ("a: 1\n b: 2", "file:2: not valid YAML"),
        ("a: *nothing", "not valid YAML"),
        ("a: 2024-13-45", "not valid YAML"),
    ],
)
def test_a_text_beyond_a_bound_is_refused_with_its_line(text, message):
    with pytest.raises(InputError, match=message):
        yaml_text.load(text, "file")


def test_values_are_counted_with_their_aliases_spelt_out(monkeypatch):
    monkeypatch.setattr(yaml_text, "LIMITS", YamlLimits(most_nodes=20))
    within = "&x [1, 2, 3]"  # a list and three numbers
    for copies, refused in ((2, False), (3, True)):
        text = f"a: {within}\nb: [{', '.join(['*x'] * copies)}]\n"
        # the mapping, two keys, the list with its anchor, the list of aliases, and each alias as what it stands for
        count = 1 + 2 + 4 + 1 + 4 * copies
        assert (count > 19) == refused
        monkeypatch.setattr(yaml_text, "LIMITS", YamlLimits(most_nodes=19))
        if refused:
            with pytest.raises(InputError, match="more than 19 values, aliases spelt out"):
                yaml_text.load(text, "file")
        else:
            assert yaml_text.load(text, "file")["b"] == [[1, 2, 3]] * copies


def test_aliases_of_single_values_count_once_each(monkeypatch):
    monkeypatch.setattr(yaml_text, "LIMITS", YamlLimits(most_nodes=9))
    assert yaml_text.load("a: &x 1\nb: [*x, *x, *x, *x]", "file") == {"a": 1, "b": [1, 1, 1, 1]}
    with pytest.raises(InputError, match="stands for more than 9 values"):
        yaml_text.load("a: &x 1\nb: [*x, *x, *x, *x, *x]", "file")


def test_a_file_is_as_long_as_the_bound_and_no_longer(tmp_path):
    path = tmp_path / "file.yaml"
    path.write_text("# " + "x" * 98)
    assert yaml_text.read_text(path, 100) == "# " + "x" * 98
    with pytest.raises(InputError, match="longer than"):
        yaml_text.read_text(path, 99)
    path.write_text("a: [1, 2]")
    assert yaml_text.load_file(path) == {"a": [1, 2]}
    with pytest.raises(InputError, match="no such file"):
        yaml_text.load_file(tmp_path / "other.yaml")


def test_a_text_in_memory_has_the_same_bound():
    with pytest.raises(InputError, match="longer than 4 MiB"):
        yaml_text.check("#" * (LIMITS.largest_text + 1), "file")
    yaml_text.check("#" * LIMITS.largest_text, "file")
