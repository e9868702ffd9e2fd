"""From messages to measurements: what a message says, where it was measured, and what cannot be true."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pymap3d
import pytest

from sources import DEVIATION, SECOND, Gyro, message
from vsense_ros.estimation.filter import Array
from vsense_ros.estimation.reading import Map, Reader, StatedNoise, noise_at_start
from vsense_ros.estimation.timeline import Event
from vsense_ros.messages.recording import Channel, Recording, Sample


def read(sample: Sample, gyro: Gyro | None = None) -> Event:
    event = Reader(3, gyro or Gyro(), Map(None)).read(sample)
    assert isinstance(event, Event), event
    return event


def refused(sample: Sample, gyro: Gyro | None = None) -> str:
    why = Reader(3, gyro or Gyro(), Map(None)).read(sample)
    assert isinstance(why, str)
    return why


def test_latency_and_offsets_are_taken_off() -> None:
    event = read(message(2.0, (0.5, 0.6)), Gyro(latency=0.1, offset=0.2))
    assert event.stamp == round(1.9 * SECOND)
    np.testing.assert_allclose(event.value, [0.3, 0.4])
    assert event.sensor == 3


def test_deviations_of_the_file_count_where_a_message_states_none() -> None:
    np.testing.assert_allclose(read(message(1.0)).variance, DEVIATION**2)


@pytest.mark.parametrize(("stated", "used"), [(0.04, 0.04), (0.0026, 0.0026), (0.0024, 0.01), (0.0, 0.01)])
def test_a_stated_variance_counts_unless_it_is_too_small_to_be_true(stated: float, used: float) -> None:
    """Less than half the deviation of the file, 0.1, is not believed."""
    assert read(message(1.0, stated=[stated, 0.01])).variance[0] == pytest.approx(used)


@pytest.mark.parametrize("unknown", [np.nan, np.inf, 1e14])
def test_a_component_of_unknown_variance_is_absent(unknown: float) -> None:
    event = read(message(1.0, (0.1, 0.2), stated=[0.01, unknown]))
    assert event.value[0] == 0.1
    assert np.isnan(event.value[1])
    assert np.isfinite(event.variance).all()


@pytest.mark.parametrize("wrong", [np.nan, np.inf, -np.inf, 2e7, -2e7])
def test_a_component_that_is_no_quantity_is_absent(wrong: float) -> None:
    event = read(message(1.0, (wrong, 0.2)))
    assert np.isnan(event.value[0])
    assert event.value[1] == 0.2
    assert refused(message(1.0, (wrong, np.nan))) == "no usable number in the message"


def test_a_large_value_with_a_stated_variance_is_a_number_still() -> None:
    event = read(message(1.0, (9e6, 0.2), stated=[0.01, np.nan]))
    assert event.value[0] == 9e6
    assert np.isnan(event.value[1])


def test_values_that_are_large_together_are_each_a_number() -> None:
    np.testing.assert_allclose(read(message(1.0, (6e6, -6e6))).value, [6e6, -6e6])


@pytest.mark.parametrize(
    ("given", "expected", "fits"),
    [("body", "body", True), ("", "body", True), ("body", "", True), ("imu", "body", False), ("imu", "", True)],
)
def test_a_frame_that_is_stated_must_be_the_sensors(given: str, expected: str, fits: bool) -> None:
    found = Reader(0, Gyro(frame_id=expected), Map(None)).read(message(1.0, frame_id=given))
    assert isinstance(found, Event) == fits
    if not fits:
        assert found == f"frame_id '{given}', expected '{expected}'"


def test_what_cannot_be_read_says_why() -> None:
    assert refused(message(1.0, kind="std_msgs/msg/Empty")).startswith("message type std_msgs/msg/Empty, expected ")
    empty = Sample("gyro", Gyro().message, SECOND, {}, "body")
    assert refused(empty).startswith("unreadable: KeyError")


def test_noise_is_stated_with_whose_it_is() -> None:
    reader = Reader(0, Gyro(), Map(None))
    assert reader.noise(np.full(2, DEVIATION**2)) == "0.1 rad/s, of the vehicle file"
    assert reader.noise(np.full(2, 0.04)) == "0.2 rad/s, of its messages; file 0.1 rad/s"


def test_noise_at_start_is_that_of_the_first_message_that_can_be_read() -> None:
    class Variances(Gyro):
        """A sensor of two components whose message states the variance of both in a third."""

        def read(self, names: tuple[str, ...], values: Mapping[str, Array], value: Array, variance: Array) -> None:
            value[:], variance[:] = values["vector"][:2], values["vector"][2]

    stamps = np.array([SECOND, 2 * SECOND])
    columns = {"vector": np.array([[np.nan, np.nan, 1.0], [0.1, 0.2, 0.04]])}
    recording = Recording({"gyro": Channel("gyro", Gyro().message, stamps, stamps, columns, "body")})
    stated = noise_at_start(recording, {"gyro": Variances(), "absent": Gyro(topic="other")})
    assert stated["gyro"].words == "0.2 rad/s, of its messages; file 0.1 rad/s"
    assert list(stated) == ["gyro"]


@pytest.mark.parametrize(("stated", "doubted"), [(0.1, False), (2.0, False), (5.8, True), (1e3, True), (1e-3, False)])
def test_a_standard_deviation_that_is_many_times_that_of_the_file_is_doubted(stated: float, doubted: bool) -> None:
    assert bool(StatedNoise("…", stated / DEVIATION).doubt) == doubted


# The map

HOME = (48.1, 11.6, 500.0)


def fix(latitude: float, longitude: float, altitude: float = 500.0, status: float | None = 0.0) -> dict[str, Array]:
    values = {"latitude": latitude, "longitude": longitude, "altitude": altitude}
    if status is not None:
        values["status"] = status
    return {name: np.array([value]) for name, value in values.items()}


def test_a_place_is_that_of_pymap3d_and_its_height_follows_the_earth() -> None:
    placed = Map(HOME).placed(fix(48.2, 11.8, 530.0))
    east, north, _ = pymap3d.geodetic2enu(48.2, 11.8, HOME[2], *HOME)
    assert (placed["east"][0], placed["north"][0]) == (pytest.approx(east), pytest.approx(north))
    assert placed["up"][0] == pytest.approx(30.0)


def test_a_place_goes_to_the_map_and_back() -> None:
    placed = Map(HOME).placed(fix(48.11, 11.62))
    back = Map(HOME).latitude_longitude(float(placed["east"][0]), float(placed["north"][0]))
    assert back == (pytest.approx(48.11, abs=1e-9), pytest.approx(11.62, abs=1e-9))


def test_the_first_fix_is_the_origin() -> None:
    made = Map(None)
    with pytest.raises(ValueError, match="no origin"):
        made.latitude_longitude(0.0, 0.0)
    placed = made.placed(fix(*HOME))
    assert made.origin == HOME
    assert [placed[name][0] for name in ("east", "north", "up")] == pytest.approx([0.0, 0.0, 0.0])
    made.placed(fix(48.2, 11.8))
    assert made.origin == HOME


@pytest.mark.parametrize(
    ("values", "origin"),
    [
        (fix(48.1, 11.6, status=-1.0), None),  # the receiver says that it has none
        (fix(48.1, 11.6, status=None), HOME),
        (fix(48.1, 11.6, np.nan), (48.1, 11.6, 0.0)),
        (fix(48.1, 11.6, 9500.0), None),
        (fix(48.1, 11.6, -600.0), None),
        (fix(0.0, 0.0), None),
        (fix(0.0005, -0.0005), None),
        (fix(0.0, 11.6), (0.0, 11.6, 500.0)),  # on the equator
        (fix(48.1, 0.0), (48.1, 0.0, 500.0)),  # on the meridian of Greenwich
        (fix(91.0, 11.6), None),
        (fix(48.1, 361.0), None),
        (fix(-90.0, 360.0), (-90.0, 360.0, 500.0)),
    ],
)
def test_an_origin_is_a_fix_on_a_road_of_this_earth(
    values: dict[str, Array], origin: tuple[float, float, float] | None
) -> None:
    made = Map(None)
    made.placed(values)
    assert made.origin == origin


@pytest.mark.parametrize("values", [fix(91.0, 11.6), fix(48.1, 361.0), fix(0.0, 0.0), fix(np.nan, 11.6)])
def test_what_is_no_place_on_earth_is_nowhere_on_the_map(values: dict[str, Array]) -> None:
    placed = Map(HOME).placed(values)
    assert all(np.isnan(placed[name][0]) for name in ("east", "north", "up"))
