"""Many estimates at once have what each has alone."""

from __future__ import annotations

import sys
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from drives import messages
from vsense_ros.messages.recording import Recording
from vsense_ros.observer.estimate import Estimate, estimate_samples, stacked
from vsense_ros.runner import Runner
from vsense_ros.runner.run import Collected

DERIVED = ("pose_covariance", "twist_covariance", "acceleration_covariance", "wheel_variance", "wheels", "side_slip")


@pytest.fixture(scope="module")
def driven(vehicle: Any, lane_change: Any) -> tuple[Runner, list[Estimate]]:
    """A filter and some of its estimates, at different speeds and angles."""
    runner, found = Runner(vehicle), []
    for i, sample in enumerate(messages(lane_change, 3.0)):
        runner.add(sample)
        if runner.started and i % 40 == 0:
            found.append(runner.snapshot())
    assert len(found) > 10
    return runner, found


@pytest.mark.parametrize("name", DERIVED)
def test_what_follows_from_many_states_at_once_is_what_follows_from_each(
    driven: tuple[Runner, list[Estimate]], name: str
) -> None:
    together, alone = getattr(stacked(driven[1]), name), np.array([getattr(e, name) for e in driven[1]])
    np.testing.assert_array_equal(together, alone)
    assert not np.array_equal(alone[0], alone[-1])


def test_what_contradictions_leave_undecided_is_in_the_covariance_of_each_and_of_many(
    driven: tuple[Runner, list[Estimate]],
) -> None:
    without = [replace(e, undecided=np.zeros(9)) for e in driven[1]]
    some = list(without)
    added = np.array([0.25, 0.04, 0.0, 0.0, 0.0, 0.01, 0.0, 0.0, 0.0])
    some[0] = replace(some[0], undecided=added)
    together = stacked(some).twist_covariance
    np.testing.assert_allclose(together[0], without[0].twist_covariance + np.diag(added[:6]), rtol=1e-15)
    np.testing.assert_array_equal(together[1:], stacked(without).twist_covariance[1:])
    np.testing.assert_array_equal(together[0], some[0].twist_covariance)


def test_an_estimate_stays_what_it_was_when_the_filter_goes_on(vehicle: Any, lane_change: Any) -> None:
    runner, drive = Runner(vehicle), iter(messages(lane_change, 3.0))
    while not runner.started:
        runner.add(next(drive))
    early, late = runner.snapshot(), runner.snapshot()
    before = {name: np.array(getattr(early, name)) for name in DERIVED}
    for sample in drive:
        runner.add(sample)
    runner.snapshot()
    for name, value in before.items():
        np.testing.assert_array_equal(getattr(late, name), value)


def test_columns_that_are_made_in_blocks_are_the_messages_of_each_state(
    driven: tuple[Runner, list[Estimate]], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(sys.modules[Collected.__module__], "BLOCK", 4)
    runner, estimates = driven
    collected = Collected(runner.adapter)
    for one in estimates:
        collected.add(one)
    output = collected.recording(Recording({}))
    for row in (0, 3, 4, len(estimates) - 1):
        for sample in estimate_samples(estimates[row]):
            for field, value in sample.values.items():
                np.testing.assert_array_equal(output[sample.topic].columns[field][row], np.ravel(value), sample.topic)


def test_forces_are_balanced_for_many_estimates_at_once_as_for_one_after_the_other(
    vehicle: Any, lane_change: Any
) -> None:
    found: dict[bool, list[Estimate]] = {True: [], False: []}
    for one_by_one, estimates in found.items():
        runner = Runner(vehicle)
        for i, sample in enumerate(messages(lane_change, 4.0)):
            runner.add(sample)
            pause = 1.5e9 < runner.stamp - lane_change.start < 2.5e9
            if runner.started and i % 3 == 0 and not pause:
                estimates.append(runner.snapshot() if one_by_one else runner.incomplete_snapshot())
        runner.adapter.complete()
    alone, together = (np.array([e.unbalanced for e in found[way]]) for way in (True, False))
    assert np.isfinite(alone).all()
    assert len(alone) > 256
    np.testing.assert_allclose(together, alone, rtol=1e-9, atol=1e-6)


def test_messages_of_an_estimate_are_made_one_by_one_with_the_odometry_first(
    driven: tuple[Runner, list[Estimate]],
) -> None:
    runner, _ = driven
    newest, whole = runner.newest(), runner.estimate()
    first = next(newest)
    assert first.topic == "vsense/odometry"
    for one, other in zip((first, *newest), whole, strict=True):
        assert one.topic == other.topic
        assert all(np.array_equal(one.values[name], values, equal_nan=True) for name, values in other.values.items())
