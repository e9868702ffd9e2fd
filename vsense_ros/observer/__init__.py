"""State observers on multibody models."""

from vsense_ros.observer.estimate import Estimate, estimate_samples
from vsense_ros.observer.observer import Observer
from vsense_ros.observer.run import Run, run

__all__ = ["Estimate", "Observer", "Run", "estimate_samples", "run"]
