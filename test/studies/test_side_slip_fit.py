"""Fits of vehicle files: on a generated drive, whose sensors are then changed in a known way."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest

from studies import side_slip_fit
from studies.side_slip_fit import SideSlipResiduals, fit_side_slip, side_slip_error
from vsense_ros.bag import read_bag
from vsense_ros.errors import InputError
from vsense_ros.files.installed import shared_folder, vehicle_path
from vsense_ros.files.vehicle import load_vehicle
from vsense_ros.identification.free_parameter import FreeParameter, added, multiplied, with_offsets
from vsense_ros.identification.identification import identify
from vsense_ros.identification.least_squares import DivergedError, cost
from vsense_ros.identification.parameter_set import of_vehicle, with_values
from vsense_ros.messages.recording import Recording
from vsense_ros.model.vehicle import Vehicle

GAIN = FreeParameter("steering gain", "-", 0.1, -np.inf, np.inf, multiplied({"sensors.steering.gain": 1}))
PLACE = FreeParameter("place of the reference", "m", 0.3, -np.inf, np.inf, added("reference.position.0"))


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


@pytest.mark.exam
def test_the_mounting_of_the_reference_is_found(car: Vehicle, drive: Recording):
    at_cog, mounted = (fit_side_slip(car, [PLACE], [_mounted(drive, *m)]) for m in ((0.0, 0.0), (0.7, 0.02)))
    here, there = (found.vehicle.reference for found in (at_cog, mounted))
    assert there.position[0] - here.position[0] == pytest.approx(0.7, abs=0.02)
    assert there.yaw - here.yaw == pytest.approx(0.02, abs=2e-4)
    assert mounted.after == pytest.approx(at_cog.after, rel=0.02)
    assert mounted.after[0] < 0.5 * mounted.before[0]


@pytest.mark.exam
def test_a_car_that_is_identified_without_side_slip_says_where_the_reference_sits(car: Vehicle, drive: Recording):
    at_cog, mounted = (identify([_mounted(drive, *m)], car, "single_track") for m in ((0.0, 0.0), (0.7, 0.02)))
    here, there = (found.vehicle.reference for found in (at_cog, mounted))
    assert there.position[0] - here.position[0] == pytest.approx(0.7, abs=0.05)
    assert there.yaw - here.yaw == pytest.approx(0.02, abs=1e-3)  # in small angles
    assert mounted.side_slip == pytest.approx(at_cog.side_slip, abs=5e-4)


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


def test_fitted_numbers_have_the_digits_that_mean_something(car: Vehicle):
    turned = with_offsets(of_vehicle(car), [GAIN], [0.0123456])
    gain = with_values(car, turned, side_slip_fit.SIDE_SLIP.digits).sensors["steering"].gain
    assert gain == float(f"{gain:.4g}") != car.sensors["steering"].gain


def test_residuals_of_the_car_as_it_is_have_a_cost_of_one_and_no_mean(car: Vehicle, drive: Recording):
    with ThreadPoolExecutor(1) as pool:
        short = replace(drive, channels={t: c.select(c.seconds < 6.0) for t, c in drive.channels.items()})
        residuals = SideSlipResiduals(car, [drive, short], pool)
        found = residuals(of_vehicle(car))
        assert cost(found) == pytest.approx(1.0)
        assert sum(float(part.sum()) * np.sqrt(len(part)) / len(part) for part in found) == pytest.approx(0.0, abs=1e-9)


def test_a_car_that_cannot_be_diverges(car: Vehicle, drive: Recording):
    with ThreadPoolExecutor(1) as pool:
        residuals = SideSlipResiduals(car, [drive], pool)
        impossible = of_vehicle(car).changed({"chassis.mass": -1.0})
        assert residuals.diverged(impossible) == [True]
        assert residuals(impossible, [np.ones(3)])[0] == pytest.approx(1.0)
        with pytest.raises(DivergedError):
            residuals(impossible)
        assert residuals.diverged(of_vehicle(car)) == [False]
