"""A plant on MuJoCo: a tree of nine rigid bodies, stepped semi-implicitly at 1 ms; tyres act as applied forces.

One model per lane, all stepped by one call of MuJoCo's batched roll-out.
"""

from __future__ import annotations

from types import SimpleNamespace

import mujoco
import numpy as np
from mujoco import rollout

from blind.cars import GRAVITY
from blind.driver import Drivers
from blind.physics import state
from blind.physics.actions import actions
from blind.physics.wheel import cross
from blind.plants.log import PERIOD, SETTLING, Log, Recorder

STEP = 0.001  # [s]
WHEELS = ("fl", "fr", "rl", "rr")
CONTROL = int(mujoco.mjtState.mjSTATE_QFRC_APPLIED) | int(mujoco.mjtState.mjSTATE_XFRC_APPLIED)
# qpos: position, quaternion, then slide and spin of each wheel; qvel likewise with one row less.
SLIDES, SPINS = [0, 2, 4, 6], [1, 3, 5, 7]


def simulate(cars, knobs, courses, formula, tick=lambda seconds: None) -> Log:
    """Drive every lane its course; `tick` is told the seconds of simulated time that have passed."""
    lanes = cars.lanes
    models = [mujoco.MjModel.from_xml_string(_xml(cars, knobs, lane)) for lane in range(lanes)]
    first = models[0]
    size = mujoco.mj_stateSize(first, int(mujoco.mjtState.mjSTATE_FULLPHYSICS))
    position, velocity = slice(1, 1 + first.nq), slice(1 + first.nq, 1 + first.nq + first.nv)
    full = np.zeros((lanes, size))
    full[:, position] = first.qpos0
    full[:, 3] = cars.cog_height
    speed = np.array([course.speed for course in courses])
    full[:, velocity.start] = speed
    rolling = speed / (cars.radius - cars.static_load / cars.tyre_vertical / 3)
    full[:, [velocity.start + 6 + i for i in SPINS]] = rolling.T

    drivers = Drivers(cars, courses)
    duration = max(course.duration for course in courses)
    recorder = Recorder(duration, lanes)
    extra = state.zeros(lanes)
    specific = np.zeros((3, lanes))
    specific[2] = GRAVITY
    every = round(PERIOD / STEP)
    control = np.zeros((lanes, 1, first.nv + 6 * first.nbody))
    states = np.zeros((lanes, 1, size))
    data = mujoco.MjData(first)
    centre = np.stack([model.body_ipos[1] for model in models], axis=1)
    with rollout.Rollout(nthread=0) as engine:
        for k in range(round((SETTLING + duration) / STEP) + 1):
            q, v = full[:, position].T, full[:, velocity].T
            matrix = _matrix(q[3:7])
            motion = SimpleNamespace(
                rotation=matrix, position=q[:3], velocity=np.einsum("jin,jn->in", matrix, v[:3]), rates=v[3:6],
                travel=q[7:][SLIDES], travel_rate=v[6:][SLIDES], spin=v[6:][SPINS], spin_angle=q[7:][SPINS], path=None,
            )  # fmt: skip
            motion.path, command = drivers.command(k * STEP, motion)
            act = actions(cars, knobs, motion, extra, command, specific, formula)
            _apply(control[:, 0], first, matrix, centre, act)
            engine.rollout(models, [data], full, control, control_spec=CONTROL, skip_checks=True, nstep=1, state=states)
            change = (states[:, 0, velocity].T - v) / STEP
            specific = np.einsum("jin,jn->in", matrix, change[:3] + np.array([0, 0, GRAVITY])[:, None])
            if k % every == 0 and k * STEP >= SETTLING:
                recorder.add(motion, act, extra[state.PLACES["hands"].start], specific, change[3:6])
                tick(PERIOD)
            full[...] = states[:, 0]
            extra = extra + STEP * act.rate
    return recorder.log()


def _apply(control, model, matrix, centre, act) -> None:
    """Generalized and Cartesian forces of MuJoCo from what acts on the car."""
    nv = model.nv
    generalized, cartesian = control[:, :nv], control[:, nv:].reshape(len(control), model.nbody, 6)
    generalized[:, [6 + i for i in SLIDES]] = -act.strut.T
    generalized[:, [6 + i for i in SPINS]] = act.axle_torque.T
    cartesian[:, 1, :3] = np.einsum("ijn,jn->ni", matrix, act.body_force)
    # MuJoCo applies forces at the centre of mass of the chassis, ours act at cog of the whole car.
    moment = act.body_moment - cross(centre, act.body_force)
    cartesian[:, 1, 3:] = np.einsum("ijn,jn->ni", matrix, moment)
    # The wheels of the tree turn about an axle that does not steer: on them acts what turns a wheel about its own, on
    # the hubs all the rest.
    turning = act.spin_torque * np.array([0.0, 1.0, 0.0])[:, None, None]
    held = cross(act.point - act.centre, act.force) + act.moment - turning
    for i in range(4):
        hub, wheel = 2 + 2 * i, 3 + 2 * i
        cartesian[:, hub, :3] = np.einsum("ijn,jn->ni", matrix, act.force[:, i])
        cartesian[:, hub, 3:] = np.einsum("ijn,jn->ni", matrix, held[:, i])
        cartesian[:, wheel, 3:] = np.einsum("ijn,jn->ni", matrix, turning[:, i])


def _matrix(quaternion):
    """Body → map, (3, 3, lanes), from w, x, y, z."""
    w, x, y, z = quaternion
    return np.stack(
        [
            np.stack([1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)]),
            np.stack([2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)]),
            np.stack([2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)]),
        ]
    )


def _chassis(cars, knobs, lane):
    """Mass, centre and inertia about it of the whole car without hubs and wheels, with the payload."""
    mass = cars.mass[lane]
    moment = np.zeros(3)
    inertia = np.diag([cars.roll_inertia[lane], cars.pitch_inertia[lane], cars.yaw_inertia[lane]])
    parts = [(-cars.unsprung[i, lane], cars.centre[:, i, lane]) for i in range(4)]
    parts.append((knobs.payload[lane], knobs.payload_place[:, lane]))
    for part, at in parts:
        mass, moment = mass + part, moment + part * at
        inertia = inertia + part * (at @ at * np.eye(3) - np.outer(at, at))
    for i in range(4):
        d, s = cars.diametral_inertia[i, lane], cars.spin_inertia[i, lane]
        inertia = inertia - np.diag([d, s, d])
    centre = moment / mass
    return mass, centre, inertia - mass * (centre @ centre * np.eye(3) - np.outer(centre, centre))


def _xml(cars, knobs, lane) -> str:
    mass, centre, inertia = _chassis(cars, knobs, lane)
    six = (inertia[0, 0], inertia[1, 1], inertia[2, 2], inertia[0, 1], inertia[0, 2], inertia[1, 2])
    corners = "".join(
        f"""
      <body name="hub_{WHEELS[i]}" pos="{_numbers(cars.centre[:, i, lane])}">
        <inertial pos="0 0 0" mass="{cars.hub_mass[i, lane]}" diaginertia="1e-4 1e-4 1e-4"/>
        <joint type="slide" axis="{_numbers(cars.guide[:, i, lane])}"/>
        <body name="wheel_{WHEELS[i]}">
          <inertial pos="0 0 0" mass="{cars.wheel_mass[i, lane]}" diaginertia="{_numbers(_inertia(cars, i, lane))}"/>
          <joint type="hinge" axis="0 1 0"/>
        </body>
      </body>"""
        for i in range(4)
    )
    return f"""<mujoco>
  <option timestep="{STEP}" gravity="0 0 {-GRAVITY}" integrator="Euler"><flag contact="disable"/></option>
  <worldbody>
    <body name="chassis" pos="0 0 {cars.cog_height[lane]}">
      <freejoint/>
      <inertial pos="{_numbers(centre)}" mass="{mass}" fullinertia="{_numbers(six)}"/>{corners}
    </body>
  </worldbody>
</mujoco>"""


def _inertia(cars, i, lane):
    d, s = cars.diametral_inertia[i, lane], cars.spin_inertia[i, lane]
    return d, s, d


def _numbers(values) -> str:
    return " ".join(f"{value:.12g}" for value in values)
