"""The vehicle file that a case gives to the tool: what an engineer would have of this car, and up to 15 % wrong.

Geometry, springs and sensors are known. The tyre is one of the tool's models, fitted to the plant's tyre by least
squares of the pure-slip curves at the nominal load and at twice that load, slips up to 0.3, small slips weighing more.
Then mass and inertia (±10 %), stiffness and friction of the tyres of each axle (±15 %) and the place of the centre of
gravity (±3 %) are drawn off, so that a re-fit is needed, and can hide what is hidden.
"""

from __future__ import annotations

from collections.abc import Collection
from pathlib import Path
from types import SimpleNamespace

import numpy as np
from ruamel.yaml import YAML
from scipy.optimize import least_squares

from blind.cars import Axle, Car
from blind.sensors import GRADES, Mounting
from blind.tyres import FORMULAS

SLIPS = np.linspace(0.004, 0.3, 75)
WEIGHTS = 1 / (SLIPS + 0.02)  # most driving is at small slip
WRONG = {"mass": 0.10, "inertia": 0.10, "stiffness": 0.15, "friction": 0.15, "cog_height": 0.03, "cog_along": 0.03}


def drawn_errors(rng: np.random.Generator) -> dict[str, float]:
    """Factors on the parameters of a car, by name."""
    names = {
        "mass": "mass", "inertia": "inertia", "front_stiffness": "stiffness", "rear_stiffness": "stiffness",
        "front_friction": "friction", "rear_friction": "friction", "cog_height": "cog_height", "cog_along": "cog_along",
    }  # fmt: skip
    return {name: 1 + WRONG[kind] * rng.uniform(-1, 1) for name, kind in names.items()}


def write(path: Path, car: Car, formula: str, model: str, mounting: Mounting, grade: str, wrong: dict[str, float]):
    """Write the file; `model` is `tmeasy` or `magic_formula`."""
    g = GRADES[grade]
    # A share of the wheelbase, the same towards the front as what is taken from the rear.
    shift = (wrong["cog_along"] - 1) * car.wheelbase / 2
    tyres = {
        place: _TYRES[model](axle, formula, wrong[f"{place}_stiffness"], wrong[f"{place}_friction"])
        for place, axle in (("front", car.front), ("rear", car.rear))
    }
    inertia = wrong["mass"] * wrong["inertia"]
    document = {
        "name": f"case car ({car.name})",
        "source": "an engineer's best knowledge, not exact",
        "physics": {
            "chassis": {
                "mass": car.mass * wrong["mass"],
                "roll_inertia": car.roll_inertia * inertia,
                "pitch_inertia": car.pitch_inertia * inertia,
                "yaw_inertia": car.yaw_inertia * inertia,
                "cog_height": car.cog_height * wrong["cog_height"],
                "cog_to_front_axle": car.front_arm + shift,
                "cog_to_rear_axle": car.rear_arm - shift,
            },
            "front": _axle(car.front) | {"tyre": tyres["front"]},
            "rear": _axle(car.rear) | {"tyre": tyres["rear"]},
            "steering": {"ratio": car.ratio, "ackermann": 1.0},
            "aerodynamics": {"drag_area": car.drag_area},
        },
        "sensors": {
            "imu": {
                "kind": "imu",
                "frame_id": "imu_link",
                "position": [float(v) for v in mounting.imu],
                "rate_noise": [g.gyro] * 3,
                "force_noise": [g.accelerometer] * 3,
                "rate_bias": g.gyro_bias,
                "force_bias": g.accelerometer_bias,
            },
            "wheel_speeds": {"kind": "wheel_speeds", "noise": g.wheel},
            "steering": {"kind": "steering"},
            "torques": {"kind": "wheel_torques"},
            "position": {"kind": "gnss_position", "position": [float(v) for v in mounting.gnss], "noise": g.position},
            "velocity": {"kind": "gnss_velocity", "position": [float(v) for v in mounting.gnss], "noise": g.velocity},
        },
        "observer": {"surroundings": {"steering_offset": g.handwheel_bias / car.ratio}},
    }
    with path.open("w", encoding="utf-8") as file:
        _yaml().dump(_rounded(document), file)


def without_sensors(known: Path, path: Path, kinds: Collection[str]) -> None:
    """A vehicle file that does not have the sensors of some kinds. Raises `ValueError` where it never had them."""
    document = _yaml().load(known.read_text(encoding="utf-8"))
    sensors = {name: sensor for name, sensor in document["sensors"].items() if sensor["kind"] not in kinds}
    had = sorted({sensor["kind"] for sensor in document["sensors"].values()})
    if not set(kinds) <= set(had):
        raise ValueError(f"no sensor {', '.join(sorted(set(kinds) - set(had)))}; there are {', '.join(had)}")
    document["sensors"] = sensors
    with path.open("w", encoding="utf-8") as file:
        _yaml().dump(document, file)


def _yaml() -> YAML:
    yaml = YAML()
    yaml.default_flow_style = None
    yaml.width = 120
    return yaml


def _axle(axle: Axle) -> dict[str, float]:
    return {
        "track": axle.track,
        "roll_centre_height": axle.roll_centre_height,
        "hub_mass": axle.hub_mass,
        "wheel_mass": axle.wheel_mass,
        "wheel_spin_inertia": axle.spin_inertia,
        "wheel_diametral_inertia": axle.diametral_inertia,
        "suspension_stiffness": axle.spring,
        "suspension_damping": axle.damper,
        "antiroll_stiffness": axle.antiroll,
        "unloaded_radius": axle.radius,
        "tyre_stiffness": axle.tyre_vertical,
        "tyre_damping": axle.tyre_damping,
        "rolling_resistance": axle.rolling_resistance,
    }


def measured(axle: Axle, formula: str, direction: str, ratio: float) -> np.ndarray:
    """The plant's force over `SLIPS` at a load, as a test bench would measure it [N]."""
    tyre = SimpleNamespace(**{name: np.full(len(SLIPS), getattr(axle, name)) for name in axle.__dataclass_fields__})
    load, none, grip = tyre.nominal_load * ratio, np.zeros_like(SLIPS), np.ones_like(SLIPS)
    if direction == "longitudinal":
        return FORMULAS[formula](tyre, SLIPS, none, load, grip)[0]
    return FORMULAS[formula](tyre, none, np.arctan(SLIPS), load, grip)[1]


def _tmeasy(axle: Axle, formula: str, stiffness: float, friction: float) -> dict:
    curves = {}
    for direction in ("longitudinal", "lateral"):
        fitted = _fitted_curves([measured(axle, formula, direction, ratio) for ratio in (1.0, 2.0)])
        curves[direction] = {
            name: {
                "initial_slope": slope * stiffness,
                "maximum": peak * friction,
                "slip_at_maximum": slip * friction / stiffness,
                "sliding": sliding * friction,
                "slip_at_sliding": end * friction / stiffness,
            }
            for name, (slope, peak, slip, sliding, end) in zip(("nominal", "double"), fitted, strict=True)
        }
    return {
        "model": "tmeasy",
        "nominal_load": axle.nominal_load,
        **curves,
        "pneumatic_trail": axle.trail,
        "slip_of_no_trail": 0.22,
    }


def tmeasy_curve(parameters: np.ndarray, slip: np.ndarray) -> np.ndarray:
    """Force over slip of Rill's curve: a fraction up to the maximum, a cubic down to the sliding force (Rill 2012)."""
    slope, peak, at, sliding, end = parameters
    s = np.minimum(slip / at, 1)
    rising = slope * slip / (1 + s * (s + slope * at / peak - 2))
    t = np.clip((slip - at) / (end - at), 0, 1)
    return np.where(slip < at, rising, peak - (peak - sliding) * t**2 * (3 - 2 * t))


def _fitted_curves(forces: list[np.ndarray]) -> list[np.ndarray]:
    """Parameters of `tmeasy_curve` at the nominal load and its double; how far a curve falls is the same for both."""
    peaks = [force.max() for force in forces]
    slopes = [force[0] / SLIPS[0] for force in forces]

    def parameters(x):
        steep, steep_double, high, high_double, stretch, loss, tail, growth = x
        slope, peak = steep * slopes[0], high * peaks[0]
        slope_double, peak_double = steep_double * slopes[1], high_double * peaks[1]
        # A curve with one maximum needs slope · slip ≥ 2 · maximum.
        at = (2 + stretch) * peak / slope
        at_double = max(at * (1 + growth), 2.02 * peak_double / slope_double)
        return [
            np.array([slope, peak, at, peak * (1 - loss), at * tail]),
            np.array([slope_double, peak_double, at_double, peak_double * (1 - loss), at_double * tail]),
        ]

    def error(x):
        fitted = parameters(x)
        return np.concatenate([WEIGHTS * (tmeasy_curve(fitted[i], SLIPS) - forces[i]) / peaks[i] for i in (0, 1)])

    start = [1.1, 1.1, 1.0, 1.0, 1.5, 0.05, 3.0, 0.15]
    bounds = ([0.7, 0.7, 0.7, 0.7, 0.02, 0.0, 1.5, 0.0], [3.0, 3.0, 1.3, 1.3, 12.0, 0.4, 12.0, 0.6])
    return parameters(least_squares(error, start, bounds=bounds).x)


def _magic_formula(axle: Axle, formula: str, stiffness: float, friction: float) -> dict:
    x, y = (_fitted_sine(axle, formula, direction) for direction in ("longitudinal", "lateral"))
    return {
        "model": "magic_formula",
        "nominal_load": axle.nominal_load,
        "unloaded_radius": axle.radius,
        "smallest_load": 0.05 * axle.nominal_load,
        "largest_load": 2.6 * axle.nominal_load,
        "longitudinal": {
            "pcx1": x["shape"], "pdx1": x["peak"] * friction, "pdx2": x["peak_by_load"] * friction,
            "pex1": x["curvature"], "pkx1": x["slope"] * stiffness, "pkx2": 0.0, "pkx3": x["slope_by_load"],
            "rbx1": x["slope"] / x["peak"] / x["shape"] * 1.1, "rcx1": 1.0,
        },
        "lateral": {
            "pcy1": y["shape"], "pdy1": y["peak"] * friction, "pdy2": y["peak_by_load"] * friction,
            "pey1": y["curvature"], "pky1": -y["slope"] * stiffness, "pky2": y["slope_by_load"],
            "rby1": y["slope_at_nominal"] / y["peak"] / y["shape"] * 1.1, "rcy1": 1.0,
        },
        "aligning": {"qbz1": 8.0, "qcz1": 1.1, "qdz1": axle.trail / axle.radius},
    }  # fmt: skip


def _fitted_sine(axle: Axle, formula: str, direction: str) -> dict[str, float]:
    """Parameters of the Magic Formula over slip and load, fitted at half, nominal and double load."""
    ratios = (0.5, 1.0, 2.0)
    forces = [measured(axle, formula, direction, r) / axle.nominal_load for r in ratios]
    slope = forces[1][0] / SLIPS[0]
    longitudinal = direction == "longitudinal"

    def force(p, ratio):
        shape, peak, by_load, curvature, steepness, bend = p
        d = (peak + by_load * (ratio - 1)) * ratio
        if longitudinal:
            k = steepness * ratio * np.exp(bend * (ratio - 1))
        else:
            k = steepness * np.sin(2 * np.arctan(ratio / bend))
        b = k / (shape * d)
        inner = b * SLIPS - curvature * (b * SLIPS - np.arctan(b * SLIPS))
        return d * np.sin(shape * np.arctan(inner))

    start = [1.4, 1.0, -0.08, -0.2, slope, -0.15 if longitudinal else 2.0]
    lower = [1.01, 0.5, -0.25, -6.0, 0.3 * slope, -0.8 if longitudinal else 0.8]
    upper = [1.95, 1.8, 0.1, 0.95, 4.0 * slope, 0.2 if longitudinal else 6.0]
    fit = least_squares(
        lambda p: np.concatenate([WEIGHTS * (force(p, r) - f) for r, f in zip(ratios, forces, strict=True)]),
        start,
        bounds=(lower, upper),
        x_scale=np.abs(start),
    )
    shape, peak, by_load, curvature, steepness, bend = fit.x
    at_nominal = steepness if longitudinal else steepness * np.sin(2 * np.arctan(1 / bend))
    return {
        "shape": shape, "peak": peak, "peak_by_load": by_load, "curvature": curvature, "slope": steepness,
        "slope_by_load": bend, "slope_at_nominal": at_nominal,
    }  # fmt: skip


_TYRES = {"tmeasy": _tmeasy, "magic_formula": _magic_formula}


def _rounded(node):
    if isinstance(node, dict):
        return {key: _rounded(value) for key, value in node.items()}
    if isinstance(node, list):
        return [_rounded(value) for value in node]
    return float(f"{node:.6g}") if isinstance(node, float) else node
