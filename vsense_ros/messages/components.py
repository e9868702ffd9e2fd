"""The numbers that messages carry, one by one, each with a name and its unit.

`FIELDS` of `recording` says which fields a message type has; here stands what their components are called and measured
in. Covariances are left out: they are matrices, which no table of signals holds.
"""

from __future__ import annotations

from collections.abc import Mapping
from types import MappingProxyType

from vsense_ros.messages.table import Array, Column

_XYZ = ("x", "y", "z")
_QUATERNION = ("x", "y", "z", "w")

# Names and unit of the components of a field, by message type. A field that is not listed is not a signal.
_COMPONENTS: Mapping[str, Mapping[str, tuple[tuple[str, ...], str]]] = MappingProxyType(
    {
        "sensor_msgs/msg/Imu": {
            "orientation": (_QUATERNION, "1"),
            "angular_velocity": (_XYZ, "rad/s"),
            "linear_acceleration": (_XYZ, "m/s²"),
        },
        "sensor_msgs/msg/NavSatFix": {
            "status": (("",), "1"),
            "latitude": (("",), "deg"),
            "longitude": (("",), "deg"),
            "altitude": (("",), "m"),
        },
        "geometry_msgs/msg/TwistWithCovarianceStamped": {"linear": (_XYZ, "m/s"), "angular": (_XYZ, "rad/s")},
        "geometry_msgs/msg/TwistStamped": {"linear": (_XYZ, "m/s"), "angular": (_XYZ, "rad/s")},
        "geometry_msgs/msg/AccelStamped": {"linear": (_XYZ, "m/s²"), "angular": (_XYZ, "rad/s²")},
        "geometry_msgs/msg/AccelWithCovarianceStamped": {"linear": (_XYZ, "m/s²"), "angular": (_XYZ, "rad/s²")},
        "geometry_msgs/msg/Vector3Stamped": {"vector": (_XYZ, "")},
        "geometry_msgs/msg/WrenchStamped": {"force": (_XYZ, "N"), "torque": (_XYZ, "N m")},
        "nav_msgs/msg/Odometry": {
            "position": (_XYZ, "m"),
            "orientation": (_QUATERNION, "1"),
            "linear": (_XYZ, "m/s"),
            "angular": (_XYZ, "rad/s"),
        },
    }
)
# Vectors whose three numbers are no directions: their names and units, by the end of the topic.
_VECTORS: Mapping[str, tuple[tuple[str, str], ...]] = MappingProxyType(
    {
        "vsense/sideslip": (("angle", "rad"), ("angle_sigma", "rad"), ("rate", "rad/s")),
        "vsense/road": (("grade", "rad"), ("bank", "rad"), ("curvature", "1/m")),
        "vsense/wheel_slip": (("longitudinal", "1"), ("angle", "rad"), ("inclination", "rad")),
    }
)
_JOINTS: Mapping[str, str] = MappingProxyType({"position": "rad", "velocity": "rad/s", "effort": "N m"})
_PARAMETERS = "vsense/parameters"  # a JointState with values as positions, standard deviations as velocities


def columns_of(topic: str, kind: str, names: tuple[str, ...], fields: Mapping[str, Array]) -> tuple[Column, ...]:
    """The signals in messages of a topic: `topic/field.component`, each (rows,) with its unit; "" for one not known.

    `kind` is the message type, `names` are the joints of a JointState, `fields` (rows, length) as in a `Channel`.
    Components that are absent in all messages (NaN) are left out.
    """
    is_joints = kind == "sensor_msgs/msg/JointState"
    columns = _joints(topic, names, fields) if is_joints else _components(topic, kind, fields)
    return tuple(column for column in columns if not column.is_absent)


def _components(topic: str, kind: str, fields: Mapping[str, Array]) -> list[Column]:
    vector = next((named for ending, named in _VECTORS.items() if _ends(topic, ending)), None)
    if vector is not None:
        parts = zip(vector, fields["vector"].T, strict=True)
        return [Column(f"{topic}/{name}", unit, value) for (name, unit), value in parts]
    columns = []
    for field, (axes, unit) in _COMPONENTS[kind].items():
        if field in fields:
            for axis, value in zip(axes, fields[field].T, strict=True):
                columns.append(Column(f"{topic}/{field}{'.' if axis else ''}{axis}", unit, value))
    return columns


def _joints(topic: str, names: tuple[str, ...], fields: Mapping[str, Array]) -> list[Column]:
    columns = []
    are_parameters = _ends(topic, _PARAMETERS)
    for field, unit in _JOINTS.items():
        values = fields.get(field)
        if values is None or values.shape[1] != len(names):
            continue
        for name, value in zip(names, values.T, strict=True):
            if are_parameters:
                columns.append(Column(f"{topic}/{name}{'_sigma' if field == 'velocity' else ''}", "", value))
            else:
                columns.append(Column(f"{topic}/{field}.{name}", _unit_of_joint(topic, field, unit), value))
    return columns


def _unit_of_joint(topic: str, field: str, unit: str) -> str:
    """Suspensions are measured in metres, brakes by their pressure."""
    if field == "position" and _ends(topic, "vehicle/suspension"):
        return "m"
    return "Pa" if field == "effort" and _ends(topic, "vehicle/brake_pressure") else unit


def _ends(topic: str, name: str) -> bool:
    """True if a topic is the one of this relative name, in whatever namespace, or a part of it."""
    return f"/{name}/" in f"/{topic.strip('/')}/"
