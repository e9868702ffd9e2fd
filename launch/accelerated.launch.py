"""An observer that has an accelerator solve its systems: ros2 launch vsense_ros accelerated.launch.py vehicle:=….

With `bag` a replay drives both. The drivers of a car are those of vehicle.launch.py.
"""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration, PythonExpression
from launch_ros.actions import LifecycleNode
from launch_ros.parameter_descriptions import ParameterValue

ARGUMENTS = {
    "vehicle": (None, "vehicle file, or the name of one in config/vehicles"),
    "backend": ("mock", "of the accelerator: mock, rtl (needs Verilator), off"),
    "faults": ("", "put in on purpose, such as 'drop: 0.01'"),
    "bag": ("", "bag to replay; empty: live sensors"),
    "rate": ("1.0", "of the replay, times real time; 0: as fast as possible"),
    "record": ("", "folder to record everything into; empty: nothing is recorded"),
    "namespace": ("", "namespace of nodes and topics"),
}


def argument(name: str) -> LaunchConfiguration:
    """The value of a launch argument."""
    return LaunchConfiguration(name)


def value(name: str, kind: type) -> ParameterValue:
    """A launch argument as a parameter of a type."""
    return ParameterValue(argument(name), value_type=kind)


def node(name: str, needs: str | None = None, **parameters: object) -> LifecycleNode:
    """A node of the package that activates itself; with `needs`, only if that argument is not empty."""
    condition = {} if needs is None else {"condition": IfCondition(PythonExpression(["'", argument(needs), "' != ''"]))}
    replayed = ParameterValue(PythonExpression(["'", argument("bag"), "' != ''"]), value_type=bool)
    return LifecycleNode(
        package="vsense_ros",
        executable=name,
        name=name,
        namespace=argument("namespace"),
        parameters=[{**({} if name == "replay" else {"use_sim_time": replayed}), **parameters}],
        remappings=[("diagnostics", "/diagnostics")],
        output="screen",
        **condition,
    )


def generate_launch_description() -> LaunchDescription:
    """Accelerator and observer, and a replay and a recorder if wanted."""
    declared = [
        DeclareLaunchArgument(name, description=text, **({} if default is None else {"default_value": default}))
        for name, (default, text) in ARGUMENTS.items()
    ]
    return LaunchDescription(
        [
            *declared,
            node("accelerator", backend=value("backend", str), faults=value("faults", str)),
            node("observer", vehicle=value("vehicle", str), accelerator="topics"),
            node("recorder", needs="record", bag=value("record", str)),
            node("replay", needs="bag", bag=value("bag", str), rate=value("rate", float)),
        ]
    )
