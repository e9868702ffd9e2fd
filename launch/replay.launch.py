"""A bag through the observer, recorded: ros2 launch vsense_ros replay.launch.py bag:=… vehicle:=genesis."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument, EmitEvent, RegisterEventHandler
from launch.event_handlers import OnProcessExit
from launch.events import Shutdown
from launch.substitutions import LaunchConfiguration
from launch_ros.actions import LifecycleNode
from launch_ros.parameter_descriptions import ParameterValue

ARGUMENTS = {
    "bag": (None, "bag to replay"),
    "vehicle": (None, "vehicle file, or the name of one in config/vehicles"),
    "monitor": ("", "limits that vsense monitor --calibrate wrote; empty: the fit of the model is not judged"),
    "out": ("vsense_output", "folder for the recorded bag"),
    "rate": ("0.0", "times real time; 0: as fast as observer and recorder can"),
    "loop": ("false", "begin again at the end"),
    "start_offset": ("0.0", "[s] where to begin"),
    "namespace": ("", "namespace of nodes and topics"),
}


def node(name: str, **parameters: object) -> LifecycleNode:
    """A node of the package in the time of the replay; it activates itself."""
    return LifecycleNode(
        package="vsense_ros",
        executable=name,
        name=name,
        namespace=LaunchConfiguration("namespace"),
        output="screen",
        parameters=[{"use_sim_time": name != "replay", **parameters}],
    )


def value(name: str, kind: type) -> ParameterValue:
    """A launch argument as a parameter of a type."""
    return ParameterValue(LaunchConfiguration(name), value_type=kind)


def generate_launch_description() -> LaunchDescription:
    """Observer and recorder, then the replay, whose end is the end of all."""
    declared = [
        DeclareLaunchArgument(name, description=text, **({} if default is None else {"default_value": default}))
        for name, (default, text) in ARGUMENTS.items()
    ]
    replay = node(
        "replay",
        bag=value("bag", str),
        rate=value("rate", float),
        loop=value("loop", bool),
        start_offset=value("start_offset", float),
        consumers=2,
        wait=60.0,
    )
    return LaunchDescription(
        [
            *declared,
            node("observer", vehicle=value("vehicle", str), monitor=value("monitor", str), publish_all=True),
            node("recorder", bag=value("out", str), overwrite=True),
            replay,
            RegisterEventHandler(OnProcessExit(target_action=replay, on_exit=[EmitEvent(event=Shutdown())])),
        ]
    )
