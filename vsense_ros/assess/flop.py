"""Floating-point operations of an observer's step, counted in its expressions and its algebra, by what they are for."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import casadi as ca

from vsense_ros import codegen
from vsense_ros.model.car import steps
from vsense_ros.model.car.car import car_of
from vsense_ros.model.car.full_car import FullCar
from vsense_ros.model.car.parts import CarInParts
from vsense_ros.model.car.steps import sensor_function
from vsense_ros.model.coordinates import COORDINATES, POSE, WHEELS
from vsense_ros.model.multibody.augmented_lagrangian import Equations
from vsense_ros.model.multibody.mechanism import Linkage
from vsense_ros.model.multibody.semi_recursive import Motion
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.observer.car_memory import SLOW
from vsense_ros.observer.sensors import sensors_of
from vsense_ros.observer.spi import FILTERS, equations_of
from vsense_ros.observer.state import FOLLOWED, GAIN_COLUMNS, ROAD_STATES, layout

FILLED = 20  # columns of a Jacobian that are not zero, of a sensor without accelerations
BODY_FLOP = 93  # of R J Rᵀ and m R s


def flop_of_filter(vehicle: Vehicle) -> float:
    """Operations of a step of the errorEKF with every sensor once, without those that move the car itself:
    linearisation, covariance, corrections."""
    car, sensors = car_of(vehicle), sensors_of(vehicle)
    functions = [steps.linearize_function(car), steps.kinematics_function(car), steps.force_function(car)]
    correcting = [s for s in sensors.values() if not s.is_input]
    functions += [sensor_function(car, s) for s in correcting]
    model = 14
    gained = 2 * model**3 * 3 + 2 * model * 39 * model  # the inverse, and its products
    return float(sum(map(operations, functions)) + gained) + flop_of_covariance(vehicle)


def flop_of_covariance(vehicle: Vehicle) -> float:
    """Operations on the covariance in a step of the filter and corrections by every sensor, as observer/car_blocks.c
    makes them without vectors: of what is symmetric one half, and none with zeros."""
    n = layout(sensors_of(vehicle)).size
    q, gain, slow, road, followed = (
        COORDINATES,
        len(GAIN_COLUMNS),
        n - SLOW,
        ROAD_STATES.stop - ROAD_STATES.start,
        len(FOLLOWED),
    )
    pose = POSE.stop - POSE.start
    products = q * gain * (n + q / 2)
    products += pose * (followed + 3) * (n + q) + (q - pose) * (n + q)
    products += road * followed * (n + road) + slow * (n + SLOW)
    learns = bool(vehicle.observer.parameters)
    for m, columns in _corrections(vehicle):
        products += m * columns * n + m * m * n / 2 + m**3 / 6  # H P, its product with H, and that factored
        products += m * (m + 1) / 2 * n * (2 if learns else 1) + n * m * n / 2  # in independent units, and subtracted
    return 2.0 * products


def factored(vehicle: Vehicle) -> float:
    """Operations of a correction that are left to the processor where a kernel keeps the covariance: H P Hᵀ + R,
    factored, and the factor's inverse; for the parameters of an SPI the gain, too."""
    n, learns = layout(sensors_of(vehicle)).size, bool(vehicle.observer.parameters)
    each = [m * m * columns / 2 + m**3 / 3 + learns * m * (m + 1) / 2 * n for m, columns in _corrections(vehicle)]
    return 2.0 * sum(each)


def _corrections(vehicle: Vehicle) -> list[tuple[int, int]]:
    """Components of each sensor, and how many columns of its Jacobian are not zero."""
    columns = {True: len(GAIN_COLUMNS) + 1, False: FILLED}
    sensors = (s for s in sensors_of(vehicle).values() if not s.is_input)
    return [(len(s.deviations()), columns[s.uses_acceleration]) for s in sensors]


def operations(function: ca.Function) -> int:
    """Floating-point operations of a function, without moving numbers."""
    moves = {ca.OP_INPUT, ca.OP_OUTPUT, ca.OP_CONST, ca.OP_ASSIGN}
    scalar = codegen.expanded(function)
    return sum(scalar.instruction_id(k) not in moves for k in range(scalar.n_instructions()))


@dataclass(frozen=True)
class Operations:
    """Floating-point operations of a step: what is done once, in each iteration, and in each evaluation of the
    equations; of these what kernels can do, and what the processor has left of it where they do."""

    once: float
    iteration: float
    factor: float  # of the matrix, in a step
    solve: float  # in an iteration
    mass_matrix: float  # in an evaluation
    update_motion: float  # in an evaluation
    check_mass: float
    check_motion: float

    def processor(self, iterations: float, evaluations: float, kernels: Collection[str] = ()) -> float:
        """Operations of the processor in a step."""
        flop = self.once + iterations * self.iteration
        if "solve" not in kernels:
            flop += self.factor + iterations * self.solve
        flop += evaluations * (self.check_mass if "body_mass" in kernels else self.mass_matrix)
        return flop + evaluations * (self.check_motion if "suspension_motion" in kernels else self.update_motion)

    def shares(self, iterations: float, evaluations: float) -> dict[str, float]:
        """Shares of parts of the whole step [%], by the names of Rodríguez 2020."""
        parts = {
            "mass matrix": evaluations * self.mass_matrix,
            "update motion": evaluations * self.update_motion,
            "solver": self.factor + iterations * self.solve,
        }
        return {name: 100 * part / self.processor(iterations, evaluations) for name, part in parts.items()}


def flop_of_simplified(vehicle: Vehicle) -> Operations:
    """Operations of a step by the implicit rule, counted in the expressions and the algebra; of an SPI where the
    vehicle lists parameters."""
    parts, n = CarInParts(vehicle), COORDINATES
    columns, inertias = operations(parts.columns_function()), operations(parts.inertias_function())
    dynamics = operations(parts.dynamics_function())
    once = flop_of_filter(vehicle) + dynamics + operations(parts.mass_function()) + 2 * n**3
    return Operations(
        once=once + (flop_of_parameters(vehicle) if vehicle.observer.parameters else 0.0),
        iteration=dynamics + 2 * n * n + 6 * n,
        factor=0.0,  # each iteration solves anew, as on the accelerator
        solve=2 / 3 * n**3 + 2 * n**2,
        mass_matrix=inertias,
        update_motion=columns,
        check_mass=operations(parts.axes_function()) + len(WHEELS) * 45,
        # One polynomial in place of six, and the sums that are compared with it.
        check_motion=operations(parts.places_function()) + columns / 6 + len(WHEELS) * 15,
    )


def flop_of_parameters(vehicle: Vehicle) -> float:
    """Operations of the parameter filter of a vehicle that lists parameters, in a step with every sensor once."""
    car, sensors = car_of(vehicle), sensors_of(vehicle)
    biases = tuple((where.start, where.stop) for where in layout(sensors).biases)
    columns = tuple(car.parameter_names.index(name) for name in vehicle.observer.parameters)
    made = FILTERS[vehicle.observer.parameter_filter](car, columns, layout(sensors).size)
    return float(sum(map(operations, equations_of(made, tuple(sensors.values()), biases))))


def flop_of_full(vehicle: Vehicle, substeps: int) -> Operations:
    """Operations of a step of the full car in `substeps`, whose systems a processor solves by elimination of one branch
    after the other."""
    mechanism = FullCar(vehicle).mechanism
    equations = Equations(mechanism)
    branches, sizes = mechanism.branches, [len(linkage.coordinate_names) for linkage in mechanism.branches]
    bodies = sum(len(linkage.bodies) for linkage in branches)
    mass, motion = float(BODY_FLOP * bodies), float(sum(operations(_moving(linkage)) for linkage in branches))

    def total(name: str) -> float:
        return float(sum(operations(equations.function_of(i, name)) for i in range(len(branches))))

    inverted = 2 * 6**3 + sum(2 * k**3 + 2 * 2 * 6 * k * k + 2 * 36 * k for k in sizes)
    solved = 2 * 36 + sum(2 * k * k + 2 * 12 * k for k in sizes)
    projected = total("tangent") + inverted + 5 * total("constraints") + 4 * solved
    once = flop_of_filter(vehicle) + substeps * (total("tangent") - motion - mass + projected)
    return Operations(
        once=once + (flop_of_parameters(vehicle) if vehicle.observer.parameters else 0.0),
        iteration=total("evaluate") - motion - mass + 10 * mechanism.coordinates,
        factor=substeps * inverted,
        solve=solved,
        mass_matrix=mass,
        update_motion=motion,
        check_mass=20.0 * bodies,
        check_motion=motion,
    )


def _moving(linkage: Linkage) -> ca.Function:
    """Function for position and motion of the bodies of a linkage."""
    n, g = len(linkage.coordinate_names), len(linkage.guides)
    z, dz, ddz, guides = (
        ca.SX.sym(name, *size) for name, size in (("z", (n,)), ("dz", (n,)), ("ddz", (n,)), ("g", (g, 3)))
    )
    frames = [Motion(linkage, z, dz, ddz, guides).frames[body.name] for body in linkage.bodies]
    outputs = [ca.veccat(f.rotation, f.origin, f.velocity, f.acceleration) for f in frames]
    return codegen.function(
        "moving", [z, dz, ddz, guides, linkage.parameters], [ca.vertcat(*outputs)], ("z", "dz", "ddz", "guides", "p")
    )
