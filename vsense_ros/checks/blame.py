"""Who is wrong, where several measure the same thing and some contradict others."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import combinations

Pairs = Mapping[tuple[str, str], bool]  # whether two sources agree; pairs that cannot be compared are left out


@dataclass(frozen=True)
class Blame:
    """Sources that are wrong by every simplest explanation of what contradicts what, and those that are wrong by some
    of these but not by all: one or another of them is."""

    wrong: tuple[str, ...]
    undecided: tuple[str, ...]


def who_is_wrong(pairs: Pairs, trust: Mapping[str, float], *, reversed_signs: bool = False) -> Blame:
    """The smallest set of wrong sources that explains which pairs agree.

    A wrong source contradicts those that are right. Two wrong ones may or may not agree; where what is wrong is a sign
    (`reversed_signs`) they do. The best explanation leaves the fewest pairs unexplained, and of those calls the sources
    wrong that are trusted least in sum; a contradiction among the sources that are right is left only where it is one
    of signs.
    """
    sources = tuple(dict.fromkeys(source for pair in pairs for source in pair))
    contradiction = 1 if reversed_signs else len(pairs) + 1

    def cost(wrong: tuple[str, ...]) -> tuple[int, float]:
        unexplained = 0
        for (one, other), agree in pairs.items():
            count = (one in wrong) + (other in wrong)
            if agree:
                unexplained += count == 1 or (count == 2 and not reversed_signs)
            elif count == 0:
                unexplained += contradiction
            elif count == 2:
                unexplained += reversed_signs
        return unexplained, round(sum(trust.get(source, 1.0) for source in wrong), 9)

    sets = [wrong for count in range(len(sources) + 1) for wrong in combinations(sources, count)]
    costs = {wrong: cost(wrong) for wrong in sets}
    best = [wrong for wrong, value in costs.items() if value == min(costs.values())]
    return Blame(
        wrong=tuple(source for source in sources if all(source in wrong for wrong in best)),
        undecided=tuple(
            source
            for source in sources
            if any(source in wrong for wrong in best) and not all(source in w for w in best)
        ),
    )
