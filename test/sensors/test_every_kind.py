"""What holds for every kind of sensor, new ones included."""

from __future__ import annotations

from pathlib import Path

import casadi as ca
import numpy as np
import pytest
from numpy.testing import assert_allclose

from vsense_ros.estimation.reading import Map, Reader
from vsense_ros.messages.recording import FIELDS, Channel
from vsense_ros.messages.topics import INPUTS as TOPICS
from vsense_ros.model import sensors
from vsense_ros.model.coordinates import INPUTS
from vsense_ros.model.motion import Motion
from vsense_ros.model.sensors import KINDS, GnssAttitude, SensorBase, Steering, WheelSpeeds, compared_signals
from vsense_ros.model.sensors.base import Names, Values, Vector
from vsense_ros.model.sensors.simulated import SimulatedDrive

ORIGIN = (43.5, -8.2, 50.0)
KNOWN = [pytest.param(kind(ratio=16.0) if kind is Steering else kind(), id=name) for name, kind in KINDS.items()]
SIMULATED = [found for found in KNOWN if found.values[0].sampling is not None]
MEASURING = [found for found in KNOWN if not found.values[0].is_input]


def test_each_file_of_the_folder_is_a_kind_but_for_what_they_share():
    files = {path.stem for path in Path(sensors.__file__).parent.glob("*.py")}
    assert set(KINDS) == files - {"__init__", "base", "gnss", "simulated"}


def test_kinds_are_listed_by_their_places():
    places = [kind.place for kind in KINDS.values()]
    assert places == sorted(places)


@pytest.mark.parametrize("sensor", KNOWN)
def test_a_kind_tells_what_it_is(sensor: SensorBase):
    topic = TOPICS[sensor.topic]
    assert (sensor.message, sensor.frame_id) == (topic.kind, topic.frame_id)
    assert sensor.joints == topic.names
    assert sensor.words
    assert len(sensor.components) in (0, len(sensor.deviations()))
    assert sensor.measures or sensor.signals


def test_signals_of_all_kinds_have_names_of_their_own():
    assert len(compared_signals()) == sum(len(kind.signals) for kind in KINDS.values())


def test_no_two_kinds_drive_the_same_input():
    inputs = [i for kind in KINDS.values() if kind.inputs is not None for i in range(len(INPUTS))[kind.inputs]]
    assert sorted(inputs) == list(range(len(INPUTS)))


@pytest.mark.parametrize("strange", [(), (np.nan,), (np.nan, -1.0, 2e7, 0.0)], ids=["clean", "absent", "strange"])
@pytest.mark.parametrize("varying", [False, True], ids=["constant", "varying"])
@pytest.mark.parametrize("sensor", KNOWN)
def test_a_channel_read_in_blocks_is_what_its_messages_are_one_by_one(
    sensor: SensorBase, varying: bool, strange: tuple[float, ...]
):
    """Covariances that change, and numbers that are none, in a tenth of all fields."""
    random, count = np.random.default_rng(3), 200
    names = sensor.joints or ("steering_wheel",)
    columns = {}
    for field, length in FIELDS[sensor.message].items():
        fixed = "covariance" in field and not varying
        column = random.uniform(0.1, 0.3, (1 if fixed else count, length or len(names)))
        column = np.repeat(column, count, axis=0) if fixed else column
        if strange and not fixed:
            column = np.where(random.random(column.shape) < 0.1, random.choice(strange, column.shape), column)
        columns[field] = column
    stamps = np.arange(count) * 10_000_000
    channel = Channel("topic", sensor.message, stamps, stamps, columns, sensor.frame_id, names)
    one_by_one, in_blocks, in_arrays = (Reader(0, sensor, Map(ORIGIN)) for _ in range(3))
    expected = [one_by_one.read(sample) for sample in channel]
    found = list(in_blocks.read_channel(channel))
    assert [repr(one) for one in found] == [repr(one) for one in expected]
    events = [one for one in expected if not isinstance(one, str)]
    assert events
    measured = in_arrays.measurements(channel)
    assert measured.stamp.tolist() == [event.stamp for event in events]
    np.testing.assert_array_equal(measured.value, [event.value for event in events])
    np.testing.assert_array_equal(measured.variance, [event.variance for event in events])
    assert measured.why == next((one for one in expected if isinstance(one, str)), "")


class _Mean(WheelSpeeds):
    """A kind that takes one message at a time: all wheels have the mean of those that are there."""

    def read(self, names: Names, values: Values, out: Vector, variance: Vector) -> None:
        out[:] = np.mean(values["velocity"])


def test_a_kind_that_reads_its_messages_otherwise_does_so_in_blocks_too():
    stamps, speeds = np.arange(3) * 10_000_000, np.arange(12.0).reshape(3, 4)
    sensor = _Mean()
    channel = Channel("topic", sensor.message, stamps, stamps, {"velocity": speeds}, "", sensor.joints)
    found = [event.value for event in Reader(0, sensor, Map(ORIGIN)).read_channel(channel)]
    assert_allclose(found, np.repeat(speeds.mean(axis=1)[:, None], 4, axis=1))


@pytest.mark.parametrize("sensor", MEASURING)
def test_an_equation_needs_no_more_than_a_motion_and_has_as_many_components_as_deviations(sensor: SensorBase):
    """A car at rest at the origin is what a motion is without further words."""
    biases, mounting = ca.SX.zeros(len(sensor.biases())), ca.SX(sensor.mounting())
    found = sensor.equation(Motion(), biases, mounting)
    assert found.shape == (len(sensor.deviations()), 1)
    assert np.isfinite(np.array(ca.DM(found))).all()


@pytest.mark.parametrize("sensor", MEASURING)
def test_whether_the_equation_refers_to_accelerations_is_true(sensor: SensorBase):
    names = ("acceleration", "angular_acceleration", "spin_rates")
    symbols = {name: ca.SX.sym(name, getattr(Motion(), name).numel()) for name in names}
    biases, mounting = ca.SX.zeros(len(sensor.biases())), ca.SX(sensor.mounting())
    found = sensor.equation(Motion(**symbols), biases, mounting)
    assert ca.depends_on(found, ca.vertcat(*symbols.values())) == sensor.uses_acceleration


@pytest.mark.parametrize("sensor", SIMULATED)
def test_what_a_simulated_message_says_is_read_as_the_truth_up_to_its_noise(sensor: SensorBase):
    """Biases are left out; what an input sensor has of noise, its simulation knows. Directions are compared as angles,
    and wheels at speeds that their sensors measure."""
    rng = np.random.RandomState(1)
    n, m = 500, len(sensor.deviations())
    truth = 0.1 * rng.standard_normal((n, m))
    if isinstance(sensor, WheelSpeeds):
        truth += 2 * sensor.lowest
    assert sensor.sampling is not None
    quantum = np.array(sensor.sampling.quantum)
    drive = SimulatedDrive(truth, np.zeros((n, 3)), ORIGIN, rng, 0.0, quantum, lambda point: np.zeros(n))
    content = sensor.simulated(drive)
    on_map, read = Map(ORIGIN), np.empty((n, m))
    for row in range(n):
        values = {name: column[row] for name, column in content.columns.items()}
        sensor.read(content.names, on_map.placed(values) if sensor.geodetic else values, read[row], np.empty(m))
    deviation = np.array([np.pi / 180 / 16.0]) if sensor.kind == "steering" else sensor.deviations()
    error = read - sensor.offsets() - truth
    if isinstance(sensor, GnssAttitude):
        assert_allclose(np.hypot(*read.T), 1.0, atol=1e-6)
        turned = np.arctan2(read[:, 1], read[:, 0]) - np.arctan2(truth[:, 1], truth[:, 0])
        error, deviation = np.angle(np.exp(1j * turned))[:, None], sensor.deviations()[:1]
    step = quantum if sensor.is_input else np.zeros(1)
    assert_allclose(error.std(axis=0), deviation, rtol=0.15, atol=step.max())
    assert np.all(np.abs(error.mean(axis=0)) <= 4 * deviation / n**0.5 + step)


@pytest.mark.parametrize("sensor", [found for found in KNOWN if found.values[0].measures_speed])
def test_speeds_of_a_car_on_equal_wheels_are_the_same_by_all_ways_to_tell_them(sensor: SensorBase):
    speed, radius = np.array([0.0, 10.0, 25.0]), 0.3
    rolling = "rolling speed" in sensor.measures
    direction = [0.6, -0.8] if len(sensor.deviations()) == 2 else [1.0]
    value = np.tile(speed[:, None] / radius, 4) if rolling else np.outer(speed, direction)
    assert_allclose(sensor.speeds(value, np.full(4, radius)), speed)
    assert_allclose(sensor.mean_speed(value, radius), speed)
    value[1, 0] = np.nan
    assert_allclose(sensor.speeds(value, np.full(4, radius)), [0.0, 10.0 if rolling else np.nan, 25.0])
    assert np.isnan(sensor.mean_speed(value, radius)[1])


def test_a_vertical_velocity_of_exactly_zero_is_no_measurement() -> None:
    sensor, read, variance = KINDS["gnss_vertical_velocity"](), np.empty(1), np.empty(1)
    for up in (0.0, -0.0, 0.25):
        sensor.read((), {"linear": np.array([10.0, 0.0, up])}, read, variance)
        assert np.isnan(read[0]) if up == 0 else read[0] == up
