"""A viewer in the tests: the protocol of Foxglove's WebSocket, as its specification has it, and nothing of its SDK."""

from __future__ import annotations

import asyncio
import json
import re
import struct
from collections import defaultdict
from collections.abc import Callable
from typing import Any

from rosbags.typesys import Stores, get_types_from_msg, get_typestore
from tornado.websocket import websocket_connect

Seen = dict[str, list[tuple[int, bytes]]]


class Viewing:
    """What a viewer has heard: the server's greeting, its topics, and of each the messages with their times [ns]."""

    def __init__(self) -> None:
        self.info: dict[str, Any] = {}
        self.topics: dict[str, dict[str, Any]] = {}
        self.seen: Seen = defaultdict(list)

    def message(self, topic: str, number: int = -1) -> Any:
        """A message by the definition that the server told."""
        told, store = self.topics[topic], get_typestore(Stores.EMPTY)
        assert told["schemaEncoding"] == "ros2msg"
        store.register(get_types_from_msg(told["schema"], told["schemaName"]))
        return store.deserialize_cdr(self.seen[topic][number][1], told["schemaName"])


def watch(url: str, enough: Callable[[Viewing], bool], timeout: float = 20.0) -> Viewing:
    """Ask for every topic until `enough` has been seen; fails the test after `timeout` [s]."""
    return asyncio.run(asyncio.wait_for(_watch(url, enough), timeout))


async def _watch(url: str, enough: Callable[[Viewing], bool]) -> Viewing:
    found, wanted = Viewing(), dict[int, str]()
    connection = await websocket_connect(url, subprotocols=["foxglove.sdk.v1"])
    while not enough(found):
        data = await connection.read_message()
        assert data is not None, "the server has closed the connection"
        if isinstance(data, bytes):
            if data[0] == 1:
                number, at = struct.unpack_from("<IQ", data, 1)
                found.seen[wanted[number]].append((at, data[13:]))
            continue
        told = json.loads(data)
        if told["op"] == "serverInfo":
            found.info = told
        new = {channel["id"]: channel for channel in told.get("channels", ()) if told["op"] == "advertise"}
        found.topics |= {channel["topic"]: channel for channel in new.values()}
        wanted |= {number: channel["topic"] for number, channel in new.items()}
        # The server may announce a channel an instant before it knows it itself, and then says so.
        again = [int(number) for number in re.findall(r"(?i:unknown channel id): (\d+)", told.get("message", ""))]
        for number in (*new, *again):
            ask = {"op": "subscribe", "subscriptions": [{"id": number, "channelId": number}]}
            await connection.write_message(json.dumps(ask))
    connection.close()
    return found
