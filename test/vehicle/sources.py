"""What comes to the drivers by topics of other packages, in the place of a bus or a port."""

from __future__ import annotations

import struct
import time

import numpy as np
from sensor_msgs.msg import JointState, NavSatFix

from recordings import formats
from vehicle.workshop import Workshop, check
from vsense_ros.bag import read_bag
from vsense_ros.bag.gnss_bytes import gnss_byte_stream
from vsense_ros.messages import cdr_messages
from vsense_ros.node.convert import message_type


@check("can_msgs/Frame and nmea_msgs/Sentence take the place of a bus and of a port")
def topics(shop: Workshop) -> str:
    (shop.folder / "car.dbc").write_text(formats.DBC)
    (shop.folder / "car.yaml").write_text(formats.CAN_MAPPING)
    files = {"database": str(shop.folder / "car.dbc"), "mapping": str(shop.folder / "car.yaml")}
    shop.start("can_driver", interface="topic", **files).wait_until_active()
    shop.start("gps_driver", sentence_topic="nmea_sentence").wait_until_active()
    speeds = shop.client.listen(JointState, "vehicle/wheel_speeds")
    fixes = shop.client.listen(NavSatFix, "gps/fix")
    frames = shop.client.node.create_publisher(message_type("can_msgs/msg/Frame"), "can/frames", 100)
    sentences = shop.client.node.create_publisher(message_type("nmea_msgs/msg/Sentence"), "nmea_sentence", 100)
    shop.client.until(lambda: frames.get_subscription_count() + sentences.get_subscription_count() == 2)
    sent = formats.frames(0.5)
    for frame in sent:
        one = cdr_messages.CanFrame(time.time_ns(), frame.arbitration_id, bytes(frame.data), length=frame.dlc)
        frames.publish(cdr_messages.encode_can_frame(one))
        time.sleep(0.005)
    lines = [line for _, burst in gnss_byte_stream(read_bag(shop.drive(3.0))) for line in burst.split(b"\r\n") if line]
    for line in lines:
        text = line + b"\0"
        header = struct.pack("<iII", 0, 0, 1) + bytes(4)
        sentences.publish(b"\0\1\0\0" + header + struct.pack("<I", len(text)) + text)
        time.sleep(0.01)
    shop.client.until(lambda: len(speeds) >= len(sent) // 2 and len(fixes) >= len(lines) // 2, 10.0)
    expected = formats.SPEED / 0.3
    np.testing.assert_allclose(speeds[-1].velocity, expected, rtol=2e-3)
    assert len(speeds) == len(sent) // 2
    assert abs(fixes[-1].latitude - 43.5) < 0.01
    return f"{len(speeds)} wheel speeds, {len(fixes)} fixes"
