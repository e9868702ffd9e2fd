"""Which cases there are: what is hidden in which car, on which plant, in which manoeuvres.

Everything of a case follows from its split's seed and its own number. What the tool is told of a case is its recordings
and its vehicle file; all else is label.
"""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator
from dataclasses import asdict, dataclass, field, replace

import numpy as np

from blind import library
from blind.cars import Car, drawn
from blind.effects import EFFECTS, SIZES, Hidden
from blind.knobs import Values
from blind.outside import OUTSIDE
from blind.sensors import AS_USUAL, GRADES, Biases, Mounting, Recorder

# A release seed is used up when the tool changes after its answers were looked at: the next release has another.
# `SPENT` are those of earlier ones, in their order.
SEEDS = {"public": 20_100, "release": 86_413}
SPENT = (
    77_003, 91_402, 57_233, 90_481, 71_365, 83_917, 61_283, 74_509, 49_128, 83_207, 52_951, 38_461, 66_173, 44_087,
    29_614, 58_741, 59_022,
)  # fmt: skip
PLANTS = ("newton_euler", "mujoco_tree")
TYRES = ("magic_formula_1989", "brush", "dugoff", "burckhardt")
MODELS = ("tmeasy", "tmeasy", "magic_formula")  # of the vehicle file; the first twice as often
SETS = ("rich", "everyday", "cruise")
BLIND_TO_VELOCITY = "rich_without_gnss"  # the rich set, its GNSS left out of the recordings

# On the steady set (straight ahead at one speed) the members of a group leave the same traces.
INSEPARABLE = (
    ("imu_roll_misalignment", "accelerometer_bias"),
    ("imu_pitch_misalignment", "accelerometer_bias"),
    ("aero_drag", "rolling_resistance"),
    ("wheel_radius", "tyre_underinflation"),
)
AS_OF_LOST_PRESSURE = 1 / 3  # of the radius change of a size, which a tyre with little pressure has too
# Two at once that do not act on the same quantity; more are drawn.
DOUBLES = 32
APART = (
    {"aero_drag", "road_grade", "rolling_resistance", "brake_drag"},
    {"road_bank", "imu_roll_misalignment", "accelerometer_bias", "body_roll_in_accelerometer", "payload_offset"},
    {"steering_ratio", "steering_compliance", "roll_steer", "toe_compliance", "gyro_scale", "camber_thrust"},
    {"tyre_relaxation", "sensor_delay", "sloshing_load"},
    {"tyre_load_sensitivity", "tyre_heating", "friction_change", "aero_downforce"},
    {"tyre_underinflation", "wheel_radius"},
    {"tyre_conicity", "crosswind", "steering_offset", "gyro_bias"},
)
# Several at once, as real recordings have them: at least two defects of sensors, the others of the car; what was found
# on real cars is drawn `LIKELIER` times as often.
SEVERAL = 120
SEVERAL_SETS = ("rich", "everyday")
WITHOUT_ANY = 6  # of so many cases one has none
FEWEST, MOST, OF_SENSORS = 3, 6, 2
DEFECTS_OF_SENSORS = (
    "sensor_delay", "gnss_lever_arm", "imu_lever_arm", "imu_roll_misalignment", "imu_pitch_misalignment",
    "imu_yaw_misalignment", "body_roll_in_accelerometer", "accelerometer_bias", "gyro_bias", "gyro_scale",
    "steering_offset",
)  # fmt: skip
FOUND_ON_REAL_CARS = (
    *DEFECTS_OF_SENSORS, "steering_ratio", "limited_slip_differential", "payload_offset", "road_bank", "road_grade",
    "wheel_radius",
)  # fmt: skip
LIKELIER = 3
NOTHING_EACH = 20
NOTHING_BLIND_TO_VELOCITY = 8


@dataclass(frozen=True)
class Case:
    """One case with all that is known of it."""

    number: str
    kind: str  # effect, nothing, double, outside, inseparable, several
    manoeuvres: str  # name of the set
    plant: str
    tyre: str
    model: str
    grade: str
    seed: int
    hidden: tuple[tuple[str, float], ...]  # id and size
    acceptable: tuple[str, ...] = ()  # ids that cannot be told from the true one

    def rng(self, purpose: str) -> np.random.Generator:
        """Numbers for one purpose, independent of all others."""
        digest = hashlib.sha256(f"{self.seed} {purpose}".encode()).digest()
        return np.random.default_rng(int.from_bytes(digest[:8], "big"))

    @property
    def car(self) -> Car:
        return drawn(self.rng("car"))

    def sensors(self) -> tuple[Mounting, Biases]:
        rng = self.rng("sensors")
        return Mounting.drawn(rng), Biases.drawn(GRADES[self.grade], rng)

    @property
    def recorder(self) -> Recorder:
        return Recorder.drawn(self.rng("recorder")) if self.kind == "several" else AS_USUAL

    def effects(self) -> list[tuple[str, float, Hidden]]:
        """Id, size and what is turned, of all that is hidden."""
        found = []
        for name, size in self.hidden:
            rng = self.rng(f"hidden {name}")
            if name in OUTSIDE:
                found.append((name, size, OUTSIDE[name](rng, self.car)))
            else:
                found.append((name, size, self._like_the_other(name, EFFECTS[name].hide(size, rng, self.car))))
        return found

    def _like_the_other(self, name: str, hidden: Hidden) -> Hidden:
        """Such that it is inseparable from its partner: a bias along the same axis, a radius that is smaller by no more
        than lost pressure can do."""
        if self.kind != "inseparable":
            return hidden
        if name == "accelerometer_bias":
            axis = 1 if "imu_roll_misalignment" in self.acceptable else 0
            return Hidden({name: [hidden.value if i == axis else 0.0 for i in range(3)]}, hidden.value, "xyz"[axis])
        if name == "wheel_radius":
            smaller = -np.sign(hidden.value) * AS_OF_LOST_PRESSURE
            changes = {knob: [smaller * value for value in values] for knob, values in hidden.knobs.items()}
            return Hidden(changes, float(smaller * hidden.value), hidden.where)
        return hidden

    def knobs(self) -> Values:
        merged: Values = {}
        for _, _, hidden in self.effects():
            for name, value in hidden.knobs.items():
                merged[name] = (np.array(value) + np.array(merged.get(name, 0.0))).tolist()
        return merged

    def label(self) -> dict:
        known = asdict(self)
        _, biases = self.sensors()
        known["hidden"] = [
            {
                "id": name,
                "size": size,
                "where": hidden.where,
                "value": None if np.isnan(hidden.value) else float(f"{hidden.value:.9g}"),
                "parameters": library.expected(name, hidden, self.car, biases),
            }
            for name, size, hidden in self.effects()
        ]
        known["car"] = self.car.name
        known["acceptable"] = list(self.acceptable)
        if self.kind == "several":
            known["recorder"] = asdict(self.recorder)
        return known


@dataclass
class _Draw:
    """Cases in the making: a running number and random choices."""

    rng: np.random.Generator
    cases: list[Case] = field(default_factory=list)

    def add(self, kind: str, manoeuvres: str, *hidden: tuple[str, float], acceptable: tuple[str, ...] = ()) -> None:
        names = PLANTS, TYRES, MODELS, tuple(GRADES)
        plant, tyre, model, grade = (str(self.rng.choice(each)) for each in names)
        seed = int(self.rng.integers(2**31))
        self.cases.append(Case("", kind, manoeuvres, plant, tyre, model, grade, seed, hidden, acceptable))


def all_cases(split: str) -> list[Case]:
    """Every case of a split, in an order that says nothing; the first N are a mixture of all kinds."""
    draw = _Draw(np.random.default_rng(SEEDS[split]))
    sizes = SIZES if split == "public" else None

    def three() -> Iterator[float]:
        yield from sizes or np.round(draw.rng.uniform((0.3, 0.7, 1.2), (0.6, 1.2, 1.7)), 3).tolist()

    for name in EFFECTS:
        for manoeuvres in SETS:
            for size in three():
                draw.add("effect", manoeuvres, (name, size))
        if name != "gnss_lever_arm":
            draw.add("effect", BLIND_TO_VELOCITY, (name, 1.0))
    for manoeuvres in SETS:
        for _ in range(NOTHING_EACH):
            draw.add("nothing", manoeuvres)
    for _ in range(NOTHING_BLIND_TO_VELOCITY):
        draw.add("nothing", BLIND_TO_VELOCITY)
    for one, other in _pairs(draw.rng):
        draw.add("double", "rich", (one, 1.0), (other, 1.0))
    for name in OUTSIDE:
        draw.add("outside", "rich", (name, 1.0))
    for group in INSEPARABLE:
        for name in group:
            for size in (1.0, 1.5):
                draw.add("inseparable", "steady", (name, size), acceptable=group)
    order = draw.rng.permutation(len(draw.cases))
    found = [draw.cases[j] for j in order] + _several(np.random.default_rng([SEEDS[split], SEVERAL]))
    return [replace(case, number=f"{i:04d}") for i, case in enumerate(found)]


def _several(rng: np.random.Generator) -> list[Case]:
    """Cases with several defects at once. Their seed is their own: the cases before them stay as they are."""
    draw = _Draw(rng)
    for i in range(SEVERAL):
        hidden = () if i % WITHOUT_ANY == WITHOUT_ANY - 1 else _defects(rng)
        draw.add("several", SEVERAL_SETS[i % len(SEVERAL_SETS)], *hidden)
    return draw.cases


def _defects(rng: np.random.Generator) -> tuple[tuple[str, float], ...]:
    """Ids and sizes of which no two act on the same quantity: first of sensors, then of any kind."""
    names = sorted(EFFECTS)
    weights = np.array([LIKELIER if name in FOUND_ON_REAL_CARS else 1.0 for name in names])
    order = [str(name) for name in rng.choice(names, len(names), replace=False, p=weights / weights.sum())]
    count = int(rng.integers(FEWEST, MOST + 1))
    chosen: list[str] = []
    for wanted, offered in ((OF_SENSORS, [n for n in order if n in DEFECTS_OF_SENSORS]), (count, order)):
        for name in offered:
            alike = any(name in group and not group.isdisjoint(chosen) for group in APART)
            if len(chosen) < wanted and name not in chosen and not alike:
                chosen.append(name)
    return tuple((name, float(np.round(rng.uniform(0.6, 1.5), 3))) for name in chosen)


def _pairs(rng: np.random.Generator) -> list[tuple[str, str]]:
    names, pairs = sorted(EFFECTS), []
    while len(pairs) < DOUBLES:
        one, other = (str(name) for name in rng.choice(names, 2, replace=False))
        if not any({one, other} <= group for group in APART) and (one, other) not in pairs:
            pairs.append((one, other))
    return pairs


def labels_text(cases: list[Case]) -> str:
    """The labels file, byte for byte the same wherever it is made."""
    return json.dumps({case.number: case.label() for case in cases}, indent=1, sort_keys=True) + "\n"


def seal(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()
