"""The parameter filter as a UKF (Julier & Uhlmann 1997), as Rodríguez 2020 has it: sigma points instead of derivatives.

Every sigma point is a car with other parameters, in the state in which the errorEKF would then have it.
"""

from __future__ import annotations

import casadi as ca
import numpy as np

from vsense_ros import codegen
from vsense_ros.model.car.kinematics import motion_of
from vsense_ros.model.coordinates import COORDINATES, DISTURBANCES
from vsense_ros.model.sensors import SensorBase
from vsense_ros.observer.parameter_filter import ParameterFilter, numbered
from vsense_ros.observer.state import DISTURB, DYNAMIC, FORCE, Q, U

KAPPA = 1.0  # positive, so that all weights are; with two parameters the points have the kurtosis of the normal one


class ParameterUkf(ParameterFilter):
    """Sensitivities by regression over 2k + 1 sigma points, and what they leave out as additional noise."""

    @property
    def width(self) -> int:
        return 2 * self.count + 1

    @property
    def weights(self) -> np.ndarray:
        """Weights of the sigma points (p,): the mean, then above and below it along each column of the root."""
        return np.array([KAPPA, *[0.5] * (2 * self.count)]) / (self.count + KAPPA)

    @property
    def displacement(self) -> float:
        return float(self.weights[0] ** -0.5)

    def points(self, covariance: ca.SX) -> ca.SX:
        """Deviations of the sigma points from the mean (k×p)."""
        step = (self.count + KAPPA) ** 0.5 * ca.chol(covariance).T
        return ca.horzcat(ca.SX.zeros(self.count, 1), step, -step)

    def _deviations(self, arguments: list[ca.MX]) -> tuple[ca.MX, ca.MX]:
        """Deviations of all sigma points from the mean: of the parameters (k×p) and of the state (n×p)."""
        m = ca.SX.sym("m", self.count, self.count)
        deviation = ca.Function("points", [m], [ca.densify(self.points(m))])(arguments[11])
        return deviation, arguments[10] @ deviation

    def accelerations(self, arguments: list[ca.MX], deviation: ca.MX, of_state: ca.MX) -> ca.MX:
        """Accelerations of the cars of all sigma points (14×p), without what errors of the forces add."""
        p = self.width
        names = ca.DM.zeros(self.car.p.numel(), self.count)
        for i, column in enumerate(self.columns):
            names[column, i] = 1
        q, u, force, around, inputs, parameters = (ca.repmat(a, 1, p) for a in arguments[:6])
        dynamics = ca.Function("f", [*self.state, self.car.internal_state], [self.car.dynamics], {"cse": True})
        return dynamics.map(p)(
            q + of_state[Q, :],
            u + of_state[U, :],
            force,
            around + of_state[DISTURB, :],
            inputs,
            parameters + names @ deviation,
            ca.repmat(arguments[12], 1, p),
        )

    def _sensor(self, sensor: SensorBase) -> ca.Function:
        """(q, u, udot, disturbances, inputs, biases, mounting) → measurement (m)."""
        bias, mounting = ca.SX.sym("biases", len(sensor.biases())), ca.SX.sym("mounting", len(sensor.mounting()))
        state = self.car.q, self.car.u, self.udot, self.car.disturbances, self.car.inputs
        motion, arguments = motion_of(*state), [*state, bias, mounting]
        return ca.Function("h", arguments, [ca.densify(sensor.equation(motion, bias, mounting))], {"cse": True})

    def effect(self) -> ca.Function:
        arguments = [ca.MX.sym("a", *a.shape) for a in self.arguments]
        deviation, of_state = self._deviations(arguments)
        accelerations = self.accelerations(arguments, deviation, of_state)
        s, nothing = arguments[10], ca.MX.zeros(COORDINATES, self.count)
        linear_effect = self.through(arguments, s[DYNAMIC.tolist(), :], s[U, :], s[DISTURB, :], nothing)
        remaining = accelerations - linear_effect @ deviation
        weighted = ca.DM(np.diag(self.weights)) @ deviation.T
        m = ca.SX.sym("m", self.count, self.count)
        x = ca.SX.sym("x", COORDINATES, self.count)
        factor = ca.chol(m)
        regress = ca.Function("regress", [x, m], [ca.solve(factor, ca.solve(factor.T, x.T)).T])
        return codegen.function(
            "parameters_effect", arguments, [regress(remaining @ weighted, arguments[11])], numbered(len(arguments))
        )

    def spread(self, sensor: SensorBase, biases: slice) -> ca.Function:
        p, m = self.width, len(sensor.deviations())
        arguments = [ca.MX.sym("a", *a.shape) for a in self.arguments]
        effect = ca.MX.sym("effect", COORDINATES, self.count)
        bias, mounting = ca.MX.sym("biases", len(sensor.biases())), ca.MX.sym("mounting", len(sensor.mounting()))
        jacobians = [ca.MX.sym("by", m, columns) for columns in (14, 14, 14, len(DISTURBANCES), 1)]
        q, u, _, around, inputs = (ca.repmat(a, 1, p) for a in arguments[:5])
        udot = ca.repmat(arguments[6], 1, p)
        deviation, of_state = self._deviations(arguments)
        if sensor.uses_acceleration:
            accelerations = self.accelerations(arguments, deviation, of_state)
            udot += accelerations - ca.repmat(accelerations[:, 0], 1, p) + of_state[FORCE, :]
        shifted = ca.repmat(bias, 1, p)
        if biases.stop > biases.start:
            shifted += of_state[biases, :]
        measured = self._sensor(sensor).map(p)(
            q + of_state[Q, :],
            u + of_state[U, :],
            udot,
            around + of_state[DISTURB, :],
            inputs,
            shifted,
            ca.repmat(mounting, 1, p),
        )
        weights = ca.DM(self.weights)
        scale = ca.DM(np.diag(self.weights**0.5))
        columns = (measured - ca.repmat(measured @ weights, 1, p)) @ scale
        return ca.Function(
            "spread", [*arguments, effect, bias, mounting, *jacobians], [columns, deviation @ scale], {"cse": True}
        )
