"""What happens at the four wheels: steer angles, contact with the road, slips, tyre forces."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np

from blind.physics import road

BUSH_TIME = 0.012  # [s] of rubber bushings
COLUMN_TIME = 0.018  # [s] of a damped steering column
TREAD_HEAT = 2600.0  # [J/K] of what warms quickly
COOLING = 45.0  # [W/K]
SMALLEST_RELAXATION = 0.05  # [m]


def cross(a, b):
    """Cross product of vectors (3, …), which may be broadcast."""
    first = a[1] * b[2]
    result = np.empty((3, *first.shape))
    np.subtract(first, a[2] * b[1], out=result[0])
    np.subtract(a[2] * b[0], a[0] * b[2], out=result[1])
    np.subtract(a[0] * b[1], a[1] * b[0], out=result[2])
    return result


def dot(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def steer_angles(car, knobs, extra, handwheel, travel, axle_torque):
    """Steer angles of the four wheels about z [rad], (4, lanes)."""
    ratio = car.ratio * (1 + knobs.ratio_change) / (1 + knobs.ratio_progression * handwheel**2)
    mean = (handwheel + knobs.steering_offset) / ratio - extra.twist
    tangent = np.tan(mean)
    half = car.track[0] / 2
    angle = np.zeros_like(travel)
    angle[0] = np.arctan(car.wheelbase * tangent / (car.wheelbase - half * tangent))
    angle[1] = np.arctan(car.wheelbase * tangent / (car.wheelbase + half * tangent))
    if knobs.any("roll_steer"):
        front = (travel[1] - travel[0]) / car.track[0]  # positive: the right side is compressed
        rear = (travel[3] - travel[2]) / car.track[2]
        angle[:2] += knobs.roll_steer[0] * front
        angle[2:] += knobs.roll_steer[1] * rear
    if knobs.any("toe_compliance", "toe_play"):
        angle += extra.bush
    if knobs.any("toe_by_torque"):
        play = np.repeat(knobs.toe_by_torque, 2, axis=0) * car.side
        angle += play * np.tanh(axle_torque / 60)
    if knobs.any("torque_steer"):
        angle[:2] += knobs.torque_steer * (axle_torque[0] + axle_torque[1])
    if knobs.any("rear_steering"):
        angle[2:] += knobs.rear_steering * mean
    return angle


def contacts(car, knobs, motion, angle):
    """Geometry and velocities at the contact points, in body axes (3, 4, lanes), and the wheel loads."""
    centre = car.centre + car.guide * motion.travel
    to_map = motion.rotation  # body → map (3, 3, lanes)
    arm = np.einsum("ijn,jkn->ikn", to_map, centre)
    # Place of each wheel relative to the nearest point of the path.
    path = motion.path
    dx, dy = arm[0] + motion.position[0] - path.x, arm[1] + motion.position[1] - path.y
    cosine, sine = np.cos(path.heading), np.sin(path.heading)
    along, across = path.along + dx * cosine + dy * sine, -dx * sine + dy * cosine
    if knobs.any("grade", "bank", "undulation"):
        grade, bank = road.slopes(knobs, along, across)
        ground = road.height(knobs, along, across)
        slope_x = cosine * grade - sine * bank
        slope_y = sine * grade + cosine * bank
        up = np.stack([-slope_x, -slope_y, np.ones_like(slope_x)]) / np.sqrt(1 + slope_x**2 + slope_y**2)
        normal = np.einsum("jin,jkn->ikn", to_map, up)
        above = (motion.position[2] + arm[2] - ground) * up[2]
    else:
        normal = np.repeat(to_map[2][:, None, :], 4, axis=1)
        above = motion.position[2] + arm[2]
    if path.surface.rms.any():
        above = above - road.roughness(path.surface, along)
    axle = np.stack([-np.sin(angle), np.cos(angle), np.zeros_like(angle)])
    ahead = cross(axle, normal)
    ahead = ahead / np.sqrt(dot(ahead, ahead))
    upward = cross(ahead, axle)
    loaded = above / dot(normal, upward)
    point = centre - loaded * upward
    sideways = cross(normal, ahead)
    rates = motion.rates[:, None, :]
    velocity = motion.velocity[:, None, :] + cross(rates, point)
    velocity = velocity + car.guide * motion.travel_rate
    radius = car.radius * (1 + knobs.radius_change)
    stiffness = car.tyre_vertical * (1 - 0.8 * knobs.pressure_loss)
    deflection = radius - loaded
    load = stiffness * deflection - car.tyre_damping * dot(normal, velocity)
    load = np.where(deflection > 0, np.maximum(load, 0.0), 0.0)
    if knobs.any("imbalance"):
        load = load + knobs.imbalance * motion.spin**2 * np.sin(motion.spin_angle)
    return SimpleNamespace(
        centre=centre, point=point, normal=normal, ahead=ahead, sideways=sideways, axle=axle, load=load, along=along,
        loaded=loaded, effective=radius - deflection / 3, camber=dot(normal, axle),
        speed_x=dot(ahead, velocity), speed_y=dot(sideways, velocity),
    )  # fmt: skip


def tyres(car, knobs, motion, extra, contact, formula, rate):
    """Forces in body axes at the contact points (3, 4, lanes), torque on the spins, rates of the tyres' states."""
    speed = np.maximum(np.abs(contact.speed_x), 1.0)
    kappa = (contact.effective * motion.spin - contact.speed_x) / speed
    alpha = -np.arctan2(contact.speed_y, speed)
    if knobs.any("relaxation"):
        length = np.maximum(knobs.relaxation, SMALLEST_RELAXATION)
        rate.slip_angle[:] = speed / length * (alpha - extra.slip_angle)
        alpha = np.where(knobs.relaxation > 0, extra.slip_angle, alpha)
    trail_angle = alpha
    cornering = car.cornering
    if knobs.any("camber_stiffness"):
        alpha = alpha - contact.camber * knobs.camber_stiffness * contact.load / cornering
    if knobs.any("conicity"):
        alpha = alpha + knobs.conicity / cornering
    grip = road.grip(knobs, contact.along, motion.velocity[0], car.side)
    if knobs.any("load_exponent"):
        grip = grip * (np.maximum(contact.load, 100.0) / car.nominal_load) ** -knobs.load_exponent
    if knobs.any("heat_loss"):
        grip = grip * np.maximum(1 - knobs.heat_loss * extra.warmth, 0.3)
    if knobs.any("pressure_loss"):
        softer = SimpleNamespace(**vars(car))
        softer.cornering = cornering * (1 - 0.5 * knobs.pressure_loss)
        force_x, force_y = formula(softer, kappa, alpha, contact.load, grip)
    else:
        force_x, force_y = formula(car, kappa, alpha, contact.load, grip)
    if knobs.any("heat_loss"):
        sliding = np.abs(force_x * kappa * speed) + np.abs(force_y * np.tan(alpha) * speed)
        rate.warmth[:] = (sliding - COOLING * extra.warmth) / TREAD_HEAT
    saturation = np.clip(1 - np.abs(np.tan(trail_angle)) / 0.22, 0.0, 1.0)
    aligning = -car.trail * saturation**1.5 * force_y
    shift = car.rolling_resistance + knobs.rolling_extra * (1 + (speed / 45) ** 2)
    shift = shift * (1 + 1.2 * knobs.pressure_loss)
    rolling = -shift * contact.load * contact.effective * np.tanh(motion.spin)
    force = force_x * contact.ahead + force_y * contact.sideways + contact.load * contact.normal
    if knobs.any("toe_compliance", "toe_play"):
        soft = -np.repeat(knobs.toe_compliance, 2, axis=0) * force_y
        loose = -knobs.toe_play * np.tanh(force_y / 300)
        rate.bush[:] = (soft + loose - extra.bush) / BUSH_TIME
    if knobs.any("steering_compliance"):
        kingpin = aligning[0] + aligning[1] - 0.018 * (force_y[0] + force_y[1])  # 18 mm of mechanical trail
        rate.twist[...] = (-knobs.steering_compliance * kingpin - extra.twist) / COLUMN_TIME
    # About the axle of a wheel that leans there is a part of what turns it about the normal of the road.
    spin_torque = -force_x * contact.loaded + rolling + aligning * contact.camber
    moment = aligning * contact.normal + rolling * contact.axle
    return force, moment, spin_torque, force_x, force_y
