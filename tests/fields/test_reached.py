"""Around which cells a scent is as strong as a number: measured by the smell there, and by programs that test only this."""

from __future__ import annotations

import meshes
import numpy as np
import pytest
from meaning import OPTION_SETS
from plan_text import plan_of

from antdsl.fields.cells import SurfaceCells
from antdsl.fields.pheromone import PheromoneField
from antdsl.fields.threshold_cells import CellsNearThreshold
from antdsl.machine_code import llvm_compiler
from antdsl.numerics import parallel
from antdsl.passes import optimise_plan
from antdsl.runtime import CrowdData, MeshData, Options, PlacementData, WorldSetting, bind, state_hash, step
from antdsl.runtime.backends.native.native_backend import NativeBackend

NATIVE = Options(backend="native", chunk=16, threads=2, wait_for_code=True)
WORLD = "ant 1\nuse steering\nworld { surface ground }\nfield scent on ground { cell 4 mm; half_life 2 s }\n"


@pytest.mark.parametrize("k", [1, 9, 16, 27])
def test_counts_equal_a_search_for_strong_cells(k: int, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(parallel, "count_available_cores", lambda: 4)
    monkeypatch.setattr(parallel, "MIN_LIGHT_ITEMS_PER_THREAD", 100)  # so that it goes in parts
    field = PheromoneField(SurfaceCells([meshes.terrain(150, 30)], 4.0))
    rng, every, least = np.random.default_rng(k), np.arange(len(field.cells)), np.float32(0.1)
    reached = CellsNearThreshold(field, least, k)
    for share in (0.0, 0.01, 0.012, 0.5, 1.0, 0.02, 0.0):
        held = rng.choice([0.1 - 1e-12, float(least), 3.0, np.inf], len(every))  # the first is 0.1 in float32
        field.amounts[:] = np.where(rng.random(len(every)) < share, held, rng.choice([0.0, 0.0999, np.nan], len(every)))
        is_reached = reached.update_counts(3)
        assert np.array_equal(is_reached[:-1] > 0, field.sample_strongest(every, k)[0] >= least) and is_reached[-1] == 0
        assert np.array_equal(reached.update_counts(), is_reached)


@pytest.mark.parametrize("least", [0.0, -1.0, np.nan])
def test_a_threshold_of_zero_holds_everywhere(least: float) -> None:
    field = PheromoneField(SurfaceCells([meshes.grid(40, 4)], 4.0))
    assert CellsNearThreshold(field, np.float32(least), 16).update_counts().all()


def test_matches_only_its_field_and_threshold() -> None:
    field, other = (PheromoneField(SurfaceCells([meshes.grid(40, 4)], 4.0)) for _ in range(2))
    reached = CellsNearThreshold(field, np.float32(1), 9)
    assert (
        reached.has_same_settings(field, np.float32(1))
        and not reached.has_same_settings(field, np.float32(2))
        and not reached.has_same_settings(other, np.float32(1))
    )
    field.extend_arrays(np.empty(0, np.int64))
    assert not reached.has_same_settings(field, np.float32(1))


def program(asks: str) -> str:
    return f"""species a {{
  param faint = 0.2 in 0 .. 10
  max_speed 20 mm/s
  got = 0
  start p
  state p {{
    steer wander()
    deposit scent 4 /s
    {asks}
  }}
  state q {{
    steer climb(scent) * 0.5 + wander()
    when max(scent) < faint held 0.1 s -> p
  }}
}}"""


@pytest.mark.parametrize(
    ("asks", "bounded"),
    [
        ("when max(scent) > faint -> q", 2),
        ("when max(scent) > 0 * faint -> q", 2),
        ("when max(scent) <= faint and got == 0 -> q", 2),
        ("when faint < max(scent) -> q { got = max(scent) }", 2),
        ("got = max(scent)\n when max(scent) > faint -> q", 2),  # in another block
        ("when max(scent) > faint -> q\n when max(scent) > 0.5 -> p", 1),
        ("when max(scent) > faint * got -> q", 1),
    ],
)
def test_comparisons_give_equal_agents(asks: str, bounded: int) -> None:
    plan = optimise_plan(plan_of(program(asks), WORLD))
    crowd = CrowdData("a", 24, PlacementData(disc_centre=(0.0, 0.0, 0.0), radius=12.0))
    setting = WorldSetting(crowds=(crowd,), surfaces={"ground": MeshData(*meshes.grid(60.0, 3))}, seed=4)
    hashes = []
    for options in (*OPTION_SETS[::2], NATIVE) if llvm_compiler.is_available() else OPTION_SETS[::2]:
        world = bind(plan, setting, options)
        hashes.append([])
        states = []
        for _ in range(10):
            step(world)
            hashes[-1].append(state_hash(world))
            states.append(world.populations["a"].now["main.state"].mean())
        if isinstance(world.backend, NativeBackend) and options is NATIVE:
            assert world.backend.ready_code is not None
            assert len(world.backend.ready_code.block_codes["a", "decide"].scent_thresholds) == bounded
    assert all(each == hashes[0] for each in hashes)
    assert 0 < np.mean(states) < 1
