"""The nodes and their parameters as a page: python -m vsense_ros.node.document > docs/nodes.md."""

from __future__ import annotations

from types import ModuleType

from vsense_ros.node import can_driver, gps_driver, imu_driver, observer, parameters, recorder, replay

NODES: tuple[tuple[ModuleType, type[parameters.NodeParameters]], ...] = (
    (can_driver, can_driver.CanDriverParameters),
    (imu_driver, imu_driver.ImuDriverParameters),
    (gps_driver, gps_driver.GpsDriverParameters),
    (observer, observer.ObserverParameters),
    (replay, replay.ReplayParameters),
    (recorder, recorder.RecorderParameters),
)

_INTRODUCTION = """\
# Nodes

Lifecycle nodes: by default each configures and activates itself (`autostart`), and follows the lifecycle services all
the same. `diagnostics` is published once a second. Topics are relative, so that a namespace may stand before them.
Parameters take effect when a node is configured; those marked *live* may change while it is active.

    ros2 run vsense_ros observer --ros-args -p vehicle:=genesis
    ros2 run vsense_ros observer --help

This page is made from the nodes' parameter models by `python -m vsense_ros.node.document`.
"""


def page() -> str:
    """The page in Markdown."""
    parts = [_INTRODUCTION]
    for module, model in NODES:
        name = module.__name__.rpartition(".")[2]
        parts.append(f"\n## {name}\n\n{(module.__doc__ or '').strip()}\n\n{parameters.markdown_table(model)}")
    return "".join(parts)


if __name__ == "__main__":
    print(page(), end="")
