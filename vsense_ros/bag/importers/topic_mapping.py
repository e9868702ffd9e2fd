"""From topics of a bag, whatever they are called, to those of this project, as a YAML file says.

    topics:
      imu/data: /sensing/imu/tamagawa/imu_raw
      gps/fix: /ublox/fix
      gps/velocity: /ublox/fix_velocity
      vehicle/velocity: /vehicle/status/velocity_status
      vehicle/wheel_speeds: {topic: /joint_states, names: {wheel_fl: front_left_wheel, wheel_fr: front_right_wheel}}

Where topics have other axes than forward, left, up and east, north, up, `convention: ned` says so for all topics of the
mapping, or `{topic: /imu, convention: sae_j670}` for one: iso_8855 (the default), sae_j670, ned or enu.

A topic gets the type and the frame that the project's has: a TwistStamped becomes a velocity without a stated noise, an
Odometry the velocity in the axes of the car. `names` are the joints of a JointState. Other topics of the bag stay as
they are.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
from pydantic import BaseModel, ConfigDict, Field, ValidationError

from vsense_ros.bag.importers.convention import ConventionName, in_own_axes
from vsense_ros.errors import InputError
from vsense_ros.messages import yaml_text
from vsense_ros.messages.recording import Channel, Recording
from vsense_ros.messages.topics import TOPICS

_TWIST, _TWIST_WITH_COVARIANCE = "geometry_msgs/msg/TwistStamped", "geometry_msgs/msg/TwistWithCovarianceStamped"


class TopicSource(BaseModel):
    """A topic of the bag, and what its joints are called there."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    topic: str = Field(min_length=1, description="topic of the bag")
    names: dict[str, str] = Field(default_factory=dict, description="joints of the project: as they are called there")
    convention: ConventionName | None = Field(
        default=None, description="its axes and signs; default: that of the mapping"
    )


class TopicMapping(BaseModel):
    """The mapping of a bag."""

    model_config = ConfigDict(extra="forbid", frozen=True)

    topics: dict[str, str | TopicSource] = Field(min_length=1, description="topic of the project: topic of the bag")
    convention: ConventionName = Field(default="iso_8855", description="axes and signs of its topics")


def load(source: str | Path | Mapping[str, Any]) -> TopicMapping:
    """A mapping from a YAML file or its content; `InputError` names key, what was found and what is allowed."""
    content = source if isinstance(source, Mapping) else yaml_text.load_file(source)
    where = "mapping" if isinstance(source, Mapping) else str(source)
    try:
        mapping = TopicMapping.model_validate(content)
    except ValidationError as error:
        first = error.errors()[0]
        key = ".".join(str(part) for part in first["loc"] if part not in ("str", "TopicSource"))
        raise InputError(f"{where}: {key or 'file'}: {first['msg']}, found {first['input']!r}") from None
    for topic in mapping.topics:
        if topic not in TOPICS:
            raise InputError(f"{where}: topics: {topic!r} is no topic of this project; known: {', '.join(TOPICS)}")
    return mapping


def mapped(recording: Recording, source: str | Path | Mapping[str, Any] | None) -> Recording:
    """A recording of a bag with its topics called and typed as the project's; as it is without a mapping.

    Raises `InputError` for a topic that the bag does not have, or whose messages do not say what is wanted.
    """
    (piece,) = mapped_pieces([recording], source)
    return piece


def mapped_pieces(pieces: Iterable[Recording], source: str | Path | Mapping[str, Any] | None) -> Iterator[Recording]:
    """Apply a mapping of topics to a bag in pieces, each of which may lack a topic.

    Raises `InputError` at the end for a topic that none has.
    """
    if source is None:
        yield from pieces
        return
    mapping = load(source)
    name = ""
    known: set[str] = set()
    for piece in pieces:
        name, known = piece.name, known | piece.channels.keys()
        yield _mapped(piece, mapping)
    for topic, wanted in mapping.topics.items():
        its = wanted.topic if isinstance(wanted, TopicSource) else wanted
        if its.lstrip("/") not in known:
            raise InputError(
                f"{name}: the bag has no topic {its!r} for {topic}; it has "
                f"{', '.join(sorted(known)) or 'none that can be read'}"
            )


def _mapped(recording: Recording, mapping: TopicMapping) -> Recording:
    channels = dict(recording.channels)
    taken: set[str] = set()
    made = {}
    for topic, wanted in mapping.topics.items():
        chosen = wanted if isinstance(wanted, TopicSource) else TopicSource(topic=wanted)
        name = chosen.topic.lstrip("/")
        if name not in channels:
            continue
        taken.add(name)
        own = _as(topic, channels[name], chosen.names, recording.name)
        made[topic] = in_own_axes(own, chosen.convention or mapping.convention)
    kept = {name: channel for name, channel in channels.items() if name not in taken and name not in made}
    return replace(recording, channels={**made, **kept})


def _as(topic: str, channel: Channel, names: Mapping[str, str], where: str) -> Channel:
    """A channel under a name of the project, with its type and frames."""
    about = TOPICS[topic]
    columns = _columns(about.kind, channel)
    if columns is None:
        raise InputError(f"{where}: {channel.topic} has messages of type {channel.kind}; {topic} needs {about.kind}")
    joints = channel.names
    if names:
        back = {theirs: ours for ours, theirs in names.items()}
        absent = [theirs for theirs in back if theirs not in joints]
        if absent:
            raise InputError(
                f"{where}: {channel.topic} has no joint {absent[0]!r}; it has {', '.join(joints) or 'none'}"
            )
        chosen = [index for index, joint in enumerate(joints) if joint in back]
        columns = {field: v[:, chosen] if v.shape[1] == len(joints) else v for field, v in columns.items()}
        joints = tuple(back[joints[index]] for index in chosen)
    frame = about.frame_id or channel.frame_id
    child = about.child_frame_id or channel.child_frame_id
    return Channel(topic, about.kind, channel.stamp, channel.received, columns, frame, joints, child)


def _columns(kind: str, channel: Channel) -> Mapping[str, np.ndarray[Any, Any]] | None:
    """The fields of a type from the messages of a channel; None if these do not say them."""
    if channel.kind == kind:
        return channel.columns
    if kind == _TWIST_WITH_COVARIANCE and channel.kind == _TWIST:
        return {**channel.columns, "covariance": np.zeros((len(channel), 36))}
    if kind == _TWIST_WITH_COVARIANCE and channel.kind == "nav_msgs/msg/Odometry":
        motion = {field: channel.columns[field] for field in ("linear", "angular")}
        return {**motion, "covariance": channel.columns["twist_covariance"]}
    if kind == _TWIST and channel.kind == _TWIST_WITH_COVARIANCE:
        return {field: channel.columns[field] for field in ("linear", "angular")}
    return None
