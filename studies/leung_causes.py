"""Why some figures of Leung 2010 come out elsewhere here, each shown by an experiment that changes one thing."""

from __future__ import annotations

from studies.leung_verdict import Cause

CAUSES: list[Cause] = []
