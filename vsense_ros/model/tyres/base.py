"""What every tyre model is: its parameters, and methods that give forces from the motion of the contact patch."""

from __future__ import annotations

from abc import abstractmethod
from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

from vsense_ros.model.parameter import Part, Scalar


@dataclass(frozen=True, slots=True, eq=False)
class TyreInput:
    """What the forces of a tyre depend on, in the axes of the contact patch (ISO 8855): symbols or numbers."""

    load: Scalar  # of the wheel [N]
    speed_x: Scalar  # velocity of the contact point, ahead [m/s]
    speed_y: Scalar  # and to the left [m/s]
    rolling_speed: Scalar  # effective radius times spin [m/s]
    friction: Scalar = 1.0  # grip of the road over that of the road on which the tyre was measured [-]
    camber: Scalar = 0.0  # inclination angle, positive where the top leans to the right (ISO 8855) [rad]
    side: Scalar = 1.0  # 1 for a wheel on the left of the car, -1 on the right


class TyreForces(NamedTuple):
    """What the road does to a tyre, in the axes of the contact patch, and the slips that it comes from."""

    longitudinal: Scalar  # force [N]
    lateral: Scalar  # force [N]
    aligning_moment: Scalar  # about the upward normal of the road [N m]
    longitudinal_slip: Scalar  # sliding velocity over the speed that the model refers it to [-]
    lateral_slip: Scalar  # likewise; minus the tangent of the slip angle [-]


class RelaxationLengths(NamedTuple):
    """Distances that a tyre rolls until 63 % of a change of its steady force have built up [m]."""

    longitudinal: Scalar
    lateral: Scalar


class Tyre(Part):
    """Parameters of a tyre, and its equations.

    A tyre model is a class of a file of its own in this folder, with a field `model`, whose one allowed value is the
    name by which files choose it, and a field `standstill_speed` [m/s], which keeps slip finite at rest. Fields hold
    numbers, or symbols where the tyre is part of a model (`parameter.symbols`).
    """

    if TYPE_CHECKING:  # declared by each model, in the order in which its file lists its parameters
        model: str
        standstill_speed: float

    @abstractmethod
    def forces(self, wheel: TyreInput) -> TyreForces:
        """Steady forces and slips."""

    @abstractmethod
    def relaxation_lengths(self, wheel: TyreInput) -> RelaxationLengths:
        """Distances over which the forces build up.

        A model of a car that has the forces among its states lets them follow with `relaxation_rate`; others leave the
        lag out.
        """

    @abstractmethod
    def steepest_slope(self, load: Scalar) -> Scalar:
        """Largest increase of longitudinal force per longitudinal slip at a wheel load [N]: keeps time steps stable."""

    @abstractmethod
    def cornering_stiffness_at(self, load: Scalar) -> Scalar:
        """Lateral force per slip angle at zero slip and a wheel load, positive [N/rad]."""
