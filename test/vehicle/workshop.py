"""Where checks are made: nodes as processes in a ROS domain of their own, a client, a folder, a small drive."""

from __future__ import annotations

import struct
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from pathlib import Path
from typing import Any

from ros_probe import Probe, probe
from vsense_ros.bag import read_bag, write_bag
from vsense_ros.files.installed import shared_folder
from vsense_ros.messages.recording import Recording
from vsense_ros.node.processes import NodeProcess, free_domain, ros_environment

CAR = "prototype_model"

Check = Callable[["Workshop"], str]
CHECKS: dict[str, Check] = {}
SECURITY: set[str] = set()  # names of the checks of what SECURITY.md says


class LeftOut(Exception):
    """A check needs a tool that is not here."""


def check(name: str, *, security: bool = False) -> Callable[[Check], Check]:
    """Add a function to the checks: it returns a figure in words, and raises where what it checks does not hold. Those
    of `security` try what SECURITY.md says."""

    def add(function: Check) -> Check:
        CHECKS[name] = function
        if security:
            SECURITY.add(name)
        return function

    return add


class Workshop:
    """Nodes that it started are ended with it."""

    def __init__(self, folder: Path, running: ExitStack) -> None:
        self.folder = folder
        self.environment: Mapping[str, str] = ros_environment(free_domain())
        self._running = running
        self._client: Probe | None = None

    @property
    def client(self) -> Probe:
        """A node of the check's own."""
        if self._client is None:
            self._client = self._running.enter_context(probe(self.environment))
        return self._client

    def start(
        self,
        node: str,
        *,
        name: str | None = None,
        namespace: str = "",
        remap: Mapping[str, str] | None = None,
        **parameters: Any,
    ) -> NodeProcess:
        """A node, with its own clock where it has a namespace, as the launch files give it."""
        remappings = {"__ns": f"/{namespace}"} if namespace else {}
        remappings |= {"/clock": "clock"} if namespace else {}
        remappings |= remap or {}
        made = NodeProcess(node, parameters, self.environment, name=name, remappings=remappings)
        return self._running.enter_context(made)

    def drive(self, seconds: float = 0.0) -> Path:
        """A bag of a generated double lane change, or its beginning."""
        whole = shared_folder("bags") / "double_lane_change"
        if not seconds:
            return whole
        path = self.folder / f"drive_{seconds:g}"
        if not path.exists():
            write_bag(path, beginning(read_bag(whole), seconds))
        return path


def beginning(recording: Recording, seconds: float) -> Recording:
    """What arrived in the first seconds."""
    end = recording.start + round(seconds * 1e9)
    return Recording({t: c.select(c.received <= end) for t, c in recording.channels.items()}, recording.name)


@contextmanager
def workshop(folder: Path) -> Iterator[Workshop]:
    """A workshop in a folder."""
    folder.mkdir(parents=True, exist_ok=True)
    with ExitStack() as running:
        yield Workshop(folder, running)


def until(condition: Callable[[], bool], timeout: float, what: str) -> float:
    """Wait for a condition; how long that took [s]."""
    began = time.monotonic()
    while not condition():
        assert time.monotonic() - began < timeout, f"waited {timeout:g} s in vain for {what}"
        time.sleep(0.02)
    return time.monotonic() - began


def transforms_in(data: bytes) -> list[tuple[str, str, int, tuple[float, ...]]]:
    """Parent, child, stamp [ns], and translation with quaternion (7,) of each transform of a TFMessage."""
    from rosbags.typesys import Stores, get_typestore

    message = get_typestore(Stores.ROS2_JAZZY).deserialize_cdr(data, "tf2_msgs/msg/TFMessage")
    found = []
    for one in message.transforms:
        t, r = one.transform.translation, one.transform.rotation
        stamp = one.header.stamp.sec * 1_000_000_000 + one.header.stamp.nanosec
        found.append((one.header.frame_id, one.child_frame_id, stamp, (t.x, t.y, t.z, r.x, r.y, r.z, r.w)))
    return found


def text_message(text: str) -> bytes:
    """A std_msgs/String."""
    encoded = text.encode() + b"\0"
    return b"\0\1\0\0" + struct.pack("<I", len(encoded)) + encoded
