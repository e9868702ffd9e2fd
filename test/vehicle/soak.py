"""Half an hour at 250 Hz: memory, latency, nothing lost; and a minute of it on a machine that has no time."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from vehicle.workshop import CAR, LeftOut, Workshop, check
from vsense_ros.node.processes import NodeProcess, lost

minutes = 30.0  # of the soak
_SETTLED = 5.0  # [min] after which memory is to be flat
_GROWTH = 0.05  # of the memory after that
_IDLE, _LOADED = 4.0, 10.0  # [ms] 99 of 100 estimates are out by then
_ELSEWHERE = 0.2  # share of the processors that others use, from which on a machine is not idle
_PRIORITY = 60
_LOADED_FOR = 60.0  # [s]


def resident(pid: int) -> float:
    """Memory of a process [MiB]."""
    for line in Path(f"/proc/{pid}/status").read_text().splitlines():
        if line.startswith("VmRSS:"):
            return int(line.split()[1]) / 1024
    return 0.0


def busy() -> tuple[float, float]:
    """What all processors have worked, and could have worked, since the machine has started [ticks]."""
    ticks = [int(word) for word in Path("/proc/stat").read_text().split("\n", 1)[0].split()[1:9]]
    return float(sum(ticks) - ticks[3] - ticks[4]), float(sum(ticks))


def worked(pid: int) -> float:
    """What a process has worked [ticks]."""
    user, system = Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[11:13]
    return float(user) + float(system)


@contextmanager
def real_time(priority: int) -> Iterator[None]:
    """What is started within runs before all else that has no such priority."""
    try:
        os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(priority))
    except PermissionError:
        raise LeftOut("needs the right to real-time priorities (rtprio in /etc/security/limits.conf)") from None
    try:
        yield
    finally:
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))


def begin(shop: Workshop) -> dict[str, NodeProcess]:
    """A drive over and over through observer and recorder; all three nodes by name."""

    def start(name: str, **parameters: Any) -> NodeProcess:
        return shop.start(name, summary=str(shop.folder / f"{name}.json"), **parameters)

    bag = str(shop.folder / "bag")
    nodes = {
        "observer": start("observer", vehicle=CAR, use_sim_time=True, rate=250.0),
        "recorder": start("recorder", bag=bag, use_sim_time=True, max_bagfile_size=50_000_000),
    }
    for node in nodes.values():
        node.wait_until_active()
    nodes["observer"].wait_for("connected", 60.0)
    nodes["replay"] = start("replay", bag=str(shop.drive()), rate=1.0, loop=True, consumers=2)
    nodes["replay"].wait_for("begins", 60.0)
    return nodes


def end(shop: Workshop, nodes: dict[str, NodeProcess]) -> tuple[dict[str, float], int]:
    """Stop them in the order of their messages: percentiles of the observer's latency [ms], and messages lost."""
    for name in ("replay", "observer", "recorder"):
        assert nodes[name].stop() == 0, nodes[name].output[-1000:]
    summaries = {name: json.loads((shop.folder / f"{name}.json").read_text()) for name in nodes}
    return summaries["observer"]["latency_ms"], lost(summaries)


@check("observer and recorder at 250 Hz: memory is flat and estimates are prompt")
def soak(shop: Workshop) -> str:
    nodes = begin(shop)
    began = time.monotonic()
    worked_before, could_before = busy()
    own_before = sum(worked(node.pid) for node in nodes.values())
    settled = min(_SETTLED, minutes / 3) * 60
    early: dict[str, float] = {}
    while (passed := time.monotonic() - began) < minutes * 60:
        for name, node in nodes.items():
            assert node.exit_code is None, f"{name}: {node.output[-1000:]}"
        if passed > settled and not early:
            early = {name: resident(node.pid) for name, node in nodes.items()}
        time.sleep(1.0)
    late = {name: resident(node.pid) for name, node in nodes.items()}
    worked_after, could_after = busy()
    own = sum(worked(node.pid) for node in nodes.values()) - own_before
    elsewhere = max(worked_after - worked_before - own, 0.0) / (could_after - could_before)
    took, missing = end(shop, nodes)
    growth = {name: late[name] / early[name] - 1 for name in nodes}
    figure = ", ".join(f"{name} {late[name]:.0f} MiB ({growth[name]:+.1%})" for name in nodes)
    figure += f"; p50 {took['p50']:.2f} ms, p99 {took['p99']:.2f} ms over {minutes:g} min"
    figure += f", {missing} messages lost, others had {elsewhere:.0%} of the processors"
    figure += "" if elsewhere <= _ELSEWHERE else ", so that the latency is not judged"
    assert all(share < _GROWTH for share in growth.values()), figure
    assert missing == 0, figure
    assert elsewhere > _ELSEWHERE or took["p99"] <= _IDLE, figure
    return figure


@check("with every processor loaded, estimates are prompt where the nodes have a real-time priority")
def loaded(shop: Workshop) -> str:
    with real_time(_PRIORITY):
        nodes = begin(shop)
    burning = [sys.executable, "-c", f"import time\nend = time.time() + {_LOADED_FOR}\nwhile time.time() < end: pass"]
    burners = [subprocess.Popen(burning) for _ in range(os.cpu_count() or 1)]
    try:
        time.sleep(_LOADED_FOR)
    finally:
        for burner in burners:
            burner.kill()
            burner.wait()
    took, missing = end(shop, nodes)
    figure = f"p50 {took['p50']:.2f} ms, p99 {took['p99']:.2f} ms beside {len(burners)} loops, priority {_PRIORITY}"
    figure += f", {missing} messages lost"
    assert took["p99"] <= _LOADED, figure
    assert missing == 0, figure
    return figure
