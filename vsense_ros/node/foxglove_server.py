"""Topics for Foxglove: a WebSocket server of Foxglove's own SDK, on this machine alone unless told otherwise."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Iterable, Sequence
from typing import Any
from urllib.parse import quote

import foxglove
from foxglove.channels import SceneUpdateChannel
from foxglove.messages import SceneUpdate
from foxglove.websocket import Capability, PlaybackControlRequest, PlaybackState

from vsense_ros.bag import TopicDescription
from vsense_ros.errors import InputError
from vsense_ros.node.foxglove_gate import Gate, hidden_address

PORT = 8765  # that the app proposes
_BACKLOG = 8192  # messages for a viewer that is slow
_ALL_ASKED = 0.2  # [s] after a viewer has asked for a topic in which it asks for others


class FoxgloveServer:
    """Sends messages of any topic to the viewers that ask for it; a latched topic's newest also to those that come
    later. Thread-safe."""

    def __init__(
        self,
        name: str,
        host: str = "127.0.0.1",
        port: int = PORT,
        *,
        origins: Sequence[str] = (),
        span: tuple[int, int] | None = None,
        control: Callable[[PlaybackControlRequest], PlaybackState] | None = None,
    ) -> None:
        """`origins` are sites whose pages may look, besides Foxglove's. `span` [ns] and `control` make a recording of
        it, whose time the viewer steers. Raises `InputError` where the port is taken."""
        self._asked = float("inf")  # when somebody has last asked for a topic [s] of the monotonic clock
        self._context = foxglove.Context()
        self._channels: dict[str, foxglove.Channel] = {}
        self._scenes: dict[str, SceneUpdateChannel] = {}
        self._latched: dict[str, Callable[[], None]] = {}
        self._lock = threading.Lock()
        self._control = control
        try:
            self._server = foxglove.start_server(
                name=name,
                host=(inner := hidden_address()),
                port=0,
                capabilities=[Capability.Time],
                server_listener=self,  # type: ignore[arg-type]
                context=self._context,
                playback_time_range=span,
                message_backlog_size=_BACKLOG,
            )
        except (OSError, RuntimeError) as error:
            raise InputError(f"Foxglove's server does not start: {error}") from None
        try:
            self._gate = Gate(host, port, (inner, self._server.port), origins)
        except InputError:
            self._server.stop()
            raise
        self.host, self.port = host, self._gate.port

    @property
    def url(self) -> str:
        """Where a viewer finds it."""
        return f"ws://{self.host}:{self.port}"

    @property
    def is_watched(self) -> bool:
        """True if a viewer has come and asked for all that it wants."""
        return time.monotonic() - self._asked > _ALL_ASKED

    @property
    def app_url(self) -> str:
        """A page of Foxglove that opens this server."""
        return f"https://app.foxglove.dev?ds=foxglove-websocket&ds.url={quote(self.url, safe='')}"

    def add(self, topic: str, description: TopicDescription) -> bool:
        """Announce a topic; False where its type's definition is not known, without which nobody can read it."""
        topic = f"/{topic.removeprefix('/')}"
        if not description.schema:
            return False
        with self._lock:
            if topic not in self._channels:
                schema = foxglove.Schema(name=description.kind, encoding="ros2msg", data=description.schema.encode())
                self._channels[topic] = foxglove.Channel(
                    topic, schema=schema, message_encoding="cdr", context=self._context
                )
        return True

    def send(self, topic: str, data: bytes, at: int, *, latched: bool = False) -> None:
        """Send a message of a topic that was announced, at a time [ns]."""
        topic = f"/{topic.removeprefix('/')}"
        channel = self._channels[topic]
        channel.log(data, log_time=at)
        if latched:
            self._latched[topic] = lambda: channel.log(data, log_time=at)

    def draw(self, topic: str, scene: SceneUpdate, at: int, *, latched: bool = False) -> None:
        """Send what is to be drawn."""
        topic = f"/{topic.removeprefix('/')}"
        with self._lock:
            if topic not in self._scenes:
                self._scenes[topic] = SceneUpdateChannel(topic, context=self._context)
        channel = self._scenes[topic]
        channel.log(scene, log_time=at)
        if latched:
            self._latched[topic] = lambda: channel.log(scene, log_time=at)

    def tell_time(self, now: int) -> None:
        """The time [ns], of which viewers that show a recording draw their clock."""
        self._server.broadcast_time(now)

    def tell_state(self, state: PlaybackState) -> None:
        """Send the state of the playback, playing or paused, and its time."""
        self._server.broadcast_playback_state(state)

    def stop(self) -> None:
        """End it."""
        self._gate.stop()
        self._server.stop()

    # What viewers ask for, in a thread of the SDK

    def on_subscribe(self, _: Any, channel: Any) -> None:
        again = self._latched.get(channel.topic)
        if again is not None:
            again()
        self._asked = time.monotonic()

    def on_playback_control_request(self, request: PlaybackControlRequest) -> PlaybackState | None:
        return None if self._control is None else self._control(request)

    def _ignored(self, *_: Any, **__: Any) -> None:
        """What else viewers may say is nothing to this server."""

    on_unsubscribe = on_client_advertise = on_client_unadvertise = on_message_data = _ignored
    on_parameters_subscribe = on_parameters_unsubscribe = _ignored
    on_connection_graph_subscribe = on_connection_graph_unsubscribe = _ignored

    def on_get_parameters(self, *_: Any, **__: Any) -> list[Any]:
        return []

    def on_set_parameters(self, *_: Any, **__: Any) -> list[Any]:
        return []


def described(topics: Iterable[tuple[str, TopicDescription]], server: FoxgloveServer) -> tuple[set[str], list[str]]:
    """Announce topics: those that were, and those whose type nobody knows."""
    known, unknown = set(), []
    for topic, description in topics:
        if server.add(topic, description):
            known.add(topic)
        else:
            unknown.append(f"{topic} ({description.kind})")
    return known, unknown
