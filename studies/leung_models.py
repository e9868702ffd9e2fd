"""What Leung 2010 says of vehicle models that nothing corrects: chapter 3 and section 5.2, side by side with ours.

The plant is the full car of `config/vehicles/jaguar_saloon.yaml` on his tracks; its tyres, driver and suspension are
ours, his were those of a commercial simulation. What needs no plant must come out as he prints it.

A table is rows of columns of `printed` and `ours`. Errors are percent of the range of the truth (his eq. 1.2), over the
whole run and with the centre of gravity as the point of reference.
"""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from pathlib import Path

import casadi as ca
import numpy as np
from numpy.typing import NDArray

from studies.handling.bicycle_3dof import Bicycle3Dof
from studies.handling.bicycle_5dof import Bicycle5Dof
from studies.handling.linear import output_values, system_matrices
from studies.handling.twin_track_3dof import TwinTrack3Dof
from studies.handling.twin_track_7dof import TwinTrack7Dof
from vsense_ros.assess.drives import trajectory
from vsense_ros.files.installed import vehicle_path
from vsense_ros.files.vehicle import load_vehicle
from vsense_ros.model.coordinates import SPEED_X, SPEED_Y, SPIN, STEERING, TORQUES, YAW, YAW_RATE
from vsense_ros.model.handling.base import HandlingModel, car_numbers, static_loads
from vsense_ros.model.handling.bicycle_2dof import Bicycle2Dof
from vsense_ros.model.handling.response import Response, Values
from vsense_ros.model.simulation.closed_loop import Trajectory, axle_of, rolling_radii
from vsense_ros.model.vehicle import Vehicle

Array = NDArray[np.float64]
Table = dict[str, dict[str, dict[str, float | None]]]

VEHICLE = "jaguar_saloon"
STEP = 0.01  # [s] of his models and sensors
SEEDS = 10
# Appendix B, at the steering wheel and of the wheels.
STEERING_BIAS, STEERING_NOISE, SPIN_NOISE = np.radians(5.0), np.radians(1.0), 0.04
MODELS = ("2DoF bicycle", "3DoF bicycle", "5DoF bicycle", "3DoF twin track", "7DoF twin track")
MANOEUVRE_ROWS = {
    **{f"DO{kph}": f"double_oval_{kph}" for kph in (15, 25, 35, 45, 55)},
    **{f"LC{kph}": f"lane_change_{kph}" for kph in (15, 25, 35, 45, 55)},
}

# Table 5.1: the car of section 5.2.2 alone, which oversteers.
CAR_5_1 = {
    "mass": 1858.0, "yaw_inertia": 3515.0, "to_front": 1.36, "to_rear": 1.55, "front_stiffness": 140_000.0,
    "rear_stiffness": 120_000.0,
}  # fmt: skip
PRINTED_3_4 = {
    "yaw rate DO25": (0.2017, 0.2126, 2.9606, 0.3800, 0.7096),
    "yaw rate LC25": (0.1263, 0.1543, 1.0734, 0.2245, 0.1846),
    "lateral velocity DO25": (0.2043, 0.2319, 1.2737, 0.2051, 0.5000),
    "lateral velocity LC25": (0.3010, 0.3395, 0.5272, 0.3416, 0.3040),
}
SENSITIVE_TO = ("front_stiffness", "rear_stiffness", "mass", "yaw_inertia", "to_front")
LABELS_5_2 = ("C_F", "C_R", "m", "J", "a/b")
PRINTED_5_2 = {  # |A|, |B|, then 1000 |dA/dp| and 1000 |dB/dp|
    5.0: (0.9965, 0.5623, (0.00416, 0.00475, 0.151, 0.0887, 703), (0.00402, 0, 0.0811, 0.154, 617)),
    10.0: (1.205, 0.547, (0.00394, 0.00450, 0.0753, 0.0444, 640), (0.00391, 0, 0.0406, 0.154, 617)),
}
PRINTED_5_3 = {  # side slip clean, noisy; yaw rate clean, noisy
    "DO15": (0.0725, 2.4016, 0.1601, 2.4212), "DO25": (0.1585, 2.5198, 0.2151, 2.3939),
    "DO35": (0.7168, 2.7793, 0.2438, 2.3401), "DO45": (5.0745, 4.2327, 0.2335, 2.3016),
    "DO55": (6.8651, 4.8325, 2.0390, 2.8444), "LC15": (0.1103, 7.1125, 0.0997, 6.8090),
    "LC25": (0.3190, 8.5723, 0.1290, 8.0845), "LC35": (0.7219, 8.8540, 0.2200, 8.9877),
    "LC45": (1.6872, 8.8018, 0.3901, 9.2137), "LC55": (6.9634, 9.4187, 0.4318, 9.5051),
}  # fmt: skip
COLUMNS_5_3 = ("beta clean", "beta noisy", "r clean", "r noisy")


@lru_cache(maxsize=1)
def plant() -> Vehicle:
    """The car that drives."""
    return load_vehicle(vehicle_path(VEHICLE))


@lru_cache(maxsize=16)
def driven(name: str, store: Path) -> Trajectory:
    """The plant in a manoeuvre, every 10 ms, as it is kept in `store`."""
    return trajectory(name, VEHICLE, store)


def nrmsd(estimate: Array, truth: Array) -> float:
    """Root mean square error over the range of the truth [%] (eq. 1.2)."""
    return float(100 * np.sqrt(np.mean((estimate - truth) ** 2)) / np.ptp(truth))


# --- table 3.4 -------------------------------------------------------------------------------------------------------


def handling_models(car: Vehicle) -> dict[str, tuple[HandlingModel, Response]]:
    """The five models with linear tyres, by their names in the thesis."""
    models: tuple[HandlingModel, ...] = (
        Bicycle2Dof(), Bicycle3Dof.of_vehicle(car), Bicycle5Dof.of_vehicle(car), TwinTrack3Dof.of_vehicle(car),
        TwinTrack7Dof.of_vehicle(car),
    )  # fmt: skip
    return {name: (model, Response(model, model.numbers(car))) for name, model in zip(MODELS, models, strict=True)}


def steered_wheels(vehicle: Vehicle, angle: Array) -> tuple[Array, Array]:
    """Angles of the left and the right front wheel (n,) for mean angles (n,) [rad], by the vehicle's share of
    Ackermann's geometry; suspension tables are left out."""
    physics = vehicle.physics
    wheelbase = physics.chassis.cog_to_front_axle + physics.chassis.cog_to_rear_axle
    share, tangent, half = physics.steering.ackermann, np.tan(angle), physics.front.track / 2
    left, right = (np.arctan2(wheelbase * tangent, wheelbase - side * half * tangent) for side in (1, -1))
    return (1 - share) * angle + share * left, (1 - share) * angle + share * right


def plant_inputs(model: HandlingModel, car: Vehicle, drive: Trajectory) -> Array:
    """What drives a model (n, k), taken from the plant without any error. Torques are less the rolling resistance,
    which the models do not know."""
    steering = drive.inputs[:, STEERING]
    left, right = steered_wheels(car, steering)
    spin, wheels = drive.u[:, SPIN], ("fl", "fr", "rl", "rr")
    coefficients = np.array([axle_of(car, i).rolling_resistance for i in range(4)])
    torque = drive.inputs[:, TORQUES] - coefficients * np.repeat(static_loads(car), 2) * rolling_radii(car)
    known = {
        "steering": steering,
        "speed": np.hypot(drive.u[:, SPEED_X], drive.u[:, SPEED_Y]),
        "steering_fl": left,
        "steering_fr": right,
        "spin_front": spin[:, :2].mean(axis=1),
        "spin_rear": spin[:, 2:].mean(axis=1),
        "torque_front": torque[:, :2].sum(axis=1),
        "torque_rear": torque[:, 2:].sum(axis=1),
        **{f"spin_{wheel}": spin[:, i] for i, wheel in enumerate(wheels)},
        **{f"torque_{wheel}": torque[:, i] for i, wheel in enumerate(wheels)},
    }
    return np.column_stack([known[name] for name in model.inputs])


def open_loop(name: str, drive: Trajectory) -> dict[str, Array]:
    """Forward and lateral velocity [m/s] and yaw rate [rad/s] of a model, (n,) each, driven as the plant."""
    model, response = handling_models(plant())[name]
    driven_by = plant_inputs(model, plant(), drive)
    start, _ = response.straight(float(drive.u[0, SPEED_X]))
    # Inputs of a kept instant are those of the millisecond that begins there: their mean is that of both ends.
    held = (driven_by[:-1] + driven_by[1:]) / 2
    states = response.drive(start, held, STEP)
    outputs = output_values(response, states, driven_by)
    by_output = {output: outputs[:, i] for i, output in enumerate(model.outputs)}
    speed = states[:, 0] if "forward_velocity" in model.states else driven_by[:, model.inputs.index("speed")]
    return {"forward": speed, "lateral": by_output["lateral_velocity"], "yaw_rate": by_output["yaw_rate"]}


def table_3_4(store: Path, manoeuvre: str) -> Table:
    """Open-loop errors of the five models in the manoeuvre of a row (DO25, LC25), with the plant's inputs."""
    drive = driven(MANOEUVRE_ROWS[manoeuvre], store)
    table: Table = {row: {} for row in PRINTED_3_4 if row.endswith(manoeuvre)}
    for k, name in enumerate(MODELS):
        ours = open_loop(name, drive)
        for words, key, truth in (("yaw rate", "yaw_rate", YAW_RATE), ("lateral velocity", "lateral", SPEED_Y)):
            line = f"{words} {manoeuvre}"
            error = nrmsd(ours[key], drive.u[:, truth])
            table[line][name] = {
                "printed": PRINTED_3_4[line][k],
                "ours": error,
                "range": float(np.ptp(drive.u[:, truth])),
            }
    return table


# --- table 5.2 -------------------------------------------------------------------------------------------------------


def sensitivities(speed: float, numbers: Mapping[str, float] = CAR_5_1) -> dict[str, Array]:
    """Matrices of the model in Euler's steps of 10 ms: A (2, 2), B (2, 1), and their derivatives by each of
    `SENSITIVE_TO`, "dA" (5, 2, 2) and "dB" (5, 2, 1); that by `to_front` keeps b, and is by a/b."""
    names = Bicycle2Dof().parameters
    p = ca.SX.sym("p", len(names))
    a, b = system_matrices(Values(names, p), speed)
    a, b = ca.SX.eye(2) + STEP * a, STEP * b
    both = ca.vertcat(ca.vec(a), ca.vec(b))
    at = np.array([numbers[name] for name in names])
    values, slopes = ca.Function("s", [p], [both, ca.jacobian(both, p)])(at)
    values, slopes = np.asarray(values).ravel(), np.asarray(slopes)
    columns = slopes[:, [names.index(name) for name in SENSITIVE_TO]].T.copy()
    columns[-1] *= numbers["to_rear"]
    return {
        "A": values[:4].reshape(2, 2, order="F"),
        "B": values[4:, None],
        "dA": np.array([column[:4].reshape(2, 2, order="F") for column in columns]),
        "dB": np.array([column[4:, None] for column in columns]),
    }


def table_5_2() -> Table:
    """Frobenius norms of A, B and their derivatives; besides, what the thesis does not print: relative sensitivities
    p |dA/dp|, which can be compared, and the largest eigenvalue, which shows whether it is stable (|A| does not)."""
    table: Table = {}
    for speed, (norm_a, norm_b, by_a, by_b) in PRINTED_5_2.items():
        ours = sensitivities(speed)
        row: dict[str, dict[str, float | None]] = {
            "|A|": {"printed": norm_a, "ours": float(np.linalg.norm(ours["A"]))},
            "|B|": {"printed": norm_b, "ours": float(np.linalg.norm(ours["B"]))},
            "largest eigenvalue": {"printed": None, "ours": float(np.abs(np.linalg.eigvals(ours["A"])).max())},
        }
        scale = [CAR_5_1[name] for name in SENSITIVE_TO[:-1]] + [CAR_5_1["to_front"] / CAR_5_1["to_rear"]]
        for k, label in enumerate(LABELS_5_2):
            by = {"dA": by_a[k], "dB": by_b[k]}
            for what, printed in by.items():
                size = float(np.linalg.norm(ours[what][k]))
                row[f"1000 |{what}/d{label}|"] = {"printed": float(printed), "ours": 1000 * size}
                row[f"p |{what}/d{label}|"] = {"printed": None, "ours": scale[k] * size}
        table[f"{speed:g} m/s"] = row
    return table


# --- open loop of the 2DoF model: table 5.3, figures 5.1 to 5.9 -------------------------------------------------------


def numbers_of(car: Vehicle) -> dict[str, float]:
    """Parameters of the 2DoF model of a car."""
    known = car_numbers(car)
    return {name: known[name] for name in Bicycle2Dof().parameters}


def bicycle_errors(
    numbers: Mapping[str, Array | float], steering: Array, speed: Array, truth: Mapping[str, Array], step: float = STEP
) -> dict[str, Array]:
    """Errors of many runs of the 2DoF model side by side [% of range]: of "side_slip", "yaw_rate" and "heading".

    Parameters are (m,) or numbers; steering and speed (n,) or (n, m) at the instants of the truth (n,), between which
    they are linear. Steps are by the trapezoidal rule: second order, and stable however slow the car.
    """
    sizes = [np.size(value) for value in numbers.values()] + [np.atleast_2d(steering.T).shape[0]]
    runs = max(sizes)
    front, rear, a, b = (numbers[k] for k in ("front_stiffness", "rear_stiffness", "to_front", "to_rear"))
    mass, inertia = numbers["mass"], numbers["yaw_inertia"]
    turning, damping, total = b * rear - a * front, a * a * front + b * b * rear, front + rear
    slip, rate, heading = np.zeros(runs), np.zeros(runs), np.zeros(runs)
    sums = np.zeros((3, runs))
    true = [truth[key] - (truth[key][0] if key == "heading" else 0.0) for key in ("side_slip", "yaw_rate", "heading")]
    half = step / 2
    for i in range(1, len(steering)):
        v, angle = (speed[i] + speed[i - 1]) / 2, (steering[i] + steering[i - 1]) / 2
        a11, a12 = -total / (mass * v), turning / (mass * v * v) - 1
        a21, a22 = turning / inertia, -damping / (inertia * v)
        # (I - h/2 A) x⁺ = (I + h/2 A) x + h B δ
        right_1 = slip + half * (a11 * slip + a12 * rate) + step * front / (mass * v) * angle
        right_2 = rate + half * (a21 * slip + a22 * rate) + step * a * front / inertia * angle
        m11, m12, m21, m22 = 1 - half * a11, -half * a12, -half * a21, 1 - half * a22
        det = m11 * m22 - m12 * m21
        before = rate
        slip, rate = (m22 * right_1 - m12 * right_2) / det, (m11 * right_2 - m21 * right_1) / det
        heading = heading + half * (before + rate)
        for k, value in enumerate((slip, rate, heading)):
            sums[k] += (value - true[k][i]) ** 2
    scale = np.array([np.ptp(one) for one in true])[:, None]
    percent = 100 * np.sqrt(sums / len(steering)) / scale
    return dict(zip(("side_slip", "yaw_rate", "heading"), percent, strict=True))


def truth_of(drive: Trajectory) -> dict[str, Array]:
    """Side slip, yaw rate and heading of a drive, (n,) [rad, rad/s]."""
    return {
        "side_slip": drive.side_slip, "yaw_rate": drive.u[:, YAW_RATE], "heading": np.unwrap(drive.q[:, YAW]),
    }  # fmt: skip


def noisy_inputs(car: Vehicle, drive: Trajectory, seeds: int, *, biased: bool = True) -> tuple[Array, Array]:
    """Road-wheel angle and speed (n, seeds) as the sensors of appendix B give them: the steering wheel's with bias and
    noise, the speed from the rear wheels and the radius that they have on the straight."""
    rng = np.random.default_rng(0)
    rows = len(drive.t)
    error = STEERING_NOISE * rng.standard_normal((rows, seeds)) + STEERING_BIAS * biased
    steering = drive.inputs[:, [STEERING]] + error / car.physics.steering.ratio
    spin = drive.u[:, SPIN][:, 2:].mean(axis=1, keepdims=True)
    radius = drive.u[0, SPEED_X] / spin[0] if spin[0] else rolling_radii(car)[2]
    return steering, radius * (spin + SPIN_NOISE / np.sqrt(2) * rng.standard_normal((rows, seeds)))


def table_5_3(store: Path, row: str) -> Table:
    """A row: errors of the 2DoF model with clean inputs and with those of sensors; the mean of ten noise runs. Besides,
    what a linear car makes of the steering bias: bias over range of the steering."""
    car = plant()
    numbers = numbers_of(car)
    drive = driven(MANOEUVRE_ROWS[row], store)
    truth = truth_of(drive)
    steering = drive.inputs[:, STEERING]
    speed = np.hypot(drive.u[:, SPEED_X], drive.u[:, SPEED_Y])
    clean = bicycle_errors(numbers, steering, speed, truth)
    noisy = bicycle_errors(numbers, *noisy_inputs(car, drive, SEEDS), truth)
    ours = [float(one[key].mean()) for key in ("side_slip", "yaw_rate") for one in (clean, noisy)]
    ranges = [float(np.ptp(truth[key])) for key in ("side_slip", "yaw_rate") for _ in (clean, noisy)]
    line: dict[str, dict[str, float | None]] = {
        column: {"printed": printed, "ours": value, "range": extent}
        for column, printed, value, extent in zip(COLUMNS_5_3, PRINTED_5_3[row], ours, ranges, strict=True)
    }
    bias = STEERING_BIAS / car.physics.steering.ratio
    line["bias over range"] = {"printed": None, "ours": float(100 * bias / np.ptp(steering))}
    return {row: line}


def sweep(drive: Trajectory, changes: Mapping[str, Array], *, consistent: bool = False) -> dict[str, Array]:
    """Errors of the 2DoF model with perfect inputs and wrong parameters: `changes` are factors (m,) of parameters.

    With `consistent` the truth is the 2DoF model itself with the right parameters, so that errors are those of the
    parameters alone.
    """
    numbers: dict[str, Array | float] = dict(numbers_of(plant()))
    steering, speed = drive.inputs[:, STEERING], np.hypot(drive.u[:, SPEED_X], drive.u[:, SPEED_Y])
    truth = truth_of(drive) if not consistent else model_truth(numbers_of(plant()), steering, speed)
    changed = {name: value * changes[name] if name in changes else value for name, value in numbers.items()}
    return bicycle_errors(changed, steering, speed, truth)


def model_truth(numbers: Mapping[str, float], steering: Array, speed: Array) -> dict[str, Array]:
    """What the 2DoF model itself does, (n,) each."""
    response = Response(Bicycle2Dof(), numbers)
    held = np.column_stack([steering, speed])
    states = response.drive(np.zeros(2), (held[:-1] + held[1:]) / 2, STEP)
    heading = np.concatenate([[0.0], np.cumsum((states[1:, 1] + states[:-1, 1]) / 2) * STEP])
    return {"side_slip": states[:, 0], "yaw_rate": states[:, 1], "heading": heading}


def stiffness_map(drive: Trajectory, factors: Array) -> dict[str, Array]:
    """Errors (f, f) over factors of the front (rows) and the rear (columns) axle's stiffness."""
    front, rear = (grid.ravel() for grid in np.meshgrid(factors, factors, indexing="ij"))
    errors = sweep(drive, {"front_stiffness": front, "rear_stiffness": rear})
    return {key: value.reshape(len(factors), -1) for key, value in errors.items()}


def bias_map(drive: Trajectory, biases: Array, noises: Array) -> dict[str, Array]:
    """Errors (b, s) over biases (rows) and noise (columns) of the steering wheel's angle [rad], one noise run."""
    car = plant()
    noise = np.random.default_rng(0).standard_normal((len(drive.t), 1))
    bias, deviation = (grid.ravel() for grid in np.meshgrid(biases, noises, indexing="ij"))
    steering = drive.inputs[:, [STEERING]] + (bias + deviation * noise) / car.physics.steering.ratio
    speed = np.hypot(drive.u[:, [SPEED_X]], drive.u[:, [SPEED_Y]])
    errors = bicycle_errors(numbers_of(car), steering, np.broadcast_to(speed, steering.shape), truth_of(drive))
    return {key: value.reshape(len(biases), -1) for key, value in errors.items()}
