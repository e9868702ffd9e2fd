"""The thresholds of the verdict: that the file has all of them with where they came from, and keeps what is not new."""

from __future__ import annotations

import shutil
from dataclasses import asdict, fields

import pytest
from ruamel.yaml import YAML

from vsense_ros.errors import InputError
from vsense_ros.mismatch import thresholds
from vsense_ros.mismatch.thresholds import FILE, THRESHOLDS, Thresholds


def test_every_threshold_has_a_value_a_unit_a_meaning_and_the_data_it_came_from():
    found = YAML(typ="safe").load(FILE.read_text(encoding="utf-8"))
    assert list(found) == [field.name for field in fields(Thresholds)]
    for name, entry in found.items():
        assert list(entry) == ["value", "unit", "meaning", "source"], name
        assert entry["value"] == asdict(THRESHOLDS)[name]
        assert all(str(entry[key]).strip() for key in ("unit", "meaning", "source")), name


def test_thresholds_that_are_written_are_read_again_and_nothing_else_in_the_file_changes(tmp_path):
    file = tmp_path / "thresholds.yaml"
    shutil.copy(FILE, file)
    thresholds.write({"trusted": (0.93, "public split, 60 names")}, file)
    assert asdict(thresholds.read(file)) == asdict(THRESHOLDS) | {"trusted": 0.93}
    before, after = (path.read_text(encoding="utf-8").splitlines() for path in (FILE, file))
    assert len(before) == len(after)
    changed = [line.strip() for line, old in zip(after, before, strict=True) if line != old]
    assert changed == ["value: 0.93", "source: public split, 60 names"]


@pytest.mark.parametrize(
    ("old", "new", "said"),
    [
        ("refused:", "denied:", "found others or not all: denied, refused"),
        ("value: 0.63", "value: much", "disagreement: expected value \\(a number\\), unit, meaning and source"),
        ("  unit: windows\n", "", "many_windows: expected value \\(a number\\), unit, meaning and source"),
    ],
)
def test_a_file_with_something_missing_or_unknown_is_refused_with_its_name(old, new, said, tmp_path):
    file = tmp_path / "thresholds.yaml"
    text = FILE.read_text(encoding="utf-8")
    assert old in text
    file.write_text(text.replace(old, new), encoding="utf-8")
    with pytest.raises(InputError, match=said):
        thresholds.read(file)
