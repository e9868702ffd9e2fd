"""Fits of vehicle files: on a generated drive, whose sensors are then changed in a known way."""

from dataclasses import replace

import numpy as np
import pytest

from vsense_ros.bag import read_bag
from vsense_ros.errors import InputError
from vsense_ros.files.installed import shared_folder, vehicle_path
from vsense_ros.files.vehicle import load_vehicle
from vsense_ros.identify import side_slip
from vsense_ros.identify.side_slip import FreeParameter, fit, side_slip_error, turned
from vsense_ros.messages.recording import Recording
from vsense_ros.model.vehicle import Vehicle

GAIN = FreeParameter("steering gain", {"sensors.steering.gain": 1}, 0.1)
PLACE = FreeParameter("place of the reference", {"reference.position.0": 1}, 0.3, adds=True)


@pytest.fixture(scope="module")
def car() -> Vehicle:
    return load_vehicle(vehicle_path("prototype_real"))


@pytest.fixture(scope="module")
def drive() -> Recording:
    return read_bag(shared_folder("bags") / "double_lane_change")


def _mounted(drive: Recording, ahead: float, angle: float) -> Recording:
    """The drive as a reference sees it that sits so far ahead of cog [m], its axes turned to the left [rad]."""
    channel = drive["reference/odometry"]
    linear, angular = channel.columns["linear"].copy(), channel.columns["angular"]
    seen = (linear[:, 0] + 1j * (linear[:, 1] + ahead * angular[:, 2])) * np.exp(-1j * angle)
    linear[:, 0], linear[:, 1] = seen.real, seen.imag
    kept = {topic: one for topic, one in drive.channels.items() if topic != "reference/sideslip"}
    kept["reference/odometry"] = replace(channel, columns={**channel.columns, "linear": linear})
    return replace(drive, channels=kept)


@pytest.mark.slow
def test_the_mounting_of_the_reference_is_found(car: Vehicle, drive: Recording):
    at_cog, mounted = (fit(car, [PLACE], [_mounted(drive, *m)]) for m in ((0.0, 0.0), (0.7, 0.02)))
    here, there = (found.vehicle.reference for found in (at_cog, mounted))
    assert there.position[0] - here.position[0] == pytest.approx(0.7, abs=0.02)
    assert there.yaw - here.yaw == pytest.approx(0.02, abs=2e-4)
    assert mounted.after == pytest.approx(at_cog.after, rel=0.02)
    assert mounted.after[0] < 0.5 * mounted.before[0]


@pytest.mark.slow
def test_where_the_observer_is_silent_it_counts_as_having_said_zero(car: Vehicle, drive: Recording):
    late = replace(
        drive,
        channels={t: c if t.startswith("reference/") else c.select(c.seconds > 6.0) for t, c in drive.channels.items()},
    )
    error, full = side_slip_error(car, late), side_slip_error(car, drive)
    truth = np.abs(full).max()
    assert len(error) == len(full)
    assert np.isfinite(error).all()
    assert np.abs(error[: len(error) // 4]).max() > 0
    assert np.sqrt(np.mean(error**2)) > np.sqrt(np.mean(full**2))
    assert truth < 0.1


def test_a_recording_without_reference_cannot_be_fitted_to(car: Vehicle, drive: Recording):
    blind = replace(drive, channels={t: c for t, c in drive.channels.items() if not t.startswith("reference/")})
    with pytest.raises(InputError, match="reference/odometry"):
        side_slip_error(car, blind)


def test_a_knob_turns_its_numbers_together_and_back(car: Vehicle):
    both = FreeParameter("both", {"sensors.imu.force_noise": 1, "physics.chassis.mass": -1}, 0.5)
    there = turned(car, [both], [1.0])
    assert there.physics.chassis.mass == pytest.approx(car.physics.chassis.mass * np.exp(-0.5))
    noise = [v.sensors["imu"].force_noise for v in (there, car)]
    assert noise[0] == pytest.approx(np.exp(0.5) * np.array(noise[1]))
    assert turned(there, [both], [-1.0], digits=10).values() == pytest.approx(car.values())


def test_a_knob_that_adds_moves_a_number_that_is_zero():
    car = load_vehicle(vehicle_path("genesis_start"))
    place = FreeParameter("place", {"reference.position.0": 1}, 0.3, adds=True)
    assert turned(car, [place], [2.0]).reference.position == pytest.approx((0.6, 0.0, 0.0))


def test_fitted_numbers_have_the_digits_that_mean_something(car: Vehicle):
    gain = GAIN.value(turned(car, [GAIN], [0.123456], side_slip.DIGITS))
    assert gain == float(f"{gain:.4g}")
