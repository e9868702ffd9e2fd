"""A tyre on a rig does what its file says."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from click.testing import CliRunner

from bench import FOLDER
from vsense_ros.cli import main
from vsense_ros.evaluate.tyre_rig import TyreRig
from vsense_ros.files.tyre import load_tyre
from vsense_ros.model.tyres import Linear

TYRES = sorted(FOLDER.iterdir())


@pytest.fixture(params=TYRES, ids=lambda path: path.stem)
def rig(request: pytest.FixtureRequest) -> TyreRig:
    return TyreRig(load_tyre(request.param))


def test_a_tyre_pushes_against_its_slip_and_is_linear_up_to_a_degree(rig: TyreRig) -> None:
    small = np.radians(0.2)
    left, none, right = rig.settled(np.array([-small, 0.0, small]))
    slope = (left - right) / (2 * small)
    assert slope == pytest.approx(float(rig.tyre.cornering_stiffness_at(rig.load)), rel=0.05)
    assert left > none > right


def test_the_force_builds_up_over_the_relaxation_length() -> None:
    linear = Linear(model="linear", slip_stiffness=1e5, cornering_stiffness=6e4, relaxation_length=0.3)
    rig = TyreRig(linear)
    force = rig.pull(np.radians(-2.0), np.array([0.0, 0.3, 0.6, 100.0]))
    assert force[0] == 0
    assert force / force[-1] == pytest.approx([0, 1 - np.exp(-1), 1 - np.exp(-2), 1])
    assert force[-1] == pytest.approx(6e4 * np.radians(2.0), rel=2e-3)


def test_a_conical_tyre_has_a_force_without_slip(rig: TyreRig) -> None:
    conical = TyreRig(rig.tyre, conicity=0.03)
    assert conical.settled(np.zeros(1)) - rig.settled(np.zeros(1)) == pytest.approx(0.03 * rig.load)


def test_more_pressure_makes_a_tyre_stiffer_at_small_slips(rig: TyreRig) -> None:
    soft, hard = (TyreRig(rig.tyre, pressure=p).settled(np.radians([-0.5]))[0] for p in (18.0, 22.0))
    assert hard > soft


def test_the_rig_is_drawn(tmp_path: Path) -> None:
    result = CliRunner().invoke(main, ["tyres", str(FOLDER / "tmeasy.yaml"), "--rig", "--out", str(tmp_path)])
    assert result.exit_code == 0, result.output
    assert (tmp_path / "tmeasy_rig.png").read_bytes().startswith(b"\x89PNG")
