"""Recordings in which what is wrong is put right, where findings say how; only if somebody asks for it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from vsense_ros.checks.examination import OF_UNITS, run
from vsense_ros.checks.finding import Finding
from vsense_ros.checks.orientation import orientation
from vsense_ros.checks.roles import USUAL_TOPICS, Topics
from vsense_ros.checks.sentences import mend_in_words
from vsense_ros.checks.subject import Subject
from vsense_ros.messages.recording import Recording


def mends(recording: Recording, topics: Topics = USUAL_TOPICS, radius: float | None = None) -> list[Finding]:
    """The findings of units, signs and axes that have a transformation which would mend the recording, in the order in
    which these are to be applied; the rolling `radius` [m] is that of the car, if it is known."""
    units = [finding for finding in run(OF_UNITS, Subject(recording, topics, radius)) if finding.mend is not None]
    axes = run((orientation,), Subject(mended(recording, units), topics, radius))
    return [*units, *(finding for finding in axes if finding.mend is not None)]


def mended(recording: Recording, findings: Sequence[Finding]) -> Recording:
    """The recording with the transformations of findings applied, and notes that say so."""
    channels = dict(recording.channels)
    for finding in findings:
        if finding.mend is not None:
            channels[finding.topic] = finding.mend.apply(channels[finding.topic])
    notes = tuple(f"mended: {mend_in_words(finding)}" for finding in findings if finding.mend is not None)
    return replace(recording, channels=channels, notes=(*recording.notes, *notes))
