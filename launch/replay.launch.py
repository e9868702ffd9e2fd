"""A bag through the observer, recorded: ros2 launch vsense_ros replay.launch.py bag:=… vehicle:=genesis.

It ends with the replay: with 0 when everything was sent, taken and recorded, else with the sentence that says why not.
"""

from typing import Any

from launch import LaunchDescription
from launch.actions import EmitEvent, RegisterEventHandler
from launch.event_handlers import OnProcessExit
from launch.events import Shutdown

from vsense_ros.node.launching import Given, description, node

ARGUMENTS = {
    "bag": (None, "bag to replay"),
    "vehicle": (None, "vehicle file, or the name of one in config/vehicles"),
    "monitor": ("", "limits that vsense monitor --calibrate wrote; empty: the fit of the model is not judged"),
    "map_origin": ("", "latitude,longitude,height [deg, deg, m] of the map; empty: the first fix"),
    "out": ("vsense_output", "folder for the recorded bag; where it holds something already, OUT_1, OUT_2 …"),
    "overwrite": ("false", "replace the bag in that folder"),
    "rate": ("0.0", "times real time; 0: as fast as observer and recorder can"),
    "loop": ("false", "begin again at the end"),
    "start_offset": ("0.0", "[s] where to begin"),
    "wait": ("600.0", "[s] for observer and recorder, of which the first may have to compile its models"),
}


def actions(given: Given) -> list[Any]:
    """Observer and recorder, then the replay, whose end is the end of all."""
    replay = node(
        given,
        "replay",
        simulated=True,
        bag=given.text("bag"),
        rate=given.number("rate"),
        loop=given.flag("loop"),
        start_offset=given.number("start_offset"),
        wait=given.number("wait"),
        consumers=2,
    )
    return [
        *node(
            given,
            "observer",
            simulated=True,
            vehicle=given.text("vehicle"),
            monitor=given.text("monitor"),
            map_origin=given.numbers("map_origin"),
            frame_prefix=given.text("frame_prefix"),
            publish_all=True,
        ),
        *node(given, "recorder", simulated=True, bag=given.text("out"), overwrite=given.flag("overwrite")),
        *replay,
        RegisterEventHandler(
            OnProcessExit(target_action=replay[0], on_exit=[EmitEvent(event=Shutdown(reason="the replay has ended"))])
        ),
    ]


def generate_launch_description() -> LaunchDescription:
    """For `ros2 launch`."""
    return description(ARGUMENTS, actions)
