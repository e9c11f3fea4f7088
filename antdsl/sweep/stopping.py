"""Decides which runs of a sweep are still needed. A variation is complete once its medians are known to the requested width.

Each decision uses the first n seeds of a variation. So the order in which runs end does not change when a variation is complete,
nor its row of the table.

The interval of a median holds for any distribution of the measure. Sort n independent draws. The distribution's median lies
between the l-th draw and the l-th from the end with a probability of at least 1 - 2 P(B < l). B is the number of heads of n fair
coins. See W. J. Conover, Practical Nonparametric Statistics, 3rd ed. (1999), section 3.2; H. A. David, H. N. Nagaraja, Order
Statistics, 3rd ed. (2003), section 7.1. The sums are exact."""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Any

from antdsl.sweep.jobs import Job
from antdsl.sweep.table import quantile

LEVEL = Fraction(95, 100)
_GROWTH = Fraction(3, 2)  # of the number of runs, from one look to the next


def interval_rank(count: int, doubt: Fraction = 1 - LEVEL) -> int:
    """Return the largest rank l of an interval from the l-th to the l-th last draw. The interval may miss the median with a
    probability of at most `doubt`. Return 0 if `count` draws are too few."""
    least, below = 0, 0
    while 2 * (below + math.comb(count, least)) <= doubt * 2**count:
        below += math.comb(count, least)
        least += 1
    return min(least, (count + 1) // 2)


def find_interval(values: Sequence[float], doubt: Fraction = 1 - LEVEL) -> tuple[float, float] | None:
    """Return the two results between which the median lies, or None for too few. An infinite result means that the event never
    happened."""
    place = interval_rank(len(values), doubt)
    if not place:
        return None
    sorted_values = sorted(values)
    return sorted_values[place - 1], sorted_values[-place]


@dataclass(frozen=True, slots=True)
class Looks:
    """The numbers of runs after which the interval is checked, and the error probability of each check.

    If the interval is checked repeatedly until it is narrow, it misses the median more often than with one check. So all checks
    share the total error probability (Bonferroni).
    """

    run_counts: tuple[int, ...]
    doubt: Fraction


def plan_looks(most: int) -> Looks | None:
    """Return checks at growing numbers of runs, each half as many again, up to `most`. Return None if `most` runs are too few."""
    for count in range(1, most + 1):
        doubt = (1 - LEVEL) / count
        least = next((n for n in range(1, most + 1) if interval_rank(n, doubt)), None)
        if least is None:
            return None
        run_counts = [least]
        while run_counts[-1] < most:
            run_counts.append(min(math.ceil(run_counts[-1] * _GROWTH), most))
        if len(run_counts) <= count:
            return Looks(tuple(run_counts), (1 - LEVEL) / len(run_counts))
    return None


def least_runs() -> int:
    """Return the fewest runs from which a sweep can estimate a median."""
    return next(n for n in range(1, 100) if plan_looks(n) is not None)


@dataclass(frozen=True, slots=True)
class WidthGoal:
    """The requested width of a median's interval.

    `measure`: the beginning of a measure's name.
    `most`: the largest width.
    `share`: whether `most` is a share of the median's size.
    """

    measure: str
    most: float
    share: bool = False

    def is_reached(self, between: tuple[float, float], median: float) -> bool:
        """Return whether an interval is as narrow as requested. `median`: the median inside it."""
        low, high = between
        if low == high:
            return True  # all the same, or never
        return high - low <= (self.most * abs(median) if self.share else self.most)


@dataclass(frozen=True, slots=True)
class KnownMedian:
    """The result for one measure of one variation: after `runs` runs, its median lies between `low` and `high`. `met`: whether
    the interval is as narrow as requested."""

    label: str
    measure: str
    runs: int
    median: float
    low: float
    high: float
    met: bool


@dataclass(slots=True)
class JobChooser:
    """All jobs that may run, ordered by seed. `needed_jobs` yields those that are needed. Without `widths`, all are needed."""

    jobs: Sequence[Job]
    widths: Sequence[WidthGoal] = ()
    _looks: Looks | None = field(init=False, default=None)
    _by_label: dict[str, list[Job]] = field(init=False, default_factory=dict)
    _measures: dict[str, Mapping[str, Any] | None] = field(init=False, default_factory=dict)
    _final_counts: dict[str, int] = field(init=False, default_factory=dict)  # by label, after how many runs

    def __post_init__(self) -> None:
        for job in self.jobs:
            self._by_label.setdefault(job.label, []).append(job)
        if self.widths and self._by_label:
            self._looks = plan_looks(max(map(len, self._by_label.values())))

    def needed_jobs(self) -> Iterator[Job]:
        """Yield the next needed job, as long as there is one. Request the next job only when a process is free."""
        for job in self.jobs:
            if job.key not in self._measures and job.label not in self._final_counts:
                yield job

    def record_result(self, job: Job, measures: Mapping[str, Any] | None) -> None:
        """Record that a run has ended. `measures`: None if the run failed."""
        self._measures[job.key] = measures
        if self._looks is None or job.label in self._final_counts:
            return
        of = self._by_label[job.label]
        for count in self._looks.run_counts:
            if any(each.key not in self._measures for each in of[:count]):
                return
            if all(known.met for known in self._known_after(job.label, count)):
                self._final_counts[job.label] = count
                return

    @property
    def counted_jobs(self) -> list[Job]:
        """Return the jobs of the table: all that have measures. A complete variation counts only the jobs that completed it."""
        within = {job.key for label, of in self._by_label.items() for job in of[: self._final_counts.get(label, len(of))]}
        return [job for job in self.jobs if job.key in within and self._measures.get(job.key) is not None]

    def known_medians(self) -> list[KnownMedian]:
        """Return the final intervals of all measures with a requested width."""
        if self._looks is None:
            return []
        return [
            known
            for label, of in self._by_label.items()
            for known in self._known_after(label, self._final_counts.get(label, len(of)))
        ]

    def missing_measures(self) -> list[str]:
        """Return the measures of the width goals that no run has reported. Empty as long as no run has ended."""
        names = self._names() if self.widths else ()
        return [w.measure for w in self.widths if names and not any(name.startswith(w.measure) for name in names)]

    def measure_prefixes(self) -> list[str]:
        """Return the first word of each name of a reported measure."""
        return list(dict.fromkeys(name.split(".")[0] for name in self._names()))

    def _names(self) -> dict[str, None]:
        """Return the names of all reported measures, as the keys of a mapping."""
        return {name: None for measures in self._measures.values() if measures is not None for name in measures}

    def _known_after(self, label: str, count: int) -> list[KnownMedian]:
        """Return the intervals of a variation's medians after its first `count` runs."""
        assert self._looks is not None
        ended = [each for job in self._by_label[label][:count] if (each := self._measures.get(job.key)) is not None]
        entries: list[KnownMedian] = []
        for width in self.widths:
            names = dict.fromkeys(name for measures in ended for name in measures if name.startswith(width.measure))
            if not names:
                entries.append(KnownMedian(label, width.measure, len(ended), math.nan, math.nan, math.nan, False))
            for name in names:
                numbers = [measures.get(name, 0.0) for measures in ended]
                if not all(value is None or isinstance(value, int | float) for value in numbers):
                    continue
                values = sorted(math.inf if value is None else float(value) for value in numbers)
                median, between = quantile(values, 0.5), find_interval(values, self._looks.doubt)
                low, high = between or (-math.inf, math.inf)
                is_reached = between is not None and width.is_reached(between, median)
                entries.append(KnownMedian(label, name, len(values), median, low, high, is_reached))
        return entries
