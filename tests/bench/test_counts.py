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
from counts import RECORDED, SETTLED, count_step, counts_of, grown

from antdsl.bench.cases import find_case
from antdsl.machine_code.kernels import source_key
from antdsl.runtime import Options, World, bind, phases, state_hash, step
from antdsl.senses.overlaps import fill_worst_overlaps

ROOT = Path(__file__).resolve().parents[2]
BENCHMARKS = ROOT / "tests" / "benchmarks"


@pytest.fixture
def worlds() -> Iterator[tuple[World, World]]:
    """Two worlds alike, under way."""
    shot = find_case("node").make_shot(60)
    pair = bind(shot.plan, shot.setting, Options(backend="numpy")), bind(shot.plan, shot.setting, Options(backend="numpy"))
    for world in pair:
        for _ in range(SETTLED):
            step(world)
    yield pair


@pytest.mark.parametrize("cases", [("boids",), pytest.param((), marks=pytest.mark.slow)])
def test_nothing_has_grown_beyond_what_is_recorded(cases: tuple[str, ...]) -> None:
    """Count in a separate process, because code that was compiled for other tests would do part of the work. Without cases, count
    all."""
    words = [sys.executable, str(BENCHMARKS / "counts.py"), *cases, "--print"]
    process = subprocess.run(words, env=child_environment(), capture_output=True, text=True)
    assert process.returncode == 0, process.stderr[-2000:]
    lines = grown(json.loads(process.stdout), json.loads(RECORDED.read_text(encoding="utf-8")))
    assert not lines, "\n".join(
        [*lines, "where that is meant: python tests/benchmarks/counts.py --record, and why in the commit"]
    )


def test_counting_changes_no_step_and_leaves_nothing_behind(worlds: tuple[World, World]) -> None:
    counted, plain = worlds
    functions = dict(vars(np))
    counts = [count_step(counted) for _ in range(2)]
    assert {name for name, value in vars(np).items() if functions.get(name) is not value} == set() and sys.getprofile() is None
    for _ in range(2):
        step(plain)
    assert state_hash(counted) == state_hash(plain)
    step(counted)
    step(plain)
    assert state_hash(counted) == state_hash(plain)
    for name in ("instructions", "instruction_bytes", "elements", "numpy_calls", "numpy_bytes", "python_calls"):
        assert counts[0][name] > 0


def test_a_kernel_that_is_made_in_a_step_that_is_counted_is_the_usual_one(
    worlds: tuple[World, World], monkeypatch: pytest.MonkeyPatch
) -> None:
    plain, kernels = (source_key.compute_source_key(fill_worst_overlaps.part, []), fill_worst_overlaps.text()), []
    monkeypatch.setattr(
        phases,
        "PHASES",
        (
            *phases.PHASES,
            (
                "made",
                lambda world: kernels.append(
                    (source_key.compute_source_key(fill_worst_overlaps.part, []), fill_worst_overlaps.text())
                ),
            ),
        ),
    )
    count_step(worlds[0])
    assert kernels == [plain] and plain[0] is not None


def test_one_more_call_of_numpy_is_counted_with_its_bytes(worlds: tuple[World, World], monkeypatch: pytest.MonkeyPatch) -> None:
    one, other = worlds
    plain_counts = count_step(one)

    def add_call(world: World) -> None:
        np.add.reduce(np.negative(np.zeros(1000)))

    monkeypatch.setattr(phases, "PHASES", (*phases.PHASES, ("more", add_call)))
    patched_counts = count_step(other)
    assert patched_counts["numpy_calls"] - plain_counts["numpy_calls"] == 3
    assert patched_counts["numpy_bytes"] - plain_counts["numpy_bytes"] == 8000 + (8000 + 8000) + 8000
    assert {name for name in patched_counts if patched_counts[name] != plain_counts[name]} == {"numpy_calls", "numpy_bytes"}


@pytest.mark.parametrize("backend", ["numpy", "native"])
def test_a_line_more_in_a_program_is_counted(backend: str, monkeypatch: pytest.MonkeyPatch) -> None:
    from antdsl.bench import programs

    if backend == "native":
        need_llvmlite()

    def counts() -> dict[str, int]:
        shot = find_case("node").make_shot(60)
        return counts_of(shot.plan, shot.setting, backend)

    plain_counts = counts()
    assert plain_counts == counts()
    push = "steer wander(swing: 50 deg)"
    monkeypatch.setattr(programs, "NODE_PROGRAM", programs.NODE_PROGRAM.replace(push, push + " + wander(swing: 90 deg) * 0.1"))
    changed_counts = counts()
    assert grown({"node": changed_counts}, {"node": plain_counts}) and not grown({"node": plain_counts}, {"node": changed_counts})
    names = ("instructions", "instruction_bytes") if backend == "numpy" else ("instructions ant.act.0",)
    assert all(changed_counts[name] > plain_counts[name] > 0 for name in names)


def test_one_more_operation_is_one_more_instruction_of_machine_code(monkeypatch: pytest.MonkeyPatch) -> None:
    from antdsl.machine_code import llvm_compiler
    from antdsl.machine_code.lanes import LaneBuilder
    from antdsl.runtime.backends.native import program_listing

    def counts() -> dict[str, int]:
        return program_listing.count_instructions_by_function(
            program_listing.build_program(find_case("node").make_shot(60).plan, llvm_compiler.PORTABLE_TARGET)
        )

    plain_counts, plain = counts(), LaneBuilder.broadcast
    insertions: list[bool] = []

    def widen_and_add(self: LaneBuilder, *arguments: Any, **named: Any) -> Any:
        value = plain(self, *arguments, **named)
        if not insertions:
            insertions.append(True)
            one = self.make_constant(1, "i64", 1)
            self.op("add", "i64", one, one)
        return value

    monkeypatch.setattr(LaneBuilder, "broadcast", widen_and_add)
    changed_counts = counts()
    assert sum(changed_counts.values()) == sum(plain_counts.values()) + 1 and not grown(
        {"node": changed_counts}, {"node": plain_counts}
    )
    twice = {name: 2 * number for name, number in plain_counts.items()}
    assert len(grown({"node": twice}, {"node": plain_counts})) == len(plain_counts)


def test_a_backend_tells_its_own_counts(worlds: tuple[World, World], monkeypatch: pytest.MonkeyPatch) -> None:
    world, _ = worlds
    monkeypatch.setattr(
        type(world.backend), "count_instructions_by_function", lambda self: {"ir_instructions": 41}, raising=False
    )
    assert count_step(world)["ir_instructions"] == 41


def test_growth_is_reported_with_both_numbers() -> None:
    assert grown({"a": {"x": 13}}, {"a": {"x": 10}}) == ["a: x is 13, 1.300 times the 10 recorded"]
    assert grown({"a": {"x": 1}}, {}) == ["a: x is 1 and not recorded"]
    assert grown({"a": {"x": 9}}, {"a": {"x": 10}}) == []
    with pytest.raises(KeyError):
        counts_of(None, None, "none")  # type: ignore[arg-type]
