"""What an identification says of parameters that the drives do not determine agrees with what it writes."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

from vsense_ros.identification.identified import Identification, Product
from vsense_ros.identification.information import Refusal


def identified(product_is_determined: bool) -> Any:
    """An identification whose drives determine at most the cornering stiffness of the front tyres."""
    product = Product("front", 7.1e4, 4.2e3, ((7.0e4, 6e3), (7.2e4, 6e3)), product_is_determined)
    refused = (Refusal("front_stiffness", 0.63, 1.0), Refusal("front_peak", 0.84, 1.0))
    names = ("front_stiffness", "front_peak")
    found = SimpleNamespace(names=names, values=SimpleNamespace(tolist=lambda: [6.2e4, 1.15]),
                            weakest=lambda _: "front_peak", pairs=tuple)  # fmt: skip
    return SimpleNamespace(
        free=names, information=found, refused=refused, products=(product,), rinsed=SimpleNamespace(settled=True),
        verdict=None, is_kept=False, start={"front_stiffness": 4.868e4, "front_peak": 0.9973},
    )  # fmt: skip


def test_a_stiffness_that_follows_from_its_product_is_not_said_to_stay() -> None:
    one = identified(product_is_determined=True)
    stiffness, peak, *_ = Identification.sentences(one)
    assert "7.1e+04 ± 4.2e+03 N/rad" in stiffness
    assert "stays" not in stiffness
    assert "It stays 0.9973." in peak
    written = Identification.values.fget(one)  # type: ignore[attr-defined]
    assert written["front_stiffness"] * written["front_peak"] == one.products[0].value


def test_a_stiffness_without_a_determined_product_stays() -> None:
    stiffness, *_ = Identification.sentences(identified(product_is_determined=False))
    assert "It stays 4.868e+04." in stiffness
