"""What all nodes are: lifecycle nodes that publish samples and diagnostics, and end with one message on bad input."""

from __future__ import annotations

import gc
import json
import sys
import traceback
from collections.abc import Collection
from contextlib import nullcontext
from functools import partial
from pathlib import Path
from typing import Any, Generic, TypeVar

import rclpy
from rcl_interfaces.msg import SetParametersResult
from rclpy.lifecycle import LifecycleNode, LifecycleState, TransitionCallbackReturn
from rclpy.parameter import Parameter
from rosgraph_msgs.msg import Clock

from vsense_ros.errors import InputError
from vsense_ros.extras import explained
from vsense_ros.messages.diagnostic import Diagnostic
from vsense_ros.node import parameters, spin
from vsense_ros.node.health import Health
from vsense_ros.node.outputs import Outputs
from vsense_ros.node.parameters import NodeParameters
from vsense_ros.node.reader import Reader
from vsense_ros.node.real_time import lock_memory
from vsense_ros.node.replay_answers import ReplayAnswers
from vsense_ros.node.time_base import TimeBase
from vsense_ros.node.timers import steady_timer

Params = TypeVar("Params", bound=NodeParameters)


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
        self.add_on_set_parameters_callback(partial(_take_changes, self))
        self.fault: InputError | None = None
        self.exit_code = 0
        self.finish: spin.Stop | None = None
        self.time_base = TimeBase(self.get_parameter("use_sim_time").value)
        self.outputs = Outputs(self)
        self.answers = ReplayAnswers(self, lambda: self.state == "active" and self.hears_all())
        by_clock = lambda: self.time_base.simulated or self.publishes_time  # noqa: E731
        self.health = Health(self, self.diagnostics, self.now, by_clock)
        self._timers_of_mine: list[Any] = []
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
        return {"published": dict(self.outputs.published)}

    def on_clock(self, stamp: int) -> None:
        """A `/clock` message had this time [ns]."""

    def hears_all(self) -> bool:
        """True if there is nothing that this node would listen to and does not yet."""
        return True

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
        return _guarded(self, self._configure, super().on_configure, state)

    def on_activate(self, state: LifecycleState) -> TransitionCallbackReturn:
        return _guarded(self, self._activate, super().on_activate, state)

    def on_deactivate(self, state: LifecycleState) -> TransitionCallbackReturn:
        self.answers.stop_expecting()
        result = _guarded(self, self.stop, super().on_deactivate, state)
        self.get_logger().info("inactive")
        return result

    def on_cleanup(self, state: LifecycleState) -> TransitionCallbackReturn:
        return _guarded(self, self._finish, super().on_cleanup, state)

    def on_shutdown(self, state: LifecycleState) -> TransitionCallbackReturn:
        _guarded(self, self.stop, super().on_deactivate, state)
        return _guarded(self, self._finish, super().on_shutdown, state)

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

    def _configure(self) -> None:
        self.fault = None
        self.parameters = parameters.read(self, self.model)
        try:
            with nullcontext() if self.finish is None else self.finish.long_job():
                self.configure()
        except BaseException:
            self._close()
            raise
        self.health.open()
        self.answers.open()
        self._timers_of_mine = [
            steady_timer(self, 1.0, self.health.publish),
            steady_timer(self, 0.1, self.outputs.look_for_subscribers),
        ]

    def _activate(self) -> None:
        self.outputs.activate()
        self.start()
        if self.consumes:
            self.answers.expect_question()
        # What there is by now stays: no garbage collection need look through it again, which would hold up messages.
        gc.unfreeze()  # of an earlier activation
        gc.collect()
        gc.freeze()
        self.get_logger().info("active")

    def _close(self) -> None:
        self.answers.stop_expecting()
        self.release()
        for timer in self._timers_of_mine:
            self.destroy_timer(timer)
        self._timers_of_mine = []
        self.outputs.close()
        self.health.close()
        self.answers.close()

    def _finish(self) -> None:
        was_configured = self.health.is_open
        self._close()
        if was_configured and self.parameters.summary:
            text = json.dumps(self.summary(), indent=2) + "\n"
            Path(self.parameters.summary).write_text(text, encoding="utf-8")

    # Time

    def _on_clock(self, message: Clock) -> None:
        stamp = self._clock_stamp = message.clock.sec * 1_000_000_000 + message.clock.nanosec
        if self.time_base.simulated:
            self.time_base.tick(stamp)
        self.on_clock(stamp)


def _take_changes(node: SensingNode, changes: list[Parameter]) -> SetParametersResult:
    """Give a node its changed parameters, or say why one of them cannot have its new value now."""
    mine = [change for change in changes if change.name in node.model.model_fields]
    fixed = [c.name for c in mine if not parameters.is_live(node.model, c.name)]
    if fixed and node.state != "unconfigured":
        reason = f"{', '.join(fixed)}: takes effect when the node is configured; clean it up first"
        return SetParametersResult(successful=False, reason=reason)
    try:
        new = parameters.changed(node, node.model, mine)
    except InputError as error:
        return SetParametersResult(successful=False, reason=str(error))
    if mine:
        node.parameters = new
        node.parameters_changed([change.name for change in mine])
    for change in changes:
        if change.name == "use_sim_time":
            node.time_base = TimeBase(change.value)
    return SetParametersResult(successful=True)


def _guarded(node: SensingNode, job: Any, then: Any, state: LifecycleState) -> TransitionCallbackReturn:
    """rclpy swallows what a transition raises: input faults refuse the transition, anything else is shown."""
    try:
        with explained():
            job()
    except InputError as error:
        node.fault = error
        node.get_logger().error(str(error))
        return TransitionCallbackReturn.FAILURE
    except Exception:
        node.get_logger().fatal(traceback.format_exc())
        return TransitionCallbackReturn.ERROR
    return then(state)


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
        spin.spin([node], stop)
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
