"""What a command and a node load at their start: everybody waits for it."""

from __future__ import annotations

import subprocess
import sys

LATER = {"scipy.interpolate", "scipy.ndimage", "scipy.optimize", "scipy.signal", "scipy.stats", "matplotlib", "pandas"}
PROGRAM = """
import sys, vsense_ros.api.estimation, vsense_ros.identification.online
print(*sys.modules)
"""


def test_an_estimate_begins_without_what_only_identification_simulation_and_pictures_need() -> None:
    printed = subprocess.run([sys.executable, "-c", PROGRAM], check=True, capture_output=True, text=True).stdout
    assert LATER.isdisjoint(printed.split())
