"""A pytest plugin: of the cases of each test function only the first is run."""

from __future__ import annotations

import pytest


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    seen: set[str] = set()
    further = []
    for item in list(items):
        function = item.nodeid.partition("[")[0]
        if function in seen:
            items.remove(item)
            further.append(item)
        seen.add(function)
    config.hook.pytest_deselected(items=further)
