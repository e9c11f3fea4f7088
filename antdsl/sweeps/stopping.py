"""The choice of the runs that a sweep still needs. A variation is complete once the intervals of its medians are as narrow as
requested.

Each decision uses the first n seeds of a variation. So the order in which runs end changes neither when a variation is complete
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

from antdsl.sweeps.jobs import SweepJob
from antdsl.sweeps.table import compute_quantile

CONFIDENCE_LEVEL = Fraction(95, 100)
_RUN_COUNT_GROWTH = Fraction(3, 2)  # growth of the number of runs from one check to the next


def compute_interval_rank(count: int, error_probability: Fraction = 1 - CONFIDENCE_LEVEL) -> int:
    """Return the rank l of the narrowest allowed interval for the median. The interval reaches from the l-th smallest to the
    l-th largest draw, and misses the median with a probability of at most `error_probability`.

    Return 0 if `count` draws are too few for such an interval."""
    rank, cumulative = 0, 0
    while 2 * (cumulative + math.comb(count, rank)) <= error_probability * 2**count:
        cumulative += math.comb(count, rank)
        rank += 1
    return min(rank, (count + 1) // 2)


def find_interval(values: Sequence[float], error_probability: Fraction = 1 - CONFIDENCE_LEVEL) -> tuple[float, float] | None:
    """Return the lower and the upper end of the confidence interval of the median. Return None if there are too few values. An
    infinite value means that the measured event did not happen."""
    place = compute_interval_rank(len(values), error_probability)
    if not place:
        return None
    sorted_values = sorted(values)
    return sorted_values[place - 1], sorted_values[-place]


@dataclass(frozen=True, slots=True)
class CheckSchedule:
    """A schedule for checking an interval: the numbers of runs after which it is checked, and the error probability per check.

    A sweep stops as soon as a check finds the interval narrow enough. With repeated checks, the interval misses the median more
    often than with a single one. Therefore all checks share the total error probability (Bonferroni).
    """

    run_counts: tuple[int, ...]
    error_probability: Fraction


def plan_checks(max_runs: int) -> CheckSchedule | None:
    """Return a schedule of checks. Each check has 1.5 times as many runs as the previous one. Return None if `max_runs` runs are
    too few for any check."""
    for count in range(1, max_runs + 1):
        doubt = (1 - CONFIDENCE_LEVEL) / count
        min_runs = next((n for n in range(1, max_runs + 1) if compute_interval_rank(n, doubt)), None)
        if min_runs is None:
            return None
        run_counts = [min_runs]
        while run_counts[-1] < max_runs:
            run_counts.append(min(math.ceil(run_counts[-1] * _RUN_COUNT_GROWTH), max_runs))
        if len(run_counts) <= count:
            return CheckSchedule(tuple(run_counts), (1 - CONFIDENCE_LEVEL) / len(run_counts))
    return None


def find_min_runs() -> int:
    """Return the smallest number of runs with which a sweep can estimate a median."""
    return next(n for n in range(1, 100) if plan_checks(n) is not None)


@dataclass(frozen=True, slots=True)
class WidthGoal:
    """A limit on the width of the confidence interval of a measure's median.

    `measure`: a prefix of the names of measures.
    `max_width`: the widest acceptable interval.
    `is_relative`: whether `max_width` is a fraction of the median's absolute value.
    """

    measure: str
    max_width: float
    is_relative: bool = False

    def is_reached(self, interval: tuple[float, float], median: float) -> bool:
        """Return whether an interval is narrow enough for this goal. `median`: the estimated median inside the interval."""
        low, high = interval
        if low == high:
            return True  # all values are equal, or the event never occurs
        return high - low <= (self.max_width * abs(median) if self.is_relative else self.max_width)


@dataclass(frozen=True, slots=True)
class MedianEstimate:
    """An estimate of the median of a measure in one variation. `median`: the estimate after `runs` runs. `low`, `high`: the ends
    of its confidence interval. `met`: whether the interval is as narrow as requested."""

    label: str
    measure: str
    runs: int
    median: float
    low: float
    high: float
    met: bool


@dataclass(slots=True)
class SweepJobChooser:
    """Chooses the jobs that a sweep still needs.

    `jobs`: all jobs that may run, ordered by seed. `width_goals`: the widest acceptable intervals of medians. Without goals, all
    jobs are needed."""

    jobs: Sequence[SweepJob]
    width_goals: Sequence[WidthGoal] = ()
    _schedule: CheckSchedule | None = field(init=False, default=None)
    _jobs_by_label: dict[str, list[SweepJob]] = field(init=False, default_factory=dict)
    _measures: dict[str, Mapping[str, Any] | None] = field(init=False, default_factory=dict)
    _final_counts: dict[str, int] = field(init=False, default_factory=dict)  # by label, the number of runs at the end

    def __post_init__(self) -> None:
        for job in self.jobs:
            self._jobs_by_label.setdefault(job.label, []).append(job)
        if self.width_goals and self._jobs_by_label:
            self._schedule = plan_checks(max(map(len, self._jobs_by_label.values())))

    def iterate_needed_jobs(self) -> Iterator[SweepJob]:
        """Yield the needed jobs one by one, until none is left. Request the next job only when a process is free, so that
        earlier results can show that it is no longer needed."""
        for job in self.jobs:
            if job.key not in self._measures and job.label not in self._final_counts:
                yield job

    def record_result(self, job: SweepJob, measures: Mapping[str, Any] | None) -> None:
        """Record that a run has ended. `measures`: its measures, or None if it failed."""
        self._measures[job.key] = measures
        if self._schedule is None or job.label in self._final_counts:
            return
        jobs = self._jobs_by_label[job.label]
        for count in self._schedule.run_counts:
            if any(each.key not in self._measures for each in jobs[:count]):
                return
            if all(median.met for median in self._find_medians_after(job.label, count)):
                self._final_counts[job.label] = count
                return

    @property
    def counted_jobs(self) -> list[SweepJob]:
        """Return the jobs that count in the table, which all have measures. Of a variation that was completed early, only the
        jobs up to its completion count."""
        counted_keys = {
            job.key for label, jobs in self._jobs_by_label.items() for job in jobs[: self._final_counts.get(label, len(jobs))]
        }
        return [job for job in self.jobs if job.key in counted_keys and self._measures.get(job.key) is not None]

    def list_known_medians(self) -> list[MedianEstimate]:
        """Return an estimate of the median for each measure with a width goal. The estimates come from the final intervals."""
        if self._schedule is None:
            return []
        return [
            median
            for label, jobs in self._jobs_by_label.items()
            for median in self._find_medians_after(label, self._final_counts.get(label, len(jobs)))
        ]

    def list_missing_measures(self) -> list[str]:
        """Return the measures in the width goals that no run has reported. The result is [] until the first run has ended."""
        names = self._collect_measure_names() if self.width_goals else ()
        return [w.measure for w in self.width_goals if names and not any(name.startswith(w.measure) for name in names)]

    def list_measure_prefixes(self) -> list[str]:
        """Return the prefixes of all reported measures: the part of the name before the first dot. Duplicates are removed."""
        return list(dict.fromkeys(name.split(".")[0] for name in self._collect_measure_names()))

    def _collect_measure_names(self) -> dict[str, None]:
        """Return the names of all reported measures, as the keys of an ordered dictionary."""
        return {name: None for measures in self._measures.values() if measures is not None for name in measures}

    def _find_medians_after(self, label: str, run_count: int) -> list[MedianEstimate]:
        """Return an estimate of the median for each measure of a variation that has a width goal. Only the variation's first
        `run_count` runs are used."""
        assert self._schedule is not None
        ended = [each for job in self._jobs_by_label[label][:run_count] if (each := self._measures.get(job.key)) is not None]
        entries: list[MedianEstimate] = []
        for width in self.width_goals:
            names = dict.fromkeys(name for measures in ended for name in measures if name.startswith(width.measure))
            if not names:
                entries.append(MedianEstimate(label, width.measure, len(ended), math.nan, math.nan, math.nan, False))
            for name in names:
                numbers = [measures.get(name, 0.0) for measures in ended]
                if not all(value is None or isinstance(value, int | float) for value in numbers):
                    continue
                values = sorted(math.inf if value is None else float(value) for value in numbers)
                median, interval = compute_quantile(values, 0.5), find_interval(values, self._schedule.error_probability)
                low, high = interval or (-math.inf, math.inf)
                is_reached = interval is not None and width.is_reached(interval, median)
                entries.append(MedianEstimate(label, name, len(values), median, low, high, is_reached))
        return entries
