"""The noise of a sensor is measured from its messages, whatever else comes in the same channel."""

from __future__ import annotations

import numpy as np
import pytest

from vsense_ros.prepare.calibration_drive import scatter

NOISE = 0.003


def turning(rows: int, period: float) -> tuple[np.ndarray, np.ndarray]:
    """Stamps [ns] and a yaw rate that changes as in bends, with white noise."""
    t = np.arange(rows) * period
    noise = NOISE * np.random.default_rng(5).standard_normal(rows)
    return (1e9 * t).astype(np.int64), 0.3 * np.sin(0.5 * t) + noise


@pytest.mark.parametrize("period", [0.004, 0.01, 0.1])
def test_the_noise_of_a_signal_is_that_of_its_messages(period: float) -> None:
    stamp, values = turning(6000, period)
    np.testing.assert_allclose(scatter(stamp, values[:, None]), NOISE, rtol=0.1)


def test_components_that_come_in_messages_of_their_own_have_the_noise_of_their_own() -> None:
    stamp, rate = turning(6000, 0.01)
    apart = np.full((12_000, 2), np.nan)
    apart[0::2, 0], apart[1::2, 1] = rate, 2 * rate
    np.testing.assert_allclose(scatter(np.repeat(stamp, 2), apart), [NOISE, 2 * NOISE], rtol=0.1)


def test_a_component_that_is_absent_has_no_noise() -> None:
    stamp, rate = turning(200, 0.01)
    known = np.isfinite(scatter(stamp, np.column_stack([rate, np.full(200, np.nan)])))
    assert known.tolist() == [True, False]
