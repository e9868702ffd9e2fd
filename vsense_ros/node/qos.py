"""Qualities of service as rosbag2 writes them into a bag, and back."""

from __future__ import annotations

from collections.abc import Iterable

from rclpy.duration import Duration
from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

from vsense_ros.errors import InputError
from vsense_ros.messages import yaml_text
from vsense_ros.node.reader import LATCHED, LOSSLESS

_LONGEST = (9223372036, 854775807)  # [s], [ns]: no limit


def _duration(duration: Duration) -> str:
    seconds, rest = divmod(duration.nanoseconds, 1_000_000_000)
    if duration.nanoseconds == 0 or seconds >= _LONGEST[0]:
        seconds, rest = _LONGEST
    return f"\n    sec: {seconds}\n    nsec: {rest}\n"


def offered_text(profiles: Iterable[QoSProfile]) -> str:
    """What publishers offer, as the YAML of `offered_qos_profiles`."""
    return "".join(
        f"""\
- history: {p.history.name.lower()}
  depth: {p.depth}
  reliability: {p.reliability.name.lower()}
  durability: {p.durability.name.lower()}
  deadline:{_duration(p.deadline)}  lifespan:{_duration(p.lifespan)}\
  liveliness: {p.liveliness.name.lower()}
  liveliness_lease_duration:{_duration(p.liveliness_lease_duration)}\
  avoid_ros_namespace_conventions: {str(p.avoid_ros_namespace_conventions).lower()}
"""
        for p in profiles
    )


def profile_of(text: str) -> QoSProfile:
    """With which to publish again what was offered so: latched if it was, best effort if all of it was."""
    try:
        content = yaml_text.load(text, "offered_qos_profiles")
    except InputError:
        return LOSSLESS
    offers = [offer for offer in content if isinstance(offer, dict)] if isinstance(content, list) else []

    def all_are(key: str, *values: object) -> bool:
        return bool(offers) and all(offer.get(key) in values for offer in offers)

    if all_are("durability", "transient_local", 1):
        return LATCHED
    if all_are("reliability", "best_effort", 2):
        return QoSProfile(
            depth=LOSSLESS.depth,
            reliability=ReliabilityPolicy.BEST_EFFORT,
            durability=DurabilityPolicy.VOLATILE,
        )
    return LOSSLESS
