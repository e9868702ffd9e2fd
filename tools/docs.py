"""Pages and schemas of docs/ that are made from code: `python tools/docs.py` writes them anew."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Callable
from importlib.util import find_spec
from pathlib import Path

import architecture
import mappings_page

from vsense_ros.files import schema
from vsense_ros.mismatch import answer_schema

DOCS = Path(__file__).parents[1] / "docs"


def explain_schema() -> str:
    """The JSON schema of explain.json."""
    return json.dumps(answer_schema.json_schema(), indent=1, ensure_ascii=False) + "\n"


def nodes() -> str:
    """The page about the parameters of the ROS nodes."""
    from vsense_ros.node import document  # needs ROS

    return document.page()


PAGES: dict[str, Callable[[], str]] = {
    "architecture.md": architecture.page,
    "architecture.svg": architecture.picture,
    "explain.schema.json": explain_schema,
    "nodes.md": nodes,
    "reference/mappings.md": mappings_page.page,
    "vehicle_parameters.md": schema.page,
}


def missing(name: str) -> str:
    """What is not installed here that a page needs; empty if nothing."""
    return "ROS 2 (rclpy)" if name == "nodes.md" and find_spec("rclpy") is None else ""


def main() -> int:
    argparse.ArgumentParser(description=__doc__).parse_args()
    for name, make in PAGES.items():
        if lacking := missing(name):
            print(f"docs/{name} stays as it is: {lacking} is not installed here", file=sys.stderr)
            continue
        text, path = make(), DOCS / name
        if not path.exists() or path.read_text(encoding="utf-8") != text:
            path.write_text(text, encoding="utf-8")
            print(f"docs/{name} has been written anew")
    return 0


if __name__ == "__main__":
    sys.exit(main())
