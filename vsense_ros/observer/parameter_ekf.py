"""The parameter filter as an EKF: exact derivatives by the parameters, of which the observer's future work in
Rodríguez 2020 speaks."""

from __future__ import annotations

import casadi as ca

from vsense_ros import codegen
from vsense_ros.model.car.steps import sensitivity_function
from vsense_ros.model.coordinates import COORDINATES, DISTURBANCES
from vsense_ros.model.sensors import SensorBase
from vsense_ros.observer.parameter_filter import ParameterFilter, numbered
from vsense_ros.observer.state import DISTURB, Q, U


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
        m, k, s = len(sensor.deviations()), self.count, self.sensitivity
        effect = ca.SX.sym("effect", COORDINATES, k)
        bias, mounting = ca.SX.sym("biases", len(sensor.biases())), ca.SX.sym("mounting", len(sensor.mounting()))
        by_q, by_u, by_udot = (ca.SX.sym(name, m, COORDINATES) for name in ("by_q", "by_u", "by_udot"))
        by_disturbances, by_biases = ca.SX.sym("by_disturbances", m, len(DISTURBANCES)), ca.SX.sym("by_biases", m)
        innovation = by_q @ s[Q, :] + by_u @ s[U, :] + by_disturbances @ s[DISTURB, :]
        if sensor.uses_acceleration:
            innovation += by_udot @ (self.through(s) + effect)
        if biases.stop > biases.start:
            innovation += ca.repmat(by_biases, 1, k) * s[biases, :]
        root = ca.chol(self.covariance).T
        return ca.Function(
            "spread",
            [*self.arguments, effect, bias, mounting, by_q, by_u, by_udot, by_disturbances, by_biases],
            [ca.densify(innovation @ root), ca.densify(root)],
        )
