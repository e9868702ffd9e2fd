"""What all nodes are: lifecycle nodes that publish samples and diagnostics, and end with one message on bad input."""

from __future__ import annotations

import gc
import json
import sys
import time
import traceback
from collections import Counter
from collections.abc import Callable, Collection
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any, Generic, TypeVar
from uuid import uuid4

import rclpy
from builtin_interfaces.msg import Time
from diagnostic_msgs.msg import DiagnosticArray
from rcl_interfaces.msg import SetParametersResult
from rclpy.clock import Clock as SteadyClock
from rclpy.clock import ClockType
from rclpy.duration import Duration
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.parameter import Parameter
from rclpy.qos import QoSProfile
from rclpy.timer import Timer
from rosgraph_msgs.msg import Clock
from std_msgs.msg import Header

from vsense_ros.errors import InputError
from vsense_ros.extras import explained
from vsense_ros.messages import cdr, cdr_messages
from vsense_ros.messages.diagnostic import Diagnostic, Level
from vsense_ros.messages.recording import Sample
from vsense_ros.node import parameters, spin
from vsense_ros.node.convert import message_type
from vsense_ros.node.parameters import NodeParameters
from vsense_ros.node.reader import LOSSLESS, Reader
from vsense_ros.node.real_time import lock_memory
from vsense_ros.node.time_base import TimeBase

Params = TypeVar("Params", bound=NodeParameters)

PROGRESS_TOPIC = "vsense/progress"
LISTENING_TOPIC = "vsense/listening"
QUESTIONS = "vsense/do_you_listen"  # the topics below it
_LAST = 0.5  # [s] for readers to take what was published before the end


class SensingNode(LifecycleNode, Generic[Params]):
    """A lifecycle node with parameters from a model.

    What a node does stands in `configure`, `start`, `stop` and `release`; each of them may raise `InputError`. Between
    `start` and `stop` the node is active. `diagnostics` is asked once a second from `configure` to `release`.
    """

    model: type[Params]
    publishes_time = False  # whether this node publishes the time itself
    consumes = False  # whether a replay waits for this node

    def __init__(self, name: str, model: type[Params], shared: Collection[str] = ()) -> None:
        """`shared` are names of parameters that were given to all nodes, whether they have them or not."""
        super().__init__(name)
        self.model = model
        parameters.declare(self, model, shared)
        self.parameters = parameters.read(self, model)
        self.add_on_set_parameters_callback(self._judge_changes)
        self.fault: InputError | None = None
        self.exit_code = 0
        self.finish: spin.Stop | None = None
        self.published: Counter[str] = Counter()
        self.time_base = TimeBase(self.get_parameter("use_sim_time").value)
        self._outputs: dict[str, Any] = {}
        self._timers_of_mine: list[Any] = []
        self._diagnostics_publisher: Any = None
        self._progress_publisher: Any = None
        self._listening_publisher: Any = None
        self._question: Reader | None = None
        self._connected = False
        self._clock_stamp = 0  # by the newest /clock message [ns]
        self._clock_reader = Reader(self, Clock, "/clock", self._on_clock)

    # What a node adds

    def configure(self) -> None:
        """Open what has to be opened; `self.parameters` is up to date."""

    def start(self) -> None:
        """Begin to work."""

    def stop(self) -> None:
        """Stop working; also called on the way down from an error."""

    def release(self) -> None:
        """Close what `configure` has opened, as far as it got."""

    def diagnostics(self) -> list[Diagnostic]:
        """Health, once a second."""
        return []

    def parameters_changed(self, names: Collection[str]) -> None:
        """Live parameters of these names were set, and have new values in `self.parameters`."""

    def summary(self) -> dict[str, Any]:
        """Counts for the file that the parameter `summary` names."""
        return {"published": dict(self.published)}

    def on_clock(self, stamp: int) -> None:
        """A `/clock` message had this time [ns]."""

    def expect_question(self) -> None:
        """Let a replay ask whether this node listens, on a topic with a name that is new.

        Subscriptions are announced in the order in which they are made: whoever asks there knows all others too, and
        what he publishes comes. A message on a topic with a known name says less. It reaches each reader of it in
        this process, also while its sender knows only one that is older than all the others, as rclpy's of `/clock`.
        """
        self._stop_expecting()
        topic = f"{QUESTIONS}/{_unique_name()}"
        self._question = Reader(self, Header, topic, lambda _: self._on_question(topic))

    def _stop_expecting(self) -> None:
        if self._question is not None:
            self._question.close()
        self._question = None

    def _on_question(self, topic: str) -> None:
        # In a task: the answer may be to make this subscription anew.
        self.executor.create_task(self._answer, topic)

    def _answer(self, topic: str) -> None:
        asked = self._question is not None and self._question.topic == topic and self.state == "active"
        if asked and self.hears_all():
            self._listening_publisher.publish(Header(frame_id=self.get_fully_qualified_name()))

    def hears_all(self) -> bool:
        """True if there is nothing that this node would listen to and does not yet."""
        return True

    # Publishing

    def create_output(self, topic: str, kind: str, qos: QoSProfile = LOSSLESS, type_hash: str = "") -> None:
        """Announce a topic on which `publish` will send, so that its subscribers are found before the first message."""
        if topic not in self._outputs:
            self._outputs[topic] = self.create_lifecycle_publisher(message_type(kind, type_hash), topic, qos)

    def publish(self, sample: Sample) -> None:
        """Send a sample; dropped while the node is not active."""
        self.publish_bytes(sample.topic, sample.kind, cdr.encode(sample))

    def publish_bytes(self, topic: str, kind: str, data: bytes) -> None:
        """Send a message that is CDR bytes already."""
        if topic not in self._outputs:
            self.create_output(topic, kind)
        self._outputs[topic].publish(data)
        self.published[topic] += 1

    def create_steady_timer(self, period: float, callback: Callable[[], None]) -> Timer:
        """A timer [s] that also runs before a replay has begun to publish `/clock`, and while it pauses."""
        return self.create_timer(period, callback, clock=SteadyClock(clock_type=ClockType.STEADY_TIME))

    @property
    def unheard(self) -> list[str]:
        """Announced topics that nobody subscribes to."""
        return [topic for topic, publisher in self._outputs.items() if publisher.get_subscription_count() == 0]

    @property
    def state(self) -> str:
        """Name of the lifecycle state."""
        return self._state_machine.current_state[1]

    def now(self) -> int:
        """Time [ns] of the system or of `/clock`; 0 before the first message. rclpy listens to that with best effort,
        and may have heard nothing yet where this node has."""
        return self.get_clock().now().nanoseconds or self._clock_stamp

    # Lifecycle

    def on_configure(self, state: LifecycleState) -> TransitionCallbackReturn:
        return self._guarded(self._configure, super().on_configure, state)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        return self._guarded(self._activate, super().on_activate, state)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        self._stop_expecting()
        result = self._guarded(self.stop, super().on_deactivate, state)
        self.get_logger().info("inactive")
        return result

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        return self._guarded(self._finish, super().on_cleanup, state)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        self._guarded(self.stop, super().on_deactivate, state)
        return self._guarded(self._finish, super().on_shutdown, state)

    def on_error(self, state: LifecycleState) -> TransitionCallbackReturn:
        self.stop()
        self._close()
        return super().on_error(state)

    def _LifecycleNodeMixin__on_change_state(self, request: Any, response: Any) -> Any:
        """In the place of rclpy's own, which raises where a transition is not possible now, and ends the process
        (https://github.com/ros2/rclpy/issues/1209)."""
        wanted = request.transition
        possible = {label: number for number, label, *_ in self._state_machine.available_transitions}
        number = possible.get(wanted.label) if wanted.label else wanted.id
        if number not in possible.values():
            known = ", ".join(f"{label} ({number})" for label, number in possible.items())
            self.get_logger().warning(
                f"transition {wanted.label or wanted.id} refused: the node is {self.state}; possible are {known}"
            )
            response.success = False
            return response
        request.transition.label, request.transition.id = "", number
        return super()._LifecycleNodeMixin__on_change_state(request, response)

    def _guarded(self, job: Any, then: Any, state: LifecycleState) -> TransitionCallbackReturn:
        """rclpy swallows what a transition raises: input faults refuse the transition, anything else is shown."""
        try:
            with explained():
                job()
        except InputError as error:
            self.fault = error
            self.get_logger().error(str(error))
            return TransitionCallbackReturn.FAILURE
        except Exception:
            self.get_logger().fatal(traceback.format_exc())
            return TransitionCallbackReturn.ERROR
        return then(state)

    def _configure(self) -> None:
        self.fault = None
        self.parameters = parameters.read(self, self.model)
        try:
            with nullcontext() if self.finish is None else self.finish.long_job():
                self.configure()
        except BaseException:
            self._close()
            raise
        self._diagnostics_publisher = self.create_publisher(DiagnosticArray, "diagnostics", 10)
        self._progress_publisher = self.create_publisher(Header, PROGRESS_TOPIC, LOSSLESS)
        self._listening_publisher = self.create_publisher(Header, LISTENING_TOPIC, LOSSLESS)
        self._timers_of_mine = [
            self.create_steady_timer(1.0, self._publish_diagnostics),
            self.create_steady_timer(0.1, self._look_for_subscribers),
        ]

    def _activate(self) -> None:
        # Publishers first: `start` may already send.
        for publisher in self._outputs.values():
            publisher.on_activate(None)
        self.start()
        if self.consumes:
            self.expect_question()
        self._connected = False
        # What there is by now stays: no garbage collection need look through it again, which would hold up messages.
        gc.unfreeze()  # of an earlier activation
        gc.collect()
        gc.freeze()
        self.get_logger().info("active")

    def _wait_for_readers(self) -> None:
        """What was published is lost with its publisher, as long as a reader has not taken it."""
        deadline = time.monotonic() + _LAST
        for topic, publisher in self._outputs.items():
            if self.published[topic]:
                publisher.wait_for_all_acked(Duration(seconds=max(deadline - time.monotonic(), 0.0)))

    def _close(self) -> None:
        self._stop_expecting()
        self.release()
        self._wait_for_readers()
        for timer in self._timers_of_mine:
            self.destroy_timer(timer)
        self._timers_of_mine = []
        for publisher in self._outputs.values():
            self.destroy_lifecycle_publisher(publisher)
        self._outputs.clear()
        if self._diagnostics_publisher is not None:
            self.destroy_publisher(self._diagnostics_publisher)
            self.destroy_publisher(self._progress_publisher)
            self.destroy_publisher(self._listening_publisher)
            self._diagnostics_publisher = None

    def _finish(self) -> None:
        was_configured = self._diagnostics_publisher is not None
        self._close()
        if was_configured and self.parameters.summary:
            text = json.dumps(self.summary(), indent=2) + "\n"
            Path(self.parameters.summary).write_text(text, encoding="utf-8")

    # Parameters, time, diagnostics

    def _judge_changes(self, changes: list[Parameter]) -> SetParametersResult:
        mine = [change for change in changes if change.name in self.model.model_fields]
        fixed = [c.name for c in mine if not parameters.is_live(self.model, c.name)]
        if fixed and self.state != "unconfigured":
            reason = f"{', '.join(fixed)}: takes effect when the node is configured; clean it up first"
            return SetParametersResult(successful=False, reason=reason)
        try:
            new = parameters.changed(self, self.model, mine)
        except InputError as error:
            return SetParametersResult(successful=False, reason=str(error))
        if mine:
            self.parameters = new
            self.parameters_changed([change.name for change in mine])
        for change in changes:
            if change.name == "use_sim_time":
                self.time_base = TimeBase(change.value)
        return SetParametersResult(successful=True)

    def _on_clock(self, message: Clock) -> None:
        stamp = self._clock_stamp = message.clock.sec * 1_000_000_000 + message.clock.nanosec
        if self.time_base.simulated:
            self.time_base.tick(stamp)
        self.on_clock(stamp)

    def report_progress(self, stamp: int) -> None:
        """Tell a replay that everything up to its clock message `stamp` [ns] has been worked off here."""
        if self._diagnostics_publisher is not None:
            seconds, nanoseconds = divmod(stamp, 1_000_000_000)
            stamp_there = Time(sec=seconds, nanosec=nanoseconds)
            self._progress_publisher.publish(Header(stamp=stamp_there, frame_id=self.get_fully_qualified_name()))

    def _publish_diagnostics(self) -> None:
        statuses = self.diagnostics()
        if statuses and self._diagnostics_publisher is not None:
            if len(clocks := self._clock_sources()) > 1:
                text = f"{len(clocks)} nodes publish {self.resolve_topic_name('/clock')}: {', '.join(clocks)}; stop one"
                statuses = [*statuses, Diagnostic("clock", Level.ERROR, text)]
            own = self.get_fully_qualified_name()
            statuses = [replace(status, name=f"{own}: {status.name}") for status in statuses]
            data = cdr_messages.encode_diagnostics(self.now(), statuses, hardware_id=self.get_name())
            self._diagnostics_publisher.publish(data)

    def _clock_sources(self) -> list[str]:
        """Who publishes the time that this node goes by, or publishes itself; reported once where these are several."""
        if not self.time_base.simulated and not self.publishes_time:
            return []
        publishers = self.get_publishers_info_by_topic("/clock")
        publishing = [f"{p.node_namespace.rstrip('/')}/{p.node_name}" for p in publishers]
        if len(publishing) > 1:
            self.get_logger().error(
                f"{len(publishing)} nodes publish the time ({', '.join(publishing)}): it will jump to and fro; stop one"
                " of them",
                once=True,
            )
        return publishing

    def _look_for_subscribers(self) -> None:
        if not self._connected and self._outputs and not self.unheard:
            self._connected = True
            self.get_logger().info("connected: every topic has a subscriber")


def _unique_name() -> str:
    return f"of_{uuid4().hex}"  # a part of a topic's name begins with a letter


def is_between_nodes(topic: str) -> bool:
    """True if nodes talk there of replays or of their lifecycle: nothing to record or to look at."""
    last = (f"/{PROGRESS_TOPIC}", f"/{LISTENING_TOPIC}", "/transition_event")
    return topic.endswith(last) or f"/{QUESTIONS}/" in topic


def run_node(node_type: type[SensingNode], model: type[NodeParameters], arguments: list[str] | None = None) -> int:
    """The process of a node: 0 after a clean end, 2 after bad input, 1 after a fault of ours."""
    arguments = sys.argv[1:] if arguments is None else arguments
    name = node_type.__module__.rpartition(".")[2] if node_type.__module__ != "__main__" else Path(sys.argv[0]).stem
    if "-h" in arguments or "--help" in arguments:
        print(f"{(sys.modules[node_type.__module__].__doc__ or '').strip()}\n")
        print(f"usage: {name} --ros-args -p PARAMETER:=VALUE …   (or --params-file FILE)\n")
        print(f"Parameters:\n{parameters.help_text(model)}")
        return 0
    try:
        spin.init(arguments)
    except Exception as error:  # rclpy's own, of several types, for arguments that it cannot read
        print(f"{name}: {error}", file=sys.stderr)
        return 2
    node: SensingNode | None = None
    try:
        node = node_type(name, model, parameters.shared_names(arguments))
        stop = node.finish = spin.Stop()
        if node.parameters.lock_memory:
            lock_memory()
        if node.parameters.autostart:
            for transition in (node.trigger_configure, node.trigger_activate):
                if transition() != TransitionCallbackReturn.SUCCESS:
                    return 2 if node.fault is not None else 1
        spin.spin(node, stop)
        if node.state != "finalized":
            node.trigger_shutdown()
        return node.exit_code
    except spin.Stopped:
        return 0
    except InputError as error:
        print(f"{name}: {error}", file=sys.stderr)
        return 2
    finally:
        if node is not None:
            node.destroy_node()
        rclpy.try_shutdown()
