"""Lifecycle requests, signals, parameters, and what happens to what was there before."""

from __future__ import annotations

import os
import signal
import socket
import subprocess
import sys
import time
from pathlib import Path

from lifecycle_msgs.msg import Transition
from lifecycle_msgs.srv import ChangeState, GetState
from rcl_interfaces.srv import SetParameters
from rclpy.parameter import Parameter

from vehicle.soak import worked
from vehicle.workshop import CAR, Workshop, check, until
from vsense_ros.bag import read_bag
from vsense_ros.node.processes import NodeProcess

T = Transition


def change(shop: Workshop, node: str, number: int, label: str = "") -> bool:
    request = ChangeState.Request(transition=Transition(id=number, label=label))
    return shop.client.call(ChangeState, f"{node}/change_state", request, 60.0).success


def state(shop: Workshop, node: str) -> str:
    return shop.client.call(GetState, f"{node}/get_state", GetState.Request()).current_state.label


def every_node(shop: Workshop, **more: object) -> dict[str, NodeProcess]:
    """Each node of the package with enough to become active."""
    folder = shop.folder
    return {
        "observer": shop.start("observer", vehicle=CAR, **more),
        "recorder": shop.start("recorder", bag=str(folder / "bag"), **more),
        "replay": shop.start("replay", bag=str(shop.drive(2.0)), paused=True, **more),
        "gps_driver": shop.start("gps_driver", port=str(folder / "gnss"), **more),
        "imu_driver": shop.start("imu_driver", port=str(folder / "imu"), **more),
        "accelerator": shop.start("accelerator", **more),
        "viewer": shop.start("viewer", port=0, **more),
    }


@check("an impossible lifecycle request is refused and the node goes on")
def impossible(shop: Workshop) -> str:
    refused = 0
    nodes = every_node(shop)
    for name, node in nodes.items():
        node.wait_until_active()
        for number in (T.TRANSITION_ACTIVATE, T.TRANSITION_CONFIGURE, T.TRANSITION_CLEANUP, 5, 6, 99, 255):
            refused += not change(shop, name, number)
        for label in ("configure", "fly", "activate"):
            refused += not change(shop, name, 0, label)
        # 5 and 6 are shutdowns of other states than the active one.
        assert state(shop, name) == "active", name
        assert node.exit_code is None, node.output
    assert refused == 10 * len(nodes)
    return f"{refused} requests to {len(nodes)} nodes"


@check("a lifecycle manager takes the nodes up and down by itself")
def managed(shop: Workshop) -> str:
    nodes = every_node(shop, autostart=False)
    rounds = 0
    for name in nodes:
        assert state(shop, name) == "unconfigured"
        for _ in range(2):
            for number, expected in (
                (T.TRANSITION_CONFIGURE, "inactive"),
                (T.TRANSITION_ACTIVATE, "active"),
                (T.TRANSITION_DEACTIVATE, "inactive"),
                (T.TRANSITION_CLEANUP, "unconfigured"),
            ):
                assert change(shop, name, number), f"{name}: {number}"
                assert state(shop, name) == expected
            rounds += 1
    for name, node in nodes.items():
        assert change(shop, name, T.TRANSITION_UNCONFIGURED_SHUTDOWN), name
        assert state(shop, name) == "finalized"
        assert node.stop() == 0, node.output
    return f"{rounds} rounds of {len(nodes)} nodes"


@check("SIGINT and SIGTERM end a node with 0 within 3 s, at any time from 0.2 s on")
def signals(shop: Workshop) -> str:
    slowest, count = 0.0, 0
    cases = [("observer", {"vehicle": CAR}, delay) for delay in (0.2, 0.6, 1.2, 2.0, 3.0, 5.0)]
    cases += [("recorder", {"bag": str(shop.folder / "bag")}, delay) for delay in (0.2, 0.6, 1.2, 2.5)]
    cases += [("gps_driver", {"port": str(shop.folder / "none")}, delay) for delay in (0.6, 2.5)]
    for number in (signal.SIGINT, signal.SIGTERM):
        for case, (name, parameters, delay) in enumerate(cases):
            # An empty cache of compiled models, so that the observer is compiling after two seconds.
            cache = shop.folder / f"cache_{number}_{case}"
            node = NodeProcess(name, parameters, {**shop.environment, "VSENSE_CACHE": str(cache)})
            time.sleep(delay)
            began = time.monotonic()
            node.signal(number)
            code = node.wait_until_ended(20.0)
            took = time.monotonic() - began
            assert code == 0, f"{name} after {delay} s by {number.name}: {code}: {node.output[-500:]}"
            assert "Traceback" not in node.output, node.output
            assert took < 3.0, f"{name} after {delay} s by {number.name}: {took:.1f} s"
            slowest, count = max(slowest, took), count + 1
    return f"{count} times, {slowest:.2f} s at most"


def run(shop: Workshop, node: str, *arguments: str, timeout: float = 90.0) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", f"vsense_ros.node.{node}", "--ros-args", *arguments]
    return subprocess.run(command, env=dict(shop.environment), capture_output=True, text=True, timeout=timeout)


@check("a replay whose consumers do not come ends with 2 and a sentence")
def no_consumers(shop: Workshop) -> str:
    bag = shop.drive(2.0)
    for rate in ("0.0", "1.0"):
        ended = run(shop, "replay", "-p", f"bag:={bag}", "-p", "consumers:=2", "-p", "wait:=1.0", "-p", f"rate:={rate}")
        assert ended.returncode == 2, ended.stderr
        assert "waited 1 s in vain" in ended.stderr, ended.stderr
        assert "2 of 2 consumers" in ended.stderr, ended.stderr
    return "at rate 0 and 1"


@check("a wrong vehicle ends the observer with 2 and a sentence")
def wrong_vehicle(shop: Workshop) -> str:
    ended = run(shop, "observer", "-p", "vehicle:=batmobile")
    assert ended.returncode == 2
    (line,) = ended.stderr.strip().splitlines()
    assert "no vehicle file 'batmobile'" in line
    return "exit code 2"


@check("nothing is overwritten without being asked", security=True)
def overwriting(shop: Workshop) -> str:
    first = shop.folder / "result"
    for _ in range(2):
        recorder = shop.start("recorder", bag=str(first))
        recorder.wait_until_active()
        publish_some(shop)
        assert recorder.stop() == 0
    kept = {file.name: file.read_bytes() for file in first.iterdir()}
    assert (shop.folder / "result_1").is_dir()
    # Asked to overwrite, it does so when there is something to write: a wrong start costs nothing.
    recorder = shop.start("recorder", bag=str(first), overwrite=True)
    recorder.wait_until_active()
    assert recorder.stop() == 0
    assert {file.name: file.read_bytes() for file in first.iterdir()} == kept
    return f"{len(kept)} files as they were"


def publish_some(shop: Workshop, count: int = 20) -> None:
    from geometry_msgs.msg import Vector3Stamped

    publisher = shop.client.node.create_publisher(Vector3Stamped, "some/topic", 100)
    shop.client.until(lambda: publisher.get_subscription_count() > 0)
    for number in range(count):
        message = Vector3Stamped()
        message.vector.x = float(number)
        publisher.publish(message)
    shop.client.spin_for(0.3)
    shop.client.node.destroy_publisher(publisher)


@check("models that were compiled ahead are not compiled at the start")
def compiled(shop: Workshop) -> str:
    environment = {**shop.environment, "VSENSE_CACHE": str(shop.folder / "cache")}
    began = time.monotonic()
    command = [sys.executable, "-m", "vsense_ros.cli", "compile", CAR]
    done = subprocess.run(command, env=environment, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
    ahead = time.monotonic() - began
    before = set((shop.folder / "cache").iterdir())
    node = NodeProcess("observer", {"vehicle": CAR}, environment)
    began = time.monotonic()
    node.wait_until_active()
    start = time.monotonic() - began
    assert node.stop() == 0
    assert {f for f in (shop.folder / "cache").iterdir() if f.suffix == ".so"} <= before
    return f"{ahead:.1f} s ahead, then active after {start:.1f} s"


@check("an observer whose models are compiled is active after 4 s of a processor's time at most")
def soon_active(shop: Workshop) -> str:
    began = time.monotonic()
    node = shop.start("observer", vehicle=CAR)
    node.wait_until_active()
    passed, busy = time.monotonic() - began, worked(node.pid) / os.sysconf("SC_CLK_TCK")
    assert node.stop() == 0
    assert busy < 4.0, busy
    return f"{busy:.1f} s of a processor, {passed:.1f} s by the clock, with what else ran"


@check("a file of parameters for all nodes may have keys of other nodes; a key of a node's own may not be wrong")
def shared_parameters(shop: Workshop) -> str:
    file = shop.folder / "shared.yaml"
    file.write_text(
        "/**:\n  ros__parameters: {use_sim_time: false, robot: {mass: 3.0}, max_speed: 3.0, rate: 50.0}\n"
        "/observer:\n  ros__parameters: {vehicle: prototype_model}\n"
    )
    for name in ("observer", "gps_driver"):
        arguments = [] if name == "observer" else ["-p", "port:=/none"]
        node = subprocess.Popen(
            [sys.executable, "-m", f"vsense_ros.node.{name}", "--ros-args", "--params-file", str(file), *arguments],
            env=dict(shop.environment),
            stderr=subprocess.PIPE,
            text=True,
        )
        shop.client.until(lambda: ("/" + name) in alive(shop), 60.0)  # noqa: B023
        until(lambda: state(shop, name) == "active", 60.0, name)  # noqa: B023
        node.send_signal(signal.SIGINT)
        assert node.wait(10) == 0
    file.write_text("/observer:\n  ros__parameters: {vehicle: prototype_model, rat: 50.0}\n")
    ended = run(shop, "observer", "--params-file", str(file))
    assert ended.returncode == 2
    assert "no parameter 'rat'" in ended.stderr
    return "two nodes with 3 foreign keys"


def alive(shop: Workshop) -> set[str]:
    return {f"{ns.rstrip('/')}/{name}" for name, ns in shop.client.node.get_node_names_and_namespaces()}


@check("nobody else tells a node what to open and where to write", security=True)
def paths_are_fixed(shop: Workshop) -> str:
    target = shop.folder / "precious"
    target.write_text("years of work")
    nodes = every_node(shop, autostart=False)
    tried = {
        "recorder": ("bag", "summary"),
        "observer": ("vehicle", "identify", "summary", "map_origin_file"),
        "replay": ("bag", "gnss_port", "imu_port", "can_channel"),
        "gps_driver": ("port",),
    }
    count = 0
    for name, parameters in tried.items():
        for parameter in parameters:
            wanted = Parameter(parameter, value=str(target)).to_parameter_msg()
            request = SetParameters.Request(parameters=[wanted])
            answer = shop.client.call(SetParameters, f"{name}/set_parameters", request, 60.0)  # all start at once
            assert not answer.results[0].successful, f"{name}: {parameter}"
            count += 1
    for node in nodes.values():
        assert node.stop() == 0
    assert target.read_text() == "years of work"
    return f"{count} parameters"


@check("nothing that a node opens can be reached from another machine", security=True)
def listens(shop: Workshop) -> str:
    nodes = every_node(shop)
    for node in nodes.values():
        node.wait_until_active()
    every = {name: sockets(node.pid) for name, node in nodes.items()}
    beyond = {name: [a for a in found if not a.startswith("127.")] for name, found in every.items()}
    # Sockets that only send have a port, too; what comes to them is never read.
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sender:
        for address in {a for found in beyond.values() for a in found}:
            host, _, port = address.partition(":")
            sender.sendto(b"anybody there?", ("127.0.0.1" if host == "0.0.0.0" else host, int(port)))
    time.sleep(1.0)
    read = {name: [a for a in found if not sockets(nodes[name].pid)[a]] for name, found in beyond.items()}
    outside = {name: addresses for name, addresses in read.items() if addresses}
    assert not outside, f"read from beyond this machine: {outside}"
    count = sum(map(len, every.values()))
    return f"{count} sockets of {len(nodes)} nodes, {sum(map(len, beyond.values()))} of which only send"


def sockets(pid: int) -> dict[str, int]:
    """Addresses of a process, UDP and listening TCP over IPv4, and the bytes that wait there to be read."""
    inodes = set()
    for descriptor in Path(f"/proc/{pid}/fd").iterdir():
        try:
            target = os.readlink(descriptor)
        except OSError:
            continue
        if target.startswith("socket:["):
            inodes.add(target[8:-1])
    found = {}
    for table in ("udp", "tcp"):
        for line in Path(f"/proc/{pid}/net/{table}").read_text().splitlines()[1:]:
            columns = line.split()
            if columns[9] in inodes and (table == "udp" or columns[3] == "0A"):
                address, _, port = columns[1].partition(":")
                octets = [str(int(address[i : i + 2], 16)) for i in (6, 4, 2, 0)]
                found[f"{'.'.join(octets)}:{int(port, 16)}"] = int(columns[4].partition(":")[2], 16)
    return found


def recorded(shop: Workshop, name: str = "bag") -> dict[str, int]:
    return {topic: len(channel) for topic, channel in read_bag(shop.folder / name).channels.items()}
