"""Values per pair in a cache: its frames have them as three arrays, and `explain` tells how they changed, by the other's id."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
from explained import cached

from antdsl.explain import CacheHistory, StepReplay, explain_agents, format_explanation, open_shot
from antdsl.outputs.cache.cache_reader import Cache
from antdsl.plan.registers import list_slot_register_names
from antdsl.runtime import Options, bind, step

ROOT = Path(__file__).resolve().parents[2]
BUG = """ant 1
use steering
world { surface ground }
species bug {
  near = 0 mm relax to 0 mm over 1 s for each bug, strongest 3
  load = 0
  start go
  state go {
    steer wander()
    near[n in neighbours(28 mm)] += 30 mm/s - distance(n) * 1 /s
    when near[nearest(bug)] > 1 m -> go { load += 1 }
  }
}
"""
SCENE = """antdsl: 1
units: cm
frames: 1..8
seed: 3
world: {ground: {mesh: ground.ply}}
crowd:
  - {species: bug, from: bug.ant, count: 9, place: {on: ground, radius: 3 cm}}
output: {checkpoint: 4, attributes: [P, id, near, load]}
"""


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Cache:
    folder = tmp_path_factory.mktemp("pairs")
    shutil.copy(ROOT / "examples" / "minimal" / "ground.ply", folder)
    (folder / "bug.ant").write_text(BUG)
    (folder / "scene.yaml").write_text(SCENE)
    return cached(folder / "scene.yaml", 8, folder / "out" / "scene")


def pairs(cache: Cache, frame: int) -> dict[tuple[int, int], float]:
    arrays = cache.frame(frame)
    ids, others, values = (arrays[f"pairs.bug.near.{part}"] for part in ("id", "other", "value"))
    assert (ids.dtype, others.dtype, values.dtype) == (np.dtype("<i8"), np.dtype("<i8"), np.dtype("<f4"))
    assert np.array_equal(np.lexsort((others, ids)), np.arange(len(ids)))
    return {(int(a), int(b)): float(value) for a, b, value in zip(ids, others, values, strict=True)}


def test_frames_hold_values_per_pair_in_scene_units(cache: Cache) -> None:
    assert "near" not in cache.manifest.attributes and "load" in cache.manifest.attributes
    assert pairs(cache, 1) == {}
    now = pairs(cache, 8)
    world = bind(open_shot(cache).plan, open_shot(cache).setting, Options(backend="numpy"))
    for _ in range(7):
        step(world)
    bugs, expected = world.populations["bug"], {}
    for who, value in list_slot_register_names("near", 3):
        held = zip(bugs.ids.tolist(), bugs.now[who].tolist(), bugs.now[value].tolist(), strict=True)
        expected |= {(agent, other): mm / 10 for agent, other, mm in held if other >= 0}
    assert now == pytest.approx(expected, rel=1e-6) and len(now) > 12
    assert all(0 < value < 3 / 24 * 7 for value in now.values())  # cm: less than 30 mm/s for seven frames


def test_explain_reports_changes_of_values_per_pair(cache: Cache) -> None:
    replay = StepReplay(CacheHistory.from_cache(cache, open_shot(cache)))
    previous_pairs, next_pairs = pairs(cache, 5), pairs(cache, 6)
    (explanation,) = explain_agents(replay, 6, [("bug", 4)])
    assert explanation is not None
    changes = {each.name: each for each in explanation.changes if each.name.startswith("near")}
    others = {b for a, b in {*previous_pairs, *next_pairs} if a == 4}
    assert changes.keys() == {f"near[{other}]" for other in others}
    for other in others:
        each = changes[f"near[{other}]"]
        if (4, other) in next_pairs:
            assert each.after == pytest.approx(next_pairs[4, other] * 10, rel=1e-5) and each.unit == "mm"
        else:
            assert each.after == "nothing"
    assert any(f"near[{other}]: " in format_explanation(explanation) for other in others)
