"""What a check finds, as values: which signal is wrong, how, why, how sure that is, and what would mend it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from enum import Enum, StrEnum, auto

import numpy as np
from numpy.typing import NDArray

from vsense_ros.checks.reason import Reason
from vsense_ros.messages.recording import Channel

Array = NDArray[np.float64]
Matrix = tuple[tuple[float, ...], ...]


class Kind(StrEnum):
    """What is wrong with a signal."""

    SIGN = auto()
    AXES = auto()
    UNIT = auto()
    LAG = auto()
    HELD = auto()
    JUMP = auto()
    QUANTISED = auto()
    CLOCK = auto()
    FRAME = auto()
    DUPLICATES = auto()
    ORDER = auto()
    GAP = auto()
    CUT = auto()
    FROZEN = auto()
    MISSING = auto()
    FAILED = auto()  # a check itself


class Confidence(Enum):
    """How sure it is that the topic of a finding is the wrong one."""

    CERTAIN = auto()  # no car, or no sensor, gives such values
    LIKELY = auto()  # it contradicts most of the others
    UNDECIDED = auto()  # it contradicts another one, and there is no third to decide


@dataclass(frozen=True)
class Scale:
    """Multiply one `column`, or all of a `field`, by `factor`, which takes the unit `given` to the unit `expected`."""

    field: str
    factor: float
    column: str = ""
    given: str = ""
    expected: str = ""

    def apply(self, channel: Channel) -> Channel:
        """The channel with its values multiplied."""
        values = channel.columns[self.field]
        factors = np.full(values.shape[1], self.factor)
        if self.column:
            factors = np.where([name == self.column for name in channel.names], self.factor, 1.0)
        return replace(channel, columns={**channel.columns, self.field: values * factors})


@dataclass(frozen=True)
class Turn:
    """Exchange and reverse the axes of vector `fields`: new = `matrix` · old, (3, 3) with one ±1 in each row."""

    fields: tuple[str, ...]
    matrix: Matrix

    def apply(self, channel: Channel) -> Channel:
        """The channel with its vectors turned; what is absent (NaN) stays so on the axis it comes to."""
        matrix = np.array(self.matrix)
        source = np.argmax(np.abs(matrix), axis=1)
        signs = matrix[np.arange(len(matrix)), source]
        turned = {name: channel.columns[name][:, source] * signs for name in self.fields}
        for name in self.fields:
            own = f"{name}_covariance"
            covariance = own if own in channel.columns else "covariance"
            if covariance in channel.columns and channel.columns[covariance].shape[1]:
                turned[covariance] = self._covariance(channel.columns[covariance])
        return replace(channel, columns={**channel.columns, **turned})

    def _covariance(self, values: Array) -> Array:
        """Covariances (rows, n²) of a vector, or of a velocity that comes first in them, in the new axes; what marks
        a vector as absent (-1 as the first) stays."""
        size = round(values.shape[1] ** 0.5)
        matrix = np.array(self.matrix)
        source, signs = np.arange(size), np.ones(size)
        source[:3] = np.argmax(np.abs(matrix), axis=1)
        signs[:3] = matrix[np.arange(3), source[:3]]
        turned = values.reshape(-1, size, size)[:, source][:, :, source] * np.outer(signs, signs)
        turned = turned.reshape(values.shape)
        return np.where(values[:, :1] == -1, values, turned)


@dataclass(frozen=True)
class Rename:
    """Call joints by other `names`: pairs of the old and the new one."""

    names: tuple[tuple[str, str], ...]

    def apply(self, channel: Channel) -> Channel:
        """The channel with its joints renamed."""
        new = dict(self.names)
        return replace(channel, names=tuple(new.get(name, name) for name in channel.names))


@dataclass(frozen=True)
class Exchange:
    """Exchange the columns of two `fields`, as latitude and longitude."""

    fields: tuple[str, str]

    def apply(self, channel: Channel) -> Channel:
        """The channel with the two fields exchanged."""
        one, other = self.fields
        columns = dict(channel.columns)
        columns[one], columns[other] = columns[other], columns[one]
        return replace(channel, columns=columns)


Transformation = Scale | Turn | Rename | Exchange


@dataclass(frozen=True)
class Finding:
    """One thing that cannot be right.

    `topic` and `signal` (a field and a component, or a joint; empty for all of the topic) are taken to be wrong in the
    way `kind`, because of `reason`. `against` is the signal or topic that they contradict, and `span` the time
    [s since the start of the recording]. `evidence` has the numbers, in SI units, `names` the texts that the sentence
    shows, `mend` the transformation of the topic's values that would put them right.
    """

    topic: str
    kind: Kind
    reason: Reason
    signal: str = ""
    against: str = ""
    confidence: Confidence = Confidence.LIKELY
    span: tuple[float, float] | None = None
    evidence: Mapping[str, float] = field(default_factory=dict)
    names: Mapping[str, str] = field(default_factory=dict)
    mend: Transformation | None = None
