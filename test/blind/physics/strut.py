"""Forces along the wheel guides, positive pushing the wheel down (4, lanes) [N]."""

from __future__ import annotations

import numpy as np


def forces(car, knobs, motion, lateral_acceleration):
    travel, speed = motion.travel, motion.travel_rate
    damper = car.damper * (1 - knobs.damper_loss)
    opposite = travel[[1, 0, 3, 2]]
    spring = car.spring * travel * (1 + car.spring_progression * travel)
    damping = damper * speed * (1 - car.damper_asymmetry * np.tanh(speed / 0.08))
    force = car.preload + spring + damping + car.antiroll * (travel - opposite)
    if knobs.any("strut_friction"):
        force = force + knobs.strut_friction * np.tanh(speed / 0.006)
    if knobs.any("bump_stiffness"):
        over = np.maximum(travel - knobs.bump_gap, 0.0)
        force = force + knobs.bump_stiffness * over**2
    if knobs.any("active_roll"):
        force = force - car.side * knobs.active_roll * lateral_acceleration**3 / car.track / 2
    return force
