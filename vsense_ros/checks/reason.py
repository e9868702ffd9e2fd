"""Why a signal is taken to be wrong, each with the sentence that says so after the name of the topic.

The sentences are formats, which `sentences` fills in: `signal` and `against` in words, `begin` and `duration` [s] of
the time span, the evidence and names of the finding.
"""

from __future__ import annotations

from enum import Enum

_NOT_THE_CHANGE = "is not the change of {against}: "
_FROZEN = "{signal} is frozen for {duration:.1f} s from {begin:.1f} s on"


class Reason(Enum):
    """Why a signal is taken to be wrong."""

    # units and sizes
    FORCE_IN_G = "specific force looks like g, expected m/s²: its mean is 1"
    NO_GRAVITY = "specific force has no gravity in it: expected +9.81 m/s² upwards at rest"
    FORCE_SIZE = "specific force has a mean of {size:.2f}, expected 9.81 m/s²"
    FORCES_TENTH = "the accelerations look like g, expected m/s²: they are a tenth of those of the motion"
    RATE_IN_DEGREES = "{signal} looks like deg/s, expected rad/s: it is {ratio:.1f} times {against}"
    RATE_SIZE = "{signal} is {ratio:.3f} times {against}, expected 1"
    WHEELS_UNIT = "look like {given}, expected rad/s: GNSS speed is {ratio:.4f} times their values"
    WHEELS_RADIUS = "GNSS speed is {ratio:.4f} m times their values, which is no rolling radius of a car"
    WHEELS_RADIUS_OF_FILE = (
        "GNSS speed is {ratio:.3f} m times their values, and the rolling radius of the vehicle file {known:.3f} m: "
        "other tyres, or a diameter?"
    )
    WHEEL_RATIO = "{signal} turns {ratio:.2f} times as fast as the others"
    STEERING_RANGE = "{signal} reaches {largest:.1f} rad, which no car does: is it in degrees?"
    STEERING_SIZE = "{signal} is {ratio:.0f} s times the yaw rate, which is too much for rad: is it in degrees?"
    STEERING_TURNS = (
        "{signal} would turn a usual car {ratio:.2g} times as much as this one turns: is it the angle of another part, "
        "or a share of the lock?"
    )
    POSITION_RANGE = "latitude or longitude is out of range: expected degrees"
    POSITION_ZERO = "latitude and longitude are near zero: are they radians, or is there no fix?"
    PRESSURE_SIZE = "reaches {largest:.1f} Pa only, which brakes nothing: is it in bar or kPa?"
    # signs and axes
    GRAVITY_AXIS = "gravity is on {axis}, expected +z (axes x forward, y left, z up)"
    TURN_AXIS = "the car turns on axis {axis} of the gyro, expected z (forward, left, up)"
    TURNS_AGAINST = "{signal} is against {against}: expected positive to the left"
    WHEELS_BACKWARDS = "turn backwards while GNSS moves: is the sign wrong?"
    WHEEL_SIDES = (
        "the difference of the wheels on the right and left is against {against}: are left and right exchanged?"
    )
    FORCES_REVERSED = "the IMU looks turned by 180° about z: longitudinal and lateral acceleration are both reversed"
    LATERAL_REVERSED = "{signal} is against speed times yaw rate: expected positive to the left{undecided}"
    LONGITUDINAL_REVERSED = "{signal} is against the change of speed: expected positive forward{undecided}"
    FORCES_EXCHANGED = "the axes x and y of the accelerometer are exchanged"
    FORCES_QUARTER_TURN = "the IMU looks turned by 90° about z"
    FORCES_EXCHANGED_REVERSED = "the axes x and y of the accelerometer are exchanged and reversed"
    SENSOR_TURNED = "the sensor is turned{convention}"
    FORCES_ALL_REVERSED = "the accelerometer is reversed on all axes, as phones and some loggers have it"
    CONVENTION_UNDECIDED = (
        "contradicts {others}: another convention of {one} would explain it, and of {other} as well: correct the one "
        "that is wrong in the mapping of the import, or in its driver"
    )
    LONGITUDE_REVERSED = "longitude is positive to the west, expected to the east"
    LATITUDE_REVERSED = "latitude is positive to the south, expected to the north"
    FORCE_AXES_TURNED = "the axes of the accelerometers are turned"
    FORCE_AXES_EXCHANGED = "the axes of the accelerometers are exchanged or reversed"
    RATE_AXES = "the axes of the gyros are turned or reversed"
    # frames of GNSS
    VELOCITY_IN_CAR_AXES = (
        _NOT_THE_CHANGE + "it looks like the axes of the car (forward, left), expected east, north, up"
    )
    VELOCITY_EXCHANGED = _NOT_THE_CHANGE + "east and north are exchanged"
    VELOCITY_EAST_REVERSED = _NOT_THE_CHANGE + "its east has the opposite sign"
    VELOCITY_NORTH_REVERSED = _NOT_THE_CHANGE + "its north has the opposite sign"
    VELOCITY_REVERSED = _NOT_THE_CHANGE + "both its components have the opposite sign"
    VELOCITY_QUARTER_TURN = _NOT_THE_CHANGE + "it is turned by 90°"
    VELOCITY_UNIT = _NOT_THE_CHANGE + "it looks like {given}, expected m/s"
    VELOCITY_SIZE = _NOT_THE_CHANGE + "it is {ratio:.2f} times as fast"
    VELOCITY_APART = (
        _NOT_THE_CHANGE + "they are {apart:.1f} m/s apart (median); body axes, or east and north exchanged?"
    )
    POSITION_EXCHANGED = "latitude and longitude are exchanged: its change is not {against}"
    POSITION_AGAINST_YAW_RATE = (
        "its change is not {against}, with whose course the yaw rate agrees: latitude and longitude exchanged, or a "
        "sign of theirs?"
    )
    COURSE_AGAINST = "its course turns against {against}: east and north exchanged?"
    POSITION_COURSE_AGAINST = "its course turns against {against}: latitude and longitude exchanged?"
    COURSE_STAYS = "its course stays 0 while the car turns: it looks like the axes of the car, expected east, north, up"
    # values
    SIGNAL_JUMPS = "{signal} jumps by {change:+.3g} at {begin:.2f} s"
    SIGNAL_JUMPS_OFTEN = SIGNAL_JUMPS + ", {count:.0f} times in all"
    POSITION_JUMPS = "the position jumps by {distance:.1f} m at {begin:.2f} s, at {speed:.1f} m/s"
    POSITION_STEPS = "the position steps by {step:.1f} m at {begin:.1f} s against the velocity"
    COARSE = "{signal} has steps of {step:.3g}{unit}, which is coarse"
    COARSE_LIKEWISE = COARSE + ", likewise {also}"
    REPEATED_VALUES = (
        "each value stands in {rows:.0f} messages: {sent:.4g} Hz hold what is measured at {measured:.4g} Hz"
    )
    VALUE_STANDS = _FROZEN
    STEERING_STANDS = _FROZEN + ": the car turns otherwise meanwhile"
    NOT_A_NUMBER = "{signal} is NaN in {count:.0f} of {rows:.0f} messages"
    # clocks
    LATE = "lies {behind}: is its clock or its latency wrong?"
    LATE_OR_OTHER = "lies {behind}: which of the clocks is wrong?"
    GAINS_LATE = "{signal} lies {behind}: is it smoothed, or its clock wrong?"
    POSITION_LATE = "lies {behind}: is a clock or a latency wrong?"
    POSITION_OR_VELOCITY_LATE = "lies {behind}: which of the two is wrong?"
    NO_COMMON_TIME = "has no time in common with the other topics: {distance:.1f} s away from them"
    NO_COMMON_TIME_WITH = "has no time in common with {against}"
    CLOCK_LATER = "begins and ends {apart:.1f} s later than the others: is its clock another one?"
    CLOCK_EARLIER = "begins and ends {apart:.1f} s earlier than the others: is its clock another one?"
    CLOCK_STEPS = "its clock steps by {change:+.2f} s at {begin:.2f} s, against the arrival"
    CLOCK_SLOWER = "its clock runs {rate:.2%} slower than that of the arrivals"
    CLOCK_FASTER = "its clock runs {rate:.2%} faster than that of the arrivals"
    CLOCK_JUMPS = "the clock jumps by {change:+.1f} s at {begin:.2f} s"
    STAMPS_OLD = "time stamps are {latency:.3f} s older than the arrival (median): is a clock wrong?"
    ENDS_EARLY = "ends {apart:.1f} s before the others"
    BEGINS_LATE = "begins {apart:.1f} s after the others"
    # the reference
    REFERENCE_SPEED = (
        "its speed is {ratio:.3g} times the change of its position, expected 1: is it in another unit than m/s?"
    )
    REFERENCE_AXES = "its velocity, turned by its heading, is not the change of its position: it looks as if {actual}"
    REFERENCE_UNLIKE = "its velocity, turned by its heading, is not the change of its position"
    REFERENCE_ANGLE = (
        "its velocity, turned by its heading, points {angle:+.0f}° beside the change of its position: is the heading "
        "that from north, or that of another axis than the car's?"
    )
    REFERENCE_YAW_RATE = (
        "its yaw rate is {ratio:.3g} times the change of its heading, expected 1 (rad/s, positive to the left)"
    )
    REFERENCE_SPEED_BY_GNSS = "its speed is {ratio:.3g} times that of {against}, expected 1"
    REFERENCE_LATE = "lies {behind}: the comparison charges that to the estimates; is its clock another one?"
    # messages
    COPIES = "{count:.0f} messages come a second time with the time stamp of an earlier one"
    SAME_STAMP = "{count:.0f} messages have the time stamp of the one before them"
    OLDER_THAN_LAST = "{count:.0f} messages are older than the one before them"
    GAPS = "{count:.0f} gaps, the longest {duration:.2f} s at {begin:.2f} s"
    MESSAGES_LOST = "{count:.0f} messages are lost; the notes say where"
    DAMAGED = "{damage}"
    NO_KNOWN_TOPIC = "has none of the topics that are read here: it has {topics}"
    TOPIC_UNKNOWN = "no topic of this project: nothing reads it, unless a mapping says what it is"
    TYPE_UNEXPECTED = "type is {actual}, expected {expected}"
    FRAME_UNEXPECTED = "{what} is '{actual}', expected '{expected}'"
    NAMES_UNKNOWN = "names {actual} are unknown, expected {expected}"
    CHECK_FAILED = "the check {check} failed: {error}"
