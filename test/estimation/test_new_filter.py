"""How to add a filter: what it knows is a state space and its measurements; what it does with that exists already.

The filter here finds heading and rolling radius from the speeds of the rear wheels and the course of GNSS (Leung 2010,
section 4.3, eqs. 4.12 to 4.16). All that belongs to it stands between the two lines.
"""

from __future__ import annotations

from typing import Any

import casadi as ca
import numpy as np
import pytest

from vsense_ros.errors import InputError
from vsense_ros.estimation.catalogue import Catalogue, FilterFamily
from vsense_ros.estimation.dense import Dense
from vsense_ros.estimation.ekf import Ekf
from vsense_ros.estimation.filter import Gaussian
from vsense_ros.estimation.state_space import Measurement, Named, StateSpace
from vsense_ros.estimation.ukf import Ukf

# ------------------------------------------------------------------------------------------------------------------


class WheelHeading(StateSpace):
    """ψ̇ = (ω_right - ω_left) (R + b) / t: heading, and how much larger than R the wheels roll."""

    names = ("yaw", "radius_error")
    inputs = ("spin_rear_left", "spin_rear_right")
    parameters = ("radius", "track")

    def turning(self, x: Named, u: Named, theta: Named) -> ca.SX:
        return (u.spin_rear_right - u.spin_rear_left) * (theta.radius + x.radius_error) / theta.track

    def transition(self, x: Named, u: Named, theta: Named, h: ca.SX) -> Any:
        return [x.yaw + h * self.turning(x, u, theta), x.radius_error]

    def noise(self, x: Named, u: Named, theta: Named, h: ca.SX) -> Any:
        return [2 * (h * 0.04 * theta.radius / theta.track) ** 2, 1e-10 * h]


COURSE = Measurement("course", lambda x, z, u, p: x.yaw, (0.01,), angles=(0,), gate=4.0)
SPEED = Measurement(
    "gnss_speed",
    lambda x, z, u, p: (u.spin_rear_left + u.spin_rear_right) / 2 * (p.radius + x.radius_error),
    (0.04,),
    when=lambda x, u, p: ca.fabs(u.spin_rear_right - u.spin_rear_left) < 0.5,  # straight ahead
)
FAMILY = FilterFamily.of(
    "wheel_heading",
    "Heading by wheel speeds",
    "Take it where there is no yaw gyro.",
    WheelHeading(),
    (COURSE, SPEED),
    lambda parameters: Ekf(Dense(WheelHeading(), (COURSE, SPEED), parameters)),
)

# ------------------------------------------------------------------------------------------------------------------

PARAMETERS = {"radius": 0.3, "track": 1.5}


@pytest.mark.parametrize("kind", ["from the catalogue", "unscented"])
def test_a_filter_is_a_state_space_in_its_own_file(kind: str) -> None:
    """Straight ahead, then a bend, with wheels that roll 5 mm less than was thought."""
    filter: Any = Ukf(WheelHeading(), (COURSE, SPEED), PARAMETERS)
    if kind == "from the catalogue":
        family = Catalogue([FAMILY])["wheel_heading"]
        assert family.make is not None
        filter = family.make(PARAMETERS)
    random, yaw, radius = np.random.default_rng(0), 3.0, 0.295
    filter.start(Gaussian(np.array([3.1, 0.0]), np.diag([0.2, 0.01]) ** 2))
    for i in range(6000):
        rate = 0.3 if i > 3000 else 0.0
        yaw += 0.01 * rate
        spin = (15.0 + np.array([-0.5, 0.5]) * rate * PARAMETERS["track"]) / radius
        filter.inputs[:] = spin + 0.04 * random.normal(size=2)
        filter.predict(0.01)
        if i % 100 == 0:
            seen = np.arctan2(np.sin(yaw), np.cos(yaw)) + 0.01 * random.normal()
            filter.correct(*COURSE.measured([seen]))
            told = filter.correct(*SPEED.measured([15.0 + 0.04 * random.normal()]))
            assert (told.nis < 0) == (rate > 0), "the speed is used straight ahead only"
    error = filter.mean - [yaw, radius - PARAMETERS["radius"]]
    assert (np.abs(error) < 4 * np.sqrt(np.diag(filter.covariance))).all()
    assert abs(error[0]) < 0.02
    assert abs(error[1]) < 0.0005


def test_the_catalogue_has_what_a_filter_needs_and_refuses_a_name_that_is_unknown_or_taken() -> None:
    families = Catalogue([FAMILY])
    assert families.names == ("wheel_heading",)
    assert [family.states for family in families] == [("yaw", "radius_error")]
    assert families["wheel_heading"].inputs == ("spin_rear_left", "spin_rear_right")
    with pytest.raises(InputError, match="no filter 'wheel_headin', did you mean 'wheel_heading'\\?"):
        families["wheel_headin"]
    with pytest.raises(InputError, match=r"no filter 'particle'\. There are: wheel_heading"):
        families["particle"]
    with pytest.raises(ValueError, match="two filters called 'wheel_heading'"):
        families.add(FAMILY)
