"""The door of a WebSocket server: it lets no page of another site in, which a browser on this machine may have open.

A browser lets any page connect to any address, and says in `Origin` whose page it is and in `Host` by which name it
came (RFC 6455, 10.2; the name is another site's where that site's DNS gives this machine's address). Foxglove's server
asks for neither. It is put behind a `Gate`, at a loopback address and port that no page can guess.
"""

from __future__ import annotations

import asyncio
import contextlib
import ipaddress
import secrets
import socket
import sys
import threading
from collections.abc import Sequence
from urllib.parse import urlsplit

from vsense_ros.errors import InputError


def hidden_address() -> str:
    """A loopback address of 2²⁴, where the system has more than one."""
    if sys.platform != "linux":
        return "127.0.0.1"
    return str(ipaddress.IPv4Address(0x7F000002 + secrets.randbelow((1 << 24) - 4)))


def is_known_host(name: str) -> bool:
    """True if the name of a `Host` is no other site's: an address, or the name of this machine."""
    try:
        ipaddress.ip_address(name)
    except ValueError:
        own = socket.gethostname().lower()
        return name in ("localhost", own, f"{own.partition('.')[0]}.local")
    return True


def is_known_origin(origin: str, allowed: Sequence[str] = ()) -> bool:
    """True if pages of `origin` may look: Foxglove's own, those of programs of this machine, and those `allowed`."""
    if origin in allowed or origin == "file://":  # of a desktop application; a file in a browser says null
        return True
    host, scheme = _host(origin), origin.partition(":")[0]
    if scheme == "https" and (host == "foxglove.dev" or host.endswith(".foxglove.dev")):
        return True
    return scheme in ("http", "https") and host in ("localhost", "127.0.0.1", "::1")


def refusal(head: bytes, allowed: Sequence[str] = ()) -> str:
    """Why a request with this head [byte] is refused; empty if it is not."""
    lines = head.decode("latin-1").split("\r\n")
    if not lines[0].startswith("GET "):
        return "400 Bad Request"
    values: dict[str, list[str]] = {"host": [], "origin": []}
    for line in lines[1:]:
        name, colon, value = line.partition(":")
        if colon and name.lower() in values:
            values[name.lower()].append(value.strip())
    if len(values["host"]) != 1 or len(values["origin"]) > 1:
        return "400 Bad Request"
    if not is_known_host(_host(f"//{values['host'][0]}")):
        return "421 Misdirected Request"
    if values["origin"] and not is_known_origin(values["origin"][0], allowed):
        return "403 Forbidden"
    return ""


def _host(url: str) -> str:
    """The host of a URL without its port; empty where there is none."""
    try:
        return urlsplit(url).hostname or ""
    except ValueError:
        return ""


class Gate:
    """Serves at `host` and `port` what a server at `inner` (address, port) serves, to whom `refusal` says nothing of.
    Raises `InputError` where the port is taken."""

    def __init__(self, host: str, port: int, inner: tuple[str, int], allowed: Sequence[str] = ()) -> None:
        self._inner, self._allowed = inner, tuple(allowed)
        self._loop = asyncio.new_event_loop()
        try:
            self._server = self._loop.run_until_complete(asyncio.start_server(self._serve, host, port))
        except OSError as error:
            self._loop.close()
            raise InputError(f"cannot serve at {host}:{port}: {error}; choose another port") from None
        self.port: int = self._server.sockets[0].getsockname()[1]
        self._thread = threading.Thread(target=self._loop.run_forever, name="gate", daemon=True)
        self._thread.start()

    async def _serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        try:
            head = await asyncio.wait_for(reader.readuntil(b"\r\n\r\n"), 10.0)
            if why := refusal(head, self._allowed):
                writer.write(f"HTTP/1.1 {why}\r\nConnection: close\r\nContent-Length: 0\r\n\r\n".encode())
                await writer.drain()
                return
            from_server, to_server = await asyncio.open_connection(*self._inner)
            to_server.write(head)
            tasks = [
                asyncio.ensure_future(_carry(reader, to_server)),
                asyncio.ensure_future(_carry(from_server, writer)),
            ]
            await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
            for task in tasks:
                task.cancel()
            to_server.close()
        except (OSError, asyncio.IncompleteReadError, asyncio.LimitOverrunError, TimeoutError):
            pass  # it went away, or was no request
        finally:
            writer.close()

    def stop(self) -> None:
        """Close the door, and every connection."""
        if self._loop.is_closed():
            return

        async def end() -> None:
            self._server.close()
            tasks = [task for task in asyncio.all_tasks() if task is not asyncio.current_task()]
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)

        asyncio.run_coroutine_threadsafe(end(), self._loop).result(5.0)
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join(5.0)
        self._loop.close()


async def _carry(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    """Carry bytes on as they come, until one side goes."""
    with contextlib.suppress(OSError):
        while data := await reader.read(65536):
            writer.write(data)
            await writer.drain()
