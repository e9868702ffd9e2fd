"""What a trailer does behind a car as it drives: its articulation, its pull at the hitch, and how its sway is damped.

The filter is that of the single track with a trailer (`combination`), which the steering angle, the speed and the
specific force along the car drive, and the yaw rate, the lateral specific force and, if a sensor measures it, the
articulation angle correct. What the vehicle file does not know well are states as well: mass, inertia, centre of
gravity and tyres of the trailer, tyres of the car. So the damping ratio and the critical speed, which are functions of
these alone, have standard deviations, which a drive that lets the trailer sway makes smaller.
"""

from __future__ import annotations

import heapq
from dataclasses import dataclass, replace
from typing import Any

import casadi as ca
import numpy as np

from vsense_ros.errors import InputError
from vsense_ros.estimation.dense import Dense
from vsense_ros.estimation.ekf import Ekf
from vsense_ros.estimation.filter import Array, Gaussian
from vsense_ros.estimation.reading import Map, Reader
from vsense_ros.estimation.state_space import Measurement, Named, StateSpace
from vsense_ros.estimation.timeline import Event
from vsense_ros.identification.combination import SWAY, SingleTrack, critical_speed, damping_ratio
from vsense_ros.messages.diagnostic import Diagnostic, Level
from vsense_ros.messages.recording import Recording, Sample
from vsense_ros.model.parameter import with_expressions
from vsense_ros.model.sensors import MeasuredQuantity, best_measuring
from vsense_ros.model.simulation.closed_loop import rolling_radii
from vsense_ros.model.trailer import Hitch, Trailer
from vsense_ros.model.vehicle import Vehicle

TOPIC = "vsense/trailer"


@dataclass(frozen=True)
class TowingSettings:
    """What is known before, what changes, and when a sway is reported: decisions of this project."""

    delay: float = 0.1  # [s] by which a message may be later than others
    period: float = 0.05  # [s] from one output to the next
    often: float = 1.0  # [s] from one damping ratio to the next
    longest: float = 0.01  # [s] of a step
    silence: float = 1.0  # [s] without messages, after which the motion is begun anew
    # Standard deviations before.
    lateral: float = 0.5  # [m/s]
    bend: float = 1.5  # [m/s²] lateral acceleration of the bend in which the filter begins
    sway: float = 0.03  # [rad] articulation and slip beyond those of a steady bend
    swaying: float = 0.05  # [rad/s] yaw rates likewise
    mass: float = 0.15  # [-] of the trailer, as a share: a load
    inertia: float = 0.25  # [-]
    stiffness: float = 0.3  # [-] of its tyres
    nose: float = 0.02  # [-] nose load over mass
    tyres: float = 0.15  # [-] of the car's axles
    steering: float = 0.01  # [rad] offset of the steering angle
    gyro: float = 0.01  # [rad/s]
    aside: float = 0.3  # [m/s²] of the accelerometer: bias, bank of the road; it comes back with
    bank_time: float = 20.0  # [s]
    leaning: tuple[float, float] = (0.05, 0.03)  # [-] by which it reads more as the body rolls
    # What a second adds.
    tyres_walk: float = 0.01  # [-/√s]: a tyre at other loads, temperatures, slips
    gyro_walk: float = 1e-4  # [rad/s/√s]
    steering_walk: float = 1e-4  # [rad/√s]
    gusts: tuple[float, float, float] = (0.1, 0.03, 0.05)  # [m/s/√s, rad/s/√s] of the lateral velocity and yaw rates
    # [rad √s] of the steering angle: steps of 0.2° at the wheel, for 0.1 s. With more, a filter that estimates
    # parameters finds tyres too soft (Ljung 1979, IEEE TAC 24).
    steering_error: float = 2e-4
    along: float = 0.2  # [m/s²] of the specific force along the car, as it errs for a second
    # Standard deviations of what the single track leaves out of readings, such as how the body rolls.
    yaw_noise: float = 0.003  # [rad/s]
    aside_noise: float = 0.1  # [m/s²]
    alike: float = 0.02  # [s] for which they err alike: more readings in this time say no more
    form: float = 0.02  # [-] of a damping ratio, by what the single track leaves out
    poor: float = 0.1  # [-] damping ratio below which a sway is reported


SETTINGS = TowingSettings()
MOTION = ("lateral_velocity", "yaw_rate", "articulation", "trailer_yaw_rate", "trailer_slip")
UNKNOWN = ("mass", "inertia", "stiffness", "nose", "front", "rear")
OUTPUTS = ("articulation", "articulation_rate", "hitch_force_x", "hitch_force_y", "hitch_moment")


class _Towing(StateSpace):
    """See the module. Shares of what is unknown are logarithms, but for that of the nose load."""

    names = (*MOTION, *UNKNOWN, "steering_offset", "gyro_bias", "aside_bias", "leaning", "angle_offset")
    inputs = ("steering", "speed", "along")
    parameters = ("sensor_ahead",)
    auxiliaries = ("aside",)

    def __init__(self, car: SingleTrack, trailer: Trailer) -> None:
        self.car, self.trailer = car, trailer

    def with_shares(self, shares: Any) -> tuple[SingleTrack, Trailer]:
        """Car and trailer with shares (6,) in the order of `UNKNOWN`, numbers or expressions."""
        mass, inertia, stiffness, nose, front, rear = shares
        t = self.trailer
        changes = {
            "mass": t.mass * ca.exp(mass),
            "yaw_inertia": t.yaw_inertia * ca.exp(mass + inertia),
            "cornering_stiffness": t.cornering_stiffness * ca.exp(stiffness),
            "nose_load": (t.nose_load / t.mass + nose) * t.mass * ca.exp(mass),
        }
        car = replace(
            self.car,
            front_stiffness=self.car.front_stiffness * ca.exp(front),
            rear_stiffness=self.car.rear_stiffness * ca.exp(rear),
        )
        return car, with_expressions(t, changes)

    def rates(self, x: Named, u: Named) -> ca.SX:
        """Derivatives of the motion (5,)."""
        car, trailer = self.with_shares([x[name] for name in UNKNOWN])
        return car.rates(trailer, x.vector[:5], u.steering - x.steering_offset, u.speed, u.along)

    def hitch(self, x: Named, u: Named) -> tuple[ca.SX, ca.SX, Hitch]:
        """As `SingleTrack.towing`."""
        car, trailer = self.with_shares([x[name] for name in UNKNOWN])
        return car.towing(trailer, x.vector[:5], u.steering - x.steering_offset, u.speed, u.along)

    def auxiliary(self, x: Named, u: Named, theta: Named) -> Any:
        lateral, spin_up, _ = self.hitch(x, u)
        return [lateral + theta.sensor_ahead * spin_up]

    def transition(self, x: Named, u: Named, theta: Named, h: ca.SX) -> Any:
        rest = x.vector[5:]
        middle = Named(ca.vertcat(x.vector[:5] + h / 2 * self.rates(x, u), rest), self.names)
        moved = x.vector[:5] + h * self.rates(middle, u)
        lasting = ca.exp(-h / SETTINGS.bank_time)
        place = self.names.index("aside_bias") - 5
        return ca.vertcat(moved, rest[:place], rest[place] * lasting, rest[place + 1 :])

    def noise(self, x: Named, u: Named, theta: Named, h: ca.SX) -> Any:
        s = SETTINGS
        aside, yaw, trailer = s.gusts
        density = [aside**2, yaw**2, 0, trailer**2, 0, 0, 0, 0, 0, s.tyres_walk**2, s.tyres_walk**2]
        density += [s.steering_walk**2, s.gyro_walk**2, 2 * s.aside**2 / s.bank_time, 0, 0]
        given = {"steering": s.steering_error**2 / h, "along": s.along**2 / h}
        return h * ca.diag(ca.DM(density)) + self.noise_of_inputs(x, u, theta, h, given)

    def outputs(self) -> ca.Function:
        """(x, u) → `OUTPUTS` (5,), and their derivatives by x and by the specific force along the car."""
        x, u = (Named(ca.SX.sym("v", len(names)), names) for names in (self.names, self.inputs))
        _, _, hitch = self.hitch(x, u)
        behind, damping = self.trailer.behind(self.car.to_rear), self.trailer.hitch_damping
        rate = x.trailer_yaw_rate - x.yaw_rate
        moment = behind * hitch.force[1] + damping * rate
        made = ca.vertcat(x.articulation, rate, -hitch.force, moment)
        return ca.Function("o", [x.vector, u.vector], [made, ca.jacobian(made, x.vector), ca.jacobian(made, u.along)])


_GYRO = Measurement("gyro", lambda x, z, u, p: x.yaw_rate + x.gyro_bias, (SETTINGS.yaw_noise,), gate=6.0)
_ASIDE = Measurement(
    "aside", lambda x, z, u, p: (1 + x.leaning) * z.aside + x.aside_bias, (SETTINGS.aside_noise,), gate=6.0
)
_ANGLE = Measurement("angle", lambda x, z, u, p: x.articulation + x.angle_offset, (0.003,), angles=(0,), gate=6.0)
_USED: tuple[MeasuredQuantity, ...] = (
    "rates and forces", "rolling speed", "ground speed", "steering", "articulation",
)  # fmt: skip


class Towing:
    """The trailer of one vehicle. `add` takes messages in order of arrival, `sample` is what is published.

    Raises `InputError` for a vehicle without a trailer, or without an inertial sensor, a speed or a steering angle.
    """

    def __init__(self, vehicle: Vehicle) -> None:
        trailer = vehicle.physics.trailer
        if trailer is None:
            raise InputError(f"{vehicle.name} tows no trailer: give physics.trailer, of which mass is enough")
        every = vehicle.sensing() | {name: one for name, one in vehicle.sensors.items() if one.of_trailer}
        best = {quantity: best_measuring(every.items(), quantity) for quantity in _USED}
        self.sensors = {quantity: every[name] for quantity, name in best.items() if name is not None}
        if "rolling speed" in self.sensors:
            self.sensors.pop("ground speed", None)
        for some in (("rates and forces",), ("steering",), ("rolling speed", "ground speed")):
            if self.sensors.keys().isdisjoint(some):
                raise InputError(f"{vehicle.name}: the filter of a trailer needs {some[0]}, which no sensor gives")
        self._radii = rolling_radii(vehicle)
        self._readers = [(quantity, Reader(0, one, Map(None))) for quantity, one in self.sensors.items()]
        self._waiting: list[tuple[int, int, MeasuredQuantity, Array]] = []  # readings: stamp, number, quantity, values
        self._count = self._newest = self._inertial = 0
        s, inertial, hitch = SETTINGS, self.sensors["rates and forces"], self.sensors.get("articulation")
        self._noise = inertial.deviations()[[2, 4]] ** 2  # of yaw rate and lateral specific force
        self._model = _Towing(SingleTrack.of(vehicle), trailer)
        ahead = float(getattr(inertial, "position", (0.0,))[0])
        self._filter = Ekf(Dense(self._model, (_GYRO, _ASIDE, _ANGLE), {"sensor_ahead": ahead}))
        offset = float(getattr(hitch, "offset", 0.01))
        self._reach = trailer.behind(vehicle.physics.chassis.cog_to_rear_axle) + trailer.length
        lasting = [s.mass, s.inertia, s.stiffness, s.nose, s.tyres, s.tyres, s.steering, s.gyro, s.aside, s.leaning[1]]
        mean = np.zeros(len(self._model.names))
        mean[self._model.names.index("leaning")] = s.leaning[0]
        self._filter.inputs[:] = 0.0, SWAY.slowest, 0.0
        self._filter.start(Gaussian(mean, np.diag(np.square([*self._begin(SWAY.slowest), *lasting, offset]))))
        self._outputs = self._model.outputs()
        self._inputs: dict[str, float] = {}  # the newest of each
        self.stamp = 0  # of the state [ns], 0 while there is none
        self._next_output = self._next_damping = 0
        self.damping: tuple[float, float] | None = None  # ratio at the present speed, and its standard deviation
        self.critical: tuple[float, float] | None = None  # speed [m/s], likewise; None: none that a car reaches

    def _begin(self, speed: float) -> Array:
        """Standard deviations of the motion at first: of a bend, and of a sway in it."""
        s = SETTINGS
        rate, angle = s.bend / speed + s.swaying, self._reach * s.bend / speed**2 + s.sway
        return np.array([s.lateral, rate, angle, rate, s.sway])

    @property
    def topics(self) -> dict[str, str]:
        """Topics that it listens to, with their message types."""
        return {sensor.topic: sensor.message for sensor in self.sensors.values()}

    def add(self, sample: Sample) -> bool:
        """Take a message. Returns whether there is something new to publish."""
        for quantity, reader in self._readers:
            if sample.topic == self.sensors[quantity].topic:
                event = reader.read(sample)
                if isinstance(event, Event):
                    self._count += 1
                    value = self.sensors[quantity].in_axes_of_car(event.value[None])[0]
                    heapq.heappush(self._waiting, (event.stamp, self._count, quantity, value))
                    self._newest = max(self._newest, event.stamp)
        while self._waiting and self._waiting[0][0] <= self._newest - SETTINGS.delay * 1e9:
            self._use(*heapq.heappop(self._waiting))
        if not self.stamp or self.stamp < self._next_output:
            return False
        self._next_output = self.stamp + round(SETTINGS.period * 1e9)
        if self.stamp >= self._next_damping:
            self._next_damping = self.stamp + round(SETTINGS.often * 1e9)
            self._judge()
        return True

    def take(self, recording: Recording) -> list[Sample]:
        """Take all messages of a recording; returns what would be published on the way."""
        return [self.sample() for sample in recording.samples() if sample.topic in self.topics and self.add(sample)]

    def _use(self, stamp: int, number: int, quantity: MeasuredQuantity, value: Array) -> None:
        """Take in one reading, in order of time."""
        if quantity == "rates and forces" and np.isfinite(value[[2, 3, 4]]).all():
            before, self._inertial = self._inertial, stamp
            self._inputs["along"] = float(value[3])
            self._go_on(stamp)
            if self.stamp:
                alike = max(1.0, SETTINGS.alike * 1e9 / max(stamp - before, 1)) if before else 1.0
                noise = self._noise + alike * np.array([SETTINGS.yaw_noise, SETTINGS.aside_noise]) ** 2
                self._filter.correct(*_GYRO.measured(value[2:3], noise[:1]))
                self._filter.correct(*_ASIDE.measured(value[4:5], noise[1:]))
        elif quantity == "articulation" and np.isfinite(value[0]) and self.stamp:
            self._go_on(stamp)
            if self.stamp:
                self._filter.correct(*_ANGLE.measured(value, self.sensors[quantity].deviations() ** 2))
        elif quantity == "steering" and np.isfinite(value[0]):
            self._inputs["steering"] = float(value[0])
        elif quantity in ("rolling speed", "ground speed"):
            speed = float(self.sensors[quantity].speeds(value[None], self._radii)[0])
            if np.isfinite(speed):
                self._inputs["speed"] = speed

    def _go_on(self, stamp: int) -> None:
        """Predict to a time; stop where the car is too slow, begin where it is no more."""
        filter, inputs = self._filter, self._inputs
        if len(inputs) < len(_Towing.inputs) or inputs["speed"] < SWAY.slowest:
            self.stamp = 0
            return
        filter.inputs[:] = [inputs[name] for name in _Towing.inputs]
        h = (stamp - self.stamp) * 1e-9
        if not self.stamp or h > SETTINGS.silence:
            filter.mean[: len(MOTION)] = 0.0
            filter.covariance[: len(MOTION), :] = filter.covariance[:, : len(MOTION)] = 0.0
            np.fill_diagonal(filter.covariance[: len(MOTION), : len(MOTION)], self._begin(inputs["speed"]) ** 2)
        elif h > 0:
            steps = int(np.ceil(h / SETTINGS.longest))
            for _ in range(steps):
                filter.predict(h / steps)
        self.stamp = max(self.stamp, stamp)

    def _judge(self) -> None:
        """Damping ratio and critical speed by the parameters of now."""
        part = slice(len(MOTION), len(MOTION) + len(UNKNOWN))
        shares, covariance = self._filter.mean[part], self._filter.covariance[part, part]
        speed = self._inputs["speed"]

        def judged(shares: Array) -> tuple[float, float]:
            car, trailer = self._model.with_shares(shares)
            critical = critical_speed(car, trailer)
            return damping_ratio(car, trailer, speed), SWAY.fastest if critical is None else critical

        now, steps = np.array(judged(shares)), np.sqrt(np.diag(covariance))
        slopes = np.array([np.subtract(judged(shares + d), judged(shares - d)) for d in np.diag(steps)]) / 2
        correlation = covariance / np.outer(steps, steps)
        ratio, critical = np.sqrt(np.einsum("ik,ij,jk->k", slopes, correlation, slopes))
        self.damping = float(now[0]), float(np.hypot(ratio, SETTINGS.form))
        self.critical = None if now[1] >= SWAY.fastest else (float(now[1]), float(critical))

    def state(self) -> tuple[Array, Array]:
        """`OUTPUTS` and their standard deviations, (5,) each: force and moment are those on the car, about its cog."""
        made, by_state, by_along = self._outputs(self._filter.mean, self._filter.inputs)
        jacobian = np.array(by_state)
        variance = np.diag(jacobian @ self._filter.covariance @ jacobian.T)
        return np.array(made)[:, 0], np.sqrt(variance + (np.array(by_along)[:, 0] * SETTINGS.along) ** 2)

    def diagnostic(self) -> Diagnostic:
        """A line that says how a sway is damped, a warning where it is badly."""
        if self.damping is None:
            return Diagnostic("trailer", Level.OK, f"not known below {SWAY.slowest * 3.6:.0f} km/h")
        ratio, deviation = self.damping
        text = f"damping ratio of its sway {ratio:.2f} ± {deviation:.2f}"
        if self.critical is not None:
            text += f", which is none at {self.critical[0] * 3.6:.0f} ± {self.critical[1] * 3.6:.0f} km/h"
        if ratio < SETTINGS.poor and self.stamp:
            return Diagnostic("trailer", Level.WARN, f"{text}: drive slower, load less behind its axle")
        return Diagnostic("trailer", Level.OK, text)

    def sample(self) -> Sample:
        """What is published: `OUTPUTS`, `damping_ratio` and, if there is one, `critical_speed` [m/s] as position, their
        standard deviations as velocity."""
        values, deviations = self.state()
        more = {"damping_ratio": self.damping, "critical_speed": self.critical}
        known = {name: pair for name, pair in more.items() if pair is not None}
        columns = {
            "position": np.array([*values, *(value for value, _ in known.values())]),
            "velocity": np.array([*deviations, *(deviation for _, deviation in known.values())]),
            "effort": np.zeros(0),
        }
        return Sample(TOPIC, "sensor_msgs/msg/JointState", self.stamp, columns, names=(*OUTPUTS, *known))


def towing_in(recording: Recording, vehicle: Vehicle) -> Towing | None:
    """The trailer after a recording; None if the vehicle has none, or the recording not the sensors for it."""
    try:
        towing = Towing(vehicle)
    except InputError:
        return None
    if not all(one.topic in recording for name, one in towing.sensors.items() if name != "articulation"):
        return None
    towing.take(recording)
    return towing
