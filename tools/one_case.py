"""A pytest plugin: of the cases of each test function below the folders of `--one-case` only the first is run."""

from __future__ import annotations

from pathlib import Path

import pytest


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption("--one-case", action="append", type=Path, default=[], help="folder of tests; repeatable")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    folders = [folder.resolve() for folder in config.getoption("--one-case")]
    seen: set[str] = set()
    kept, further = [], []
    for item in items:
        function = item.nodeid.partition("[")[0]
        is_one_of_many = function in seen and any(folder in item.path.parents for folder in folders)
        (further if is_one_of_many else kept).append(item)
        seen.add(function)
    items[:] = kept
    config.hook.pytest_deselected(items=further)
