"""What the launch files share: their arguments, and nodes that end a launch when they refuse their input.

Imports nothing of the package, as `ros2 launch` may run without the environment that the nodes run in.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from typing import Any

from launch import LaunchContext, LaunchDescription
from launch.actions import DeclareLaunchArgument, OpaqueFunction, RegisterEventHandler, SetEnvironmentVariable
from launch.event_handlers import OnProcessExit
from launch_ros.actions import LifecycleNode
from launch_ros.parameter_descriptions import ParameterValue

from vsense_ros.node.discovery import PROFILES, RANGE, on_this_machine

BAD_INPUT = 2  # exit code of a node that refuses its parameters or files


Arguments = Mapping[str, tuple[str | None, str]]  # name → default (None: has to be given), description

COMMON: Arguments = {
    "namespace": ("", "of nodes and topics, such as car1; several cars in one domain each have their own"),
    "frame_prefix": ("", "before every frame, such as car1/"),
    "params_file": ("", "parameters of the nodes (YAML of ROS 2); what is given here besides takes precedence"),
    "autostart": ("true", "nodes configure and activate themselves; false: a lifecycle manager does it"),
    "log_level": ("info", "debug, info, warn, error or fatal"),
    "priority": ("0", "of the nodes among real-time processes (SCHED_FIFO), 1 to 99; 0: none"),
    "lock_memory": ("false", "keep the memory of the nodes from being paged out"),
    "affinity": ("", "processors on which the nodes may run, such as 2,3; empty: all"),
    "discovery": ("", "LOCALHOST, SUBNET or OFF: who is looked for; empty: as the environment says, else LOCALHOST"),
}


class Given:
    """The values of the launch arguments."""

    def __init__(self, values: Mapping[str, str]) -> None:
        self._values = values

    def text(self, name: str) -> str:
        return self._values[name]

    def flag(self, name: str) -> bool:
        return self._value(name, {"true": True, "1": True, "false": False, "0": False}.__getitem__, "true or false")

    def number(self, name: str) -> float:
        return self._value(name, float, "a number")

    def integer(self, name: str) -> int:
        return self._value(name, int, "a whole number")

    def numbers(self, name: str) -> list[float]:
        """Numbers of a list with commas between; empty for an empty text."""
        return self._value(name, lambda text: [float(part) for part in text.split(",")] if text else [], "numbers a,b")

    def _value(self, name: str, read: Callable[[str], Any], expected: str) -> Any:
        text = self._values[name].strip()
        try:
            return read(text.lower())
        except (KeyError, ValueError):
            raise RuntimeError(f"{name}:={text}: expected {expected}") from None


def node(given: Given, name: str, *, respawn: bool = False, simulated: bool = False, **parameters: Any) -> list[Any]:
    """A node of the package, and what happens when it ends; parameters that are empty or None are left to the file of
    parameters and to the defaults."""
    prefix = []
    if given.text("affinity"):
        prefix += ["taskset", "--cpu-list", given.text("affinity")]
    if given.integer("priority"):
        prefix += ["chrt", "--fifo", str(given.integer("priority"))]
    chosen: dict[str, Any] = {
        # A text stays one, also where it reads like a number.
        key: ParameterValue(value, value_type=str) if isinstance(value, str) else value
        for key, value in parameters.items()
        if value not in (None, "", [])
    }
    chosen |= {"autostart": given.flag("autostart")}
    if given.flag("lock_memory"):
        chosen |= {"lock_memory": True}
    if name != "replay":
        chosen |= {"use_sim_time": simulated}
    files = [given.text("params_file")] if given.text("params_file") else []
    remapped = [("diagnostics", "/diagnostics")]
    if simulated and given.text("namespace"):
        remapped.append(("/clock", "clock"))  # each car's own
    options: dict[str, Any] = {"respawn": True, "respawn_delay": 2.0} if respawn else {}
    process = LifecycleNode(
        package="vsense_ros",
        executable=name,
        name=name,
        namespace=given.text("namespace"),
        output="screen",
        parameters=[*files, chosen],
        remappings=remapped,
        ros_arguments=["--log-level", given.text("log_level")],
        prefix=" ".join(prefix),
        additional_env={"VSENSE_ENDS_WITH": str(os.getpid())},
        **options,
    )

    def ended(event: Any, context: LaunchContext) -> None:
        """Raise what makes `ros2 launch` say a sentence, stop all, and end with an exit code."""
        if event.returncode == 0 or (context.is_shutdown and event.returncode < 0):
            return
        if respawn and event.returncode != BAD_INPUT:
            return
        what = "refused its parameters or files" if event.returncode == BAD_INPUT else "failed"
        raise RuntimeError(f"{name} {what} (exit code {event.returncode}); its last lines above say why")

    return [process, RegisterEventHandler(OnProcessExit(target_action=process, on_exit=ended))]


def description(arguments: Arguments, actions: Callable[[Given], list[Any]]) -> LaunchDescription:
    """A launch description with these arguments and the common ones, and the actions that follow from their values."""
    every = {**arguments, **COMMON}
    declared = [
        DeclareLaunchArgument(name, description=text, **({} if default is None else {"default_value": default}))
        for name, (default, text) in every.items()
    ]

    def made(context: LaunchContext) -> list[Any]:
        given = Given({name: context.launch_configurations[name] for name in every})
        reach = given.text("discovery") or os.environ.get(RANGE, "LOCALHOST")
        environment = {RANGE: reach}
        if reach == "LOCALHOST" and not any(name in os.environ for name in PROFILES):
            environment = on_this_machine()
        return [*(SetEnvironmentVariable(name, value) for name, value in environment.items()), *actions(given)]

    return LaunchDescription([*declared, OpaqueFunction(function=made)])
