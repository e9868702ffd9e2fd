"""The stages of the workbench, one file each, in the order in which a newcomer takes them."""

from __future__ import annotations

from vsense_ros.studio.stages import car, check, compare, data, estimate, explain, identify, live
from vsense_ros.studio.stages.stage import Stage

STAGES: tuple[Stage, ...] = (
    car.STAGE, data.STAGE, check.STAGE, estimate.STAGE, identify.STAGE, explain.STAGE, compare.STAGE, live.STAGE,
)  # fmt: skip
__all__ = ["STAGES", "Stage"]
