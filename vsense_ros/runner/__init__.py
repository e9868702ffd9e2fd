"""One way from messages to estimates for every filter: start, late data, faults, resets, diagnostics, topics."""

from vsense_ros.runner import kinematic, multibody  # which register their adapters
from vsense_ros.runner.run import Run, run
from vsense_ros.runner.runner import Runner

__all__ = ["Run", "Runner", "kinematic", "multibody", "run"]
