"""Recordings in Foxglove: what a viewer gets, and whether the layout asks for what there is."""

from __future__ import annotations

import json
import socket
import threading
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from click.testing import CliRunner
from foxglove.websocket import PlaybackCommand, PlaybackStatus

from foxglove_client import watch
from vsense_ros.bag import read_bag, write_bag
from vsense_ros.cli import main
from vsense_ros.errors import InputError
from vsense_ros.files.vehicle import load_vehicle
from vsense_ros.messages import definitions
from vsense_ros.messages.recording import Recording, Sample
from vsense_ros.model.vehicle import Vehicle
from vsense_ros.node.foxglove_playback import Playback, Timeline
from vsense_ros.node.foxglove_scene import Scene
from vsense_ros.runner import Runner, run

ROOT = Path(__file__).parents[2]
LAYOUT = ROOT / "config/foxglove/vsense.json"


@pytest.fixture(scope="module")
def car() -> Vehicle:
    return load_vehicle(ROOT / "config/vehicles/prototype_model.yaml")


@pytest.fixture(scope="module")
def bags(tmp_path_factory: pytest.TempPathFactory, car: Vehicle) -> list[Path]:
    """Three seconds of a drive, and what the observer made of it."""
    folder = tmp_path_factory.mktemp("bags")
    drive = read_bag(ROOT / "bags/double_lane_change").between(0.0, 3.0)
    write_bag(folder / "drive", drive)
    write_bag(folder / "estimate", run(drive, car).output)
    return [folder / "drive", folder / "estimate"]


@pytest.fixture
def playback(bags: list[Path], car: Vehicle) -> Iterator[Playback]:
    made = Playback(Timeline(bags, car), car, port=0)
    made._speed = 10.0
    thread = threading.Thread(target=made.run, daemon=True)
    thread.start()
    yield made
    made.stop()
    thread.join(5.0)


def test_a_viewer_gets_every_message_in_its_order_with_the_definition_of_its_type(
    playback: Playback, bags: list[Path]
) -> None:
    drive, estimate = map(read_bag, bags)
    last = len(estimate["vsense/odometry"])
    found = watch(playback.server.url, lambda v: len(v.seen["/vsense/odometry"]) >= last - 1)
    assert playback.server.url.startswith("ws://127.0.0.1:")
    assert found.info["dataStartTime"] == {"sec": drive.start // 10**9, "nsec": drive.start % 10**9}
    for recording in (drive, estimate):
        for topic, channel in recording.channels.items():
            times = [at for at, _ in found.seen[f"/{topic}"]]
            assert times == sorted(times), topic
            assert len(times) >= 0.8 * len(channel), topic
    odometry, truth = found.message("/vsense/odometry"), estimate["vsense/odometry"]
    row = int(np.argmin(np.abs(truth.stamp - found.seen["/vsense/odometry"][-1][0])))
    assert odometry.header.frame_id == "map"
    assert odometry.twist.twist.linear.x == truth.columns["linear"][row, 0]


def test_the_car_and_its_frames_are_made_where_the_bags_lack_them_and_told_to_who_comes_later(
    playback: Playback, car: Vehicle
) -> None:
    for _ in range(2):
        found = watch(playback.server.url, lambda v: {"/robot_description", "/tf_static", "/tf"} <= set(v.seen))
    assert "<robot name=" in found.message("/robot_description").data
    (cog, *_) = found.message("/tf_static").transforms
    assert (cog.header.frame_id, cog.child_frame_id) == ("base_link", "cog")
    assert cog.transform.translation.x == car.physics.chassis.cog_to_rear_axle
    frames = {t.child_frame_id for t in found.message("/tf").transforms}
    assert {"odom", "base_link", "contact_fl", "contact_rr"} <= frames


def test_a_viewer_that_seeks_sees_how_things_were_there(playback: Playback) -> None:
    times = playback.timeline.times
    middle = int(times[0] + (times[-1] - times[0]) // 2)

    def ask(command: Any, seek: int | None) -> Any:
        request = SimpleNamespace(playback_command=command, playback_speed=1.0, seek_time=seek, request_id="one")
        return playback._on_request(request)  # type: ignore[arg-type]

    state = ask(PlaybackCommand.Pause, middle)
    assert (state.status, state.current_time, state.did_seek) == (PlaybackStatus.Paused, middle, True)
    newest = playback.timeline.newest(int(np.searchsorted(times, middle)))
    assert {topic for _, topic, _ in newest} >= {"vsense/odometry", "imu/data", "tf"}
    assert all(at <= middle for at, _, _ in newest)
    assert ask(PlaybackCommand.Pause, int(times[-1]) + 10**12).current_time == times[-1]
    assert ask(PlaybackCommand.Play, middle).status == PlaybackStatus.Playing


def test_the_force_of_a_tyre_is_drawn_in_the_circle_of_what_it_could_have(car: Vehicle) -> None:
    scene = Scene(car)
    at_rest = car.physics.chassis.mass * 9.80665 / 4
    made = []
    for wheel in ("fl", "fr", "rl", "rr"):
        force = {"force": np.array([0.3, -0.4, 1.2]) * at_rest, "torque": np.zeros(3)}
        kind = "geometry_msgs/msg/WrenchStamped"
        made += scene.add(Sample(f"vsense/wheel_force/{wheel}", kind, 10**9, force, f"contact_{wheel}"))
    assert [topic for topic, _ in made] == ["vsense/view/tyres"]
    assert scene.sizes("rl") == pytest.approx((0.5, np.arctan2(-0.4, 0.3), 1.2 * car.physics.road.friction), rel=1e-3)
    assert len(made[0][1].encode()) > 4 * 48 * 16  # four circles


def test_bags_of_other_drives_are_not_shown_together(bags: list[Path], tmp_path: Path) -> None:
    late = read_bag(bags[1])
    channels = {
        topic: replace(channel, stamp=channel.stamp + 10**12, received=channel.received + 10**12)
        for topic, channel in late.channels.items()
    }
    write_bag(tmp_path / "late", Recording(channels, "late"))
    with pytest.raises(InputError, match="no time in common"):
        Timeline([bags[0], tmp_path / "late"])
    with pytest.raises(InputError, match="which a bag named before has"):
        Timeline([bags[0], bags[0]])


def test_a_port_that_is_taken_is_told(playback: Playback, bags: list[Path]) -> None:
    with pytest.raises(InputError, match="choose another port"):
        Playback(Timeline(bags[:1]), port=playback.server.port)


def paths_of(content: Any) -> Iterator[str]:
    """All that a layout reads: message paths and topics."""
    if isinstance(content, dict):
        for key, value in content.items():
            if key in ("value", "followTopic", "topicToRender", "topic") and isinstance(value, str) and value:
                yield value
            elif key == "topics" and isinstance(value, dict):
                yield from value
            yield from paths_of(value)
    elif isinstance(content, list):
        for one in content:
            yield from paths_of(one)


def test_the_layout_reads_only_what_is_published(car: Vehicle) -> None:
    layout = json.loads(LAYOUT.read_text(encoding="utf-8"))
    kinds = {f"/{sample.topic}": sample.kind for sample in Runner(car).output()}
    kinds |= {"/reference/odometry": "nav_msgs/msg/Odometry", "/gps/fix": "sensor_msgs/msg/NavSatFix"}
    kinds |= {"/diagnostics": "diagnostic_msgs/msg/DiagnosticArray"}
    others = {"/robot_description", "/vsense/view/path", "/vsense/view/tyres"}
    read = list(paths_of(layout))
    assert len(read) > 20
    for path in read:
        topic, *fields = path.split(".")
        if topic in others:
            continue
        kind = kinds[topic]
        for name in fields:
            types = {field: of for of, field in definitions.fields(kind)}
            assert name in types, path
            kind = types[name]


def test_every_panel_of_the_layout_has_its_settings() -> None:
    layout = json.loads(LAYOUT.read_text(encoding="utf-8"))

    def panels(node: Any) -> Iterator[str]:
        if isinstance(node, str):
            yield node
        elif isinstance(node, dict):
            for side in ("first", "second"):
                yield from panels(node[side])

    shown = list(panels(layout["layout"]))
    for name in list(shown):
        for tab in layout["configById"][name].get("tabs", []):
            shown += panels(tab["layout"])
    assert sorted(shown) == sorted(layout["configById"])


def test_the_layout_is_written_once(tmp_path: Path) -> None:
    file = tmp_path / "layout.json"
    assert CliRunner().invoke(main, ["view", "--layout", str(file)]).exit_code == 0
    assert file.read_text() == LAYOUT.read_text()
    again = CliRunner().invoke(main, ["view", "--layout", str(file)])
    assert again.exit_code == 2
    assert "exists already" in again.output


@pytest.mark.parametrize(
    ("host", "origin", "wanted"),
    [
        ("127.0.0.1:{port}", None, 101),  # a program
        ("localhost:{port}", "https://app.foxglove.dev", 101),
        ("127.0.0.1:{port}", "http://localhost:8080", 101),
        ("127.0.0.1:{port}", "https://evil.example", 403),
        ("127.0.0.1:{port}", "https://foxglove.dev.evil.example", 403),
        ("127.0.0.1:{port}", "null", 403),
        ("127.0.0.1:{port}", "http://[", 403),
        ("evil.example:{port}", None, 421),  # a name of another site that leads to this machine
        ("evil.example:{port}", "http://evil.example:{port}", 421),
        ("[", None, 421),
    ],
)
def test_a_page_of_another_site_sees_nothing(playback: Playback, host: str, origin: str | None, wanted: int) -> None:
    port = playback.server.port
    head = ["GET / HTTP/1.1", f"Host: {host.format(port=port)}", "Upgrade: websocket", "Connection: Upgrade"]
    head += ["Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==", "Sec-WebSocket-Version: 13"]
    head += ["Sec-WebSocket-Protocol: foxglove.sdk.v1"]
    if origin is not None:
        head.append(f"Origin: {origin.format(port=port)}")
    with socket.create_connection(("127.0.0.1", port), 5.0) as connection:
        connection.sendall("\r\n".join([*head, "", ""]).encode())
        answer = connection.recv(64)
    assert int(answer.split()[1]) == wanted
