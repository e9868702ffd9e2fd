"""What SECURITY.md says, tried from outside."""

from __future__ import annotations

import os
import re
import shutil
import socket
import subprocess
from urllib.error import HTTPError
from urllib.request import urlopen

import pytest

from vehicle.workshop import LeftOut, Workshop, check
from vsense_ros.cache import kept


@check("the viewer refuses a page of another site, by Origin and by Host", security=True)
def pages(shop: Workshop) -> str:
    viewer = shop.start("viewer", port=0)
    viewer.wait_until_active()
    port = int(re.findall(r"serving at ws://127\.0\.0\.1:(\d+);", viewer.output)[0])
    answers = {}
    for host, origin in (
        (f"127.0.0.1:{port}", ""),
        (f"127.0.0.1:{port}", "https://evil.example"),
        (f"127.0.0.1:{port}", "null"),
        (f"evil.example:{port}", f"http://evil.example:{port}"),
    ):
        lines = ["GET / HTTP/1.1", f"Host: {host}", "Upgrade: websocket", "Connection: Upgrade"]
        lines += ["Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==", "Sec-WebSocket-Version: 13"]
        lines += ["Sec-WebSocket-Protocol: foxglove.sdk.v1", *([f"Origin: {origin}"] if origin else [])]
        with socket.create_connection(("127.0.0.1", port), 5.0) as connection:
            connection.sendall("\r\n".join([*lines, "", ""]).encode())
            answers[host, origin] = int(connection.recv(64).split()[1])
    assert list(answers.values()) == [101, 403, 403, 421], answers
    return "3 pages refused, a program let in"


@check("ss lists no socket that listens beyond this machine", security=True)
def listening(shop: Workshop) -> str:
    if shutil.which("ss") is None:
        raise LeftOut("needs ss, of Debian's iproute2")
    nodes = [shop.start("observer", vehicle="prototype_model"), shop.start("viewer", port=0), shop.start("gps_driver")]
    for node in nodes[:2]:
        node.wait_until_active()
    said = subprocess.run(["ss", "-Hltnp"], capture_output=True, text=True, check=True).stdout
    own = [line.split()[3] for line in said.splitlines() if any(f"pid={node.pid}," in line for node in nodes)]
    beyond = [address for address in own if not address.startswith(("127.", "[::1]", "[::ffff:127."))]
    assert own
    assert not beyond, beyond
    return f"{len(own)} listening sockets"


@check("workers of a fleet talk by TLS, and to nobody without the key of the run", security=True)
def fleet_by_tls(_: Workshop) -> str:
    try:
        from distributed import Client

        from vsense_ros.fleet import fleet
    except ImportError as error:
        raise LeftOut(f"needs {error.name}") from None
    with fleet.workers(None, 1) as client:
        address = client.scheduler.address
        assert address.startswith("tls://127.0.0.1:"), address
        with pytest.raises(OSError, match=r"scheduler|connect|Timed out|closed"):
            Client(address.replace("tls://", "tcp://"), timeout="2s")
        # The scheduler's HTTP server asks for no key: it may have nothing to show.
        port = client.scheduler_info()["services"]["dashboard"]
        for page in ("health", "info/main/workers.html", "metrics", "status", "json/counts.json"):
            with pytest.raises(HTTPError, match="404"):
                urlopen(f"http://127.0.0.1:{port}/{page}", timeout=5.0)
    return "tls, and no page without it"


@check("a compiled library that another user could have written is not loaded", security=True)
def planted(shop: Workshop) -> str:
    folder = shop.folder / "cache"
    before = os.environ.get("VSENSE_CACHE")
    os.environ["VSENSE_CACHE"] = str(folder)
    try:
        built = []

        def make(place):  # type: ignore[no-untyped-def]
            (place / "library.so").write_bytes(b"ours")
            built.append(place)
            return place / "library.so"

        kept("security", ["content"], make)
        (library,) = folder.rglob("security*.so")
        library.write_bytes(b"planted")
        library.chmod(0o777)
        assert kept("security", ["content"], make).read_bytes() == b"ours"
    finally:
        os.environ.pop("VSENSE_CACHE")
        if before is not None:
            os.environ["VSENSE_CACHE"] = before
    assert len(built) == 2
    return "built again"
