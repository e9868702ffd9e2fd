"""What sensors, drives, filters and devices can reach, before and after they are bought: accuracy of sensors,
observability of a drive, faults of sensors, gain of an accelerator.
"""
