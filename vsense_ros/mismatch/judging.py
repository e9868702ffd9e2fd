"""From proposed sets of effects to a verdict: what is fitted besides depends on what the verdict is not sure of."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from vsense_ros.mismatch.hypothesis import Hypothesis
from vsense_ros.mismatch.search import Search, is_trusted
from vsense_ros.mismatch.search_settings import EFFORT
from vsense_ros.mismatch.thresholds import THRESHOLDS
from vsense_ros.mismatch.validation import Validation
from vsense_ros.mismatch.verdict import Judged, judge


def judged_with_further(search: Search, proposed: list[Hypothesis], validation: Validation, threshold: float) -> Judged:
    """The verdict on the sets that the evidence proposes; where it is not sure of them, on single effects and what
    explains more with further ones as well; and on terms without known physics where something is left."""
    prepare = validation.comparisons.prepare
    prepare(proposed)
    provable = list(filter(validation.comparisons.can_prove, proposed))
    least = max(threshold, THRESHOLDS.least_gain)
    promising = [e for e in provable if validation.proven(e) > least]
    every = [*proposed, *search.reduced(promising, validation.proven, prepare)]
    likely = [e for e in every if len(e.effects) == 1 or is_trusted(e)]
    doubtful = [e for e in provable if not is_trusted(e)]
    hypotheses = [*likely, *_as_good(doubtful, likely, validation.proven)] or every
    described: list[Hypothesis] = []

    def verdict(hypotheses: Sequence[Hypothesis]) -> Judged:
        return judge(
            hypotheses, described, validation, search.with_profile, threshold, improbable=search.improbable
        )  # fmt: skip

    judged = verdict(hypotheses)
    named = judged.verdict == "named" and not judged.partial
    begin, rounds = [judged.leader] if named and judged.leader is not None else [], 1
    worth_trying = promising or validation.something_unexplained() or search.promised > EFFORT.clear_promise * least
    if not named and worth_trying:
        begin, rounds = search.single(), EFFORT.most_effects
        prepare(begin)
        hypotheses += begin
    if begin and (not named or search.leaves_something(begin[0].fit)):
        further = _with_further(search, begin, validation, threshold, rounds)
        hypotheses += [*further, *_without_earlier(search, further, hypotheses, validation, least)]
        judged = verdict(hypotheses)
    if search.leaves_something(judged.leader.fit if judged.leader is not None else search.base):
        described = search.described()
        prepare(described)
        judged = verdict(hypotheses)
    if judged.in_doubt:
        joint = search.joint(judged.in_doubt)
        prepare(joint)
        judged = verdict([*hypotheses, *joint])
    return judged


def _as_good(
    doubtful: Sequence[Hypothesis], likely: Sequence[Hypothesis], proven: Callable[[Hypothesis], float]
) -> list[Hypothesis]:
    """Those of the doubtful sets that prove as much as a likely one in which one effect is another: slopes say that
    they are unlikely, and the fit does not."""

    def rival(e: Hypothesis, one: Hypothesis) -> bool:
        shared = set(e.effects) & set(one.effects)
        return len(shared) + 1 == len(e.effects) == len(one.effects) and proven(e) >= proven(one)

    return [e for e in doubtful if any(rival(e, one) for one in likely)]


def _with_further(
    search: Search,
    begin: Sequence[Hypothesis],
    validation: Validation,
    threshold: float,
    rounds: int = EFFORT.most_effects,
) -> list[Hypothesis]:
    """Hypotheses with one more effect than those to begin with, and so on for some `rounds`, as long as that promises
    to explain more, and the last one did."""
    least, unseen = max(threshold, THRESHOLDS.least_gain), bool(validation.recordings)
    found: list[Hypothesis] = []
    newest = list(begin)
    most = max(map(validation.proven, begin), default=0.0)
    for _ in range(rounds):
        if not (newest := search.further(newest, least, validation.proven, unseen)):
            break
        validation.comparisons.prepare(newest)
        found += newest
        before, most = most, max(map(validation.proven, newest))
        if most - before <= least * max(1 - before, search.least_whole):
            break
    return found


def _without_earlier(
    search: Search, further: Sequence[Hypothesis], known: Sequence[Hypothesis], validation: Validation, least: float
) -> list[Hypothesis]:
    """The best of the hypotheses with a further effect without each of its other effects, where that is not known and
    it proves a share `least` more of what is left than the known ones: the further effect may be what another one stood
    in for."""
    best = max(further, key=validation.proven, default=None)
    if best is None or len(best.effects) < 3:
        return []
    proven = max(map(validation.proven, known), default=0.0)
    if validation.proven(best) - proven <= least * max(1 - proven, search.least_whole):
        return []
    fitted = search.without_each(best, {frozenset(e.effects) for e in (*known, *further)})
    validation.comparisons.prepare(fitted)
    return fitted


def with_final_sizes(search: Search, judged: Judged, validation: Validation) -> tuple[Judged, str]:
    """The verdict with the sizes of the leader fitted once more, hardly drawn to zero any longer, if it is then still
    proven; or with another size at every place of the road, if that predicts better. If it does not predict better, but
    brings the worst signal near a good model, also the name of that signal."""
    if judged.leader is None:
        return judged, ""
    off = validation.unmended(judged.leader)
    varied = search.with_profile(judged.leader) if off else None
    unshrunk = search.fitting.unshrunk(judged.leader)
    if validation.lasting(unshrunk) > 0:
        judged = _led_by(judged, unshrunk, validation)
    if varied is None or judged.leader is None:
        return judged, ""
    if validation.lasting(varied) > validation.lasting(judged.leader):
        return _led_by(judged, varied, validation), ""
    return judged, off


def _led_by(judged: Judged, leader: Hypothesis, validation: Validation) -> Judged:
    """The verdict with another fit of the leader, unless that one would make names doubtful which are not."""
    led = judged.led_by(leader, validation)
    return judged if set(led.doubted) > set(judged.doubted) else led


def describing(search: Search, judged: Judged, validation: Validation) -> Hypothesis | None:
    """What describes best what is left over besides a partial answer, if that explains enough of it."""
    if not judged.partial or judged.leader is None or judged.verdict != "named":
        return None
    known, least = validation.proven(judged.leader), THRESHOLDS.least_term_gain
    best = max(search.described(judged.leader), key=validation.proven, default=None)
    if best is None or validation.proven(best) - known < least * max(1 - known, search.least_whole):
        return None
    return best
