"""Figures of tables in docs/ are those that the commands print which they name: `python tools/printed.py`."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
sys.path.insert(0, str(ROOT / "tools"))

from printed import KINDS, PAGES, Figures, every, missing, run

TABLES = [table for page in PAGES for table in every(page)]
PRINTED = """
row         RMSE [m]   of it     thesis
DO15   3.461 ± 0.2  0.0034 (12.6)
DO25       12.04    1.2e-05
"""


def table(kind: str, *rows: str) -> Figures:
    return Figures(Path("page.md"), 1, kind, "command", rows)


@pytest.mark.parametrize("each", TABLES, ids=str)
def test_a_table_with_figures_says_what_prints_it(each: Figures) -> None:
    assert each.kind in KINDS, "put a comment before it that names the command (tools/printed.py)"


def test_rows_may_leave_columns_out_and_round_what_is_printed() -> None:
    printed = table(KINDS[0], "`DO15`  3.46 ± 0.2  12.6", "DO25  12.04  1.2e-5", "a line without figures")
    assert missing(printed, PRINTED) == []


@pytest.mark.parametrize("row", ["DO15  3.47", "DO25  12.6", "DO15  12.6  3.46", "DO35  12.04"])
def test_a_row_with_a_figure_of_another_row_or_order_or_size_is_named(row: str) -> None:
    assert missing(table(KINDS[0], row), PRINTED) == [row]


def test_figures_in_sentences_are_looked_for_one_by_one() -> None:
    assert missing(table(KINDS[1], "4.6  3.5 m beside 12.0 m, and 0.004 in bends"), PRINTED) == ["0.004"]


def test_times_of_computing_are_not_compared(tmp_path: Path) -> None:
    page = tmp_path / "page.md"
    page.write_text(
        "<!-- printed by: command -->\n\n| case | error | time [µs] |\n|---|---|---|\n| DO15 | 3.5 | 70 |\n\n"
        "```\nDO25  12.04  181 µs\n```\n\n```yaml\nmass: 3.2\n```\n",
        encoding="utf-8",
    )
    of_table, of_block = every(page)
    assert (of_table.origin, of_block.origin) == ("command", "")
    assert missing(of_table, PRINTED) == missing(of_block, PRINTED) == []


@pytest.mark.exam
@pytest.mark.parametrize("each", [one for one in TABLES if one.kind in KINDS[:2]], ids=str)
def test_a_page_has_the_figures_that_its_command_prints(each: Figures) -> None:
    assert missing(each, run(each.origin)) == []
