"""Properties of the hardware that bounded model checking proves within seconds; `make hw` proves all of them."""

from __future__ import annotations

import runpy
from pathlib import Path

import pytest

PROVE = runpy.run_path(str(Path(__file__).parents[2] / "hw" / "formal" / "prove.py"))
MISSING = PROVE["missing"]()


@pytest.mark.exam
@pytest.mark.skipif(bool(MISSING), reason=f"needs {', '.join(MISSING)}: make hw-tools")
@pytest.mark.parametrize(
    "name",
    [
        "a product with one",
        "a quotient by zero",
        "results after wrong, aborted and good packets are reached",
        "a reset of one clock suffices for body_mass",
    ],
)
def test_a_property_of_the_hardware_holds(name: str) -> None:
    assert PROVE["holds"](PROVE["PROOFS"][name])


def test_every_file_of_a_proof_is_there_and_has_its_module() -> None:
    for proof in PROVE["PROOFS"].values():
        texts = [(PROVE["HW"] / file).read_text(encoding="utf-8") for file in proof.files]
        assert any(f"module {proof.top} " in text for text in texts)
