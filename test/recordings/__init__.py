"""Recordings as people have them: cases that failed once, faults planted in generated drives, and every format."""
