"""Nodes that find each other on this machine alone, and open nothing that another machine could reach."""

from __future__ import annotations

from pathlib import Path

PROFILES = ("FASTRTPS_DEFAULT_PROFILES_FILE", "FASTDDS_DEFAULT_PROFILES_FILE")  # by the version of Fast DDS
RANGE = "ROS_AUTOMATIC_DISCOVERY_RANGE"


def on_this_machine() -> dict[str, str]:
    """Environment variables by which nodes use the loopback and shared memory alone.

    The range LOCALHOST of ROS limits who is looked for; the sockets it sends from are still those of every interface.
    So the profiles of `discovery.xml` say all of it, and ROS adds nothing to them.
    """
    profiles = str(Path(__file__).with_name("discovery.xml"))
    return {RANGE: "SYSTEM_DEFAULT", **dict.fromkeys(PROFILES, profiles)}
