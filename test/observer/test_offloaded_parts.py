"""An observer whose suspension tables, wheel inertias and systems an accelerator computes."""

from __future__ import annotations

import dataclasses

import casadi as ca
import numpy as np
import pytest

from vsense_ros.accelerator.client import Client, Direct
from vsense_ros.accelerator.device import Device
from vsense_ros.accelerator.faults import Faults
from vsense_ros.bag import read_bag
from vsense_ros.errors import InputError
from vsense_ros.files.installed import shared_folder, vehicle_path
from vsense_ros.files.vehicle import load_vehicle
from vsense_ros.messages.recording import Recording
from vsense_ros.model.car.car import Car
from vsense_ros.model.car.parts import CarInParts
from vsense_ros.model.coordinates import DISTURBANCES, WHEELS
from vsense_ros.observer.implicit import Work, accelerated, implicit_error_ekf, work_with
from vsense_ros.observer.offload import PARTS, OffloadedParts, Parts
from vsense_ros.runner.run import run

VEHICLE = load_vehicle(vehicle_path("prototype_model"))


@pytest.fixture(scope="module")
def turn_in() -> Recording:
    """The first turn of a double lane change."""
    whole = read_bag(shared_folder("bags") / "double_lane_change")
    end = whole.first_stamp + 750_000_000
    channels = [c.select(c.stamp < end) for c in whole.channels.values() if not c.topic.startswith("reference")]
    return dataclasses.replace(whole, channels={c.topic: c for c in channels})


@pytest.fixture(scope="module")
def alone(turn_in: Recording) -> Recording:
    """The estimates of the turn without an accelerator."""
    return run(turn_in, VEHICLE, rate=250.0, make=implicit_error_ekf()).output


def placed(seed: int) -> list[np.ndarray]:
    """q, u, disturbances, inputs, parameters and internal state of a car somewhere, also beyond its tables."""
    random = np.random.default_rng(seed)
    q = np.concatenate([[0, 0, 0.3], random.normal(0, 0.05, 3), random.uniform(-0.15, 0.15, 4), random.normal(0, 9, 4)])
    u = np.concatenate([[15.0, 0.2, 0.0], random.normal(0, 0.3, 7), np.full(4, 50.0)])
    inputs = np.concatenate([random.uniform(-0.4, 0.4, 1), random.normal(0, 100, 4), [0.0]])
    return [q, u, np.zeros(len(DISTURBANCES)), inputs, VEHICLE.parameter_vector(), np.zeros(0)]


@pytest.mark.parametrize("seed", range(5))
def test_a_car_of_its_parts_is_the_car(seed: int) -> None:
    q, u, around, inputs, p, memory = placed(seed)
    car, whole = CarInParts(VEHICLE), Car(VEHICLE)
    columns = car.columns_function()(q, around, inputs, p, memory)
    inertias = car.inertias_function()(q, around, inputs, p, memory, columns)
    found = car.dynamics_function()(q, u, np.zeros(14), around, inputs, p, memory, columns, inertias)
    arguments = [whole.q, whole.u, whole.force, whole.disturbances, whole.inputs, whole.p, whole.internal_state]
    expected = ca.Function("f", arguments, [whole.dynamics])(q, u, np.zeros(14), around, inputs, p, memory)
    assert np.allclose(np.array(found), np.array(expected), rtol=1e-10, atol=1e-9)


@pytest.mark.parametrize("seed", range(10))
def test_the_accelerator_has_the_parts_of_the_processor_in_single_precision(seed: int) -> None:
    where = placed(seed)
    car, client = CarInParts(VEHICLE), Client(Direct(Device("mock")))
    offloaded = OffloadedParts(car, VEHICLE, Parts(client), where)
    offloaded.update()
    assert client.counts["accelerated"] == 1 + len(WHEELS)
    q, _, *rest = where
    columns = np.array(car.columns_function()(q, *rest))
    inertias = np.array(car.inertias_function()(q, *rest, columns))
    found = offloaded.columns.reshape(-1, 4, order="F")
    # Beside a table's end a slope or curvature is a sum of large terms of both signs.
    assert np.abs(found[0::3] - columns[0::3]).max() < 1e-7
    assert np.abs(found - columns).max() < 3e-6
    assert np.abs(offloaded.inertias.reshape(-1, 4, order="F") - inertias).max() < 1e-6 * inertias.max()


@pytest.mark.parametrize("bit", [16, 20, 23, 27, 30])
@pytest.mark.parametrize("part", PARTS)
def test_a_wrong_word_of_a_part_is_found_and_the_processor_computes_it(part: str, bit: int) -> None:
    """Where a flipped bit passes, what it changes is next to nothing."""
    where, worst = placed(3), 0.0
    car = CarInParts(VEHICLE)
    device = Device("mock")
    honest = device._disturbed
    client = Client(Direct(device))
    offloaded = OffloadedParts(car, VEHICLE, Parts(client, (part,)), where)
    q, _, *rest = where
    matrix = np.array(car.columns_function()(q, *rest))
    inertias = np.array(car.inertias_function()(q, *rest, matrix)).reshape(-1, order="F")
    columns = matrix.reshape(-1, order="F")
    for word in range(9 if part == "body_mass" else 96):
        client._misses = 0

        def flipped(kernel, result, word=word):
            given = honest(kernel, result).copy()
            given[word] ^= np.uint32(1 << bit)
            return given

        device._disturbed = flipped
        offloaded.update()
        worst = max(
            worst,
            np.abs(offloaded.columns - columns).max() / 0.05,  # m, rad: the size of the tables
            np.abs(offloaded.inertias - inertias).max() / inertias.max(),
        )
    assert worst < 2e-3
    assert client.counts["implausible"] > 0


@pytest.mark.exam
@pytest.mark.parametrize("parts", [("suspension_motion",), PARTS])
def test_forces_with_parts_from_the_accelerator_are_those_of_the_processor(
    turn_in: Recording, alone: Recording, parts: tuple[str, ...]
) -> None:
    transport = Direct(Device("mock"))
    client = Client(transport)
    make = accelerated("error_ekf", client, ("solve14", *parts), transport.at)
    ours = run(turn_in, VEHICLE, rate=250.0, make=make)
    assert client.counts["accelerated"] == client.counts["requests"] > 500
    for wheel in WHEELS:
        found, expected = (out[f"vsense/wheel_force/{wheel}"].columns["force"] for out in (ours.output, alone))
        assert np.abs(found - expected).max() < 1e-3 * np.abs(expected).max()
        assert not np.array_equal(found, expected)  # it is single precision, after all


def test_an_accelerator_that_fails_costs_nothing_but_its_use(turn_in: Recording, alone: Recording) -> None:
    transport = Direct(Device("mock", faults=Faults(drop=0.02, nan=0.05, silent_error=0.05), seed=2))
    client = Client(transport)
    make = accelerated("error_ekf", client, ("solve14", "suspension_motion"), transport.at)
    ours = run(turn_in, VEHICLE, rate=250.0, make=make)
    assert client.counts["not_finite"] > 0
    assert client.counts["implausible"] > 0
    assert client.fallbacks > 0
    found, expected = (out["vsense/odometry"].columns["linear"] for out in (ours.output, alone))
    assert np.abs(found - expected).max() < 1e-3 * np.abs(expected).max()


def test_what_no_accelerator_computes_is_refused_by_name() -> None:
    with pytest.raises(InputError, match="engine"):
        Parts(Client(Direct(Device())), ("engine",))
    with pytest.raises(InputError, match="solve42"):
        work_with(Client(Direct(Device())), ("solve14", "solve42"))
    with pytest.raises(InputError, match="solve14"):
        accelerated("full_error_ekf", Client(Direct(Device())), ("solve14",))


def test_a_car_without_tables_has_no_parts_to_compute_elsewhere() -> None:
    bare = VEHICLE.model_copy(update={"suspension": None})
    make = implicit_error_ekf(Work(parts=Parts(Client(Direct(Device())))))
    with pytest.raises(InputError, match="tables"):
        make(bare, dict(bare.sensors))
