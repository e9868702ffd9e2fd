"""Recordings in which what is wrong is put right, where findings say how; only if somebody asks for it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from vsense_ros.checks.finding import Finding
from vsense_ros.checks.sentences import mend_in_words
from vsense_ros.messages.recording import Recording


def mended(recording: Recording, findings: Sequence[Finding]) -> Recording:
    """The recording with the transformations of findings applied, and notes that say so."""
    channels = dict(recording.channels)
    for finding in findings:
        if finding.mend is not None:
            channels[finding.topic] = finding.mend.apply(channels[finding.topic])
    notes = tuple(f"mended: {mend_in_words(finding)}" for finding in findings if finding.mend is not None)
    return replace(recording, channels=channels, notes=(*recording.notes, *notes))
