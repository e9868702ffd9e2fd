"""What the plants hide, told to the tool's model by the names and values that the scorer expects, explains a drive."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("mujoco", reason="MuJoCo is one of the plants: make venv installs it")

from blind import cars, cases, courses, knobs, library, vehicle_file
from blind.cars import CARS, GRAVITY
from blind.effects import EFFECTS
from blind.plants import mujoco_tree
from blind.plants.log import PERIOD
from blind.sensors import STEPS, Bench, Mounting, Recorder
from blind.tyres import FORMULAS
from vsense_ros.files.vehicle import load_vehicle
from vsense_ros.model.effects import BY_ID, Effects
from vsense_ros.model.simulation.closed_loop import rolling_straight, simulate

CAR = CARS[1]
BEGIN = 1.5  # [s] after which an unsettled start is forgotten
# Those that act on the motion itself and mean the same quantity here and there.
ON_THE_MOTION = (
    "aero_drag", "rolling_resistance", "crosswind", "steering_offset", "steering_ratio", "steering_compliance",
    "roll_steer", "toe_compliance", "camber_thrust", "tyre_conicity", "tyre_relaxation",
    "tyre_underinflation", "wheel_radius", "brake_drag", "limited_slip_differential", "suspension_friction",
    "payload_offset", "sloshing_load", "aero_downforce",
)  # fmt: skip

# What little more load does to a cornering tyre is less certain than what it does to rolling resistance.
ELSEWHERE = {"aero_downforce": "coast-down"}


def _hidden(name: str):
    return EFFECTS[name].hide(1.0, np.random.default_rng(5), CAR)


def test_expected_parameters_are_those_of_the_library():
    assert set(EFFECTS) == set(BY_ID)
    for name in EFFECTS:
        for seed in range(6):
            expected = library.expected(name, EFFECTS[name].hide(1.0, np.random.default_rng(seed), CAR), CAR)
            assert set(expected) <= set(BY_ID[name].model_fields), name


def at_rest(rows: int) -> dict[str, np.ndarray]:
    """A log of a car that stands."""
    columns = {"rates": 3, "turning": 3, "force": 3, "angles": 3, "spin": 4, "handwheel": 1, "torque": 4}
    columns |= {"position": 3, "velocity": 3}
    return {key: np.zeros((rows, n)) for key, n in columns.items()}


@pytest.mark.parametrize(("per_second", "coarse"), [(1.0, 4), (25.0, 16)])
def test_a_recorder_says_how_often_gnss_comes_and_in_what_steps_can_signals_are(per_second, coarse):
    mounting, biases = Mounting((0.0, 0.0, 0.0), (0.0, 0.0, 0.9)), cases.Biases(np.zeros(3), np.zeros(3), 0.3)
    bench = Bench("simple", mounting, biases, {}, Recorder(1 / per_second, coarse))
    recorded = bench.record(at_rest(20_000), "rest", 0, np.random.default_rng(1))
    velocity = recorded["gps/velocity"]
    assert np.diff(velocity.stamp) == pytest.approx(1e9 / per_second, abs=1)
    for topic, column, signal in (("steering", "position", "handwheel"), ("wheel_speeds", "velocity", "wheel")):
        steps = recorded[f"vehicle/{topic}"].columns[column] / (coarse * STEPS[signal])
        assert steps == pytest.approx(np.rint(steps), abs=1e-9)
        assert len(np.unique(steps)) > 1


@pytest.mark.parametrize("name", ["gyro_bias", "accelerometer_bias", "steering_offset"])
def test_a_bias_is_expected_to_be_what_sensors_at_rest_show(name):
    case = next(c for c in cases.all_cases("public") if c.kind == "effect" and c.hidden[0][0] == name)
    mounting, biases = case.sensors()
    bench = Bench(case.grade, mounting, biases, case.knobs())
    recorded = bench.record(at_rest(20_000), "rest", 0, np.random.default_rng(1), gnss=False)
    imu, steering = recorded["imu/data"].columns, recorded["vehicle/steering"].columns["position"]
    shown = {
        "gyro_bias": dict(zip("xyz", imu["angular_velocity"].mean(axis=0), strict=True)),
        "accelerometer_bias": dict(zip("xyz", imu["linear_acceleration"].mean(axis=0), strict=True)),
        "steering_offset": {"angle": (case.knobs().get("steering_offset", 0.0) - steering.mean()) / case.car.ratio},
    }[name]
    for key, value in case.label()["hidden"][0]["parameters"].items():
        assert value == pytest.approx(shown[key], rel=0.03)


def _course(name: str) -> str:
    return ELSEWHERE.get(name, EFFECTS[name].best)


@pytest.fixture(scope="module")
def drives():
    """Logs by what is hidden (None: nothing) and course."""
    known = {c.name: replace(c, duration=min(c.duration, 12.0)) for c in courses.rich(np.random.default_rng(4))[0]}
    lanes = [(name, _course(name)) for name in ON_THE_MOTION]
    lanes += [(None, course) for course in sorted({course for _, course in lanes})]
    log = mujoco_tree.simulate(
        cars.side_by_side([CAR] * len(lanes)),
        knobs.side_by_side([_hidden(name).knobs if name else {} for name, _ in lanes]),
        [known[course] for _, course in lanes],
        FORMULAS["magic_formula_1989"],
    )
    return {(name, course): log.lane(i, known[course].duration) for i, (name, course) in enumerate(lanes)}


@pytest.fixture(scope="module")
def vehicle(tmp_path_factory):
    """The tool's model of the car, all these effects in it with zero size."""
    file = tmp_path_factory.mktemp("library") / "car.yaml"
    exact = dict.fromkeys(vehicle_file.drawn_errors(np.random.default_rng(0)), 1.0)
    mounting = Mounting((0.0, 0.0, 0.0), (0.0, 0.0, 0.0))
    vehicle_file.write(file, CAR, "magic_formula_1989", "magic_formula", mounting, "automotive", exact)
    plain = load_vehicle(file)
    effects = Effects(**{name: BY_ID[name]() for name in ON_THE_MOTION})
    return plain.model_copy(update={"physics": plain.physics.model_copy(update={"effects": effects})})


def _misfit(vehicle, lane) -> dict[str, np.ndarray]:
    """Difference of the motions of plant and model with the same inputs, in units that make quantities comparable."""
    times = np.arange(len(lane["spin"])) * PERIOD

    def inputs(t, q, u):
        angle = np.interp(t, times, lane["handwheel"][:, 0]) / CAR.ratio
        return np.array([angle, *(np.interp(t, times, torque) for torque in lane["torque"].T)])

    q, u = rolling_straight(vehicle, lane["velocity"][0, 0])
    u[10:14] = lane["spin"][0]
    driven = simulate(vehicle, inputs, times[-1], keep_every=round(PERIOD / 0.001), q=q, u=u)
    kept = times > BEGIN
    return {
        "speed": (lane["velocity"][:, 0] - driven.u[:, 0])[kept] / 0.3,
        "yaw rate": (lane["rates"][:, 2] - driven.u[:, 5])[kept] / 0.01,
        "roll rate": (lane["rates"][:, 0] - driven.u[:, 3])[kept] / 0.01,
        **{f"wheel {i}": (lane["spin"][:, i] - driven.u[:, 10 + i])[kept] / 0.5 for i in range(4)},
    }


def _beside(name: str, hidden) -> dict[str, float]:
    """What else the tool's model must be told to be the same car: what a re-fit finds, and shapes."""
    if name == "payload_offset":
        return {"chassis.mass": CAR.mass + hidden.knobs["payload"]}
    if name == "sloshing_load":
        return {"effects.sloshing_load.frequency": float(np.sqrt(GRAVITY / hidden.knobs["slosh_length"]))}
    return {}


@pytest.mark.exam
@pytest.mark.timeout(1200)
@pytest.mark.parametrize("name", ON_THE_MOTION)
def test_the_librarys_effect_with_the_expected_values_explains_what_the_plant_hides(drives, vehicle, name):
    hidden, course = _hidden(name), _course(name)
    same_car = vehicle.with_parameters(_beside(name, hidden))
    expected = library.expected(name, hidden, CAR)
    told = same_car.with_parameters({f"effects.{name}.{key}": value for key, value in expected.items()})
    always = _misfit(vehicle, drives[None, course])
    without, with_it = _misfit(same_car, drives[name, course]), _misfit(told, drives[name, course])
    before, after = (
        {signal: float(np.sqrt(np.mean((wrong[signal] - always[signal]) ** 2))) for signal in always}
        for wrong in (without, with_it)
    )
    most = max(before, key=before.__getitem__)
    assert after[most] < 0.5 * before[most], (most, before, after)
