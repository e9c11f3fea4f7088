"""Between which two results the median of all seeds lies, whatever the measure's distribution.

Of n independent draws in order, the median of what they are drawn from lies between the l-th and the l-th from the end with a
chance of at least 1 - 2 P(B < l), B the number of heads of n fair coins: W. J. Conover, Practical Nonparametric Statistics, 3rd
ed. (1999), section 3.2; H. A. David, H. N. Nagaraja, Order Statistics, 3rd ed. (2003), section 7.1. The sums are exact."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction

LEVEL = Fraction(95, 100)
_GROWTH = Fraction(3, 2)  # of the number of runs, from one look to the next


def rank(count: int, doubt: Fraction = 1 - LEVEL) -> int:
    """The greatest l for which the interval from the l-th to the l-th from the end misses the median with a chance of `doubt` at
    most; 0 where `count` draws are too few."""
    least, below = 0, 0
    while 2 * (below + math.comb(count, least)) <= doubt * 2**count:
        below += math.comb(count, least)
        least += 1
    return min(least, (count + 1) // 2)


def interval(values: Sequence[float], doubt: Fraction = 1 - LEVEL) -> tuple[float, float] | None:
    """The two results between which the median lies; None of too few. An infinite one has never happened."""
    place = rank(len(values), doubt)
    if not place:
        return None
    there = sorted(values)
    return there[place - 1], there[-place]


@dataclass(frozen=True, slots=True)
class Looks:
    """After how many runs the interval is looked at, and the doubt that each look is allowed: looking again and again until it
    is narrow would miss the median more often than one look does, so all looks share what may be missed (Bonferroni)."""

    after: tuple[int, ...]
    doubt: Fraction


def looks(most: int) -> Looks | None:
    """Looks at half as many runs more each time, up to `most`; None where so few runs can tell nothing."""
    for count in range(1, most + 1):
        doubt = (1 - LEVEL) / count
        least = next((n for n in range(1, most + 1) if rank(n, doubt)), None)
        if least is None:
            return None
        after = [least]
        while after[-1] < most:
            after.append(min(math.ceil(after[-1] * _GROWTH), most))
        if len(after) <= count:
            return Looks(tuple(after), (1 - LEVEL) / len(after))
    return None


def least_runs() -> int:
    """The fewest runs of which a sweep can know a median."""
    return next(n for n in range(1, 100) if looks(n) is not None)
