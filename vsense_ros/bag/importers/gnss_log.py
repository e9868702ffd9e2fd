"""What a GNSS receiver sent, as a file: NMEA 0183 or UBX, by the decoders of the driver.

A file has no times of arrival: those of measurement stand for them.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from vsense_ros.driver.nmea import NmeaDecoder
from vsense_ros.driver.ubx import UbxDecoder
from vsense_ros.errors import InputError
from vsense_ros.messages import cdr
from vsense_ros.messages.recording import Channel, Recording, Sample

NAME = "gnss_log"
DESCRIPTION = "bytes of a GNSS receiver (.nmea, .ubx)"

_SENTENCE = re.compile(rb"\$[A-Z]{2}(?:GGA|RMC|GNS|VTG|GSA|GSV|GLL|ZDA|GST),[ -~]*\*[0-9A-F]{2}")
_TIMED = re.compile(rb"\$[A-Z]{2}(?:GGA|RMC|GNS|ZDA),(\d{2})(\d{2})(\d{2}(?:\.\d*)?)")
_UBX = b"\xb5\x62"
_BLOCK = 1 << 16  # [byte]
_DAY = 86_400_000_000_000  # [ns]


def matches(path: Path) -> bool:
    """True if `path` has sentences or frames of a receiver near its beginning."""
    if not path.is_file():
        return False
    with path.open("rb") as file:
        head = file.read(4096)
    return bool(_SENTENCE.search(head)) or (head.count(_UBX) > 1 and (head.startswith(_UBX) or path.suffix == ".ubx"))


def read(path: Path) -> Recording:
    """`gps/fix`, `gps/velocity` and, of receivers with two antennas, `gps/attitude`."""
    with path.open("rb") as file:
        is_nmea = bool(_SENTENCE.search(file.read(4096)))
    decoder: NmeaDecoder | UbxDecoder = NmeaDecoder() if is_nmea else UbxDecoder()
    samples: dict[str, list[Sample]] = {}
    at = 0
    for at, data in _sentences(path) if is_nmea else _blocks(path):
        for sample in decoder.feed(data, at):
            samples.setdefault(sample.topic, []).append(sample)
    health = decoder.diagnostics(at)
    counts = decoder.link.counts
    notes = []
    if counts["broken frames"]:
        notes.append(f"{path.name}: {counts['broken frames']} broken frames left out")
    if decoder.link.not_decoded:
        notes.append(f"{path.name}: not decoded: {decoder.link.not_decoded}")
    if not samples:
        told = "; ".join(d.message for d in health if d.level > 0)
        raise InputError(f"{path}: no fix and no velocity in {counts['frames']} frames: {told}")
    channels = {topic: _channel(topic, found) for topic, found in samples.items()}
    return Recording(channels, path.stem, tuple(notes), 0, {"source": NAME})


def _sentences(path: Path) -> Iterator[tuple[int, bytes]]:
    """Lines, each with the time of day that the latest sentence told [ns], which stands for its arrival."""
    at, day = 0, 0
    with path.open("rb") as file:
        while line := file.readline(_BLOCK):
            found = _TIMED.search(line)
            if found is not None:
                hours, minutes, seconds = (float(part) for part in found.groups())
                now = day + round(((hours * 60 + minutes) * 60 + seconds) * 1e9)
                if now < at - _DAY // 2:
                    day += _DAY
                    now += _DAY
                at = now
            yield at, line


def _blocks(path: Path) -> Iterator[tuple[int, bytes]]:
    with path.open("rb") as file:
        while block := file.read(_BLOCK):
            yield 0, block


def _channel(topic: str, samples: list[Sample]) -> Channel:
    stamp = np.array([sample.stamp for sample in samples], np.int64)
    payloads = [cdr.encode(replace(sample, received=None)) for sample in samples]
    channel = cdr.decode_channel(samples[0].kind, topic, payloads, stamp).channel
    assert channel is not None
    return channel
