"""What the workers of the workbench do, one file for each stage: plain functions of options that give JSON.

A task takes its options, a folder for what it writes, and a function that is called with the share done. It raises
`InputError` where the input cannot be used.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from vsense_ros.studio.tasks.check import calibrate, check, observe
from vsense_ros.studio.tasks.data import join, propose, read
from vsense_ros.studio.tasks.estimate import estimate
from vsense_ros.studio.tasks.explain import explain
from vsense_ros.studio.tasks.identify import identify
from vsense_ros.studio.tasks.live import listen

Task = Callable[[dict[str, Any], Path, Callable[[float], None]], dict[str, Any]]

TASKS: Mapping[str, Task] = {
    "read": read,
    "propose": propose,
    "join": join,
    "check": check,
    "calibrate": calibrate,
    "observe": observe,
    "estimate": estimate,
    "identify": identify,
    "explain": explain,
    "listen": listen,
}
