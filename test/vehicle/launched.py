"""The launch files through the real `ros2 launch`, where ROS 2 is installed with its tools."""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import time
from importlib.util import find_spec

from vehicle.workshop import CAR, LeftOut, Workshop, check, until
from vsense_ros.bag import read_bag


def tools(shop: Workshop) -> dict[str, str]:
    """The environment for `ros2 launch`."""
    if shutil.which("ros2") is None or find_spec("launch_ros") is None:
        raise LeftOut("needs ros2 launch, which PyPI does not have")
    try:
        from ament_index_python.packages import get_package_prefix

        get_package_prefix("vsense_ros")
    except LookupError:
        raise LeftOut("needs vsense_ros built by colcon, and its install/setup.bash sourced") from None
    return dict(shop.environment)


def launch(shop: Workshop, *arguments: str, timeout: float = 120.0) -> subprocess.CompletedProcess[str]:
    command = ["ros2", "launch", "vsense_ros", *arguments]
    return subprocess.run(command, env=tools(shop), cwd=shop.folder, capture_output=True, text=True, timeout=timeout)


@check("ros2 launch replay.launch.py ends with 0 and every estimate")
def replayed(shop: Workshop) -> str:
    done = launch(shop, "replay.launch.py", f"bag:={shop.drive(6.0)}", f"vehicle:={CAR}", "out:=result")
    assert done.returncode == 0, done.stdout[-2000:] + done.stderr[-2000:]
    count = len(read_bag(shop.folder / "result")["vsense/odometry"])
    assert count > 500, count
    return f"{count} estimates"


@check("ros2 launch replay.launch.py with a wrong vehicle or bag ends with an exit code and a sentence")
def wrong(shop: Workshop) -> str:
    slowest = 0.0
    for bag, vehicle, words in (
        (str(shop.drive(2.0)), "batmobile", "observer refused its parameters or files (exit code 2)"),
        ("/nowhere", CAR, "replay refused its parameters or files (exit code 2)"),
    ):
        began = time.monotonic()
        done = launch(shop, "replay.launch.py", f"bag:={bag}", f"vehicle:={vehicle}")
        assert done.returncode != 0
        assert words in done.stdout + done.stderr, done.stdout + done.stderr
        slowest = max(slowest, time.monotonic() - began)
    return f"2 cases, {slowest:.1f} s at most"


@check("ros2 launch vehicle.launch.py with a wrong vehicle does not start again and again")
def no_respawn(shop: Workshop) -> str:
    done = launch(shop, "vehicle.launch.py", "vehicle:=batmobile", timeout=60.0)
    assert done.returncode != 0
    starts = (done.stdout + done.stderr).count("process started with pid")
    assert starts == 1, f"{starts} starts"
    return "1 start"


@check("ros2 launch ends within 3 s of SIGINT and of SIGTERM and leaves no process behind")
def ended(shop: Workshop) -> str:
    slowest = 0.0
    for number in (signal.SIGINT, signal.SIGTERM):
        for delay in (3.0, 9.0):
            command = ["ros2", "launch", "vsense_ros", "replay.launch.py", f"bag:={shop.drive()}", f"vehicle:={CAR}"]
            process = subprocess.Popen(
                [*command, "rate:=1.0", f"out:=out_{number}_{delay:g}"],
                env=tools(shop),
                cwd=shop.folder,
                stdout=subprocess.DEVNULL,
                stderr=subprocess.DEVNULL,
                start_new_session=True,
            )
            time.sleep(delay)
            began = time.monotonic()
            # Ctrl-C reaches all of a terminal's processes, SIGTERM the one that it is sent to.
            os.killpg(process.pid, number) if number == signal.SIGINT else process.send_signal(number)
            while group_lives(process):
                assert time.monotonic() - began < 15.0, "processes are left behind"
                time.sleep(0.02)
            slowest = max(slowest, time.monotonic() - began)
    assert slowest < 3.0, f"{slowest:.1f} s"
    return f"4 times, {slowest:.1f} s at most"


@check("ros2 run, ros2 lifecycle and ros2 bag do with the nodes what they do with others")
def by_the_tools(shop: Workshop) -> str:
    environment = tools(shop)

    def ros2(*words: str, timeout: float = 60.0) -> str:
        done = subprocess.run(
            ["ros2", *words], env=environment, cwd=shop.folder, capture_output=True, text=True, timeout=timeout
        )
        assert done.returncode == 0, f"ros2 {' '.join(words)}: {done.stdout[-500:]}{done.stderr[-500:]}"
        return done.stdout

    bag = str(shop.drive(4.0))
    assert "/imu/data" in ros2("bag", "info", bag)
    command = ["ros2", "run", "vsense_ros", "observer", "--ros-args", "-p", f"vehicle:={CAR}", "-p", "autostart:=false"]
    process = subprocess.Popen(command, env=environment, cwd=shop.folder, start_new_session=True)
    try:
        until(lambda: "/observer" in ros2("node", "list"), 60.0, "the observer in ros2 node list")
        for transition, state in (("configure", "inactive"), ("activate", "active")):
            ros2("lifecycle", "set", "/observer", transition)
            assert state in ros2("lifecycle", "get", "/observer")
        record = ["ros2", "bag", "record", "-o", "recorded", "/vsense/odometry"]
        recorder = subprocess.Popen(record, env=environment, cwd=shop.folder, start_new_session=True)
        try:
            until(lambda: "recorder" in ros2("node", "list"), 60.0, "ros2 bag record")
            ros2("bag", "play", bag, timeout=120.0)
        finally:
            os.killpg(recorder.pid, signal.SIGINT)
            recorder.wait(30.0)
    finally:
        os.killpg(process.pid, signal.SIGINT)
        process.wait(30.0)
    count = len(read_bag(shop.folder / "recorded")["vsense/odometry"])
    assert count > 100, count
    return f"{count} estimates of what ros2 bag played"


def group_lives(process: subprocess.Popen[bytes]) -> bool:
    process.poll()
    try:
        os.killpg(process.pid, 0)
    except ProcessLookupError:
        return False
    return True
