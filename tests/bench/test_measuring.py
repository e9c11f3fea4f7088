"""What a benchmark measures is what it says: cases can be opened, costs add up, the bound does all its work."""

from __future__ import annotations

import importlib
import json
import os
import sys
from concurrent.futures import Future
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from compilers import need_llvmlite, need_numba
from pydantic import TypeAdapter

from antdsl import resources
from antdsl.bench import BENCH_CASES, BenchJob
from antdsl.bench.cases import CaseError, find_case, open_shot
from antdsl.bench.costs import MEASUREMENT_ADAPTER, MeasuringError, measure_in_process
from antdsl.bench.measuring import measure_job
from antdsl.bench.programs import BOIDS_PROGRAM, NODE_PROGRAM
from antdsl.bench.tables import (
    STEP_COLUMNS,
    BenchCaseResult,
    build_phase_table,
    build_step_rows,
    compare_backends,
    describe_machine,
    describe_result,
    format_ratios,
    list_messages,
    make_json_document,
)
from antdsl.cli.printing.bench_tables import print_case_result
from antdsl.machine_code import llvm_compiler as native_machine
from antdsl.machine_code.object_cache import CACHE_VARIABLE
from antdsl.runtime.backends import NumpyBackend
from antdsl.runtime.backends.native import compile_queue
from antdsl.runtime.world import Population, World
from antdsl.source import Source
from antdsl.syntax import format as formatted

BENCHMARKS = Path(__file__).parents[1] / "benchmarks"


@pytest.mark.parametrize("text", [BOIDS_PROGRAM, NODE_PROGRAM])
def test_programs_of_cases_are_as_the_formatter_writes_them(text: str) -> None:
    assert formatted(Source("case.ant", text))[0] == text


@pytest.mark.parametrize("name", list(BENCH_CASES))
def test_every_case_can_be_opened(name: str) -> None:
    case = BENCH_CASES[name]
    agents = min(case.agents, default=None)
    shot = case.make_shot(agents)
    assert agents is None or sum(crowd.count for crowd in shot.setting.crowds) == agents
    assert set(case.quick_agent_counts) <= set(case.agents)


def test_the_valley_of_meshes_is_the_valley_without_its_volume() -> None:
    with_volume, without = BENCH_CASES["valley"].make_shot(500).setting, BENCH_CASES["valley_of_meshes"].make_shot(500).setting
    assert set(with_volume.solids) == {"hill"} and not without.solids
    assert set(without.surfaces) == set(with_volume.surfaces) | {"hill"}
    assert np.array_equal(without.surfaces["hill"].vertices, with_volume.solids["hill"].mesh.vertices)
    with pytest.raises(CaseError, match="500 ants or 15,000, not 7"):
        BENCH_CASES["valley"].make_shot(7)


@pytest.mark.parametrize(("name", "least", "most"), [("boids", 7.5, 10.5), ("cluster", 60, 105)])
def test_boids_see_about_as_many_as_is_said(name: str, least: float, most: float) -> None:
    measurement = measure_job(BenchJob(name, 1000, ("numpy",), turns=1, steps=1))
    assert measurement.neighbours is not None and least < measurement.neighbours < most


def test_a_scene_is_scaled_or_the_reason_is_given(tmp_path: Path) -> None:
    scene = resources.example_file("minimal/scene.yaml")
    assert sum(crowd.count for crowd in find_case(str(scene)).make_shot(33).setting.crowds) == 33
    with pytest.raises(CaseError, match="fixed meshes"):
        open_shot(resources.example_file("tunnel/scene.yaml"), 10)
    (tmp_path / "scene.yaml").write_text("antdsl: 1\n")
    with pytest.raises(CaseError) as why:
        open_shot(tmp_path / "scene.yaml", None)
    assert [diagnostic.code for diagnostic in why.value.report.errors] == ["no-crowd"]


def test_costs_of_phases_add_up_to_those_of_steps() -> None:
    measurement = measure_job(BenchJob("node", 100, ("numpy", "reference"), turns=3, steps=2))
    assert measurement.agents == 100 and measurement.steps == 2
    for name in ("numpy", "reference"):
        cost = measurement.costs[name]
        assert len(cost.cpu) == len(cost.wall) == 3
        # Whatever a busy machine does between two phases counts for the step alone.
        assert 0.2 < sum(cost.phases_cpu.values()) / (sum(cost.cpu) / 3) < 1.2
        assert 0 < sum(cost.phases_wall.values()) / (sum(cost.wall) / 3) < 1.2
    assert len(measurement.compute_ratios("reference", "numpy")) == 3
    assert measurement.set_up.total > measurement.set_up.first > 0
    assert 100 * 100 < measurement.state < 100 * 1000, "an ant is some hundred bytes"
    assert MEASUREMENT_ADAPTER.validate_python(asdict(measurement)) == measurement


@pytest.mark.slow
def test_a_full_run_costs_more_than_its_step() -> None:
    measurement = measure_in_process(BenchJob("node", 500, ("numpy",), turns=4, steps=8, full_run=True))
    run = measurement.full_run
    assert run is not None and run.cpu > run.step > run.feet >= 0 and run.frames >= 8
    assert measurement.memory > measurement.state
    with pytest.raises(MeasuringError, match="fixed meshes"):
        measure_in_process(BenchJob("tunnel", 7, ("numpy",)))


def test_machine_code_is_ready_before_steps_are_measured_and_its_making_and_loading_are_reported(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    """Independent of code that earlier runs stored: each function is built once, and loaded once from the folder that then has
    it."""
    need_llvmlite()
    compiled_texts: list[str] = []
    by_numpy: list[str] = []
    plain, make = NumpyBackend.run, native_machine.compile_object

    def run(self: NumpyBackend, world: World, population: Population, block: str, *rows: Any) -> None:
        by_numpy.append(block)
        plain(self, world, population, block, *rows)

    def object_code(text: str, target: native_machine.Target) -> bytes:
        compiled_texts.append(text)
        return make(text, target)

    monkeypatch.setattr(NumpyBackend, "run", run)
    monkeypatch.setattr(native_machine, "compile_object", object_code)
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    previous_folder = os.environ.get(CACHE_VARIABLE)
    measurement = measure_job(BenchJob("node", 60, ("native",), turns=2, steps=1, full_run=True))
    assert len(compiled_texts) == len(set(compiled_texts)) > 0, "none again for what is loaded, nor for the run with a cache"
    assert [block for block in by_numpy if block in ("act", "blend")] == ["act", "blend"], "the first step, and no other"
    assert measurement.set_up.code and measurement.set_up.kept and measurement.set_up.second
    assert os.environ.get(CACHE_VARIABLE) == previous_folder and list(tmp_path.iterdir()) == []
    (row,) = build_step_rows(BenchCaseResult((measurement,)))
    assert "" not in row[-3:] and row[STEP_COLUMNS.index("code, CPU s")] != ""
    other = measure_job(BenchJob("node", 60, ("numpy",), turns=1, steps=1))
    assert (other.set_up.code, other.set_up.kept) == (None, None)
    (row,) = build_step_rows(BenchCaseResult((other,)))
    assert row[-3:-1] == ["", ""]


def test_code_that_no_folder_keeps_has_no_time_to_be_loaded_in(monkeypatch: pytest.MonkeyPatch) -> None:
    need_llvmlite()

    def no_key(*, create: bool) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("antdsl.machine_code.signing.get_signer", no_key)
    measurement = measure_job(BenchJob("node", 60, ("native",), turns=1, steps=1))
    assert measurement.set_up.code and measurement.set_up.kept is None
    (line,) = list_messages(BenchCaseResult((measurement,)))
    assert line.startswith("native: compiled code is not stored in") and "no such key exists (Permission denied)" in line


def test_missing_machine_code_is_reported_with_the_times(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    coming: Future[None] = Future()
    coming.set_exception(compile_queue.CodeUnavailable("llvmlite is not there: install it"))
    monkeypatch.setattr("antdsl.runtime.backends.native.native_backend.start_code_build", lambda *_: coming)
    measurement = measure_job(BenchJob("node", 1, ("native", "numpy"), turns=1, steps=1))
    (line,) = list_messages(BenchCaseResult((measurement,)))
    assert line.startswith("native: NumPy runs instead of machine code") and line.endswith("llvmlite is not there: install it")
    assert MEASUREMENT_ADAPTER.validate_json(json.dumps(asdict(measurement))) == measurement
    print_case_result(BenchCaseResult((measurement,), measurement))
    printed = capsys.readouterr().out.splitlines()
    assert printed[0].startswith("node, 1 agent; ") and printed[1] == line
    assert {"grew by, MiB", "first step, CPU s"} <= {words.split("  ")[0] for words in printed}


def test_words_of_what_was_measured() -> None:
    one = measure_job(BenchJob("node", 60, ("numpy",), turns=20, steps=1))
    cost = one.costs["numpy"]
    slower = replace(cost, cpu=[2 * each for each in cost.cpu])
    together = replace(one, job=replace(one.job, backends=("numpy", "other")), costs={"numpy": cost, "other": slower})
    result = BenchCaseResult((one,), together)
    assert compare_backends(result) == ["other: 2.000 (2.000 to 2.000) of the CPU time of numpy, in turn in one process"]
    (row,) = build_step_rows(result)
    cells = dict(zip(STEP_COLUMNS, row, strict=True))
    assert row[0] == "numpy" and cells["bare step, CPU ms"] == f"{cost.cpu_ms:.2f}"
    assert cells["run, CPU ms"] == ""
    assert describe_result(result).startswith("node, 60 agents; 500 points")
    columns, rows = build_phase_table(result)
    assert columns == ["phase", "numpy: CPU ms", "wall ms"] and {"blend", "move"} <= {each[0] for each in rows}
    assert format_ratios([1.0, 2.0]) == "1.50 (2 turns)"
    assert [TypeAdapter(BenchCaseResult).validate_python(each) for each in make_json_document([result])["results"]] == [result]
    assert {"date", "machine", "numpy", "antdsl"} <= set(describe_machine())


def test_the_hand_written_frame_does_all_its_work(monkeypatch: pytest.MonkeyPatch) -> None:
    need_numba()
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    bound = importlib.import_module("bound")
    ants = bound.Bound(2000)
    x = ants.x.copy()
    for _ in range(40):
        ants.frame()
    far = np.hypot(ants.x - x, ants.z - ants.z)
    assert np.isfinite(ants.y).all() and far.mean() > 0.5
    assert (np.hypot(ants.px, ants.pz) > 0).mean() > 0.9, "nearly all have somebody near"
    assert 0.05 < (np.abs(ants.hit).sum(axis=1) > 0).mean() < 0.95, "feelers meet the ground here and there"
    assert ants.scent.max() > 0 and len(np.unique(ants.state)) > 1 and ants.field.max() == 2
    height = 1.5 * np.sin(ants.x / 7.0) + 1.2 * np.sin(ants.z / 5.0 + ants.x / 19.0)
    assert np.abs(ants.y - height).max() < 0.5, "they keep to the ground"
    reach = (np.hypot(ants.x[:, None] - ants.x, ants.z[:, None] - ants.z) < ants.radius).sum(axis=1) - 1
    assert 5 < reach.mean() < 11


def test_the_hand_written_frame_takes_turns_with_backends(monkeypatch: pytest.MonkeyPatch) -> None:
    need_numba()
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    beside_bound = importlib.import_module("beside_bound")
    measurement = beside_bound.measure_beside_bound(BenchJob("node", 50, ("numpy",), turns=2, steps=1))
    assert list(measurement.costs) == ["numpy", beside_bound.BOUND]
    assert len(measurement.compute_ratios("numpy", beside_bound.BOUND)) == 2


def test_a_process_that_cannot_measure_says_why(tmp_path: Path) -> None:
    script = tmp_path / "broken.py"
    script.write_text("raise SystemExit('no such machine')\n", encoding="utf-8")
    with pytest.raises(MeasuringError, match="no such machine"):
        measure_in_process(BenchJob("node", 50, ("numpy",)), [sys.executable, str(script)])


def test_the_page_is_what_its_measurements_say(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    page = importlib.import_module("page")
    measurements = json.loads(page.RESULTS_FILE.read_text(encoding="utf-8"))
    written: list[str] = []
    monkeypatch.setattr(Path, "write_text", lambda self, text, **_: written.append(text))
    page.write(measurements)
    assert written == [each.read_text(encoding="utf-8") for each in page.PAGES]


def test_what_the_cases_need_ships() -> None:
    import tomllib

    text = (Path(__file__).resolve().parents[2] / "pyproject.toml").read_text(encoding="utf-8")
    packed = tomllib.loads(text)["tool"]["hatch"]["build"]["targets"]["wheel"]["force-include"]
    named = {"foraging", "flocking", "tunnel", "moods", "anthill", "thesis"}
    assert named <= {name.removeprefix("examples/") for name in packed if name.startswith("examples/")}
    for name, place in packed.items():
        assert place == f"antdsl/_data/{name}" or not name.startswith("examples/")
