"""Checks of recordings and live streams: what contradicts what, who is wrong, and what would mend it.

Each check gives findings as typed values (`finding.Finding`); `sentences` puts them into words. `examination.findings`
runs all checks on a recording, `inspect.inspect` describes its topics as well, `mending` repairs it, and `watch` looks
at what a driver receives. The checks know messages alone, neither cars nor filters.
"""
