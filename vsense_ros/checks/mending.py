"""What would put a recording right that is wrong in its units, axes or signs."""

from __future__ import annotations

from vsense_ros.checks.conventions import decided
from vsense_ros.checks.correcting import mended
from vsense_ros.checks.examination import OF_UNITS, run
from vsense_ros.checks.finding import Finding, Kind
from vsense_ros.checks.roles import USUAL_TOPICS, Topics
from vsense_ros.checks.subject import Subject
from vsense_ros.messages.recording import Recording


def mends(recording: Recording, topics: Topics = USUAL_TOPICS, radius: float | None = None) -> list[Finding]:
    """The findings of units, signs and axes that have a transformation which would mend the recording, in the order in
    which these are to be applied; the rolling `radius` [m] is that of the car, if it is known.

    Axes and signs are mended only if nothing of them is wrong afterwards.
    """
    subject = Subject(recording, topics, radius)
    units = [finding for finding in run(OF_UNITS, subject) if _is_of_a_unit(finding)]
    units += [finding for finding in subject.frame_findings if _is_of_a_unit(finding)]
    without = mended(recording, units)
    return [*units, *(finding for finding in decided(Subject(without, topics, radius)) if finding.mend)]


def _is_of_a_unit(finding: Finding) -> bool:
    return finding.mend is not None and finding.kind is Kind.UNIT
