"""Message types by name. Messages themselves travel as CDR bytes, which `vsense_ros.messages.cdr` turns into samples.

rclpy publishes bytes as they are and hands them over to raw subscriptions, so that a sample meets no message object on
its way: converting one field by field costs some 30 µs, its bytes a third of that.
"""

from __future__ import annotations

import sys
from contextlib import suppress
from functools import cache
from importlib import import_module
from pathlib import Path
from typing import Any

from vsense_ros.bag.metadata import RELIABLE_QOS, TopicDescription
from vsense_ros.errors import InputError
from vsense_ros.messages import definitions
from vsense_ros.node.raw_type import raw_type


@cache
def message_type(kind: str, type_hash: str = "") -> Any:
    """The class of `package/msg/Name`; where that is not installed, with its hash (`RIHS01_…`, or one that the project
    knows) a stand-in for bytes alone. `InputError` if there is neither."""
    package, _, name = kind.partition("/msg/")
    try:
        return getattr(import_module(f"{package}.msg"), name)
    except (ImportError, AttributeError, ValueError):
        type_hash = type_hash or definitions.TYPE_HASHES.get(kind, "")
    if not type_hash:
        raise InputError(f"message type {kind!r} is not installed; expected such as 'sensor_msgs/msg/Imu'")
    return raw_type(kind, type_hash)


@cache
def _typestore() -> Any:
    from rosbags.typesys import Stores, get_typestore

    return get_typestore(Stores.ROS2_JAZZY)


def _read_installed(kind: str) -> bool:
    """Take the definition of a type from where its package is installed, with those of all types inside it."""
    store = _typestore()
    package, _, name = kind.partition("/msg/")
    if kind in store.fielddefs:
        return True
    try:
        module = Path(import_module(package).__file__ or "")
    except (ImportError, TypeError):
        return False
    for share in (*(parent / "share" for parent in module.parents), Path(sys.prefix) / "share"):
        file = share / package / "msg" / f"{name}.msg"
        if file.is_file():
            break
    else:
        return False
    from rosbags.typesys import get_types_from_msg

    types = get_types_from_msg(file.read_text(encoding="utf-8"), kind)
    store.register(types)
    needed = {word for _, fields in types.values() for word in _types_in(fields)}
    return all(_read_installed(inner) for inner in needed - {kind})


def _types_in(node: object) -> set[str]:
    """Names of message types anywhere in the field descriptions of rosbags."""
    if isinstance(node, str):
        return {node} if "/msg/" in node else set()
    if isinstance(node, list | tuple):
        return set().union(*(_types_in(item) for item in node)) if node else set()
    return set()


def describe(kind: str, type_hash: str = "", qos: str = RELIABLE_QOS) -> TopicDescription:
    """What a bag says of a topic of this type. Where its definition is found nowhere, the bag holds none, and whoever
    reads it has to know the type; `type_hash` is what a publisher announced."""
    if kind in definitions.TYPE_HASHES:
        return TopicDescription(kind, definitions.schema_text(kind), definitions.TYPE_HASHES[kind], qos)
    with suppress(Exception):  # of rosbags, of many kinds, for definitions that it does not understand
        if _read_installed(kind):
            text, _ = _typestore().generate_msgdef(kind, ros_version=2)
            return TopicDescription(kind, text, type_hash or _typestore().hash_rihs01(kind), qos)
    return TopicDescription(kind, "", type_hash, qos)
