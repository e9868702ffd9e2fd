"""Observer: estimates `vsense/*` from the topics that a vehicle file names, at up to 250 Hz.

Every message is used, in order of arrival. If messages have queued up, all of them are processed and only the newest
estimate is published. The node catches up without losing a measurement. With `publish_all`, every due estimate is
published, as is useful for a recording.
"""

from __future__ import annotations

import sys
import time
from collections import Counter
from dataclasses import replace
from typing import Any, Literal

import numpy as np
from pydantic import Field

from vsense_ros.errors import InputError
from vsense_ros.files.installed import vehicle_path
from vsense_ros.files.urdf import urdf
from vsense_ros.files.vehicle import load_vehicle
from vsense_ros.messages import cdr, cdr_messages
from vsense_ros.messages.diagnostic import Diagnostic, Level
from vsense_ros.messages.recording import Sample
from vsense_ros.messages.topics import WHEELS
from vsense_ros.model.frames import sensor_frames
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.node import autoware
from vsense_ros.node.base import SensingNode, run_node
from vsense_ros.node.convert import message_type
from vsense_ros.node.durations import Durations
from vsense_ros.node.extensions import Extension, fault_lines, installed, with_extensions
from vsense_ros.node.odometry_frame import moved
from vsense_ros.node.origin import read_origin, write_origin
from vsense_ros.node.parameters import NodeParameters, parameter, path_parameter
from vsense_ros.node.reader import LATCHED, Reader
from vsense_ros.node.transforms import Transforms
from vsense_ros.observer.monitor import load_limits
from vsense_ros.runner import Runner
from vsense_ros.runner.catalogue import every_filter

_MOST_FRAMES = 20  # that are reported
_PERCENTILES = (50, 90, 99, 99.9)


class _OwnParameters(NodeParameters):
    """Vehicle and output."""

    vehicle: str = path_parameter("vehicle file, or the name of one in config/vehicles")
    filter: str = Field(
        "",
        description="filter, as `vsense filters` lists them; empty: errorEKF or SPI",
    )
    rate: float = parameter(250.0, "Hz", "highest rate of the estimates", gt=0, le=1000)
    publish_all: bool = Field(False, description="publish every due estimate, even if messages have queued up")
    monitor: str = path_parameter("limits that `vsense monitor --calibrate` wrote; empty: the fit is not checked")
    map_origin: tuple[float, ...] = parameter(
        (), "deg, deg, m", "latitude, longitude, height of the map's origin; empty: the stored one, else the first fix"
    )
    map_origin_file: str = path_parameter("file that keeps the map's origin from one start to the next; empty: none")
    transforms: bool = Field(True, description="publish /tf, /tf_static and robot_description")
    map_frame: str = Field("map", description="frame of the map", min_length=1)
    odom_frame: str = Field("odom", description="frame in which the pose of the car is continuous", min_length=1)
    base_frame: str = Field("base_link", description="frame of the car: middle of the rear axle, on the ground")
    odometry_frame: Literal["cog", "base_link"] = Field(
        "cog", description="point of the car whose motion vsense/odometry has; Nav2 expects base_link"
    )
    frame_prefix: str = Field("", description="prefix of all published and expected frames, such as car1/")
    autoware: bool = Field(False, description="publish vehicle/status/* of autoware_vehicle_msgs")


ObserverParameters = with_extensions(_OwnParameters, "ObserverParameters")


class ObserverNode(SensingNode[_OwnParameters]):
    """See the module."""

    consumes = True
    _observer: Runner | None = None
    _inputs: tuple[Reader, ...] = ()
    _extensions: tuple[Extension, ...] = ()

    def configure(self) -> None:
        p = self.parameters
        if not p.vehicle:
            raise InputError("parameter vehicle is empty: expected a vehicle file, or the name of one")
        if len(p.map_origin) not in (0, 3):
            raise InputError(f"parameter map_origin has {len(p.map_origin)} numbers, expected three or none")
        origin = self._origin()
        car = load_vehicle(vehicle_path(p.vehicle))
        self._extend(car)
        makers = [make for extension in self._extensions if (make := extension.make_filter()) is not None]
        if not makers and p.filter:
            makers = [every_filter()[p.filter].make]
        self._observer = Runner(car, origin, makers[0] if makers else None)
        if self._observer.left_out:
            self.get_logger().warning(self._observer.left_out)
        if p.monitor:
            self._observer.watch(load_limits(p.monitor))
        # The topics are those of any estimate, also of one before the start.
        for sample in self._observer.output():
            self.outputs.create(sample.topic, sample.kind)
        self._interval = round(1e9 / p.rate)
        self._next_due = 0
        self.received: Counter[str] = Counter()
        self.unreadable = 0
        self._noise_unreported = set(self._observer.names)
        self.refused_frames = 0
        self._wanted_frames: dict[str, set[str]] = {}
        for sensor in self._observer.sensors.values():
            self._wanted_frames.setdefault(sensor.topic, set()).add(sensor.frame_id)
        self._wanted_frames = {topic: set() if "" in f else f for topic, f in self._wanted_frames.items()}
        self._delays: dict[str, int] = {}  # of the newest message of each topic [ns]
        self.step_times, self.latencies = Durations(), Durations()
        self._newest_due = False
        self._announce(car)
        self._foreign: set[tuple[str, str]] = set()  # topics and frames that were refused
        topics = {**self._observer.topics, **{k: v for one in self._extensions for k, v in one.inputs.items()}}
        self._inputs = tuple(self._subscribe(topic, kind) for topic, kind in topics.items())

    def _extend(self, car: Vehicle) -> None:
        """Make the extensions that the parameters ask for, and report those that cannot be imported."""
        wanted, faults = installed()
        for sentence in faults:
            self.get_logger().warning(sentence)
        self._extensions = ()
        for extension in wanted:
            if extension.is_wanted(self.parameters):
                self._extensions += (extension(self, self.parameters, car),)
                for topic, kind in extension.outputs.items():
                    self.outputs.create(topic, kind)

    def _origin(self) -> tuple[float, float, float] | None:
        """The map's origin that was set, or that an earlier process of this node has stored."""
        p = self.parameters
        self._origin_is_stored = bool(p.map_origin)
        if p.map_origin:
            return (p.map_origin[0], p.map_origin[1], p.map_origin[2])
        stored = read_origin(p.map_origin_file) if p.map_origin_file else None
        if stored is not None:
            self._origin_is_stored = True
            self.get_logger().info(f"map origin of {p.map_origin_file}: {stored[0]:.7f}, {stored[1]:.7f}")
        return stored

    def _keep_origin(self, observer: Runner) -> None:
        """Store the origin once there is one, or say that another start will have another map."""
        origin = observer.intake.on_map.origin
        if self._origin_is_stored or origin is None:
            return
        self._origin_is_stored = True
        text = f"the map begins at {origin[0]:.7f}, {origin[1]:.7f}, {origin[2]:.2f} m"
        if self.parameters.map_origin_file:
            write_origin(self.parameters.map_origin_file, origin)
            self.get_logger().info(f"{text}; kept in {self.parameters.map_origin_file}")
        else:
            self.get_logger().warning(
                f"{text}, where this process had its first fix; after a restart it would be another: "
                "set map_origin, or map_origin_file"
            )

    def _announce(self, car: Vehicle) -> None:
        """Set up the transforms and the description that say where the car's frames are."""
        p = self.parameters
        names = {"map": p.map_frame, "odom": p.odom_frame, "base_link": p.base_frame}
        every = ("cog", *(f"contact_{wheel}" for wheel in WHEELS), *(frame.name for frame in sensor_frames(car)))
        names |= {name: name for name in every}
        self._frames = {name: f"{p.frame_prefix}{own}" for name, own in names.items()}
        self._renamed = any(name != own for name, own in self._frames.items())
        self._expected = {own: name for name, own in self._frames.items()}
        self._transforms = Transforms(car, self._frames) if p.transforms else None
        chassis = car.physics.chassis
        at_base = np.array([-chassis.cog_to_rear_axle, 0.0, -chassis.cog_height])
        self._odometry_arm = at_base if p.odometry_frame == "base_link" else None
        if self._transforms is not None:
            self.outputs.create("/tf", "tf2_msgs/msg/TFMessage")
            self.outputs.create("/tf_static", "tf2_msgs/msg/TFMessage", LATCHED)
            self.outputs.create("robot_description", "std_msgs/msg/String", LATCHED)
            self._description = urdf(car, p.frame_prefix, p.base_frame)
        if p.autoware:
            for topic, kind in autoware.TOPICS.items():
                self.outputs.create(topic, kind)

    def start(self) -> None:
        if self._transforms is not None:
            self.outputs.publish_bytes("/tf_static", "tf2_msgs/msg/TFMessage", self._transforms.static())
            self.outputs.publish_bytes(
                "robot_description", "std_msgs/msg/String", cdr_messages.encode_text(self._description)
            )

    def _subscribe(self, topic: str, kind: str) -> Reader:
        def receive(data: bytes) -> None:
            self._receive(topic, kind, data)

        return Reader(self, message_type(kind), topic, receive, raw=True, made_anew=self.answers.expect_question)

    def release(self) -> None:
        for extension in self._extensions:  # which stay, as the summary is written afterwards
            extension.release()
        for reader in self._inputs:
            reader.close()
        self._inputs = ()

    def _receive(self, topic: str, kind: str, data: bytes) -> None:
        observer = self._observer
        if observer is None or self.state != "active":
            return
        self.received[topic] += 1
        try:
            sample = cdr.decode(kind, data, topic, self.now() or None)
        except InputError as error:
            self.unreadable += 1
            self.get_logger().warning(str(error), throttle_duration_sec=1.0)
            return
        framed = self._in_own_frame(sample)
        if framed is None:
            return
        sample = framed
        if sample.received is not None:
            self._delays[topic] = sample.received - sample.stamp
        before = time.perf_counter()
        observer.add(sample)
        self.step_times.add(time.perf_counter() - before)
        if self._noise_unreported:
            self._tell_noise(observer)
        for extension in self._extensions:
            for made in extension.add(sample):
                self.outputs.publish(made)
        if not observer.started or not self._due(observer.stamp):
            return
        if self.parameters.publish_all:
            self._publish()
        elif not self._newest_due:
            # A task queues up behind the messages that have arrived by now.
            self._newest_due = True
            self.executor.create_task(self._publish_newest)

    def _tell_noise(self, observer: Runner) -> None:
        """Log, of each sensor once, which standard deviations count."""
        for name, health in zip(observer.names, observer.health, strict=True):
            if name in self._noise_unreported and health.noise is not None:
                self._noise_unreported.discard(name)
                if health.noise:
                    self.get_logger().info(f"{name}: standard deviation {health.noise}")

    def _in_own_frame(self, sample: Sample) -> Sample | None:
        """The sample with the frame as the vehicle file has it; None, reported once, where it has another or none."""
        observer, frame = self._observer, sample.frame_id
        if observer is None:
            return None
        wanted = self._wanted_frames.get(sample.topic)
        if not wanted or (frame in wanted and not self._renamed):
            return sample
        name = self._expected.get(frame, frame)
        if name in wanted:
            return sample if name == frame else replace(sample, frame_id=name)
        if (sample.topic, frame) not in self._foreign and len(self._foreign) < _MOST_FRAMES:
            self._foreign.add((sample.topic, frame))
            expected = " or ".join(repr(self._frames.get(name, name)) for name in sorted(wanted))
            self.get_logger().error(
                f"{sample.topic}: messages with frame_id {frame!r} are refused, expected {expected}: set it where they "
                "are published, or frame_id of the sensor in the vehicle file (empty: any), or frame_prefix"
            )
        self.refused_frames += 1
        return None

    def _due(self, stamp: int) -> bool:
        """True if an estimate for this time may be published; half an interval of jitter costs none of them."""
        if stamp < self._next_due - 2 * self._interval:  # the clock went back
            self._next_due = stamp
        return stamp >= self._next_due

    def _publish_newest(self) -> None:
        self._newest_due = False
        if self.state == "active":
            self._publish()

    def _publish(self) -> None:
        observer = self._observer
        if observer is None:
            return
        self._next_due = max(self._next_due + self._interval, observer.stamp + self._interval // 2)
        odometry: Sample | None = None
        for sample in observer.newest():
            one = sample
            if sample.topic == "vsense/odometry":
                odometry = sample
                if self._odometry_arm is not None:
                    one = moved(sample, self._odometry_arm, "base_link")
            self.outputs.publish(self._in_published_frame(one) if self._renamed else one)
        if odometry is not None and self._transforms is not None:
            moving = self._transforms.moving(odometry, observer.adapter.steering_angle)
            self.outputs.publish_bytes("/tf", "tf2_msgs/msg/TFMessage", moving)
        if odometry is not None and self.parameters.autoware:
            for topic, data in autoware.messages(odometry, observer, self._frames["base_link"]):
                self.outputs.publish_bytes(topic, autoware.TOPICS[topic], data)
        self._keep_origin(observer)
        now = self.time_base.now()
        if now is not None:
            self.latencies.add((now - observer.stamp) * 1e-9)

    def _in_published_frame(self, sample: Sample) -> Sample:
        frame, child = sample.frame_id, sample.child_frame_id
        return replace(sample, frame_id=self._frames.get(frame, frame), child_frame_id=self._frames.get(child, child))

    def on_clock(self, stamp: int) -> None:
        if self.state == "active":
            self.answers.report_progress(stamp)

    def diagnostics(self) -> list[Diagnostic]:
        if self._observer is None:
            return []
        own, *others = self._observer.diagnostics(self.now() or None)
        sensors = [line for line in others if line.name in self._observer.names]
        if self._observer.started and all(line.level == Level.STALE for line in sensors):
            own = replace(own, level=Level.STALE, message="no sensor is heard any more: the estimate is an old one")
        elif self._observer.started and (dead := self._dead(sensors)):
            message = f"{own.message}, without {', '.join(dead)}: {'; '.join(dead.values())}"
            own = replace(own, level=Level.ERROR, message=message)
        if self._delays and any(line.level != Level.OK for line in sensors):
            others = [*self._clocks(round(self._observer.vehicle.observer.history * 1e9)), *others]
        extended = [line for extension in self._extensions for line in extension.diagnostics()]
        return [own, *others, *extended, *fault_lines()]

    def _dead(self, lines: list[Diagnostic]) -> dict[str, str]:
        """Sensors that the estimate needs and of which nothing comes: what is wrong, by name. It needs what drives its
        model, rates and forces, and something that measures the speed."""
        observer = self._observer
        if observer is None:
            return {}
        silent = {line.name: line.message for line in lines if line.level == Level.STALE}
        speed = [name for name, sensor in observer.sensors.items() if sensor.measures_speed]
        without_speed = all(name in silent for name in speed)
        return {
            name: message
            for name, message in silent.items()
            if (sensor := observer.sensors[name]).is_input
            or "rates and forces" in sensor.measures
            or (without_speed and name in speed)
        }

    def _clocks(self, reach: int) -> list[Diagnostic]:
        """Which topics have stamps so far behind those of others [ns] that the filter cannot go back to them."""
        newest = min(self._delays.values())
        behind = {topic: delay - newest for topic, delay in self._delays.items() if delay - newest > reach}
        if not behind:
            return []
        others = ", ".join(topic for topic in self._delays if topic not in behind)
        text = f"stamps of {', '.join(behind)} are {max(behind.values()) * 1e-9:.1f} s behind those of {others}"
        return [Diagnostic("clocks", Level.WARN, f"{text}; are the clocks synchronised?")]

    def summary(self) -> dict[str, Any]:
        if self._observer is None:
            return super().summary()
        extended: dict[str, Any] = {"accelerator": {}}
        for extension in self._extensions:
            extended |= extension.summary()
        return {
            **super().summary(),
            **extended,
            "received": dict(self.received),
            "unreadable": self.unreadable,
            "refused_frames": self.refused_frames,
            "step_us_median": 1e6 * self.step_times.percentile(50) if self.step_times.count else None,
            "latency_ms": percentiles(self.latencies),
            "parameters": self._observer.parameters() if self._observer.started else {},
            "diagnostics": [
                {"name": d.name, "level": int(d.level), "message": d.message, "values": dict(d.values)}
                for d in self._observer.diagnostics()
            ],
        }


def percentiles(durations: Durations) -> dict[str, float]:
    """Percentiles of times, in milliseconds, by name; empty without times."""
    return {f"p{q:g}": 1e3 * durations.percentile(q) for q in _PERCENTILES} if durations.count else {}


def main() -> int:
    """Entry point of `ros2 run vsense_ros observer`."""
    return run_node(ObserverNode, ObserverParameters)


if __name__ == "__main__":
    sys.exit(main())
