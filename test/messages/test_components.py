"""Names and units of what messages carry, and tables of them, also as other libraries have them."""

from __future__ import annotations

import numpy as np
import pytest

from vsense_ros.bag.importers import build
from vsense_ros.messages.components import columns_of
from vsense_ros.messages.recording import FIELDS, Channel, Recording
from vsense_ros.messages.table import Column, Table, merged
from vsense_ros.messages.topics import TOPICS

JOINTS = "sensor_msgs/msg/JointState"
STAMP = build.nanoseconds(np.arange(3) * 0.1, 5)


def channel(topic: str, kind: str, names: tuple[str, ...] = ("a", "b")) -> Channel:
    """Each component has a value of its own: a hundred a field, one a component."""
    columns = {}
    for place, (field, width) in enumerate(FIELDS[kind].items()):
        count = width or len(names)
        columns[field] = np.tile(100.0 * place + np.arange(count), (3, 1))
    return Channel(topic, kind, STAMP, STAMP, columns, names=names)


def headings(topic: str, kind: str, names: tuple[str, ...] = ("a", "b")) -> dict[str, float]:
    found = columns_of(topic, kind, names, channel(topic, kind, names).columns)
    return {column.heading.removeprefix(f"{topic}/"): float(column.value[0]) for column in found}


@pytest.mark.parametrize("kind", [kind for kind in FIELDS if kind != "sensor_msgs/msg/JointState"])
def test_every_number_of_a_message_but_covariances_is_a_signal_with_its_own_values(kind):
    found = headings("t", kind)
    places = {field: place for place, field in enumerate(FIELDS[kind])}
    for heading, value in found.items():
        name = heading.partition(" [")[0]
        field, _, component = name.partition(".")
        assert value == 100 * places[field] + ("xyzw".index(component) if component else 0)
    fields = {heading.partition(" [")[0].partition(".")[0] for heading in found}
    left_out = {f for f in FIELDS[kind] if "covariance" in f or f == "service"}
    assert fields == FIELDS[kind].keys() - left_out


@pytest.mark.parametrize(
    ("topic", "kind", "expected"),
    [
        ("imu/data", "sensor_msgs/msg/Imu", {"angular_velocity.z [rad/s]", "linear_acceleration.x [m/s²]"}),
        ("gps/fix", "sensor_msgs/msg/NavSatFix", {"latitude [deg]", "altitude [m]", "status [1]"}),
        ("f", "geometry_msgs/msg/WrenchStamped", {"force.x [N]", "torque.z [N m]"}),
        ("a", "geometry_msgs/msg/AccelStamped", {"linear.x [m/s²]", "angular.z [rad/s²]"}),
        ("v", "geometry_msgs/msg/Vector3Stamped", {"vector.x"}),
        ("vsense/sideslip", "geometry_msgs/msg/Vector3Stamped", {"angle [rad]", "angle_sigma [rad]", "rate [rad/s]"}),
        ("/car/vsense/sideslip", "geometry_msgs/msg/Vector3Stamped", {"angle [rad]"}),
        ("vsense/wheel_slip/fl", "geometry_msgs/msg/Vector3Stamped", {"longitudinal [1]", "angle [rad]"}),
        ("my_vsense/sideslip", "geometry_msgs/msg/Vector3Stamped", {"vector.x"}),
        ("steering", JOINTS, {"position.a [rad]", "velocity.b [rad/s]", "effort.a [N m]"}),
        ("vehicle/suspension", JOINTS, {"position.a [m]", "velocity.a [rad/s]", "effort.a [N m]"}),
        ("vehicle/brake_pressure", JOINTS, {"effort.a [Pa]", "position.a [rad]"}),
        ("vsense/parameters", JOINTS, {"a", "b", "a_sigma", "b_sigma"}),
    ],
)  # fmt: skip
def test_signals_are_named_with_the_unit_in_which_the_topic_has_them(topic, kind, expected):
    assert expected <= headings(topic, kind).keys()


def test_parameters_have_their_values_and_deviations():
    values = {"position": np.array([[1.0, 2.0]]), "velocity": np.array([[0.1, 0.2]]), "effort": np.zeros((1, 0))}
    found = columns_of("vsense/parameters", JOINTS, ("mass", "grip"), values)
    assert {column.name.rpartition("/")[2]: float(column.value[0]) for column in found} == {
        "mass": 1.0, "grip": 2.0, "mass_sigma": 0.1, "grip_sigma": 0.2,
    }  # fmt: skip


def test_fields_and_joints_that_are_not_there_and_signals_that_are_absent_are_left_out():
    values = {"position": np.array([[1.0, np.nan]] * 3), "velocity": np.zeros((3, 0))}
    found = columns_of("vehicle/steering", "sensor_msgs/msg/JointState", ("a", "b"), values)
    assert [column.name for column in found] == ["vehicle/steering/position.a"]
    some = columns_of("t", "geometry_msgs/msg/TwistStamped", (), {"angular": np.ones((3, 3))})
    assert [column.name for column in some] == ["t/angular.x", "t/angular.y", "t/angular.z"]
    half = np.array([[1.0, np.nan, np.nan], [np.nan, np.nan, 2.0]])
    found = columns_of("t", "geometry_msgs/msg/TwistStamped", (), {"linear": half})
    assert [column.name for column in found] == ["t/linear.x", "t/linear.z"]


def test_every_topic_of_the_project_has_a_type_whose_components_have_names():
    for topic, spec in TOPICS.items():
        assert headings(topic, spec.kind, spec.names or ("a", "b")), topic


def test_a_table_is_in_the_order_of_its_times_and_of_two_rows_of_one_time_the_last_counts():
    table = Table("t", np.array([3, 1, 2, 1]), (Column("a", "m", np.array([30.0, 10.0, 20.0, 11.0])),))
    ordered = table.in_order()
    assert ordered.stamp.tolist() == [1, 2, 3]
    assert ordered.columns[0].value.tolist() == [11.0, 20.0, 30.0]
    assert ordered.in_order() is ordered
    assert (ordered.seconds() * 1e9).tolist() == pytest.approx([0.0, 1.0, 2.0])
    assert (ordered.seconds(start=-1) * 1e9).tolist() == pytest.approx([2.0, 3.0, 4.0])


def test_merged_tables_have_all_times_and_nothing_between_them():
    one = Table("one", np.array([1, 3]), (Column("a", "m", np.array([1.0, 3.0])),))
    other = Table("other", np.array([2, 3]), (Column("b", "", np.array([20.0, 30.0])),))
    both = merged([one, other], "both")
    assert (both.name, both.stamp.tolist()) == ("both", [1, 2, 3])
    np.testing.assert_array_equal([column.value for column in both.columns], [[1, np.nan, 3], [np.nan, 20, 30]])
    assert [column.heading for column in both.columns] == ["a [m]", "b"]
    assert merged([one]) is one
    assert len(merged([])) == 0
    assert merged([]).seconds().tolist() == []


def test_frames_of_other_libraries_have_the_same_numbers():
    for library in ("pandas", "polars", "xarray"):
        pytest.importorskip(library)
    fix = build.fix(STAMP, np.array([48.0, np.nan, 48.2]), np.arange(3.0), np.arange(3.0))
    recording = Recording({"gps/fix": fix})
    pandas, polars, xarray = recording.to_pandas(), recording.to_polars(), recording.to_xarray()
    np.testing.assert_array_equal(pandas["gps/fix/latitude [deg]"], [48.0, np.nan, 48.2])
    assert pandas.attrs["start_ns"] == 5
    assert pandas.index.tolist() == pytest.approx([0.0, 0.1, 0.2])
    assert polars["stamp [ns]"].to_list() == STAMP.tolist()
    assert polars["gps/fix/latitude [deg]"].to_list() == [48.0, None, 48.2]
    np.testing.assert_array_equal(xarray["gps/fix/latitude"], [48.0, np.nan, 48.2])
    assert xarray["gps/fix/latitude"].attrs["units"] == "deg"
    assert xarray.attrs["start_ns"] == 5
    empty = Recording({})
    assert len(empty.to_pandas()) == 0
    assert empty.to_xarray().attrs["start_ns"] == 0
