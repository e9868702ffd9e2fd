"""What is installed on a vehicle computer, as far as a machine without the car can tell."""

from __future__ import annotations

import ast
import re
import shutil
import subprocess
from pathlib import Path
from typing import Any

import pytest

from vsense_ros.messages import yaml_text

ROOT = Path(__file__).parents[2]
DEPLOY = ROOT / "deploy"
NODES = sorted(path.stem for path in (ROOT / "vsense_ros" / "node").glob("*.py") if "\ndef main(" in path.read_text())


def arguments_of(launch_file: str) -> set[str]:
    """Names of the arguments of a launch file, without a launch system."""
    names: set[str] = set()
    for path in (ROOT / "launch" / launch_file, ROOT / "vsense_ros/node/launching.py"):
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            target = node.targets[0] if isinstance(node, ast.Assign) else getattr(node, "target", None)
            if isinstance(target, ast.Name) and target.id in ("ARGUMENTS", "COMMON"):
                assert isinstance(node, ast.Assign | ast.AnnAssign)
                assert isinstance(node.value, ast.Dict)
                names |= {key.value for key in node.value.keys if isinstance(key, ast.Constant)}
    return names


@pytest.mark.parametrize("file", ["deploy/systemd/vsense.conf", "docs/deployment.md", "README.md"])
def test_every_launch_argument_that_is_named_exists(file: str) -> None:
    known = arguments_of("vehicle.launch.py") | arguments_of("replay.launch.py") | arguments_of("accelerated.launch.py")
    parameters = {"observer", "monitor", "filter", "rate", "loop", "overwrite", "position"}
    named = set(re.findall(r"(?<![-\w])([a-z_]+):=", (ROOT / file).read_text(encoding="utf-8")))
    assert named
    assert named <= known | parameters


def test_the_unit_is_one_that_systemd_takes(tmp_path: Path) -> None:
    if shutil.which("systemd-analyze") is None:
        pytest.skip("systemd-analyze is not installed here")
    text = (DEPLOY / "systemd/vsense.service").read_text(encoding="utf-8")
    commands = re.findall(r"^Exec\w+=(\S+)", text, re.MULTILINE)
    assert {Path(command).relative_to("/opt/vsense/src/vsense_ros") for command in commands} == {
        Path("deploy/environment")
    }
    unit = tmp_path / "vsense.service"
    unit.write_text(text.replace(commands[0], "/bin/true"), encoding="utf-8")
    done = subprocess.run(["systemd-analyze", "verify", str(unit)], capture_output=True, text=True, timeout=60)
    assert done.returncode == 0, done.stderr
    assert "vsense.service" not in done.stderr
    unit.write_text(unit.read_text().replace("LimitRTPRIO=80", "LimitRTPRIO=a lot"), encoding="utf-8")
    done = subprocess.run(["systemd-analyze", "verify", str(unit)], capture_output=True, text=True, timeout=60)
    assert "vsense.service" in done.stderr  # it would have said so


def test_what_the_unit_reads_of_its_file_is_in_it() -> None:
    unit = (DEPLOY / "systemd/vsense.service").read_text(encoding="utf-8")
    wanted = set(re.findall(r"\$\{?(VSENSE_[A-Z]+)", unit))
    content = (DEPLOY / "systemd/vsense.conf").read_text(encoding="utf-8")
    assert wanted == set(re.findall(r"^(VSENSE_[A-Z]+)=", content, re.MULTILINE))


TOKEN = re.compile(
    r"(SUBSYSTEM|SUBSYSTEMS|ACTION|KERNEL|DRIVER|DRIVERS|NAME|SYMLINK|GROUP|MODE|TAG|ENV\{\w+\}|ATTRS?\{\w+\})"
    r'(==|!=|\+=|:=|=)"([^"]+)"'
)
MATCHING = re.compile(r"(SUBSYSTEMS?|ACTION|KERNEL|DRIVERS?|ATTRS\{)")


def test_the_rules_match_before_they_set() -> None:
    """The grammar of udev(7), and that every rule is about a kind of device."""
    path = DEPLOY / "udev/70-vsense.rules"
    lines = [line.lstrip("#") for line in path.read_text(encoding="utf-8").splitlines() if '="' in line]
    rules = [line for line in lines if re.match(r"[A-Z]+(\{\w+\})?[=!+:]", line)]
    assert len(rules) >= 5
    for rule in rules:
        tokens = [TOKEN.fullmatch(part.strip()) for part in rule.split(", ")]
        assert all(tokens), rule
        operators = [(t[1], t[2]) for t in tokens if t]
        assert any(key == "SUBSYSTEM" and operator == "==" for key, operator in operators), rule
        assert any(operator not in ("==", "!=") for _, operator in operators), rule
        assert all(operator in ("==", "!=") for key, operator in operators if MATCHING.match(key)), rule


@pytest.mark.skipif(
    shutil.which("udevadm") is None
    or subprocess.run(["udevadm", "verify", "--help"], capture_output=True, timeout=10).returncode != 0,
    reason="udevadm is older than 254 here, and has no verify",
)
def test_udev_takes_the_rules() -> None:
    done = subprocess.run(["udevadm", "verify", str(DEPLOY / "udev/70-vsense.rules")], capture_output=True, timeout=30)
    assert done.returncode == 0, done.stdout.decode()


def test_the_rules_name_the_ports_that_the_launch_arguments_have() -> None:
    rules = (DEPLOY / "udev/70-vsense.rules").read_text(encoding="utf-8")
    ports = re.findall(r"/dev/(\w+)", (DEPLOY / "systemd/vsense.conf").read_text(encoding="utf-8"))
    assert ports
    assert all(f'SYMLINK+="{port}"' in rules for port in ports)


def test_the_aggregator_puts_what_every_node_says_into_one_group() -> None:
    content: Any = yaml_text.load_file(ROOT / "config/diagnostics/aggregator.yaml")
    groups = {k: v for k, v in content["/**"]["ros__parameters"].items() if isinstance(v, dict)}
    assert all(group["type"] == "diagnostic_aggregator/GenericAnalyzer" for group in groups.values())
    assert len({group["path"] for group in groups.values()}) == len(groups)
    for namespace in ("", "/car1", "/fleet/car_2"):
        for node in NODES:
            name = f"{namespace}/{node}: imu"
            assert [key for key, group in groups.items() if any(part in name for part in group["contains"])] == [node]


def test_the_image_installs_what_the_package_needs_and_runs_as_nobody() -> None:
    lines = re.sub(r"\\\n", " ", (DEPLOY / "Dockerfile").read_text(encoding="utf-8")).splitlines()
    steps = [line.split(maxsplit=1) for line in lines if line and not line.startswith("#")]
    assert steps[0][0] == "FROM"
    known = {"FROM", "SHELL", "RUN", "ENV", "WORKDIR", "COPY", "USER", "VOLUME", "ENTRYPOINT", "CMD"}
    assert {step[0] for step in steps} <= known
    users = [argument for step, argument in steps if step == "USER"]
    assert users[-1] not in ("root", "0")
    order = [step for step, _ in steps]
    assert order.index("USER") < order.index("ENTRYPOINT")
    for step, argument in steps:
        if step == "COPY":
            source = argument.split()[0]
            assert (ROOT / source).exists(), argument
    entry = ast.literal_eval(next(argument for step, argument in steps if step == "ENTRYPOINT"))[0]
    assert (ROOT / Path(entry).relative_to("/opt/vsense/src/vsense_ros")).exists()


def test_the_environment_is_a_script_that_bash_reads() -> None:
    script = DEPLOY / "environment"
    assert script.stat().st_mode & 0o111
    assert subprocess.run(["bash", "-n", str(script)], timeout=10).returncode == 0
    done = subprocess.run(
        [str(script), "true"], env={"ROS_DISTRO": "none", "PATH": "/usr/bin:/bin"}, timeout=10, capture_output=True
    )
    assert done.returncode != 0
    assert b"/opt/ros/none/setup.bash" in done.stderr


def test_the_manifest_has_only_keys_that_bloom_can_make_packages_of() -> None:
    """Keys that end in -pip name nothing that apt has."""
    keys = re.findall(r"<\w*depend>([^<]+)<", (ROOT / "package.xml").read_text(encoding="utf-8"))
    assert keys
    assert not [key for key in keys if key.endswith("-pip")]


def test_the_nodes_lock_their_memory_on_request_and_say_what_forbids_it() -> None:
    code = """
import resource, os
resource.setrlimit(resource.RLIMIT_MEMLOCK, (1 << 16, 1 << 16))
from vsense_ros.errors import InputError
from vsense_ros.node.real_time import lock_memory
if os.getuid() == 0:
    import ctypes
    ctypes.CDLL(None).prctl(24, 14, 0, 0, 0)  # without CAP_IPC_LOCK the limit counts
    os.setresuid(65534, 65534, 65534)
try:
    lock_memory()
except InputError as error:
    print(error)
"""
    import sys

    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)
    assert "the limit is 64 KiB: set LimitMEMLOCK=infinity" in done.stdout, done.stderr
