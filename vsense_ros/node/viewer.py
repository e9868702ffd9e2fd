"""Viewer: shows topics of any type in Foxglove, over a WebSocket of this machine, while a viewer is connected.

In a namespace it shows the topics below the namespace, and the transforms and diagnostics of all. With a vehicle it
also draws the path of the car, and at each tyre its force inside the friction circle.
"""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING, Any

from pydantic import Field
from rclpy.qos import DurabilityPolicy

from vsense_ros.errors import InputError
from vsense_ros.files.installed import vehicle_path
from vsense_ros.files.vehicle import load_vehicle
from vsense_ros.messages import cdr
from vsense_ros.messages.diagnostic import Diagnostic, Level
from vsense_ros.messages.recording import FIELDS
from vsense_ros.node.base import SensingNode, run_node
from vsense_ros.node.convert import describe, message_type
from vsense_ros.node.parameters import NodeParameters, parameter, path_parameter
from vsense_ros.node.reader import Reader
from vsense_ros.node.replay_answers import is_between_nodes
from vsense_ros.node.timers import steady_timer

if TYPE_CHECKING:  # at run time only once it is configured: they need an optional package
    from vsense_ros.node.foxglove_server import FoxgloveServer

_OF_ALL = ("/tf", "/tf_static", "/diagnostics", "/diagnostics_agg")
_NOT_SHOWN = ("/clock", "/parameter_events")


class ViewerParameters(NodeParameters):
    """What and where."""

    host: str = Field("127.0.0.1", description="address to serve at; 0.0.0.0 lets other machines look")
    port: int = parameter(8765, "", "TCP port; 0: any free port", ge=0, le=65535)
    origins: tuple[str, ...] = Field(
        (),
        description="sites whose pages may look, as https://example.org, besides Foxglove's and this machine's",
    )
    vehicle: str = path_parameter("vehicle file, or the name of one; empty: no friction circles")
    frame_prefix: str = Field("", description="prefix of the frames of the car, as for the observer")


class Viewer(SensingNode[ViewerParameters]):
    """See the module."""

    _server: FoxgloveServer | None = None
    _timers_of_viewing: tuple[Any, ...] = ()

    def configure(self) -> None:
        from vsense_ros.node.foxglove_scene import PATH, Scene
        from vsense_ros.node.foxglove_server import FoxgloveServer

        p = self.parameters
        self._inputs: dict[str, Reader] = {}
        self._unknown: set[str] = set()
        self.shown = 0
        car = load_vehicle(vehicle_path(p.vehicle)) if p.vehicle else None
        self._scene = Scene(car, p.frame_prefix)
        self._latched_scene = PATH
        self._server = FoxgloveServer(self.get_fully_qualified_name(), p.host, p.port, origins=p.origins)
        self.get_logger().info(f"serving at {self._server.url}; {self._server.app_url}")

    def start(self) -> None:
        self._timers_of_viewing = (
            steady_timer(self, 0.2, self._look_for_topics),
            steady_timer(self, 0.05, self._tell_time),
        )

    def stop(self) -> None:
        for timer in self._timers_of_viewing:
            self.destroy_timer(timer)
        self._timers_of_viewing = ()
        for reader in getattr(self, "_inputs", {}).values():
            reader.close()
        self._inputs = {}

    def release(self) -> None:
        self.stop()
        if self._server is not None:
            self._server.stop()
            self._server = None

    def _tell_time(self) -> None:
        if self._server is not None and (now := self.now()) > 0:
            self._server.tell_time(now)

    def _wants(self, topic: str) -> bool:
        namespace = self.get_namespace().rstrip("/")
        if topic in _NOT_SHOWN or is_between_nodes(topic):
            return False
        return topic.startswith(f"{namespace}/") or topic in _OF_ALL

    def _look_for_topics(self) -> None:
        server = self._server
        if server is None:
            return
        for topic, _ in self.get_topic_names_and_types():
            if topic in self._inputs or topic in self._unknown or not self._wants(topic):
                continue
            publishers = self.get_publishers_info_by_topic(topic)
            if not publishers:
                continue
            kind, type_hash = publishers[0].topic_type, str(publishers[0].topic_type_hash)
            latched = all(p.qos_profile.durability == DurabilityPolicy.TRANSIENT_LOCAL for p in publishers)
            try:
                accepted = message_type(kind, type_hash)
                known = server.add(topic, describe(kind, type_hash))
            except InputError:
                known = False
            if not known:
                self._unknown.add(topic)
                self.get_logger().warning(f"{topic} is not shown: the definition of {kind} is not installed")
                continue
            self._inputs[topic] = self._subscribe(topic, kind, accepted, latched)

    def _subscribe(self, topic: str, kind: str, accepted: Any, latched: bool) -> Reader:
        drawn = kind in FIELDS and "/vsense/" in topic

        def receive(data: bytes) -> None:
            server = self._server
            if server is None:
                return
            now = self.now()
            server.send(topic, data, now, latched=latched)
            self.shown += 1
            if drawn:
                self._draw(server, topic, kind, data, now)

        return Reader(self, accepted, topic, receive, raw=True, latched=latched)

    def _draw(self, server: FoxgloveServer, topic: str, kind: str, data: bytes, now: int) -> None:
        try:
            sample = cdr.decode(kind, data, topic, now or None)
        except InputError:
            return
        namespace = self.get_namespace().strip("/")
        for name, scene in self._scene.add(sample):
            server.draw(f"{namespace}/{name}", scene, now, latched=name == self._latched_scene)

    def diagnostics(self) -> list[Diagnostic]:
        if self._server is None:
            return []
        values = {"topics": str(len(self._inputs)), "messages": str(self.shown)}
        if self._unknown:
            values["topics of unknown types"] = ", ".join(sorted(self._unknown))
        return [Diagnostic("viewer", Level.OK, f"serving at {self._server.url}", values)]


def main() -> int:
    """Entry point of `ros2 run vsense_ros viewer`."""
    return run_node(Viewer, ViewerParameters)


if __name__ == "__main__":
    sys.exit(main())
