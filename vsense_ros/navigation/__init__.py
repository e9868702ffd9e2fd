"""GNSS/INS filters after Leung 2010 and beyond, one file each: heading, velocity and side slip from a cheap receiver.

A filter here is a state space whose states, inputs, parameters and measurements have names of one vocabulary
(`readings.py`, `car_numbers.py`): by these names it is given readings of the sensors of a vehicle file, numbers of the
car, and a start. What it does with them it has from `vsense_ros/estimation`.
"""
