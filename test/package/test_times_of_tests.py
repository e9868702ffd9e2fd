"""The table of the slowest tests is made of the reports of all runs."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path
from types import ModuleType

import pytest

ROOT = Path(__file__).parents[2]
REPORT = """<testsuites><testsuite>
<testcase classname="test.bag.test_mcap" name="test_a[x|y]" time="{0}"/>
<testcase classname="test.accelerator.test_registers.TestSimulated" name="test_b" time="{1}"/>
<testcase classname="test.test_cli" name="test_c" time="9.0"><skipped/></testcase>
</testsuite></testsuites>"""


@pytest.fixture(scope="module")
def times() -> ModuleType:
    sys.path.insert(0, str(ROOT / "tools"))
    return importlib.import_module("test_times")


def test_tests_of_all_reports_stand_with_their_files_the_slowest_first(times: ModuleType, tmp_path: Path) -> None:
    for name, seconds in (("one", (1.0, 4.0)), ("two", (3.0, 2.0))):
        (tmp_path / f"{name}.xml").write_text(REPORT.format(*seconds))
    slowest = times.durations(sorted(tmp_path.glob("*.xml")))
    assert [seconds for seconds, _ in slowest] == [4.0, 3.0, 2.0, 1.0]
    assert slowest[0][1] == "test/accelerator/test_registers.py::TestSimulated::test_b"
    assert slowest[1][1] == "test/bag/test_mcap.py::test_a[x|y]"


def test_the_table_is_put_between_its_marks_and_can_be_put_there_again(times: ModuleType) -> None:
    page = f"before\n{times.BEGIN}{times.END}\nafter\n"
    written = times.with_table(page, {"tests": 2, "minutes": 9.5, "slowest": [[1.0, "test/a.py::test_a[x|y]"]]})
    assert "| 1.0 | `test/a.py::test_a[x\\|y]` |" in written
    assert written.startswith("before\n")
    assert written.endswith("\nafter\n")
    assert times.with_table(written, {"tests": 2, "minutes": 9.5, "slowest": []}).count("seconds") == 1
