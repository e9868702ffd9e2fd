"""Message types of packages that are not installed, for publishers and subscriptions of bytes.

A process that only passes CDR bytes on needs of a type its name and its hash; both are in every bag, and publishers
tell them. rmw_fastrtps asks for the rest (how to turn a message into bytes) when a message object is to be converted,
which with bytes never happens. So the structures that generated code would hold are filled in here. That works with
rmw_fastrtps_cpp alone, the default of ROS 2 Jazzy.
"""

from __future__ import annotations

import ctypes as c
import re
from functools import cache
from typing import Any

from rclpy.utilities import get_rmw_implementation_identifier
from std_msgs.msg import UInt8MultiArray

from vsense_ros.errors import InputError

_IDENTIFIER = b"rosidl_typesupport_fastrtps_c"
_NAME = re.compile(r"[a-z][a-z0-9_]*/msg/[A-Z][A-Za-z0-9]*")
_HASH = re.compile(r"RIHS01_[0-9a-f]{64}")

_Convert = c.CFUNCTYPE(c.c_bool, c.c_void_p, c.c_void_p)
_Size = c.CFUNCTYPE(c.c_uint32, c.c_void_p)
_LargestSize = c.CFUNCTYPE(c.c_size_t, c.POINTER(c.c_char))
_Handle = c.CFUNCTYPE(c.c_void_p, c.c_void_p, c.c_char_p)
_Get = c.CFUNCTYPE(c.c_void_p, c.c_void_p)


class _Callbacks(c.Structure):
    """`message_type_support_callbacks_t` of rosidl_typesupport_fastrtps_cpp/message_type_support.h."""

    _fields_ = (
        ("namespace", c.c_char_p),
        ("name", c.c_char_p),
        ("serialize", _Convert),
        ("deserialize", _Convert),
        ("serialized_size", _Size),
        ("largest_size", _LargestSize),
        ("key", c.c_void_p),
    )


class _Support(c.Structure):
    """`rosidl_message_type_support_t` of rosidl_runtime_c/message_type_support_struct.h."""

    _fields_ = (
        ("identifier", c.c_char_p),
        ("data", c.c_void_p),
        ("handle", _Handle),
        ("hash", _Get),
        ("description", _Get),
        ("sources", _Get),
    )


class _Hash(c.Structure):
    _fields_ = (("version", c.c_uint8), ("value", c.c_uint8 * 32))


class _Text(c.Structure):
    _fields_ = (("data", c.c_char_p), ("size", c.c_size_t), ("capacity", c.c_size_t))


class _Sequence(c.Structure):
    _fields_ = (("data", c.c_void_p), ("size", c.c_size_t), ("capacity", c.c_size_t))


class _Description(c.Structure):
    """`TypeDescription` of type_description_interfaces: the type's name, without fields and without further types."""

    _fields_ = (("name", _Text), ("fields", _Sequence), ("referenced", _Sequence))


_KEPT: list[Any] = []  # what the middleware holds pointers to, for as long as the process lives


def _capsule_functions() -> tuple[Any, Any]:
    new, pointer = c.pythonapi.PyCapsule_New, c.pythonapi.PyCapsule_GetPointer
    new.restype, new.argtypes = c.py_object, (c.c_void_p, c.c_char_p, c.c_void_p)
    pointer.restype, pointer.argtypes = c.c_void_p, (c.py_object, c.c_char_p)
    return new, pointer


def _handle_of(support: _Support) -> Any:
    """The function of a type support that gives the one for a middleware, by its name."""
    return _Handle(c.cast(support.handle, c.c_void_p).value or 0)


@cache
def raw_type(kind: str, type_hash: str) -> Any:
    """A message type for bytes alone: `package/msg/Name`, and its hash of REP-2016 (`RIHS01_…`).

    Raises `InputError` where name or hash are none, or with another middleware.
    """
    if not _NAME.fullmatch(kind) or not _HASH.fullmatch(type_hash):
        raise InputError(f"message type {kind!r} is not installed, and its hash {type_hash!r} is unknown")
    if get_rmw_implementation_identifier() != "rmw_fastrtps_cpp":
        raise InputError(f"message type {kind!r} is not installed, which only rmw_fastrtps_cpp can do without")
    new_capsule, pointer = _capsule_functions()
    # What describes the fields is not asked for their meaning: that of any type will do.
    type(UInt8MultiArray).__import_type_support__()
    lent = pointer(UInt8MultiArray._TYPE_SUPPORT, None)
    ask = _handle_of(_Support.from_address(lent))
    package, _, name = kind.partition("/msg/")
    support, name_of_type = _Support(), kind.encode()
    description = _Description(_Text(name_of_type, len(name_of_type), len(name_of_type) + 1), _Sequence(), _Sequence())
    sources, digest = _Sequence(), _Hash(1, (c.c_uint8 * 32)(*bytes.fromhex(type_hash.removeprefix("RIHS01_"))))

    def largest(bounds: Any) -> int:
        bounds[0] = b"\0"  # unbounded
        return 4

    never = _Convert(lambda message, cdr: False)
    callbacks = _Callbacks(
        f"{package}::msg".encode(), name.encode(), never, never, _Size(lambda message: 0), _LargestSize(largest), None
    )
    support.identifier, support.data = _IDENTIFIER, c.addressof(callbacks)
    support.handle = _Handle(lambda _, wanted: c.addressof(support) if wanted == _IDENTIFIER else ask(lent, wanted))
    support.hash = _Get(lambda _: c.addressof(digest))
    support.description = _Get(lambda _: c.addressof(description))
    support.sources = _Get(lambda _: c.addressof(sources))
    _KEPT.append((support, callbacks, digest, description, sources, ask))
    capsule = new_capsule(c.addressof(support), None, None)
    conversions = ("_TYPE_SUPPORT", "_CREATE_ROS_MESSAGE", "_CONVERT_FROM_PY", "_CONVERT_TO_PY", "_DESTROY_ROS_MESSAGE")
    return type(f"Raw{name}Type", (type,), dict.fromkeys(conversions, capsule))(name, (), {})


class _Service(c.Structure):
    """`rosidl_service_type_support_t` of rosidl_runtime_c/service_type_support_struct.h."""

    _fields_ = (
        ("identifier", c.c_char_p),
        ("data", c.c_void_p),
        ("handle", _Handle),
        ("request", c.c_void_p),
        ("response", c.c_void_p),
        ("event", c.c_void_p),
        ("create_event", c.c_void_p),
        ("destroy_event", c.c_void_p),
        ("hash", _Get),
        ("description", _Get),
        ("sources", _Get),
    )


class _ServiceCallbacks(c.Structure):
    """`service_type_support_callbacks_t` of rosidl_typesupport_fastrtps_cpp/service_type_support.h."""

    _fields_ = (
        ("namespace", c.c_char_p),
        ("name", c.c_char_p),
        ("request", c.c_void_p),
        ("response", c.c_void_p),
    )


def _renamed(message: Any, namespace: str, name: str) -> _Support:
    """The support of an installed message type, under another name."""
    _, pointer = _capsule_functions()
    type(message).__import_type_support__()
    original = _Support.from_address(pointer(message._TYPE_SUPPORT, None))
    ask = _handle_of(original)
    fast = _Support.from_address(ask(c.addressof(original), _IDENTIFIER))
    callbacks = _Callbacks.from_buffer_copy(c.string_at(fast.data, c.sizeof(_Callbacks)))
    callbacks.namespace, callbacks.name = namespace.encode(), name.encode()
    support = _Support.from_buffer_copy(c.string_at(c.addressof(fast), c.sizeof(_Support)))
    support.data = c.addressof(callbacks)
    support.handle = _Handle(
        lambda _, wanted: c.addressof(support) if wanted == _IDENTIFIER else ask(c.addressof(original), wanted)
    )
    _KEPT.append((support, callbacks, ask, original))
    return support


@cache
def service_like(kind: str, request: Any, response: Any) -> Any:
    """A service type `package/srv/Name` whose package is not installed, with installed message types of the same fields
    in the same order as its request and response. Raises `InputError` with another middleware than rmw_fastrtps."""
    if get_rmw_implementation_identifier() != "rmw_fastrtps_cpp":
        raise InputError(f"service type {kind!r} is not installed, which only rmw_fastrtps_cpp can do without")
    new_capsule, _ = _capsule_functions()
    package, _, name = kind.partition("/srv/")
    namespace = f"{package}::srv"
    asked, answered = _renamed(request, namespace, f"{name}_Request"), _renamed(response, namespace, f"{name}_Response")
    callbacks = _ServiceCallbacks(namespace.encode(), name.encode(), c.addressof(asked), c.addressof(answered))
    name_of_type, digest, sources = kind.encode(), _Hash(1), _Sequence()
    description = _Description(_Text(name_of_type, len(name_of_type), len(name_of_type) + 1), _Sequence(), _Sequence())
    support = _Service(_IDENTIFIER, c.addressof(callbacks))
    support.handle = _Handle(lambda _, wanted: c.addressof(support) if wanted == _IDENTIFIER else None)
    support.request, support.response = c.addressof(asked), c.addressof(answered)
    support.hash = _Get(lambda _: c.addressof(digest))
    support.description = _Get(lambda _: c.addressof(description))
    support.sources = _Get(lambda _: c.addressof(sources))
    _KEPT.append((support, callbacks, digest, sources, description))
    meta = type(f"{name}Type", (type,), {"_TYPE_SUPPORT": new_capsule(c.addressof(support), None, None)})
    return meta(name, (), {"Request": request, "Response": response})
