"""What a GNSS receiver sent, as a file: NMEA 0183, UBX, or both with RTCM between, by the decoders of the driver.

A file has no times of arrival: those of measurement stand for them.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

from vsense_ros.driver.gnss_stream import ReceiverDecoder, frame_end
from vsense_ros.errors import InputError
from vsense_ros.messages import cdr
from vsense_ros.messages.recording import Channel, Recording, Sample

NAME = "gnss_log"
DESCRIPTION = "bytes of a GNSS receiver (.nmea, .ubx)"

_SENTENCE = re.compile(rb"\$[A-Z]{2}(?:GGA|RMC|GNS|VTG|GSA|GSV|GLL|ZDA|GST|GBS|GRS|TXT|HDT|THS),[ -~]*\*[0-9A-F]{2}")
_TIMED = re.compile(rb"\$[A-Z]{2}(?:GGA|RMC|GNS|ZDA),(\d{2})(\d{2})(\d{2}(?:\.\d*)?)")
_UBX = b"\xb5\x62"
_BLOCK = 1 << 16  # [byte]
_NEAR, _HEAD = 1 << 12, 1 << 15  # [byte] at the beginning in which a sentence, and a frame of UBX, is looked for
_DAY = 86_400_000_000_000  # [ns]


def matches(path: Path) -> bool:
    """True if `path` has sentences or frames of a receiver near its beginning."""
    if not path.is_file():
        return False
    with path.open("rb") as file:
        head = file.read(_HEAD)
    if _SENTENCE.search(head[:_NEAR]):
        return True
    starts = [match.start() for match in re.finditer(re.escape(_UBX), head)]
    return any((frame_end(head, start) or start) > start for start in starts)


def read(path: Path) -> Recording:
    """`gps/fix`, `gps/velocity` and, of receivers with two antennas, `gps/attitude`."""
    decoder = ReceiverDecoder()
    of_ubx: list[Sample] = []
    of_nmea: list[Sample] = []
    at = 0
    for at, data in _sentences(path):
        ubx, nmea = decoder.feed_each(data, at)
        of_ubx += ubx
        of_nmea += nmea
    samples: dict[str, list[Sample]] = {}
    for sample in [*of_ubx, *decoder.additional(of_nmea)] if decoder.speaks_ubx else [*of_nmea, *of_ubx]:
        samples.setdefault(sample.topic, []).append(sample)
    health = decoder.diagnostics(at)
    link = decoder.link
    counts = link.counts
    notes = []
    if counts["broken frames"]:
        notes.append(f"{path.name}: {counts['broken frames']} broken frames left out")
    if decoder.foreign_bytes:
        other = "belong to no whole sentence of NMEA and no whole frame of UBX or RTCM"
        notes.append(f"{path.name}: {decoder.foreign_bytes} bytes {other}")
    if link.not_decoded:
        notes.append(f"{path.name}: not decoded: {link.not_decoded}")
    if not samples:
        reasons = "; ".join(d.message for d in health if d.level > 0)
        raise InputError(f"{path}: no fix and no velocity in {counts['frames']} frames: {reasons}")
    channels = {topic: _channel(topic, of_topic) for topic, of_topic in samples.items()}
    return Recording(channels, path.stem, tuple(notes), 0, {"source": NAME})


def _sentences(path: Path) -> Iterator[tuple[int, bytes]]:
    """Lines, each with the time of day that the latest sentence had [ns], which stands for its arrival."""
    at, day = 0, 0
    with path.open("rb") as file:
        while line := file.readline(_BLOCK):
            time = _TIMED.search(line)
            if time is not None:
                hours, minutes, seconds = (float(part) for part in time.groups())
                now = day + round(((hours * 60 + minutes) * 60 + seconds) * 1e9)
                if now < at - _DAY // 2:
                    day += _DAY
                    now += _DAY
                at = now
            yield at, line


def _channel(topic: str, samples: list[Sample]) -> Channel:
    stamp = np.array([sample.stamp for sample in samples], np.int64)
    payloads = [cdr.encode(replace(sample, received=None)) for sample in samples]
    channel = cdr.decode_channel(samples[0].kind, topic, payloads, stamp).channel
    assert channel is not None
    return channel
