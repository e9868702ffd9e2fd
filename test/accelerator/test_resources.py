"""Resources on the thesis's device, as recorded and as Yosys counts them now."""

from __future__ import annotations

import runpy
import shutil
from pathlib import Path

import pytest

from vsense_ros.accelerator.kernels import KERNELS
from vsense_ros.accelerator.kernels.row_combiner import RowCombiner
from vsense_ros.assess.partition import recorded_resources

ROOT = Path(__file__).parents[2]


def test_every_variant_of_every_kernel_has_its_resources_on_record_with_the_clocks_that_it_takes() -> None:
    known = recorded_resources()
    wanted = {f"{k.name}/{v}": k.cycles(**p) for k in KERNELS.values() for v, p in k.variants.items()}
    programmed = {f"{RowCombiner.name}/{variant}" for variant in RowCombiner.variants}  # whose clocks are a program's
    assert programmed < known.keys()
    assert {name: entry["cycles"] for name, entry in known.items() if name not in programmed} == wanted


@pytest.mark.exam
@pytest.mark.skipif(shutil.which("yosys") is None, reason="needs yosys: make hw-tools")
def test_the_smallest_variant_has_the_resources_on_record() -> None:
    kernel = KERNELS["body_mass"]
    found = runpy.run_path(str(ROOT / "hw" / "synthesise.py"))["xc7"](kernel.top, kernel.variants["serial"])
    expected = recorded_resources()["body_mass/serial"]
    assert (found["dsp"], found["bram"]) == (expected["dsp"], expected["bram"])
    for name in ("lut", "ff"):  # which differ a little from one release of Yosys to the next
        assert found[name] == pytest.approx(expected[name], rel=0.1)


def test_the_table_of_resources_in_the_readme_is_what_was_recorded() -> None:
    known, listed = recorded_resources(), set()
    for line in (ROOT / "hw" / "README.md").read_text(encoding="utf-8").splitlines():
        cells = [cell.strip("*† ") for cell in line.strip("|").split("|")]
        if len(cells) == 8 and (name := f"{cells[0]}/{cells[1]}") in known:
            shown = [int(cell.replace(",", "")) for cell in cells[4:]]
            assert shown == [known[name][kind] for kind in ("dsp", "lut", "ff", "bram")], name
            listed.add(name)
    assert listed == known.keys()
