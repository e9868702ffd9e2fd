"""When an axis of an inertial sensor counts as wrong, and when it is believed again.

The limits were chosen on the committed bags and on the recordings of a Genesis and a RAV4, such that no axis is left
out where nothing is wrong, and every fault of `vsense faults` is named before it moves the lateral velocity by 0.3 m/s.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class VoteSettings:
    """Times are in ns, as stamps are; sums of whitened innovations in their standard deviations."""

    # A jump: refusals in a row, or a sum of one or two blocks.
    refused_for: int = 20_000_000  # [ns] of refusals in a row, and
    refusals: int = 3  # at least so many, after which an axis has jumped: no single outlier does that
    streak: int = 50_000_000  # [ns] after which a refusal does not belong to those before
    block: int = 20_000_000  # [ns] in which innovations are summed
    rows: int = 128  # messages in a block at most
    memory: int = 20_000_000_000  # [ns] over which the mean square of sums is averaged
    unusual: float = 4.0  # [-] times the usual square, beyond which a sum counts no more in that
    jump: float = 9.5  # [-] sum of one block or two: the axis has jumped away from what all others measure
    # [ns] of refusals, after which an axis that is still confirmed is used: as long as the course is that confirms it,
    # so that it turned as the axis said while this was refused, and not before.
    confirmed: int = 500_000_000
    redone_after_jump: int = 200_000_000  # [ns] that are filtered again without the axis then

    # An alarm: a sum of 0.2 s or 1 s, or a sensor that is refused at large.
    alarm: float = 4.5  # [-]
    alarm_of_conditions: float = 15.0  # [-] of what is required of the motion at each reading, which is no white noise
    calm: float = 3.0  # [-] mean normalized innovation squared per component of a sensor that agrees
    loud: float = 6.0  # [-] the same, within a second, that is an alarm
    settled: int = 2_000_000_000  # [ns] from the start without a vote: what nobody knows yet is not one axis's fault
    unsettled: float = 0.15  # [m/s] of lateral velocity that is not known while there is an alarm then

    # A vote.
    first_pause: int = 100_000_000  # [ns] from a vote that decided nothing to the next one; twice as long each time, up
    last_pause: int = 1_000_000_000  # [ns] to this
    urgent: int = 1_000_000_000  # [ns] after the alarm, from which on pauses grow
    before: int = 200_000_000  # [ns] before the alarm, from which on measurements are filtered again
    look_back: int = 2_000_000_000  # [ns] that this is at most
    gain: float = 90.0  # [-] twice a logarithm of likelihoods: evidence of more than 10¹⁹ to 1
    second: float = 0.25  # [-] of the gain, at least, that is not of the one component that gains most
    own: float = 7.0  # [-] an axis's own sum of 0.2 s, with which …
    gain_with_own: float = 15.0  # [-] … this gain is enough
    worth_a_vote: float = 0.0  # [-] gain of leaving out a whole sensor, below which its axes are not tried
    disagree: float = 3.5  # [-] mean square of whitened innovations of a sensor that does not agree with the others
    nearly: float = 0.35  # [-] share of the largest gain, from which on another axis may be the wrong one
    suspect: float = 30.0  # [-] gain from which on an axis is asked about again soon
    # [-] share of what an axis read beyond its noise, at most, that is left where another sensor is what was wrong
    unexplained: float = 0.5
    largest_square: float = 36.0  # [-] of a whitened innovation, beyond which it counts no more

    # An appeal of an axis that is out.
    appeals_again: float = 1.5  # [-] times as long after it was left out as the last time
    appealing: int = 2  # [-] axes of a sensor that are out at once, of more of which none may appeal
    appealed: int = 1_000_000_000  # [ns] that are filtered again then, at most
    usual_once_acquitted: float = 3.0  # [-] usual deviations that its sums had when it was left out
    # [-] stated deviations that are usual after an acquittal, at most: an axis of the wrong sign is off by tens of them
    usual_at_most: float = 4.0

    # No noise.
    frozen: int = 20  # equal values in a row, of an axis that has noise
    looks: int = 10  # values from one look for frozen axes to the next
    lively: float = 0.2  # [-] share of values that equal the one before, up to which an axis has noise
    share: float = 0.03  # [-] weight of the newest such share in their mean

    # Return of an axis that is left out.
    asked: int = 10_000_000  # [ns] from one innovation of the axis to the next
    same: int = 10  # times that it may repeat its value
    step: float = 6.0  # [-] standard deviations of its noise, within which it moves on from where it stood
    moved: int = 10  # times that it has to be elsewhere then
    agreed: int = 1_000_000_000  # [ns] that it has to agree the first time; twice as long each time, up
    longest: int = 60_000_000_000  # [ns] to this
    agrees: float = 4.0  # [-] mean normalized innovation squared meanwhile

    @property
    def remembered(self) -> float:
        """How far a timeline has to be able to go back [s]: a vote, with a margin for the distance of checkpoints."""
        return 1.25 * self.look_back * 1e-9


@dataclass(frozen=True)
class SteeringSettings:
    """What is known of a steering angle that is not believed: decisions of this project. Times are in ns."""

    density: float = 0.04  # [rad²/s] by which the variance of the road-wheel angle grows: 0.2 rad in a second
    # [m²/s⁵] by which that of the lateral acceleration grows at most while no angle comes: the linear model
    # would otherwise turn faster than tyres let a car turn, by angles of which no first order knows anything.
    lateral_density: float = 25.0
    period: int = 50_000_000  # [ns] in which it does
    periods: float = 5.0  # [-] periods of the sensor in which no angle came, after which the driver may have steered
    unheard: int = 100_000_000  # [ns] without any measurement, in which a driver may have steered
    unknown: int = 1_000_000_000  # [ns] in which it may have come to be what it is, where none came since the start
    before: int = 100_000_000  # [ns] before the contradiction, from which on the angle is not believed
    undecided: int = 500_000_000  # [ns] in which an angle that jumped is not believed yet
    kept: int = 64  # [-] newest angles that may be held
    doubtful: int = 5_000_000_000  # [ns] before, from which on axes were left out that may have been right


VOTE = VoteSettings()
STEERING = SteeringSettings()
