"""Half an hour at 250 Hz: memory, latency, nothing lost."""

from __future__ import annotations

import json
import time
from pathlib import Path

from vehicle.workshop import CAR, Workshop, check

minutes = 30.0  # of the soak
_SETTLED = 5.0  # [min] after which memory is to be flat
_GROWTH = 0.05  # of the memory after that


def resident(pid: int) -> float:
    """Memory of a process [MiB]."""
    for line in Path(f"/proc/{pid}/status").read_text().splitlines():
        if line.startswith("VmRSS:"):
            return int(line.split()[1]) / 1024
    return 0.0


@check("observer and recorder at 250 Hz: memory is flat and estimates are prompt")
def soak(shop: Workshop) -> str:
    summary = shop.folder / "observer.json"
    observer = shop.start("observer", vehicle=CAR, use_sim_time=True, rate=250.0, summary=str(summary))
    recorder = shop.start("recorder", bag=str(shop.folder / "bag"), use_sim_time=True, max_bagfile_size=50_000_000)
    for node in (observer, recorder):
        node.wait_until_active()
    shop.start("replay", bag=str(shop.drive()), rate=1.0, loop=True, consumers=2).wait_for("begins", 60.0)
    began = time.monotonic()
    settled = min(_SETTLED, minutes / 3) * 60
    early: dict[str, float] = {}
    nodes = {"observer": observer, "recorder": recorder}
    while (passed := time.monotonic() - began) < minutes * 60:
        for name, node in nodes.items():
            assert node.exit_code is None, f"{name}: {node.output[-1000:]}"
        if passed > settled and not early:
            early = {name: resident(node.pid) for name, node in nodes.items()}
        time.sleep(1.0)
    late = {name: resident(node.pid) for name, node in nodes.items()}
    for node in nodes.values():
        assert node.stop() == 0, node.output[-1000:]
    growth = {name: late[name] / early[name] - 1 for name in nodes}
    latency = json.loads(summary.read_text())["latency_ms"]
    figure = ", ".join(f"{name} {late[name]:.0f} MiB ({growth[name]:+.1%})" for name in nodes)
    figure += f"; p50 {latency['p50']:.2f} ms, p99 {latency['p99']:.2f} ms over {minutes:g} min"
    assert all(share < _GROWTH for share in growth.values()), figure
    return figure
