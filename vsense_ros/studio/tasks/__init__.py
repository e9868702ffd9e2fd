"""What the workers of the workbench do, one file for each stage: plain functions of options that give JSON.

A task takes its options, a folder for what it writes, and a function that is called with the share done. It raises
`InputError` where the input cannot be used.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from importlib import import_module
from pathlib import Path
from typing import Any

Task = Callable[[dict[str, Any], Path, Callable[[float], None]], dict[str, Any]]

# The module of each task, in the order in which they are needed: a worker imports one after the other while it waits.
TASKS: Mapping[str, str] = {
    "read": "data",
    "propose": "data",
    "join": "data",
    "estimate": "estimate",
    "check": "check",
    "calibrate": "check",
    "observe": "check",
    "identify": "identify",
    "explain": "explain",
    "listen": "live",
}


def task_of(kind: str) -> Task:
    """The function that does a kind of job."""
    task: Task = getattr(import_module(f"{__name__}.{TASKS[kind]}"), kind)
    return task
