"""A bias of the gyro that wanders within bounds (Bevly 2004; Leung 2010, eq. 2.66).

    ψ̇ = r_m - b,  ḃ = -b / T + w / T                           first-order Markov process, driven by white noise

Exactly, over a step: b decays by exp(-h/T), and noise of σ² (1 - exp(-2h/T)) is added, where σ is the deviation that b
keeps: that of w is σ √(2 T) [rad/s/√Hz]. As T grows the bias becomes a constant, as in the other filters of the thesis.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import casadi as ca
import numpy as np
from scipy.signal import lfilter

from studies.literature.finding import Array, Finding
from vsense_ros.estimation.filter import Filter
from vsense_ros.estimation.state_space import Measurement, Named
from vsense_ros.navigation.space import Definition, NavigationSpace

SOURCE = "Bevly 2004, eq. 2.66"
GYRO = {"gyro_noise": np.radians(0.1), "sample_time": 0.1, "bias": np.radians(0.1), "time_constant": 60.0}
_HEADING = np.radians(0.3)  # [rad] of two antennas


class MarkovHeading(NavigationSpace):
    """ψ and b."""

    names = ("yaw", "gyro_bias")
    inputs = ("yaw_rate",)
    parameters = tuple(GYRO)
    prior: Mapping[str, float] = {"yaw": _HEADING, "gyro_bias": GYRO["bias"]}

    def transition(self, x: Named, u: Named, theta: Named, h: ca.SX) -> Any:
        return [x.yaw + h * (u.yaw_rate - x.gyro_bias), x.gyro_bias * ca.exp(-h / theta.time_constant)]

    def noise(self, x: Named, u: Named, theta: Named, h: ca.SX) -> Any:
        lost = 1 - ca.exp(-2 * h / theta.time_constant)
        wandering = ca.diag(ca.vertcat(0.0, theta.bias**2 * lost))
        return self.sampled(x, u, theta, h, yaw_rate=theta.gyro_noise) + wandering


HEADING = Measurement("heading", lambda x, z, u, p: x.yaw, (_HEADING,), angles=(0,))
MARKOV_HEADING = Definition.of(MarkovHeading(), HEADING)


def biases(random: np.random.Generator, n: int, h: float, deviation: float, time_constant: float) -> Array:
    """A bias (n,) each `h` [s] that follows eq. 2.66."""
    decay = np.exp(-h / time_constant)
    driving = deviation * np.sqrt(1 - decay**2) * random.standard_normal(n)
    driving[0] = deviation * random.standard_normal()  # it has wandered for long
    return np.asarray(lfilter([1.0], [1.0, -decay], driving))


def drive(random: np.random.Generator, filter: Filter, fixes: float, outage: float) -> tuple[float, float]:
    """Error of the heading [rad] and its stated deviation, after fixes each second and an outage, `fixes` and `outage`
    [s] long, of a car that goes straight."""
    h = GYRO["sample_time"]
    count, until = round((fixes + outage) / h), round(fixes / h)
    rate = biases(random, count, h, GYRO["bias"], GYRO["time_constant"])
    rate += GYRO["gyro_noise"] * random.standard_normal(count)
    filter.start(MARKOV_HEADING.start({}))
    for k in range(count):
        if k < until and k % round(1 / h) == 0:
            filter.correct(*HEADING.measured([_HEADING * random.standard_normal()]))
        filter.inputs[:] = rate[k]
        filter.predict(h)
    mean, covariance = filter.belief()
    return float(mean[0]), float(np.sqrt(covariance[0, 0]))


def examine() -> list[Finding]:
    """A hundred drives with fixes for five minutes, then none for one; the bias is believed to wander, or constant."""
    found = []
    for time_constant in (GYRO["time_constant"], 1e9):
        random, filter = np.random.default_rng(2004), MARKOV_HEADING.make(GYRO | {"time_constant": time_constant})
        found.append(np.array([drive(random, filter, 300.0, 60.0) for _ in range(100)]))
    rows = []
    for quantity, unit, judge in (
        ("heading after 60 s without fixes, RMSE", "°", lambda e: np.degrees(np.sqrt(np.mean(e[:, 0] ** 2)))),
        ("its NEES", "", lambda e: np.mean((e[:, 0] / e[:, 1]) ** 2)),
    ):
        values = [float(judge(one)) for one in found]
        rows.append(Finding("Markov bias", SOURCE, quantity, unit, values[0], "bias believed constant", values[1]))
    return rows
