"""C, unit and Python on one recording, as `vsense export compare` has them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from vsense_ros import codegen
from vsense_ros.bag.importers import import_recording
from vsense_ros.cli import main
from vsense_ros.export import side_by_side
from vsense_ros.files.installed import vehicle_path
from vsense_ros.files.vehicle import load_vehicle

BAG = Path(__file__).resolve().parents[2] / "bags/double_lane_change"
SECONDS = 2.0


@pytest.mark.slow
@pytest.mark.skipif(codegen.compiler() is None, reason="no C compiler here")
def test_c_and_python_agree_to_rounding_and_no_unit_is_made_without_fmpy(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(side_by_side, "has_unit", lambda: False)
    car = load_vehicle(vehicle_path("prototype_model"))
    built = side_by_side.build(car, tmp_path, "-O0")
    found = side_by_side.compare(car, built, side_by_side.beginning(import_recording(BAG), SECONDS))
    assert found.pairs == [("Python", "C")]
    rms, largest = found.apart(("Python", "C"))
    assert np.all(rms <= largest)
    assert np.all(largest <= 1e-9 * np.maximum(1.0, np.abs(found.values["C"]).max()))
    assert found.steps >= SECONDS / car.observer.longest_step - 1
    assert all(each > 0 for each in found.seconds.values())
    speed = found.values["C"][:, [name for name, _ in found.outputs].index("velocity_x")]
    assert np.ptp(found.values["C"][:, 0]) == pytest.approx(speed.mean() * SECONDS, rel=0.05)  # the car drove east


@pytest.mark.exam
@pytest.mark.skipif(codegen.compiler() is None, reason="no C compiler here")
def test_the_unit_has_the_bits_of_c(tmp_path: Path) -> None:
    pytest.importorskip("fmpy")
    car = load_vehicle(vehicle_path("prototype_model"))
    built = side_by_side.build(car, tmp_path, "-O0")
    found = side_by_side.compare(car, built, side_by_side.beginning(import_recording(BAG), SECONDS))
    assert found.pairs == [("Python", "C"), ("Python", "FMU"), ("C", "FMU")]
    assert not np.any(found.apart(("C", "FMU"))[1])


def test_differences_are_those_of_two_known_series() -> None:
    values = {"a": np.array([[0.0, 1.0], [0.0, 1.0]]), "b": np.array([[3.0, 1.0], [-4.0, np.nan]])}
    rms, largest = side_by_side.SideBySide((), values, {}, 2).apart(("a", "b"))
    assert (rms[0], largest[0]) == (pytest.approx(np.sqrt(12.5)), 4.0)
    assert np.isnan([rms[1], largest[1]]).all()  # a missing number is never taken as agreement


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--filter", "ukf"], "exists in Python alone"),
        (["--filter", "dual_kkf"], "dual_kkf"),
        (["--filter", "magic"], "no filter 'magic'"),
        (["--seconds", "-1"], "seconds"),
    ],
)
def test_what_cannot_be_compared_is_refused_in_a_sentence(arguments: list[str], words: str) -> None:
    result = CliRunner().invoke(main, ["export", "compare", str(BAG), "--vehicle", "prototype_model", *arguments])
    assert result.exit_code == 2
    assert words in result.output
