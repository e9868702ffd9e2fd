"""Samples of the outputs of a CAN mapping: one frame after the other fills what all of them have in common."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from vsense_ros.driver import samples
from vsense_ros.driver.can_mapping import ImuOutput, JointStateOutput
from vsense_ros.driver.can_motion import MotionBase
from vsense_ros.messages.recording import Sample

# A sample of values in a fixed order, with its stamp and its arrival [ns].
InOrder = Callable[[tuple[float, ...], int, int], Sample]


def motion_sample(output: MotionBase, values: dict[str, float], stamp: int, received: int) -> Sample:
    """The message of a motion at a time [ns], with its values in SI by their names."""
    columns = output.columns({name: np.array([value]) for name, value in values.items()})
    row = {name: column[0] for name, column in columns.items()}
    frame, child = output.frames
    return Sample(output.topic, output.message_kind, stamp, row, frame, child_frame_id=child, received=received)


@dataclass(frozen=True, slots=True)
class Template:
    """What all samples of one output with the same values have in common: arrays that may not be changed, and which
    values make each of the others."""

    sample: Sample
    vectors: tuple[tuple[str, tuple[str, ...]], ...]
    names: tuple[str, ...]  # of the values

    @staticmethod
    def of(output: JointStateOutput | ImuOutput, names: tuple[str, ...]) -> Template:
        """The template of an output that is made of the values with these names."""
        if isinstance(output, JointStateOutput):
            sample = samples.joint_state(output.topic, 0, output.field, dict.fromkeys(names, 0.0))
            vectors: dict[str, tuple[str, ...]] = {output.field: names}
        else:
            sample, vectors = _imu_sample(output, names)
        for array in sample.values.values():
            array.setflags(write=False)
        return Template(sample, tuple(vectors.items()), names)

    @property
    def filled_in_order(self) -> InOrder:
        """What `filled` does with all values in the order of `names`."""
        common, names = self.sample, self.names
        known, frame, joints, child = common.values, common.frame_id, common.names, common.child_frame_id
        topic, kind = common.topic, common.kind
        if len(self.vectors) == 1 and self.vectors[0][1] == names:
            field = self.vectors[0][0]

            def make(values: tuple[float, ...], stamp: int, received: int) -> Sample:
                content = {**known, field: np.array(values)}
                return Sample(topic, kind, stamp, content, frame, joints, child, received)

            return make
        order = {name: i for i, name in enumerate(names)}
        placed = []  # a vector of which nothing is measured, and its axes that are, with their places among the values
        for field, wanted in self.vectors:
            axes = [(k, order[name]) for k, name in enumerate(wanted) if name in order]
            placed.append((field, np.full(len(wanted), math.nan), axes))

        def make_vectors(values: tuple[float, ...], stamp: int, received: int) -> Sample:
            content = dict(known)
            for field, empty, axes in placed:
                content[field] = vector = empty.copy()
                for axis, place in axes:
                    vector[axis] = values[place]
            return Sample(topic, kind, stamp, content, frame, joints, child, received)

        return make_vectors

    def filled(self, values: dict[str, float], stamp: int, received: int) -> Sample:
        """A sample with these values at a time [ns]."""
        common = self.sample
        content = dict(common.values)
        for field, names in self.vectors:
            content[field] = np.array([values.get(name, math.nan) for name in names])
        return Sample(
            common.topic, common.kind, stamp, content, common.frame_id, common.names, common.child_frame_id, received
        )


def _imu_sample(output: ImuOutput, names: tuple[str, ...]) -> tuple[Sample, dict[str, tuple[str, ...]]]:
    """A sample of an inertial sensor that measures the axes with these names, and the names that make its vectors."""
    axes: dict[str, tuple[str, ...]] = {}
    fields: dict[str, Any] = {}
    deviations = {str(axis): signal.standard_deviation for axis, signal in output.axes.items() if axis in names}
    for field in ("angular_velocity", "linear_acceleration"):
        every = tuple(f"{field}_{axis}" for axis in "xyz")
        if any(name in names for name in every):
            axes[field], fields[field] = every, np.full(3, math.nan)
            fields[f"{field}_covariance"] = samples.diagonal(
                [(deviations.get(name) or 0.0) ** 2 or samples.UNMEASURED_VARIANCE for name in every]
            )
    return samples.imu(output.topic, 0, output.frame_id, **fields), axes
