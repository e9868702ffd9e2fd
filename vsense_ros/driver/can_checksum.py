"""Checksums of CAN messages: one function each, found by name in `CHECKSUMS`.

Each takes the identifier, the data without the checksum byte, and the length of the whole data field, and returns
the byte that the sender should have put there.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from functools import reduce
from types import MappingProxyType

Checksum = Callable[[int, bytes, int], int]


def toyota(frame_id: int, payload: bytes, length: int) -> int:
    """Sum of the identifier's bytes, the data length and the other data bytes, modulo 256."""
    return (frame_id & 0xFF) + (frame_id >> 8 & 0xFF) + length + sum(payload) & 0xFF


def byte_sum(frame_id: int, payload: bytes, length: int) -> int:
    """Sum of the other data bytes, modulo 256."""
    return sum(payload) & 0xFF


def byte_xor(frame_id: int, payload: bytes, length: int) -> int:
    """Exclusive or of the other data bytes."""
    return reduce(lambda a, b: a ^ b, payload, 0)


def _crc8_table(polynomial: int) -> bytes:
    table = []
    for value in range(256):
        for _ in range(8):
            value = (value << 1 ^ polynomial if value & 0x80 else value << 1) & 0xFF
        table.append(value)
    return bytes(table)


_J1850 = _crc8_table(0x1D)


def crc8_sae_j1850(frame_id: int, payload: bytes, length: int) -> int:
    """CRC-8 of SAE J1850 (polynomial 0x1D, start and final exclusive or 0xFF) of the other data bytes."""
    return reduce(lambda crc, byte: _J1850[crc ^ byte], payload, 0xFF) ^ 0xFF


CHECKSUMS: Mapping[str, Checksum] = MappingProxyType(
    {"toyota": toyota, "sum": byte_sum, "xor": byte_xor, "crc8_sae_j1850": crc8_sae_j1850}
)
