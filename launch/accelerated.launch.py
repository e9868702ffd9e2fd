"""An observer that has an accelerator compute its kernels: ros2 launch vsense_ros accelerated.launch.py vehicle:=….

With `bag` a replay drives both. The drivers of a car are those of vehicle.launch.py.
"""

from typing import Any

from launch import LaunchDescription

from vsense_ros.node.launching import Given, description, node

ARGUMENTS = {
    "vehicle": (None, "vehicle file, or the name of one in config/vehicles"),
    "backend": ("mock", "of the accelerator: mock, rtl (needs Verilator), off"),
    "kernels": ("solve14", "that it computes, with commas: solve14, suspension_motion, body_mass"),
    "faults": ("", "put in on purpose, such as 'drop: 0.01'"),
    "bag": ("", "bag to replay; empty: live sensors"),
    "rate": ("1.0", "of the replay, times real time; 0: as fast as possible"),
    "record": ("", "folder to record everything into; empty: nothing is recorded"),
}


def actions(given: Given) -> list[Any]:
    """Accelerator and observer, and a replay and a recorder if wanted."""
    simulated = bool(given.text("bag"))
    made = [
        *node(
            given,
            "accelerator",
            simulated=simulated,
            backend=given.text("backend"),
            faults=given.text("faults"),
        ),
        *node(
            given,
            "observer",
            simulated=simulated,
            vehicle=given.text("vehicle"),
            accelerator="topics",
            accelerator_kernels=[name.strip() for name in given.text("kernels").split(",")],
            frame_prefix=given.text("frame_prefix"),
        ),
    ]
    if given.text("record"):
        made += node(given, "recorder", simulated=simulated, bag=given.text("record"))
    if simulated:
        made += node(given, "replay", simulated=True, bag=given.text("bag"), rate=given.number("rate"))
    return made


def generate_launch_description() -> LaunchDescription:
    """For `ros2 launch`."""
    return description(ARGUMENTS, actions)
