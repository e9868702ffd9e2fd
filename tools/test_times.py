"""How long the tests took: python tools/test_times.py BEGUN FOLDER, at the end of `make test`.

Reads the reports in JUnit's format that the runs of pytest left in FOLDER, prints the hundred slowest tests and writes
all that is known to out/test.json: the minutes since BEGUN (seconds since 1970), the number of tests and the slowest.
`python tools/test_times.py --page` puts the table into docs/development.md.
"""

from __future__ import annotations

import json
import re
import sys
import time
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterable
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
TIMES, PAGE = ROOT / "out/test.json", ROOT / "docs/development.md"
SHOWN = 100
BEGIN, END = "<!-- the slowest tests: make test, then make docs -->\n", "<!-- end of the slowest tests -->"


def durations(reports: Iterable[Path]) -> list[tuple[float, str]]:
    """Seconds of each test with its fixtures, and its name as "folder/file.py::test", longest first.

    Skipped tests are not among them.
    """
    cases = [case for path in reports for case in ElementTree.parse(path).iter("testcase")]
    run = [case for case in cases if case.find("skipped") is None]
    return sorted(((float(case.get("time", 0)), _name(case)) for case in run), reverse=True)


def _name(case: ElementTree.Element) -> str:
    """JUnit knows a test by its module, as test.bag.test_mcap, and the classes in it."""
    module, _, rest = case.get("classname", "").partition(".test_")
    file, *classes = rest.split(".")
    return "::".join([f"{module.replace('.', '/')}/test_{file}.py", *classes, case.get("name", "")])


def table(slowest: Iterable[tuple[float, str]]) -> str:
    """The tests as a table in Markdown."""
    rows = [f"| {seconds:.1f} | `{name.replace('|', chr(92) + '|')}` |" for seconds, name in slowest]
    return "\n".join(["| seconds | test |", "|---|---|", *rows]) + "\n"


def with_table(page: str, times: dict[str, Any]) -> str:
    """A page with the table of the slowest tests between its two marks."""
    text = f"{BEGIN}\n{times['tests']:,} tests in {times['minutes']:.1f} minutes, lint and build included:\n\n"
    pattern = re.compile(f"{re.escape(BEGIN)}.*?{re.escape(END)}", re.DOTALL)
    return pattern.sub(lambda _: f"{text}{table(times['slowest'])}\n{END}", page)


def main() -> None:
    if sys.argv[1:] == ["--page"]:
        if not TIMES.is_file():
            print(f"docs/{PAGE.name} stays as it is: {TIMES} is missing, which `make test` writes", file=sys.stderr)
            return
        PAGE.write_text(with_table(PAGE.read_text(encoding="utf-8"), json.loads(TIMES.read_text(encoding="utf-8"))))
        return
    begun, folder = float(sys.argv[1]), Path(sys.argv[2])
    slowest = durations(sorted(folder.glob("*.xml")))
    times = {"minutes": round((time.time() - begun) / 60, 2), "tests": len(slowest), "slowest": slowest[:SHOWN]}
    TIMES.write_text(json.dumps(times, indent=1) + "\n", encoding="utf-8")
    print(f"The {len(times['slowest'])} slowest tests [s]:")
    print("\n".join(f"{seconds:6.1f}  {name}" for seconds, name in times["slowest"]))


if __name__ == "__main__":
    main()
