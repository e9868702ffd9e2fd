"""The drivers of a car and its observer: ros2 launch vsense_ros vehicle.launch.py vehicle:=rav4 dbc:=…."""

from launch import LaunchDescription
from launch.actions import DeclareLaunchArgument
from launch.conditions import IfCondition
from launch.substitutions import LaunchConfiguration, PythonExpression
from launch_ros.actions import LifecycleNode
from launch_ros.parameter_descriptions import ParameterValue

ARGUMENTS = {
    "vehicle": (None, "vehicle file, or the name of one in config/vehicles"),
    "monitor": ("", "limits that vsense monitor --calibrate wrote; empty: the fit of the model is not judged"),
    "can_interface": ("socketcan", "python-can interface: socketcan, udp_multicast, slcan"),
    "can_channel": ("can0", "of the interface"),
    "dbc": ("", "CAN database; empty: no CAN driver"),
    "can_mapping": ("", "which signals become which topics (config/can)"),
    "imu_port": ("", "serial port of an Xsens IMU, or socket://host:port; empty: no IMU driver"),
    "imu_mounting": ("x,y,z", "which sensor axis points forward, left and up"),
    "gnss_port": ("", "serial port of the GNSS receiver, or socket://host:port; empty: no GNSS driver"),
    "gnss_protocol": ("nmea", "nmea or ubx"),
    "gnss_baud_rate": ("115200", "of the serial port"),
    "record": ("", "folder to record everything into; empty: nothing is recorded"),
    "namespace": ("", "namespace of nodes and topics"),
}


def node(name: str, needs: str | None = None, **parameters: object) -> LifecycleNode:
    """A node of the package that activates itself; with `needs`, only if that argument is not empty."""
    condition = {} if needs is None else {"condition": IfCondition(PythonExpression(["'", argument(needs), "' != ''"]))}
    return LifecycleNode(
        package="vsense_ros",
        executable=name,
        name=name,
        namespace=LaunchConfiguration("namespace"),
        output="screen",
        parameters=[parameters],
        respawn=True,
        respawn_delay=2.0,
        **condition,
    )


def argument(name: str) -> LaunchConfiguration:
    """The value of a launch argument."""
    return LaunchConfiguration(name)


def value(name: str, kind: type) -> ParameterValue:
    """A launch argument as a parameter of a type."""
    return ParameterValue(argument(name), value_type=kind)


def generate_launch_description() -> LaunchDescription:
    """Those drivers whose arguments are given, the observer, and a recorder if wanted."""
    declared = [
        DeclareLaunchArgument(name, description=text, **({} if default is None else {"default_value": default}))
        for name, (default, text) in ARGUMENTS.items()
    ]
    return LaunchDescription(
        [
            *declared,
            node(
                "can_driver",
                needs="dbc",
                interface=value("can_interface", str),
                channel=value("can_channel", str),
                database=value("dbc", str),
                mapping=value("can_mapping", str),
            ),
            node("imu_driver", needs="imu_port", port=value("imu_port", str), mounting=value("imu_mounting", str)),
            node(
                "gps_driver",
                needs="gnss_port",
                port=value("gnss_port", str),
                protocol=value("gnss_protocol", str),
                baud_rate=value("gnss_baud_rate", int),
            ),
            node("observer", vehicle=value("vehicle", str), monitor=value("monitor", str)),
            node("recorder", needs="record", bag=value("record", str)),
        ]
    )
