"""How far the search for effects goes."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class SearchSettings:
    """How far the search for effects goes: decisions of this project, between computing time and completeness."""

    # candidates by their gain, as many by their cross-validation gain, and as many without their best window
    shortlist: int = 4
    # [-] of a profile (a size for every place of the road) beyond that of one size for all places
    least_profile_gain: float = 0.06
    # [-] of the best score, below which no profile is fitted: it has a parameter for each place
    promising_share: float = 0.5
    # Least gains that a single effect promises by the linear model where the evidence finds nothing: cars with nothing
    # hidden promise at most one.
    clear_promise: float = 2.0
    trace: float = 1e-6  # [deviations] by which a likely size changes something that was recorded, beyond rounding
    secant: float = 1.0  # [likely offsets]: some effects have no slope at zero
    paired: int = 8  # single hypotheses of which all pairs are tried
    beam: int = 3  # hypotheses to which a further effect is added, and further effects that are tried with each
    most_effects: int = 6  # at once
    shares: tuple[float, ...] = (1.0, 0.5, 0.2)  # of the way to the likeliest unknowns that are tried
    least_likely: float = 5.0  # [-] logarithm of the odds from which on another set is fitted, too
    unlikely: float = 1e-5  # [-] probability of a set whose sizes are not made linear again
    rounds: int = 4  # in which the evidence proposes a set, and is judged where that is likeliest
    linear_again: float = 600.0  # [s] of driving for which all effects are made linear again, in all rounds together
    shaped_gain: float = 0.03  # [-] of an effect from where on its shape can be seen
    # Least gain of hypotheses that are fitted again with secants of their own: where base parameters stand in
    # for an effect, it takes several fits to undo that.
    refined_gain: float = 0.01
    places_apart: int = 6  # from one to the next of the places that are changed together
    # of a profile up to which explanations are refined: on 76, on two laps, that doubled the computing
    few_places: int = 40
    # [-] of the cost by which base parameters fit better elsewhere if their fit stopped short
    stuck_share: float = 0.02
    stored_from: int = 4_000_000  # [byte] of slopes of an explanation, from where on they are kept in a file
    terms_tried: int = 3  # terms that are fitted in full
    # [-] deviation of a size that was named, over its fitted value, with which the prior hardly shrinks it
    unshrunk_ratio: float = 2.0


EFFORT = SearchSettings()
