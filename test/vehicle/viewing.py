"""What Foxglove gets of a car that drives."""

from __future__ import annotations

import re

from foxglove_client import watch
from vehicle.workshop import CAR, Workshop, check
from vsense_ros.bag import read_bag

_NEEDED = (
    "vsense/odometry",
    "vsense/sideslip",
    "vsense/wheel_force/fl",
    "imu/data",
    "robot_description",
    "vsense/view/tyres",
)


@check("Foxglove gets the live topics of a car by its own protocol, on this machine alone, the latched ones too")
def live(shop: Workshop) -> str:
    shop.start("observer", vehicle=CAR, namespace="car1", use_sim_time=True).wait_until_active()
    viewer = shop.start("viewer", vehicle=CAR, namespace="car1", use_sim_time=True, port=0)
    viewer.wait_until_active()
    found = re.search(r"serving at (ws://127\.0\.0\.1:\d+);", viewer.output)
    assert found, viewer.output
    shop.start("replay", bag=str(shop.drive(5.0)), namespace="car1", consumers=1)
    needed = {f"/car1/{topic}" for topic in _NEEDED} | {"/tf", "/tf_static"}
    seen = watch(found[1], lambda v: needed <= set(v.seen) and len(v.seen["/car1/vsense/odometry"]) > 200, 60.0)
    odometry = seen.message("/car1/vsense/odometry")
    truth = read_bag(shop.drive())["reference/odometry"].columns["linear"][:, 0]
    assert truth.min() - 1 < odometry.twist.twist.linear.x < truth.max() + 1
    assert viewer.stop() == 0
    return f"{len(seen.topics)} topics, {sum(map(len, seen.seen.values()))} messages"
