"""YAML from anywhere is loaded as it is meant, or refused before it fills the memory."""

from __future__ import annotations

import os
import time
from contextlib import suppress
from pathlib import Path

import pytest
import yaml as pyyaml
from hypothesis import given
from hypothesis import strategies as st

from vsense_ros.errors import InputError
from vsense_ros.messages import yaml_text

_LEAVES = st.none() | st.booleans() | st.integers(-(10**9), 10**9) | st.text("abc δ:#-[]{}*&!", max_size=8)
_TREES = st.recursive(
    _LEAVES,
    lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text("xyz", min_size=1), inner, max_size=4),
    max_leaves=20,
)

BOMBS = {
    "aliases of aliases": "a: &a [1, 1, 1, 1, 1, 1, 1, 1, 1]\n"
    + "".join(f"{b}: &{b} [{', '.join([f'*{a}'] * 9)}]\n" for a, b in zip("abcdefgh", "bcdefghi", strict=True)),
    "brackets": "[" * 500 + "]" * 500,
    "braces": "{a: " * 300 + "1" + "}" * 300,
    "indents": "\n".join(" " * i + "a:" for i in range(500)),
    "dashes": "- " * 500 + "1",
    "a number": "a: " + "9" * 5000,
    "a hexadecimal number": "a: 0x" + "f" * 100_000,
    "a mapping that merges itself": "a: &a\n  <<: *a\n",
    "a list within itself": "&a [*a]",
    "length": "# \n" * 2_000_000,
}


@pytest.mark.parametrize("name", BOMBS)
def test_what_stands_for_more_than_anybody_would_write_is_refused_at_once(name: str) -> None:
    began = time.process_time()
    with pytest.raises(InputError, match="file"):
        yaml_text.load(BOMBS[name], "file")
    assert time.process_time() - began < 2.0


@given(_TREES)
def test_what_pyyaml_writes_is_read_as_it_was(tree: object) -> None:
    assert yaml_text.load(pyyaml.safe_dump(tree, allow_unicode=True), "file") == tree


def test_an_alias_stands_for_what_it_names() -> None:
    assert yaml_text.load("a: &x {b: 1}\nc: *x\nd: {<<: *x, e: 2}", "file") == {
        "a": {"b": 1},
        "c": {"b": 1},
        "d": {"b": 1, "e": 2},
    }


@given(st.text(max_size=60))
def test_any_text_is_read_or_refused_in_words(text: str) -> None:
    with suppress(InputError):
        yaml_text.load(text, "file")


@pytest.mark.parametrize("kind", ["device", "pipe", "folder", "missing", "no text"])
def test_a_file_that_is_none_is_refused_without_reading_it(kind: str, tmp_path: Path) -> None:
    path = tmp_path / "file.yaml"
    if kind == "pipe":
        os.mkfifo(path)
    elif kind == "folder":
        path.mkdir()
    elif kind == "device":
        path = Path("/dev/zero")
    elif kind == "no text":
        path.write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match=r"not a regular file|no such file|no UTF-8 text"):
        yaml_text.load_file(path)
