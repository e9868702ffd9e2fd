"""State observers on multibody models."""

from vsense_ros.observer.estimate import Estimate, estimate_samples

__all__ = ["Estimate", "estimate_samples"]
