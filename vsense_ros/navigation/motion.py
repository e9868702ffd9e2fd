"""The car's motion as a filter of GNSS and inertial sensors estimates it, and as messages."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import casadi as ca
import numpy as np

from vsense_ros.estimation.filter import Array
from vsense_ros.estimation.state_space import Symbols, expression
from vsense_ros.messages import estimates as messages
from vsense_ros.messages.recording import Sample
from vsense_ros.navigation.aided import Aided
from vsense_ros.navigation.space import MOTION, filters_of, parameters_of

_SMALLEST_SPEED = 0.5  # [m/s] below it a side-slip angle has no meaning
_ACCELERATIONS = slice(MOTION.index("forward_acceleration"), MOTION.index("vertical_acceleration") + 1)
_FORWARD, _LATERAL, _SIDE_SLIP = (MOTION.index(n) for n in ("forward_velocity", "lateral_velocity", "side_slip"))


@dataclass(frozen=True)
class Snapshot:
    """A filter at one time: mean (n,), covariance (e, e), inputs (k,) and their variances (k,) of each of its parts."""

    stamp: int  # [ns]
    parts: tuple[tuple[Array, Array, Array, Array], ...]


@dataclass(frozen=True)
class Motions:
    """The motion of a car at n times, in the order of `MOTION`: `value` (n, 16), NaN of what the filter does not
    estimate, and covariances of pose and twist, in which the variance of that is `UNESTIMATED_VARIANCE`; slow states
    with their standard deviations."""

    stamp: np.ndarray  # (n,) [ns]
    value: Array
    pose_covariance: Array  # (n, 6, 6)
    twist_covariance: Array  # (n, 6, 6)
    acceleration_covariance: Array  # (n, 3, 3)
    side_slip: Array  # (n, 3): angle, deviation, rate (not estimated: 0)
    estimated: tuple[str, ...]  # names of `MOTION`
    parameter_names: tuple[str, ...]
    parameters: Array
    deviations: Array

    def samples(self) -> list[Sample]:
        """As the messages of the output topics; of one time without the axis in front."""
        is_single = len(self.stamp) == 1
        row = (lambda a: a[0]) if is_single else (lambda a: a)
        stamp, v = int(self.stamp[0]), row(self.value)
        pose, twist = row(self.pose_covariance), row(self.twist_covariance)
        orientation = messages.quaternion(np.nan_to_num(v[..., 3:6]))  # an angle that is not estimated is zero
        samples = [messages.odometry(stamp, v[..., 0:3], orientation, pose, v[..., 6:9], v[..., 9:12], twist)]
        if "forward_acceleration" in self.estimated:
            rows = v.shape[:-1]
            covariance = np.zeros((*rows, 6, 6))
            covariance[..., :3, :3] = row(self.acceleration_covariance)
            covariance[..., [3, 4, 5], [3, 4, 5]] = messages.UNESTIMATED_VARIANCE
            flat = covariance.reshape(*rows, 36)
            samples.append(messages.acceleration(stamp, v[..., 12:15], np.zeros((*rows, 3)), flat))
        if self.has_side_slip:
            samples.append(messages.side_slip(stamp, row(self.side_slip)))
        if self.parameter_names:
            samples.append(messages.parameters(stamp, self.parameter_names, row(self.parameters), row(self.deviations)))
        return samples

    @property
    def has_side_slip(self) -> bool:
        """True if the filter estimates the lateral velocity, or the angle itself."""
        return "side_slip" in self.estimated or {"forward_velocity", "lateral_velocity"} <= set(self.estimated)


class Readout:
    """The way from snapshots of one filter to motions."""

    def __init__(self, filter: Aided) -> None:
        self._filter = filter
        self._parts = filters_of(filter.filter)
        definition = filter.definition
        functions, names = [], []
        slow: list[str] = []
        self._slow: list[tuple[int, list[int], list[int]]] = []
        for i, (part, (system, _)) in enumerate(definition.parts.items()):
            symbols = Symbols(system)
            estimated = system.motion(symbols.x, symbols.u, symbols.theta)
            value = expression(list(estimated.values()))
            by_input = ca.densify(ca.jacobian(value, symbols.u.vector))
            functions.append(ca.Function("motion", symbols.now, [value, symbols.by_error(value), by_input]))
            names.append(list(estimated))
            own_names = [n for n in system.names if n not in MOTION and n in system.error_names]
            slow += [f"{part}.{n}" if definition.is_cascade else n for n in own_names]
            places = [system.names.index(n) for n in own_names], [system.error_names.index(n) for n in own_names]
            self._slow.append((i, *places))
        self._functions, self.parameter_names = functions, tuple(slow)
        source = {name: (i, j) for i, estimated_names in enumerate(names) for j, name in enumerate(estimated_names)}
        self._estimated = [(MOTION.index(name), *source[name]) for name in MOTION if name in source]
        self.estimated = tuple(name for name in MOTION if name in source)

    def snapshot(self, stamp: int) -> Snapshot:
        """The filter now."""
        of_inputs = self._filter.variances_of_inputs()
        parts = zip(self._parts, of_inputs, strict=True)
        return Snapshot(stamp, tuple((p.mean.copy(), p.covariance.copy(), p.inputs.copy(), v) for p, v in parts))

    def motions(self, snapshots: Sequence[Snapshot]) -> Motions:
        """Motions at the times of one or more snapshots."""
        n, count = len(snapshots), len(MOTION)
        value, covariance = np.full((n, count), np.nan), np.zeros((n, count, count))
        of_parts: list[tuple[Array, Array]] = []  # values (n, k) and their covariances (n, k, k)
        for i, (function, part) in enumerate(zip(self._functions, self._parts, strict=True)):
            mean, spread, inputs, of_inputs = (np.array([s.parts[i][k] for s in snapshots]) for k in range(4))
            theta = parameters_of(part)
            mapped = function.map(n) if n > 1 else function
            mapped_values, *slopes = mapped(mean.T, inputs.T, np.repeat(theta[:, None], n, axis=1))
            k = function.size1_out(0)
            by_error, by_input = (np.array(slope).reshape(k, n, -1).transpose(1, 0, 2) for slope in slopes)
            by_states = by_error @ spread @ by_error.transpose(0, 2, 1)
            by_readings = (by_input * of_inputs[:, None, :]) @ by_input.transpose(0, 2, 1)
            of_parts.append((np.array(mapped_values).T, by_states + by_readings))
        for place, i, row in self._estimated:
            value[:, place] = of_parts[i][0][:, row]
            for second_place, j, column in self._estimated:
                if i == j:
                    covariance[:, place, second_place] = of_parts[i][1][:, row, column]
        absent = [i for i, name in enumerate(MOTION) if name not in self.estimated]
        covariance[:, absent, absent] = messages.UNESTIMATED_VARIANCE
        slip = _side_slip(value, covariance, self.estimated)
        parameters = np.hstack([np.array([s.parts[i][0][m] for s in snapshots]) for i, m, _ in self._slow])
        variances = np.hstack([np.array([s.parts[i][1].diagonal()[e] for s in snapshots]) for i, _, e in self._slow])
        return Motions(
            np.array([s.stamp for s in snapshots]),
            value,
            covariance[:, 0:6, 0:6],
            covariance[:, 6:12, 6:12],
            covariance[:, _ACCELERATIONS, _ACCELERATIONS],
            slip,
            self.estimated,
            self.parameter_names,
            parameters,
            np.sqrt(variances.clip(min=0)),
        )


def _side_slip(value: Array, covariance: Array, estimated: Sequence[str]) -> Array:
    """Angle, standard deviation and rate (n, 3); zero with an infinite deviation at rest. There is no rate."""
    side_slip = np.zeros((len(value), 3))
    forward, lateral = np.nan_to_num(value[:, [_FORWARD, _LATERAL]]).T
    rests = np.hypot(forward, lateral) < _SMALLEST_SPEED
    if "side_slip" in estimated:
        angle, variance = value[:, _SIDE_SLIP], covariance[:, _SIDE_SLIP, _SIDE_SLIP]
        rests &= "forward_velocity" in estimated
    else:
        square = np.maximum(forward**2 + lateral**2, _SMALLEST_SPEED**2)
        slope = np.stack([-lateral / square, forward / square], axis=1)
        block = covariance[:, [_FORWARD, _LATERAL]][:, :, [_FORWARD, _LATERAL]]
        angle, variance = np.arctan2(lateral, forward), np.einsum("ni,nij,nj->n", slope, block, slope)
    side_slip[:, 0] = np.where(rests, 0.0, angle)
    side_slip[:, 1] = np.where(rests, np.inf, np.sqrt(variance.clip(min=0)))
    return side_slip
