"""Bytes of buses and serial sensors to `Sample`s, with integrity checks; no ROS.

One file per protocol. Every decoder has the same two methods: `feed(...) -> list[Sample]`, which never raises on bad
bytes, and `diagnostics(now) -> list[Diagnostic]`, which says what was wrong with them.
"""
