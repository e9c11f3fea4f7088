"""Designs of experiments: which points are run, that one seed gives one design, messages about words that do not fit."""

from __future__ import annotations

import itertools
import math
from fractions import Fraction

import numpy as np
import pytest

from antdsl import limits
from antdsl.sweeps.designs import DESIGNS, ChosenPoints, choose_design
from antdsl.sweeps.factors import Factor, build_end_points, parse_factors
from antdsl.sweeps.jobs import SweepJob
from antdsl.sweeps.sensitivity import find_effects, is_salib_available
from antdsl.sweeps.stopping import (
    CONFIDENCE_LEVEL,
    SweepJobChooser,
    WidthGoal,
    compute_interval_rank,
    find_interval,
    find_min_runs,
    plan_checks,
)

SMELL, PACE = Factor("ant.smell", (), 30.0, 90.0, "mm"), Factor("ant.pace", (), 0.0, 1.0)


def read(**vary: str) -> tuple[list[Factor], list[tuple[str, str]]]:
    factor_list, report = parse_factors({f"ant.{name}": text for name, text in vary.items()})
    return factor_list, [(d.message, d.help or "") for d in report.errors]


def chosen(word: str, *of: Factor, points: int | None = None, seed: int = 1) -> ChosenPoints:
    design, report = choose_design(word, of, points, seed)
    assert design is not None, report.errors
    return design


def refused(word: str, *of: Factor, points: int | None = None) -> str:
    design, report = choose_design(word, of, points, 1)
    assert design is None
    return " ".join(f"{d.message}: {d.help}" for d in report.errors)


def test_values_one_by_one_and_ranges_are_read() -> None:
    assert read(smell="30mm, 60mm")[0] == [Factor("ant.smell", ("30mm", "60mm"))]
    assert read(smell="30 mm .. 90 mm")[0] == [SMELL] == read(smell="30..90mm")[0]
    assert read(pace="-1.5..2e-1")[0] == [Factor("ant.pace", (), -1.5, 0.2)]


@pytest.mark.parametrize(
    ("text", "says", "write"),
    [
        ("1,,2", "an empty value", "ant.smell=1,2,3"),
        ("1,1", "a value twice", "each once"),
        ("90mm..30mm", "ends before it begins", "ant.smell=30mm..90mm"),
        ("3mm..3mm", "no width", "one value"),
        ("3mm..9cm", "begins in `mm` and ends in `cm`", "both ends in one unit"),
        ("3mm..9", "ends in `no unit`", "both ends"),
        ("1..2..3", "is not a range", "ant.smell=30mm..90mm"),
        ("a..b", "is not a range", "separate values"),
        ("1,2..3", "is not a range", "separate values"),
        ("1..9e9999", "not representable", "ant.smell=30mm..90mm"),
    ],
)
def test_unreadable_values_are_reported_with_a_correction(text: str, says: str, write: str) -> None:
    factor_list, ((message, help),) = read(smell=text)
    assert not factor_list and says in message and write in help


def test_a_grid_has_every_combination_the_last_name_changing_fastest() -> None:
    design = chosen("grid", Factor("x.p", ("1", "2")), Factor("x.q", ("3", "4")))
    assert design.points == tuple({"x.p": p, "x.q": q} for p, q in itertools.product("12", "34"))
    assert chosen("grid").points == ({},)


def test_a_latin_hypercube_has_each_part_of_each_range_once() -> None:
    design = chosen("latin", SMELL, PACE, points=20)
    for factor in (SMELL, PACE):
        shares = [(factor.parse_number(p[factor.name]) - factor.low) / (factor.high - factor.low) for p in design.points]
        assert sorted(math.floor(20 * share) for share in shares) == list(range(20))
    levels = chosen("latin", Factor("ant.kind", ("a", "b", "c", "d")), points=20)
    assert sorted(p["ant.kind"] for p in levels.points) == [k for k in "abcd" for _ in range(5)], "levels have equal shares"


def test_a_sobol_sequence_fills_every_cell_of_a_square() -> None:
    design = chosen("sobol", SMELL, PACE, points=64)
    assert design.shares is not None
    cells = {(math.floor(8 * a), math.floor(8 * b)) for a, b in design.shares}
    assert len(cells) == 64, "a (0, 6, 2)-net in base 2 has one point in each of 64 cells"


@pytest.mark.parametrize("word", [d.name for d in DESIGNS if d.sample_shares is not None])
def test_one_seed_is_one_design_and_another_is_another(word: str) -> None:
    if word in ("saltelli", "morris"):
        pytest.importorskip("SALib")
    first = chosen(word, SMELL, PACE, points=8)
    assert chosen(word, SMELL, PACE, points=8).points == first.points
    assert chosen(word, SMELL, PACE, points=8, seed=2).points != first.points
    design = first.design
    assert len(first.points) == 8 * (1 if design.points_per_unit is None else 2 + design.points_per_unit)
    for point in first.points:
        assert 30 <= SMELL.parse_number(point["ant.smell"]) <= 90 and point["ant.smell"].endswith("mm")
        assert len(point["ant.smell"]) <= len("30.12345mm") and "e" not in point["ant.pace"]
    assert len(first.unique_points) == len({tuple(p.values()) for p in first.points})


def test_small_and_large_numbers_are_written_without_powers_of_ten() -> None:
    tiny = Factor("x.p", (), 1e-9, 1e-7, "mm")
    assert tiny.format_value_at(0.5) == "0.0000000505mm" and tiny.parse_number(tiny.format_value_at(0.5)) == 5.05e-8
    assert Factor("x.p", (), 0.0, 1e9).format_value_at(0.1234567) == "123457000"


def test_every_end_is_named_once() -> None:
    assert build_end_points([SMELL, Factor("x.q", ("1", "2", "3"))]) == [
        {"ant.smell": "30mm", "x.q": "1"},
        {"ant.smell": "90mm", "x.q": "2"},
        {"ant.smell": "90mm", "x.q": "3"},
    ]


def test_options_that_do_not_fit_together_are_reported_with_a_correction() -> None:
    assert "`--vary ant.smell=30mm,60mm,90mm`, or choose points within: `--design latin --points 20`" in refused("grid", SMELL)
    assert "leave out `--points 4`" in refused("grid", Factor("x.p", ("1",)), points=4)
    assert "write `--design latin --points 20`" in refused("latin", SMELL)
    assert "add a param with its range" in refused("latin", points=4)
    assert "`--points 64` or `--points 32`" in refused("sobol", SMELL, points=50)
    assert "write its ends: `--vary x.p=1..3`" in refused("morris", Factor("x.p", ("1", "2", "3")), points=10)
    assert "more than the limit of 20,000" in refused("latin", SMELL, points=limits.MAX_SWEEP_POINTS + 1)
    assert "more than the limit of 20,000" in refused("grid", *(Factor(f"x.p{k}", tuple(map(str, range(100)))) for k in range(3)))


def test_without_salib_its_designs_name_the_extra(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("antdsl.sweeps.sensitivity.find_spec", lambda name: None)
    assert not is_salib_available()
    for word in ("saltelli", "morris"):
        assert "pip install 'antdsl[sensitivity]'" in refused(word, SMELL, points=8)


def ishigami(shares: np.ndarray) -> np.ndarray:
    z = -np.pi + 2 * np.pi * shares
    return np.sin(z[:, 0]) + 7 * np.sin(z[:, 1]) ** 2 + 0.1 * z[:, 2] ** 4 * np.sin(z[:, 0])


def analyse(word: str, points: int, function, of: int = 3):  # type: ignore[no-untyped-def]
    chosen_design = chosen(word, *(Factor(f"x.p{k}", (), 0.0, 1.0) for k in range(of)), points=points)
    assert chosen_design.shares is not None and chosen_design.design.analysis is not None
    labels = [f"{k}" for k in range(len(chosen_design.points))]
    medians = {(label, "y"): float(value) for label, value in zip(labels, function(chosen_design.shares), strict=True)}
    names = [factor.name for factor in chosen_design.factors]
    return find_effects(chosen_design.design.analysis, names, chosen_design.shares, {"scene": labels}, medians, ["y"])


def test_sobol_indices_are_the_exact_ones_of_a_known_function() -> None:
    """T. Ishigami, T. Homma: An importance quantification technique in uncertainty analysis (1990)."""
    pytest.importorskip("SALib")
    effect_rows, notes = analyse("saltelli", 1024, ishigami)
    assert not notes
    assert [e.columns["first_order"] for e in effect_rows] == pytest.approx([0.3139, 0.4424, 0.0], abs=0.03)
    assert [e.columns["total"] for e in effect_rows] == pytest.approx([0.5576, 0.4424, 0.2437], abs=0.03)
    assert all(0 < e.columns["total_95"] < 0.1 for e in effect_rows)


def test_elementary_effects_of_a_sum_are_its_factors() -> None:
    pytest.importorskip("SALib")
    effect_rows, notes = analyse("morris", 10, lambda shares: shares @ np.array([3.0, -1.0, 0.0]))
    assert not notes and [e.columns["mu_star"] for e in effect_rows] == pytest.approx([3, 1, 0])
    assert [e.columns["mu"] for e in effect_rows] == pytest.approx([3, -1, 0]) and [
        e.columns["sigma"] for e in effect_rows
    ] == pytest.approx([0] * 3)


def test_measures_without_values_have_no_sensitivity() -> None:
    pytest.importorskip("SALib")
    assert "is 2 at all points" in analyse("saltelli", 8, lambda s: np.full(len(s), 2.0))[1][0]
    assert "never happened" in analyse("saltelli", 8, lambda s: np.where(s[:, 0] < 0.5, math.inf, 1.0))[1][0]
    effect_rows, notes = analyse("saltelli", 8, lambda s: np.where(s[:, 0] < 0.5, math.nan, 1.0))
    assert not effect_rows and "not known at" in notes[0]


def test_the_interval_is_the_narrowest_of_its_kind_that_holds_what_it_promises() -> None:
    for count in range(1, 60):
        place = compute_interval_rank(count)
        missed = [Fraction(2 * sum(math.comb(count, k) for k in range(least)), 2**count) for least in range(place + 2)]
        assert (place == 0 or missed[place] <= 1 - CONFIDENCE_LEVEL) and missed[place + 1] > 1 - CONFIDENCE_LEVEL
    assert [compute_interval_rank(n) for n in (5, 6, 9, 12, 20, 100)] == [0, 1, 2, 3, 6, 40], "as tables of the sign test have it"


def test_the_interval_is_that_of_scipy() -> None:
    from scipy.stats import quantile_test

    rng = np.random.default_rng(4)
    for count in (6, 7, 25, 80):
        values = rng.normal(size=count)
        theirs = quantile_test(values, q=0, p=0.5).confidence_interval(confidence_level=0.95)
        assert find_interval(list(values)) == pytest.approx((theirs.low, theirs.high))
    assert find_interval([1.0] * 5) is None and find_interval([1.0, 2, 3, 4, 5, math.inf]) == (1, math.inf)


def test_repeated_checks_respect_the_error_probability() -> None:
    schedule = plan_checks(60)
    assert (
        schedule is not None
        and schedule.run_counts[-1] == 60
        and schedule.error_probability * len(schedule.run_counts) == 1 - CONFIDENCE_LEVEL
    )
    assert (
        all(compute_interval_rank(n, schedule.error_probability) for n in schedule.run_counts)
        and find_min_runs() == 6
        and plan_checks(5) is None
    )
    rng, missed, sweeps = np.random.default_rng(7), 0, 2000
    for values in rng.standard_cauchy((sweeps, 60)):
        for count in schedule.run_counts:
            low, high = find_interval(list(values[:count]), schedule.error_probability) or (-math.inf, math.inf)
            if high - low < 1.0 or count == 60:
                missed += not low <= 0 <= high
                break
    assert missed / sweeps < 0.05


def make_jobs(labels: str, seeds: int) -> list[SweepJob]:
    return [
        SweepJob("s.yaml", name, (), seed, (1, 9), None, (), f"{name}{seed}") for seed in range(1, seeds + 1) for name in labels
    ]


def test_runs_stop_once_the_median_is_known_in_any_order() -> None:
    worth = {"a": lambda seed: 10 + seed % 2 / 10, "b": lambda seed: seed * 7919 % 100}
    ends = []
    for at_once in (1, 3, 7):
        chooser, running = SweepJobChooser(make_jobs("ab", 40), [WidthGoal("y", 5.0)]), []
        job_queue, ran = chooser.iterate_needed_jobs(), 0
        while True:
            while len(running) < at_once and (job := next(job_queue, None)) is not None:
                running.append(job)
                ran += 1
            if not running:
                break
            job = running.pop(ran * 5 % len(running))
            chooser.record_result(job, {"y.z": worth[job.label](job.seed)})
        assert ran < 80 and len([job for job in chooser.counted_jobs if job.label == "b"]) == 40
        ends.append(([job.key for job in chooser.counted_jobs], chooser.list_known_medians()))
    assert ends[0] == ends[1] == ends[2]
    known = {known.label: known for known in ends[0][1]}
    assert known["a"].met and known["a"].runs < 15 and known["a"].high - known["a"].low <= 5
    assert not known["b"].met and known["b"].low <= known["b"].median <= known["b"].high


def test_widths_may_be_shares_and_what_never_happens_is_known_too() -> None:
    assert WidthGoal("y", 0.1, is_relative=True).is_reached((95, 104), 100) and not WidthGoal(
        "y", 0.1, is_relative=True
    ).is_reached((90, 104), 100)
    chooser = SweepJobChooser(make_jobs("a", 40), [WidthGoal("y", 1.0)])
    for job in chooser.iterate_needed_jobs():
        chooser.record_result(job, None if job.seed == 2 else {"y": None})
    (known,) = chooser.list_known_medians()
    assert known.met and known.median == math.inf and known.runs == len(chooser.counted_jobs) < 20
    assert not any(job.seed == 2 for job in chooser.counted_jobs), "a run that failed counts nowhere"


def test_without_widths_all_runs_are_requested_and_a_measure_that_no_run_reports_is_noticed() -> None:
    chooser = SweepJobChooser(make_jobs("ab", 2))
    for job in chooser.iterate_needed_jobs():
        chooser.record_result(job, {"y": 1})
    assert chooser.counted_jobs == list(chooser.jobs) and not chooser.list_missing_measures()
    chooser = SweepJobChooser(make_jobs("a", 9), [WidthGoal("nothing", 1.0), WidthGoal("y", 1.0)])
    assert chooser.list_missing_measures() == []
    chooser.record_result(chooser.jobs[0], {"y": 1})
    assert chooser.list_missing_measures() == ["nothing"]
