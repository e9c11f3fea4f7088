"""Machine code gives the bits that the reference gives: of every operation, of whole programs, and of what is rare."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import plans
import pytest
from meaning import crowd, item, play

from antdsl import limits
from antdsl.machine_code import llvm_compiler
from antdsl.machine_code.lanes import add_elementwise_function
from antdsl.machine_code.llvm_module import LlvmModule
from antdsl.machine_code.number_kinds import BOOL, F32, I32, LANE_COUNT
from antdsl.numerics.elementwise import FUNCTION_BY_NAME
from antdsl.pipeline import open_scene
from antdsl.plan import ir
from antdsl.runtime import FaultStop, Options, World, bind, state_hash, step
from antdsl.runtime.backends.native import block_runner, compile_queue, program_listing, stored_blocks
from antdsl.runtime.backends.native import native_backend as native_backend
from antdsl.runtime.backends.native.address_layout import AddressLayout
from antdsl.runtime.backends.native.block_writer import FunctionWriter

pytestmark = pytest.mark.skipif(not llvm_compiler.is_available(), reason="llvmlite is not installed")

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
SCENES = sorted(path.relative_to(EXAMPLES).as_posix() for path in EXAMPLES.rglob("*.yaml"))
NUMPY = Options(backend="numpy")
NATIVE = Options(backend="native", wait_for_code=True)
OPTION_SETS = (NUMPY, NATIVE, replace(NATIVE, chunk=8, shuffle_rows=3), replace(NATIVE, chunk=100, threads=5))
KINDS = {"f": F32, "b": BOOL, "x": F32}
DTYPES = {F32: np.float32, BOOL: np.bool_, I32: np.int32}
SPECIAL = (0.0, -0.0, np.inf, -np.inf, np.nan, 1e30, -1e30, 1e-40, 1.0, -1.0, 0.5, 2.0, 3.0, 1e6, 1e7, 6.2831855, 3.4e38, 1e-45)


def loop(op: str) -> tuple[str, tuple[str, ...], str]:
    """A module that applies an operation to arrays: its text, the kinds of its operands and of its result."""
    kinds = (I32,) if op == "number" else tuple(KINDS[letter] for letter in ir.OPERATION_BY_NAME[op].args)
    module = LlvmModule(llvm_compiler.find_host_target())
    w = FunctionWriter(module, AddressLayout({(k,): k for k in range(len(kinds) + 1)}))
    name = add_elementwise_function(module, "of_lanes", kinds, FUNCTION_BY_NAME[op])
    kind = F32 if module.functions[name].startswith("define internal <8 x float>") else BOOL
    with w.builder.write_loop(w.end, LANE_COUNT) as at:
        value = w.builder.call_function(
            name, kind, *(w.builder.load_lanes(w.emit_array_address(k), at, each) for k, each in enumerate(kinds))
        )
        w.builder.store_lanes(w.emit_array_address(len(kinds)), at, value)
    w.add_function_to_module("of_arrays")
    return module.text(), kinds, kind


def random_values(kind: str, seed: int, count: int) -> Any:
    """Values of many sizes, a quarter of them special ones."""
    draw = np.random.default_rng(seed)
    if kind == BOOL:
        return draw.random(count) < 0.5
    if kind == I32:
        return draw.integers(-5, 1000, count).astype(np.int32)
    values = (draw.normal(size=count) * 10.0 ** draw.integers(-6, 7, count)).astype(np.float32)
    values[: count // 4] = draw.choice(np.array(SPECIAL, np.float32), count // 4)
    return values


@pytest.mark.parametrize("op", sorted(FUNCTION_BY_NAME))
def test_an_operation_gives_the_bits_of_numpy(op: str) -> None:
    text, kinds, kind = loop(op)
    code = llvm_compiler.load_object(llvm_compiler.compile_object(text, llvm_compiler.find_host_target()))
    count = 1 << 13
    operands = [random_values(each, 3 + k, count) for k, each in enumerate(kinds)]
    results = np.zeros(count, DTYPES[kind])
    table = np.array([each.ctypes.data for each in (*operands, results)], np.int64)
    code.function("of_arrays")(table.ctypes.data, 0, count)
    with np.errstate(all="ignore"):
        expected = FUNCTION_BY_NAME[op](*operands)
    if kind == F32:
        nan = np.isnan(expected)
        assert np.array_equal(nan, np.isnan(results)) and nan.sum() < count
        expected, results = expected[~nan].view(np.int32), results[~nan].view(np.int32)
    assert np.array_equal(expected, results)


def hashes(scene: str, frames: int, options: Options, most: int = 2000) -> list[str]:
    shot, report = open_scene(EXAMPLES / scene)
    assert shot is not None, report
    crowds = tuple(replace(each, count=min(each.count, most)) for each in shot.setting.crowds)
    world = bind(shot.plan, replace(shot.setting, crowds=crowds), options)
    hash_list = [state_hash(world)]
    for _ in range(frames):
        step(world)
        hash_list.append(state_hash(world))
    return hash_list


MANY_CHUNKS, SOME_CHUNKS, ONE_CHUNK = (
    replace(NATIVE, chunk=8, shuffle_rows=5),
    replace(NATIVE, chunk=104, threads=2),
    replace(NATIVE, chunk=100_000, threads=5),
)


@pytest.mark.parametrize(
    ("scene", "options"),
    [("foraging/scene.yaml", SOME_CHUNKS), ("moods/scene.yaml", MANY_CHUNKS), ("tunnel/scene.yaml", ONE_CHUNK)],
)
def test_examples_have_the_states_that_numpy_gives_them(scene: str, options: Options) -> None:
    assert hashes(scene, 4, options, 150) == hashes(scene, 4, NUMPY, 150)


@pytest.mark.slow
@pytest.mark.parametrize("scene", SCENES)
def test_an_example_has_the_states_that_numpy_gives_it(scene: str) -> None:
    expected = hashes(scene, 18, NUMPY)
    for options in (MANY_CHUNKS, SOME_CHUNKS, ONE_CHUNK):
        assert hashes(scene, 18, options) == expected


def test_a_world_of_every_operation_has_the_states_that_the_reference_gives_it() -> None:
    end_hashes = []
    for options in (Options(backend="reference"), NATIVE, replace(NATIVE, chunk=8, shuffle_rows=2)):
        world = bind(plans.rich(), plans.setting(), options)
        for _ in range(12):
            step(world)
        end_hashes.append(state_hash(world))
    assert end_hashes[0] == end_hashes[1] == end_hashes[2]


DENSE = """
species a {
  mood = 0
  near_by = 0
  ahead = 0
  least = 0
  whose = 0
  state only {
    mood = sum(n in neighbours(3 mm): n.least + distance(n) / 1 mm)
    near_by = count(neighbours(3 mm))
    ahead = count(neighbours(3 mm, 90 deg))
    least = min(10, min(n in neighbours(2 mm): distance(n) / 1 mm))
    whose = best(n in neighbours(3 mm): distance(n)).id
  }
}
"""


@pytest.mark.parametrize("radius", [2.0, 0.0])
def test_of_many_neighbours_the_nearest_count(radius: float) -> None:
    """More than the cap within the radius of each; with a radius of 0 all in one place, where ids decide."""
    history = play(
        DENSE, crowd(700, radius=radius), steps=2, option_sets=(*OPTION_SETS[:2], replace(NATIVE, chunk=200, shuffle_rows=3))
    )
    counts = np.array(history["near_by"])
    assert counts.max() == limits.MAX_QUERY_NEIGHBOURS and (radius == 0 or len(set(history["mood"])) > 1)


def test_a_crowd_in_one_sheet_that_comes_to_lie_level_is_searched_as_before() -> None:
    def run(options: Options) -> list[str]:
        world = bind(plans.rich(), plans.crowd(200), options)
        frame_hashes = []
        for frame in range(6):
            for population in world.populations.values():
                tall = np.linspace(0, 2, len(population), dtype=np.float32) if frame < 3 else np.float32(0)
                population.start["position.y"][:] = population.now["position.y"][:] = tall
            step(world)
            frame_hashes.append(state_hash(world))
        return frame_hashes

    assert run(Options(backend="native", wait_for_code=True)) == run(Options(backend="numpy"))


def test_too_many_in_a_radius_are_reported_as_by_numpy(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(limits, "MAX_CANDIDATES_IN_RADIUS", 300)
    monkeypatch.setattr(stored_blocks, "index_plan", lambda *plan: None)  # what is stored is for the limit of the sources
    messages = []
    for options in (NUMPY, NATIVE):
        with pytest.raises(FaultStop) as stop:
            play(DENSE, crowd(400, radius=1.0), option_sets=(options,))
        messages.append(str(stop.value))
    assert messages[0] == messages[1] and "300" in messages[0]


FAULTY = """
species a {
  mood = 1
  late = 0
  state only {
    late = log(3 - id)
    mood = mood / (id - 5)
  }
}
"""


def test_refused_values_are_reported_as_by_the_reference() -> None:
    fault_reports = []
    for options in (Options(backend="reference"), NUMPY, NATIVE):
        history = play(FAULTY, crowd(12, radius=40), steps=3, option_sets=(replace(options, on_fault="quarantine"),))
        log = history.world.faults
        fault_reports.append((log.fault_count, [str(fault) for fault in log.reported_faults], history["late"], history["mood"]))
    assert fault_reports[0] == fault_reports[1] == fault_reports[2] and fault_reports[0][0] > 2


def test_who_has_given_all_has_0_whatever_the_sign_of_its_zero() -> None:
    text = "species a { load = -(id * 0)\n state only { when true -> only { give all load to nest } } }"
    option_sets = (Options(backend="reference"), NUMPY, NATIVE)
    history = play(text, crowd(9, radius=5), steps=2, option_sets=option_sets, items={"nest": (item("n", 0, 0, 9),)})
    assert np.signbit(history.at("load", 0)).all() and not np.signbit(history["load"]).any()


def rich(options: Options) -> World:
    return bind(plans.rich(), plans.setting(), options)


def test_code_that_becomes_ready_in_mid_run_changes_nothing(monkeypatch: pytest.MonkeyPatch) -> None:
    expected = []
    world = rich(NUMPY)
    for _ in range(8):
        step(world)
        expected.append(state_hash(world))
    world = rich(Options(backend="native"))
    coming: Any = compile_queue.start_code_build(world.plan, world.backend.blocks, compile_queue.WorldFacts(False, False))  # type: ignore[attr-defined]
    ready_code = coming.result()

    class Later:
        steps = 0

        def done(self) -> bool:
            self.steps += 1
            return self.steps > 4

        def result(self) -> Any:
            return ready_code

    monkeypatch.setattr("antdsl.runtime.backends.native.native_backend.find_compiled_code", lambda plan, facts: None)
    world.backend._pending_code = Later()  # type: ignore[attr-defined]
    frame_hashes, native = [], []
    for _ in range(8):
        step(world)
        frame_hashes.append(state_hash(world))
        native.append(world.backend.ready_code is not None)  # type: ignore[attr-defined]
    assert frame_hashes == expected and native == [False] * 4 + [True] * 4


@pytest.mark.parametrize("options", [NUMPY, NATIVE])
def test_without_llvmlite_binding_names_the_package(options: Options, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(llvm_compiler, "find_unavailability_reason", lambda: "llvmlite is not installed: pip install it")
    with pytest.raises(llvm_compiler.MachineCodeUnavailableError, match="llvmlite is not installed: pip install it"):
        rich(options)


WIDE = dict.fromkeys(("avx2", "fma", "fma4", "avx512f", "avx512vl", "avx512dq", "avx512bw", "avx512vbmi2"), True)
TARGETS = {
    "host": llvm_compiler.find_host_target,
    "with fma": lambda: replace(llvm_compiler.PORTABLE_TARGET, features="+avx2,+fma"),
    "of 512 bits": lambda: llvm_compiler.Target(
        llvm_compiler.PORTABLE_TARGET.triple, "icelake-server", llvm_compiler.format_features(WIDE)
    ),
    "arm": lambda: llvm_compiler.Target("aarch64-unknown-linux-gnu", "cortex-a72", "+neon"),
}
FUSED = ("fmadd", "fmsub", "fnmadd", "fnmsub", "fmla", "fmls")


@pytest.mark.parametrize("target", TARGETS)
def test_no_operations_are_fused(target: str) -> None:
    """A fused multiply-add rounds once instead of twice; not even a processor that has one is given it."""
    chosen = TARGETS[target]()
    code = llvm_compiler.compile_assembly(program_listing.build_program(plans.rich(), chosen).text, chosen)
    assert len(code.splitlines()) > 2000
    assert not [line for line in code.splitlines() if any(word in line for word in FUSED)]
    assert ("zmm" in code) == (target == "of 512 bits" or "+avx512f" in chosen.features)


def test_what_implies_that_operations_are_fused_does_not_bring_it_back() -> None:
    """As `xop` of AMD's Bulldozer, which has `fma4` with it."""
    text = """declare <8 x float> @llvm.fma.v8f32(<8 x float>, <8 x float>, <8 x float>)
define void @a(ptr %p) {
  %x = load <8 x float>, ptr %p
  %y = call <8 x float> @llvm.fma.v8f32(<8 x float> %x, <8 x float> %x, <8 x float> %x)
  store <8 x float> %y, ptr %p
  ret void
}"""

    def fused(features: str) -> bool:
        return "vfm" in llvm_compiler.compile_assembly(text, llvm_compiler.Target("x86_64-unknown-linux-gnu", "bdver2", features))

    assert fused("+avx,-fma,-fma4,+xop")
    assert not fused(llvm_compiler.format_features({"avx": True, "fma": True, "fma4": True, "xop": True}))


def reference_operations(program: str, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """What the reference has to compute while a crowd takes two steps with the same states as NumPy's."""
    history, plain, node_names = (
        play(program, crowd(300, radius=60), steps=2, option_sets=(NUMPY,)),
        native_backend.AgentRun.compute_value,
        [],
    )

    def value(agent: native_backend.AgentRun, node: ir.PlanNode) -> Any:
        node_names.append(node.op)
        return plain(agent, node)

    with monkeypatch.context() as patch:
        patch.setattr(native_backend.AgentRun, "compute_value", value)
        world = bind(history.world.plan, history.world.setting, NATIVE)
        for _ in range(2):
            step(world)
    assert state_hash(world) == state_hash(history.world)
    return node_names


def test_a_radius_is_worked_out_of_few_agents_and_never_where_that_takes_the_crowd(monkeypatch: pytest.MonkeyPatch) -> None:
    """Before the first search, to choose its cells by."""
    text = "species a {{ n = 0\n let near = count(neighbours(9 mm))\n state s {{ n = count(neighbours({})) }} }}"
    assert reference_operations(text.format("9 mm + n * 0.1 mm"), monkeypatch) == ["add"] * 8
    assert reference_operations(text.format("9 mm + near * 1 mm"), monkeypatch) == ["const"] * 8, "the radius of `near`"


class Crowd:
    """What is read of a population to learn how far its agents are apart."""

    def __init__(self, positions: Any) -> None:
        self.start = {f"position.{axis}": positions[:, k] for k, axis in enumerate("xyz")}
        self._count = len(positions)

    def __len__(self) -> int:
        return self._count


def test_what_holds_some_agents_is_found_of_lines_sheets_and_clouds() -> None:
    rng = np.random.default_rng(2)
    for extents, expected in (((1000, 0, 0), 8.0), ((1000, 1000, 0), 89.4), ((1000, 1000, 1000), 200.0), ((0, 0, 0), 0.0)):
        positions = (rng.random((1000, 3)) * extents).astype(np.float32)
        population: Any = Crowd(positions)
        assert native_backend._choose_cell_size(population) == pytest.approx(expected, rel=0.01)


def test_arrays_of_cells_that_are_no_longer_needed_are_released() -> None:
    """Radii that grow with time ask for cells of other sizes all the time."""
    text = "species a { n = 0\n reach = 5 mm\n state s { reach = reach * 1.06\n n = count(neighbours(reach)) } }"
    history = play(text, crowd(200, radius=40), steps=60, option_sets=(NATIVE, NUMPY))
    grids = history.world.backend._grids  # type: ignore[attr-defined]
    assert 0 < len(grids._stored_grids) <= 1 + 16 and all(size < np.inf for _, size in grids._stored_grids)
    assert min(each.last_used_step for each in grids._stored_grids.values()) >= grids._step - 16


def test_rows_are_shared_out_among_threads_in_whole_eights() -> None:
    for count, chunk, threads, parts in (
        (15_000, 16_384, 1, 1),
        (15_000, 16_384, 2, 8),
        (2_200, 16_384, 4, 2),
        (125, 16_384, 8, 1),
        (300, 100, 2, 5),
        (100_000, 16_384, 2, 25),
    ):
        size = block_runner._choose_part_size(count, chunk, threads)
        assert size % LANE_COUNT == 0 and -(-count // size) == parts, (count, chunk, threads)


def test_what_is_machine_code_is_listed() -> None:
    shot, _ = open_scene(EXAMPLES / "foraging" / "scene.yaml")
    assert shot is not None
    plan_listing = program_listing.build_program(shot.plan, llvm_compiler.find_host_target())
    text = program_listing.format_listing(plan_listing)
    assert "then NumPy: ray(stones)" in text and "3 times" in text and "searches forager for 2 sets" in text
    counts = program_listing.count_instructions_by_function(plan_listing)
    assert counts == program_listing.count_instructions_by_function(
        program_listing.build_program(shot.plan, llvm_compiler.find_host_target())
    )
    assert f"stage 0: {counts['forager.decide.0']:,} instructions" in text and counts["forager.decide.0"] > 500


def test_another_number_needs_no_other_code() -> None:
    texts = []
    for speed in ("10", "25"):
        text = f"species a {{ max_speed {speed} mm/s\n pace = 1\n state only {{ pace = pace * 1.5 + {speed} }} }}"
        texts.append(
            program_listing.build_program(play(text, option_sets=(NATIVE,)).world.plan, llvm_compiler.find_host_target()).text
        )
    assert texts[0] == texts[1]
