"""A plant written out by hand: Newton and Euler for the car as a whole, wheels sliding on guides, Runge-Kutta at 1 ms.

The accelerations of body and guides are eliminated into a 6 × 6 system per lane (Schur complement of the guides).
"""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np

from blind.cars import GRAVITY
from blind.driver import Drivers
from blind.physics import state
from blind.physics.actions import actions
from blind.physics.wheel import cross, dot
from blind.plants.log import PERIOD, SETTLING, Log, Recorder, rotation

STEP = 0.001  # [s]
POSITION, ANGLES, VELOCITY, RATES = slice(0, 3), slice(3, 6), slice(6, 9), slice(9, 12)
TRAVEL, TRAVEL_RATE, SPIN, SPIN_ANGLE = slice(12, 16), slice(16, 20), slice(20, 24), slice(24, 28)
EXTRA = slice(28, 28 + state.SIZE)


def simulate(cars, knobs, courses, formula, tick=lambda seconds: None) -> Log:
    """Drive every lane its course; `tick` is told the seconds of simulated time that have passed."""
    plant = _Plant(cars, knobs, formula)
    drivers = Drivers(cars, courses)
    duration = max(course.duration for course in courses)
    recorder = Recorder(duration, cars.lanes)
    x = plant.start(np.array([course.speed for course in courses]))
    force = np.zeros((3, cars.lanes))
    force[2] = GRAVITY
    every = round(PERIOD / STEP)
    for k in range(round((SETTLING + duration) / STEP) + 1):
        motion = plant.motion(x, None)
        path, command = drivers.command(k * STEP, motion)
        first, linear, turning, action = plant.derivative(x, path, command, force)
        force = linear
        if k % every == 0 and k * STEP >= SETTLING:
            recorder.add(plant.motion(x, path), action, x[EXTRA][state.PLACES["hands"].start], linear, turning)
            tick(PERIOD)
        second = plant.derivative(x + STEP / 2 * first, path, command, force)[0]
        third = plant.derivative(x + STEP / 2 * second, path, command, force)[0]
        fourth = plant.derivative(x + STEP * third, path, command, force)[0]
        x = x + STEP / 6 * (first + 2 * second + 2 * third + fourth)
    return recorder.log()


class _Plant:
    def __init__(self, cars, knobs, formula) -> None:
        self.car, self.knobs, self.formula = cars, knobs, formula
        unsprung, centre = cars.unsprung, cars.centre
        self.sprung = cars.mass - unsprung.sum(axis=0)
        # First and second moments of what is left of the whole car without its wheels, and the payload.
        self.first = -(unsprung * centre).sum(axis=1) + knobs.payload * knobs.payload_place
        inertia = np.zeros((3, 3, cars.lanes))
        spheres = dot(centre, centre)
        for i, whole in enumerate((cars.roll_inertia, cars.pitch_inertia, cars.yaw_inertia)):
            own = cars.spin_inertia if i == 1 else cars.diametral_inertia
            inertia[i, i] = whole - (unsprung * (spheres - centre[i] ** 2) + own).sum(axis=0)
        for i, j in ((0, 1), (0, 2), (1, 2)):
            inertia[i, j] = inertia[j, i] = (unsprung * centre[i] * centre[j]).sum(axis=0)
        at = knobs.payload_place
        inertia += knobs.payload * (dot(at, at) * np.eye(3)[:, :, None] - at[:, None] * at[None])
        self.inertia = inertia
        self.body_mass = self.sprung + knobs.payload

    def start(self, speed):
        x = np.zeros((EXTRA.stop, self.car.lanes))
        x[POSITION.start + 2] = self.car.cog_height
        x[VELOCITY.start] = speed
        x[SPIN] = speed / (self.car.radius - self.car.static_load / self.car.tyre_vertical / 3)
        return x

    def motion(self, x, path):
        return SimpleNamespace(
            rotation=rotation(*x[ANGLES]), position=x[POSITION], velocity=x[VELOCITY], rates=x[RATES], travel=x[TRAVEL],
            travel_rate=x[TRAVEL_RATE], spin=x[SPIN], spin_angle=x[SPIN_ANGLE], path=path,
        )  # fmt: skip

    def derivative(self, x, path, command, force_before):
        """Derivative of the state; and specific force of cog, angular acceleration [body axes], and what acts."""
        car = self.car
        m = self.motion(x, path)
        act = actions(car, self.knobs, m, x[EXTRA], command, force_before, self.formula)
        omega, velocity = m.rates, m.velocity
        gravity = -GRAVITY * m.rotation[2]  # in body axes
        wheels, unsprung, guide = act.centre, car.unsprung, car.guide
        turn = omega[:, None]
        # Mass, first moment and inertia about cog with the wheels where they are.
        mass = self.body_mass + unsprung.sum(axis=0)
        first = self.first + (unsprung * wheels).sum(axis=1)
        inertia = self.inertia.copy()
        square = (unsprung * dot(wheels, wheels)).sum(axis=0)
        for i in range(3):
            inertia[i, i] += square + car.diametral_inertia.sum(axis=0) * (i != 1)
        inertia -= np.einsum("wn,iwn,jwn->ijn", unsprung, wheels, wheels)
        # Known accelerations of the wheels: of rotation and of sliding on turning guides (Coriolis).
        known = cross(turn, cross(turn, wheels)) + 2 * cross(turn, guide * m.travel_rate)
        at_wheel = act.force + unsprung * gravity[:, None]
        along_guide = dot(guide, at_wheel) - act.strut - unsprung * dot(guide, known)
        # Whole car: linear and angular momentum, moved by all outer forces.
        inner = self.inertia
        whirl = cross(omega, np.einsum("ijn,jn->in", inner, omega))
        centrifugal = cross(omega, cross(omega, self.first)) + (unsprung * known).sum(axis=1)
        spins = (car.spin_inertia * m.spin).sum(axis=0)
        diametral = car.diametral_inertia.sum(axis=0)
        wheel_momentum = np.stack(
            [diametral * omega[0], spins + car.spin_inertia.sum(axis=0) * omega[1], diametral * omega[2]]
        )
        gyroscopic = cross(omega, wheel_momentum)
        weight_moment = cross(first, gravity)
        outer_moment = cross(act.point, act.force).sum(axis=1) + act.moment.sum(axis=1) + act.body_moment
        # Torque about the wheels' axles turns the wheels, not the body; what engine and brakes give reacts on the body.
        rolling = act.spin_torque + act.axle_torque
        linear_load = act.force.sum(axis=1) + act.body_force + mass * gravity - centrifugal
        angular_load = (
            outer_moment
            + weight_moment
            - whirl
            - (cross(wheels, unsprung * known)).sum(axis=1)
            - gyroscopic
            - (rolling * act.contact.axle).sum(axis=1)
        )
        lever = cross(wheels, guide)
        linear_load = linear_load - (guide * along_guide).sum(axis=1)
        angular_load = angular_load - (lever * along_guide).sum(axis=1)
        matrix = np.zeros((6, 6, car.lanes))
        for i in range(3):
            matrix[i, i] = mass
        zero = np.zeros_like(mass)
        skew = np.stack(
            [
                np.stack([zero, -first[2], first[1]]),
                np.stack([first[2], zero, -first[0]]),
                np.stack([-first[1], first[0], zero]),
            ]
        )
        matrix[:3, 3:], matrix[3:, :3], matrix[3:, 3:] = -skew, skew, inertia
        direction = np.concatenate([guide, lever])
        matrix -= np.einsum("wn,iwn,jwn->ijn", unsprung, direction, direction)
        load = np.concatenate([linear_load, angular_load])
        solved = np.linalg.solve(matrix.transpose(2, 0, 1), load.T[:, :, None])[:, :, 0].T
        linear, angular = solved[:3], solved[3:]  # acceleration of cog against the map, in body axes
        carried = linear[:, None] + cross(angular[:, None], wheels)
        sliding = along_guide / unsprung - dot(guide, carried)
        derivative = np.empty_like(x)
        derivative[POSITION] = np.einsum("ijn,jn->in", m.rotation, velocity)
        roll, pitch = x[ANGLES][0], x[ANGLES][1]
        tilted = np.sin(roll) * omega[1] + np.cos(roll) * omega[2]
        derivative[3] = omega[0] + np.tan(pitch) * tilted
        derivative[4] = np.cos(roll) * omega[1] - np.sin(roll) * omega[2]
        derivative[5] = tilted / np.cos(pitch)
        derivative[VELOCITY] = linear - cross(omega, velocity)
        derivative[RATES] = angular
        derivative[TRAVEL] = m.travel_rate
        derivative[TRAVEL_RATE] = sliding
        derivative[SPIN] = rolling / car.spin_inertia - angular[1]
        derivative[SPIN_ANGLE] = m.spin
        derivative[EXTRA] = act.rate
        return derivative, linear - gravity, angular, act
