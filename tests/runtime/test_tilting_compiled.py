"""Substeps of odd crowds, bodies that are laid, walks over planes, steps along obstacles: the same bits by kernels and NumPy."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from antdsl.casting.rays import RayScene
from antdsl.ground.mesh.surface import MeshGround
from antdsl.ground.plane import Plane
from antdsl.ground.protocol import Move
from antdsl.numerics import compiled
from antdsl.numerics import vectors as vec
from antdsl.runtime.moving import advance, obstacles, rises, tilting
from antdsl.runtime.world import Population
from tests.meshes import box, terrain

N = 1200
DT = np.float32(1 / 24)


class People(SimpleNamespace):
    """What bodies read of a population."""

    room, vector = Population.room, Population.vector

    def __len__(self) -> int:
        return N


def unit(rng: np.random.Generator) -> np.ndarray:
    found = rng.normal(size=(N, 3))
    return (found / np.linalg.norm(found, axis=1, keepdims=True)).astype(np.float32)


def odd(rng: np.random.Generator, *values: float) -> np.ndarray:
    return rng.choice([2.0, 3.0, 4.0, *values], N).astype(np.float32)


def people(ground: MeshGround, seed: int, facing: bool) -> People:
    """A crowd on a ground of which some lean, some stand upside down and some have sizes and limits that are none."""
    rng = np.random.default_rng(seed)
    footing, _ = ground.nearest(rng.uniform(ground.low, ground.high, (N, 3)))
    normal = ground.normal(footing).astype(np.float32)
    up, heading = normal.copy(), unit(rng)
    leans = rng.random(N) < 0.3
    up[leans] = unit(rng)[leans]
    up[:20] = -normal[:20]
    now = {"size": odd(rng, 0, -1, np.nan, np.inf), "max_speed": odd(rng, 0, -1, np.inf, np.nan)}
    now |= {"max_turn": odd(rng, 0, -1, np.inf, np.nan)}
    now |= {
        "max_force": odd(rng, 1e30, np.inf, np.nan, 200),
        "mass": odd(rng, 0, -1, np.nan),
        "response": odd(rng, 0, DT),
        "radius": odd(rng),
    }
    velocity = (unit(rng) * rng.choice([0, 1e-20, 1, 40], (N, 1))).astype(np.float32)
    velocity[rng.random(N) < 0.02] = rng.choice([-0.0, np.inf, np.nan], 3)
    for name, vectors in (("up", up), ("heading", heading), ("push", unit(rng)), ("velocity", velocity), ("position", 0 * up)):
        now |= {f"{name}.{axis}": np.ascontiguousarray(vectors[:, k]) for k, axis in enumerate("xyz")}
    if facing:
        wish = unit(rng) * rng.choice([0, 1], (N, 1)).astype(np.float32)
        now |= {f"~face.{axis}": np.ascontiguousarray(wish[:, k]) for k, axis in enumerate("xyz")}
    start = {name: array.copy() for name, array in now.items()}
    place, alone = ground.position(footing), rng.random(N) < 0.05
    stands = {"normal": normal, "footing": footing, "position": place}
    return People(now=now, start=start, laid=None, rooms={}, quarantined=alone, **stands)


def assert_same(one: dict[str, Any], two: dict[str, Any]) -> None:
    for name, array in one.items():
        a, b = np.ascontiguousarray(array), np.ascontiguousarray(two[name])
        nan = np.isnan(a) if a.dtype.kind == "f" else np.zeros(a.shape, bool)  # a NaN's own bits carry no meaning
        assert a.dtype == b.dtype and a.shape == b.shape and np.array_equal(nan, np.isnan(b)), name
        assert a[~nan].tobytes() == b[~nan].tobytes(), name


@pytest.fixture(scope="module")
def ground() -> MeshGround:
    hills, faces = terrain(24, 8)
    return MeshGround({"hills": (hills, faces), "a": box((-7, -3, -8), (-2, 4, 3)), "b": box((3, -3, 2), (7, 4, 8))})


def by_rays() -> MeshGround:
    return MeshGround({"a": box((-7, -3, -8), (7, 4, 3))}, by_rays=True)


@pytest.mark.parametrize(
    "facing, keeps, orient, substep", [(False, False, "normal", 0), (True, True, "normal", 1), (False, True, "turns", 0)]
)
@pytest.mark.parametrize("of", ["meshes", "plane", "rays"])
def test_substeps_have_the_same_bits(
    ground: MeshGround, of: str, facing: bool, keeps: bool, orient: str, substep: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    found: list[dict[str, Any]] = []
    here = {"meshes": ground, "rays": by_rays(), "plane": Plane(np.array([0.36, 0.48, 0.8]))}[of]
    walls = []
    taken = rises.Rises.take
    monkeypatch.setattr(rises.Rises, "take", lambda self, which: walls.append(len(which)) or taken(self, which))
    for fast in (False, True):
        monkeypatch.setattr(compiled, "wanted", lambda count, fast=fast: fast)
        crowd = people(ground, 3, facing)
        if of != "meshes":
            crowd.footing = here.nearest(crowd.position)[0]
            crowd.position = here.position(crowd.footing)
        else:
            crowd.footing.mesh[:7] = -1
        if keeps:
            crowd.now["min_speed"] = odd(np.random.default_rng(4), 0, -1, np.nan, np.inf)
        setting = SimpleNamespace(substeps=2, orient=orient, crowds=())
        plan = SimpleNamespace(of_kind=lambda kind: ())
        world = SimpleNamespace(
            ground=here, options=SimpleNamespace(threads=2), dt=float(DT), setting=setting, plan=plan, solids={}
        )
        with np.errstate(all="ignore"):
            for _ in range(3):
                advance.move(world, crowd, substep)  # type: ignore[arg-type]
        found.append({**crowd.now, **crowd.footing.columns, "place": crowd.position, "normal": crowd.normal})
    assert_same(*found)
    leans = sum(crowd.now[f"up.{axis}"] != crowd.normal[:, k] for k, axis in enumerate("xyz")) > 0
    assert 20 < leans.sum() < N and (of != "meshes" or max(walls) > 20)


def test_bodies_are_laid_and_stand_up_with_the_same_bits(ground: MeshGround, monkeypatch: pytest.MonkeyPatch) -> None:
    found = []
    for fast in (False, True):
        monkeypatch.setattr(compiled, "wanted", lambda count, fast=fast: fast)
        crowd, rng = people(ground, 5, False), np.random.default_rng(6)
        tilting.lay(crowd)
        shown = {f"shown {name}": array.copy() for name, array in (crowd.now | crowd.start).items()}
        told = np.flatnonzero(rng.random(N) < 0.2)
        crowd.now["heading.y"][told] = 0.5
        tilting.stand_up(crowd)
        assert crowd.laid is None
        found.append({**shown, **crowd.now, **{f"start {name}": array for name, array in crowd.start.items()}})
    assert_same(*found)


def test_straight_walks_have_the_same_bits(monkeypatch: pytest.MonkeyPatch) -> None:
    rng, plane = np.random.default_rng(7), Plane(np.array([0.36, 0.48, 0.8]))
    footing, _ = plane.nearest(rng.normal(0, 30, (N, 3)))
    way, heading = rng.normal(size=(N, 3)) * rng.choice([0, 1e-200, 1], (N, 1)), unit(rng).astype(np.float64)
    found: list[dict[str, Any]] = []
    for fast in (False, True):
        monkeypatch.setattr(compiled, "wanted", lambda count, fast=fast: fast)
        moved: Move = plane.move(footing, vec.rows(tuple(way.T)), heading, heading, 1.0)
        columns = dict(zip(map(str, range(8)), moved.columns(), strict=False))
        found.append({**columns, **moved.footing.columns})
    assert_same(*found)


@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("odd_sizes", [False, True])
def test_steps_along_an_obstacle_are_the_same(monkeypatch: pytest.MonkeyPatch, odd_sizes: bool, threads: int) -> None:
    rng, found = np.random.default_rng(8), []
    scene = RayScene(*box((-2, -2, -2), (2, 3, 1)))
    place, step = (tuple((size * rng.normal(size=(3, N))).astype(np.float32)) for size in (3, 2))
    up = tuple(np.ascontiguousarray(unit(rng).T))
    for component in step:
        component[:50] = 0
    radius, clear = odd(rng, 0, -1, np.nan, np.inf), odd(rng, 0, np.inf, 1)
    asked: list[int] = []
    apart = scene.apart
    monkeypatch.setattr(scene, "apart", lambda x, *others: asked.append(len(x)) or apart(x, *others))
    monkeypatch.setattr(compiled, "LIGHT", N // 4)
    if not odd_sizes:  # then the grid of triangles tells of all, in one call
        radius = np.abs(np.nan_to_num(radius, nan=1, posinf=1)) % 4
        place = tuple(np.clip(each, -6, 6) for each in place)
    for fast in (False, True):
        monkeypatch.setattr(compiled, "wanted", lambda count, fast=fast: fast)
        along = obstacles._along(scene, place, step, up, radius, clear, threads)  # type: ignore[arg-type]
        found.append({str(k): v for k, v in enumerate(along)})
    assert_same(*found)
    assert len(asked) == (2 if odd_sizes else 1)
    bent = sum(found[0][str(k)] != step[k] for k in range(3)) > 0
    assert 0.1 < bent.mean() < 0.9
