"""Counts of a step: exact, recorded, and seen to grow where a step does more."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from children import child_environment
from compilers import need_llvmlite

sys.path.insert(0, str(Path(__file__).parents[1] / "benchmarks"))
from counts import RECORDED, grown

from antdsl.bench.cases import case_of
from antdsl.bench.counting import SETTLED, count_step, counts_of
from antdsl.machine_code.kernels import sources
from antdsl.runtime import Options, World, bind, phases, state_hash, step
from antdsl.senses.overlaps import worst

ROOT = Path(__file__).resolve().parents[2]
BENCHMARKS = ROOT / "tests" / "benchmarks"


@pytest.fixture
def worlds() -> Iterator[tuple[World, World]]:
    """Two worlds alike, under way."""
    shot = case_of("node").make(60)
    found = bind(shot.plan, shot.setting, Options(backend="numpy")), bind(shot.plan, shot.setting, Options(backend="numpy"))
    for world in found:
        for _ in range(SETTLED):
            step(world)
    yield found


@pytest.mark.parametrize("cases", [("boids",), pytest.param((), marks=pytest.mark.slow)])
def test_nothing_has_grown_beyond_what_is_recorded(cases: tuple[str, ...]) -> None:
    """In a process of its own: what was compiled for other tests would do some of the work. Without cases, all of them."""
    words = [sys.executable, str(BENCHMARKS / "counts.py"), *cases, "--print"]
    done = subprocess.run(words, env=child_environment(), capture_output=True, text=True)
    assert done.returncode == 0, done.stderr[-2000:]
    lines = grown(json.loads(done.stdout), json.loads(RECORDED.read_text(encoding="utf-8")))
    assert not lines, "\n".join(
        [*lines, "where that is meant: python tests/benchmarks/counts.py --record, and why in the commit"]
    )


def test_counting_changes_no_step_and_leaves_nothing_behind(worlds: tuple[World, World]) -> None:
    counted, plain = worlds
    functions = dict(vars(np))
    found = [count_step(counted) for _ in range(2)]
    assert {name for name, value in vars(np).items() if functions.get(name) is not value} == set() and sys.getprofile() is None
    for _ in range(2):
        step(plain)
    assert state_hash(counted) == state_hash(plain)
    step(counted)
    step(plain)
    assert state_hash(counted) == state_hash(plain)
    for name in ("instructions", "instruction_bytes", "elements", "numpy_calls", "numpy_bytes", "python_calls"):
        assert found[0][name] > 0


def test_a_kernel_that_is_made_in_a_step_that_is_counted_is_the_usual_one(
    worlds: tuple[World, World], monkeypatch: pytest.MonkeyPatch
) -> None:
    plain, made = (sources.key(worst.part, []), worst.text()), []
    monkeypatch.setattr(
        phases, "PHASES", (*phases.PHASES, ("made", lambda world: made.append((sources.key(worst.part, []), worst.text()))))
    )
    count_step(worlds[0])
    assert made == [plain] and plain[0] is not None


def test_one_more_call_of_numpy_is_counted_with_its_bytes(worlds: tuple[World, World], monkeypatch: pytest.MonkeyPatch) -> None:
    one, other = worlds
    before = count_step(one)

    def more(world: World) -> None:
        np.add.reduce(np.negative(np.zeros(1000)))

    monkeypatch.setattr(phases, "PHASES", (*phases.PHASES, ("more", more)))
    after = count_step(other)
    assert after["numpy_calls"] - before["numpy_calls"] == 3
    assert after["numpy_bytes"] - before["numpy_bytes"] == 8000 + (8000 + 8000) + 8000
    assert {name for name in after if after[name] != before[name]} == {"numpy_calls", "numpy_bytes"}


@pytest.mark.parametrize("backend", ["numpy", "native"])
def test_a_line_more_in_a_program_is_counted(backend: str, monkeypatch: pytest.MonkeyPatch) -> None:
    from antdsl.bench import programs

    if backend == "native":
        need_llvmlite()

    def counts() -> dict[str, int]:
        shot = case_of("node").make(60)
        return counts_of(shot.plan, shot.setting, backend)

    before = counts()
    assert before == counts()
    push = "steer wander(swing: 50 deg)"
    monkeypatch.setattr(programs, "NODE", programs.NODE.replace(push, push + " + wander(swing: 90 deg) * 0.1"))
    after = counts()
    assert grown({"node": after}, {"node": before}) and not grown({"node": before}, {"node": after})
    names = ("instructions", "instruction_bytes") if backend == "numpy" else ("instructions ant.act.0",)
    assert all(after[name] > before[name] > 0 for name in names)


def test_one_more_operation_is_one_more_instruction_of_machine_code(monkeypatch: pytest.MonkeyPatch) -> None:
    from antdsl.machine_code import machine
    from antdsl.machine_code.lanes import LaneBuilder
    from antdsl.runtime.backends.native import listing

    def counts() -> dict[str, int]:
        return listing.counts(listing.of_plan(case_of("node").make(60).plan, machine.ANY))

    before, plain = counts(), LaneBuilder.widened
    done: list[bool] = []

    def more(self: LaneBuilder, *given: Any, **named: Any) -> Any:
        found = plain(self, *given, **named)
        if not done:
            done.append(True)
            one = self.constant(1, "i64", 1)
            self.op("add", "i64", one, one)
        return found

    monkeypatch.setattr(LaneBuilder, "widened", more)
    after = counts()
    assert sum(after.values()) == sum(before.values()) + 1 and not grown({"node": after}, {"node": before})
    twice = {name: 2 * number for name, number in before.items()}
    assert len(grown({"node": twice}, {"node": before})) == len(before)


def test_a_backend_tells_its_own_counts(worlds: tuple[World, World], monkeypatch: pytest.MonkeyPatch) -> None:
    world, _ = worlds
    monkeypatch.setattr(type(world.backend), "counts", lambda self: {"ir_instructions": 41}, raising=False)
    assert count_step(world)["ir_instructions"] == 41


def test_what_has_grown_is_told_with_both_numbers() -> None:
    assert grown({"a": {"x": 13}}, {"a": {"x": 10}}) == ["a: x is 13, 1.300 times the 10 recorded"]
    assert grown({"a": {"x": 1}}, {}) == ["a: x is 1 and not recorded"]
    assert grown({"a": {"x": 9}}, {"a": {"x": 10}}) == []
    with pytest.raises(KeyError):
        counts_of(None, None, "none")  # type: ignore[arg-type]
