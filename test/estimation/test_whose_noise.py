"""Which of two standard deviations counts, that of a message or that of the vehicle file."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.testing import assert_allclose

from vsense_ros.estimation.reading import Map, Reader
from vsense_ros.estimation.timeline import Event
from vsense_ros.messages.recording import Sample
from vsense_ros.model.sensors.gnss_velocity import GnssVelocity
from vsense_ros.model.sensors.imu import Imu

IMU = Imu(rate_noise=(0.03, 0.03, 0.015), force_noise=(1.0, 1.0, 1.0))
GNSS = GnssVelocity(noise=0.1)


def deviations(sensor, stated):
    """That a filter is given with a message that states this variance of all components; and the words for it."""
    if isinstance(sensor, Imu):
        fields = {"angular_velocity": [0.1, 0.2, 0.3], "linear_acceleration": [1, 2, 9.8]}
        covariances = {f"{field}_covariance": np.diag([stated] * 3).ravel() for field in fields}
    else:
        fields = {"linear": [3, 4, 0]}
        covariances = {"covariance": np.diag([stated] * 6).ravel()}
    values = {name: np.asarray(value, float) for name, value in {**fields, **covariances}.items()}
    reader = Reader(0, sensor, Map(None))
    event = reader.read(Sample(sensor.topic, sensor.message, 10**9, values, sensor.frame_id))
    assert isinstance(event, Event)
    return np.sqrt(event.variance), reader.noise(event.variance)


@given(st.floats(1e-6, 1e3))
def test_of_an_inertial_sensor_the_larger_standard_deviation_counts(stated):
    found, _ = deviations(IMU, stated**2)
    assert_allclose(found, np.maximum(IMU.deviations(), stated))


@given(st.floats(1.001e-4, 1e3))
def test_of_a_gnss_receiver_the_standard_deviation_of_its_message_counts(stated):
    found, words = deviations(GNSS, stated**2)
    assert_allclose(found, stated)
    assert words.startswith(f"{stated:.3g} m/s")


@pytest.mark.parametrize("sensor", [IMU, GNSS], ids=["imu", "gnss"])
@pytest.mark.parametrize("stated", [1e-30, 1e-12, 0.0])
def test_a_variance_that_no_sensor_has_is_none(sensor, stated):
    found, words = deviations(sensor, stated)
    assert_allclose(found, sensor.deviations())
    assert words.endswith("of the vehicle file")


@pytest.mark.parametrize("sensor", [IMU, GNSS], ids=["imu", "gnss"])
def test_the_vehicle_file_may_say_that_messages_do_not_count(sensor):
    found, _ = deviations(sensor.model_copy(update={"noise_from_message": False}), 100.0)
    assert_allclose(found, sensor.deviations())


def test_it_is_told_with_units_and_whose_it_is():
    assert deviations(IMU, 0.02**2)[1] == (
        "0.03 0.03 0.02 rad/s, 1 m/s², of its messages; file 0.03 0.03 0.015 rad/s, 1 m/s²"
    )
    assert deviations(IMU, 0.01**2)[1] == "0.03 0.03 0.015 rad/s, 1 m/s², of the vehicle file"
