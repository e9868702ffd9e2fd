"""The parameter filter as an EKF: exact derivatives by the parameters, of which the observer's future work in
Rodríguez 2020 speaks."""

from __future__ import annotations

import casadi as ca

from vsense_ros import codegen
from vsense_ros.model.car.steps import sensitivity_function
from vsense_ros.model.coordinates import COORDINATES, DISTURBANCES
from vsense_ros.model.sensors import SensorBase
from vsense_ros.observer.parameter_filter import ParameterFilter, function, numbered, product
from vsense_ros.observer.state import DISTURB, DYNAMIC, FORCE, Q, U


class ParameterEkf(ParameterFilter):
    """Sensitivities by automatic differentiation of the car's dynamics, of the columns that are wanted alone."""

    @property
    def width(self) -> int:
        return self.count

    def effect(self) -> ca.Function:
        state = [*self.state, self.car.internal_state]
        effect = sensitivity_function(self.car, self.columns)(*state)
        return codegen.function("parameters_effect", self.arguments, [effect], numbered(len(self.arguments)))

    def spread(self, sensor: SensorBase, biases: slice) -> ca.Function:
        m, k = len(sensor.deviations()), self.count
        arguments = [ca.MX.sym("a", *a.shape) for a in self.arguments]
        effect = ca.MX.sym("effect", COORDINATES, k)
        bias, mounting = ca.MX.sym("biases", len(sensor.biases())), ca.MX.sym("mounting", len(sensor.mounting()))
        jacobians = [ca.MX.sym("by", m, columns) for columns in (COORDINATES,) * 3 + (len(DISTURBANCES), 1)]
        of_q, of_u, around, dynamic, direct, of_biases = self._apart(biases)(arguments[10], effect)
        innovation = product(jacobians[0], of_q, product(jacobians[1], of_u, product(jacobians[3], around)))
        if sensor.uses_acceleration:
            innovation = product(jacobians[2], self.through(arguments, dynamic, of_u, around, direct), innovation)
        results = self._rooted(m, of_biases.shape)(innovation, jacobians[4], of_biases, arguments[11])
        return ca.Function("spread", [*arguments, effect, bias, mounting, *jacobians], list(results))

    def _apart(self, biases: slice) -> ca.Function:
        """(S, effect) → S of coordinates, velocities, disturbances, dynamic coordinates, that of accelerations with the
        effect, and that of a sensor's biases."""
        s, effect = self.sensitivity, ca.SX.sym("effect", COORDINATES, self.count)
        of_biases = s[biases, :]
        results = [s[Q, :], s[U, :], s[DISTURB, :], s[DYNAMIC.tolist(), :], s[FORCE, :] + effect, of_biases]
        return function("apart", [s, effect], results)

    def _rooted(self, m: int, of_biases: tuple[int, int]) -> ca.Function:
        """(what parameters do to the measurement without biases (m×k), derivatives by biases (m), S of these, M) → what
        a standard deviation does (m×k), root of M."""
        unbiased, bias_sensitivity = ca.SX.sym("unbiased", m, self.count), ca.SX.sym("bias_sensitivity", *of_biases)
        by_biases, root = ca.SX.sym("by_biases", m), ca.chol(self.covariance).T
        total = (
            unbiased + ca.repmat(by_biases, 1, self.count) * bias_sensitivity if bias_sensitivity.numel() else unbiased
        )
        return function("rooted", [unbiased, by_biases, bias_sensitivity, self.covariance], [total @ root, root])
