"""Bodies before, during and after a walk, and what rises before them: the same bits by kernels and with NumPy."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from compilers import need_kernels

from antdsl.casting.rays import RayScene
from antdsl.ground.mesh.surface import MeshGround
from antdsl.ground.plane import Plane
from antdsl.ground.protocol import Move
from antdsl.numerics import compiled
from antdsl.numerics import vectors as vec
from antdsl.runtime.moving import advance, obstacles, tilting
from antdsl.runtime.world import Population
from tests.meshes import box, terrain

N = 1200
DT = np.float32(1 / 24)


class People(SimpleNamespace):
    """What bodies read of a population."""

    room = Population.room

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
    for name, vectors in (("up", up), ("heading", heading), ("push", unit(rng))):
        now |= {f"{name}.{axis}": np.ascontiguousarray(vectors[:, k]) for k, axis in enumerate("xyz")}
    if facing:
        wish = unit(rng) * rng.choice([0, 1], (N, 1)).astype(np.float32)
        now |= {f"~face.{axis}": np.ascontiguousarray(wish[:, k]) for k, axis in enumerate("xyz")}
    start = {name: array.copy() for name, array in now.items()}
    place = ground.position(footing)
    return People(now=now, start=start, normal=normal, footing=footing, position=place, laid=None, rooms={})


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


@pytest.mark.parametrize("facing", [False, True])
def test_bodies_have_the_same_bits(ground: MeshGround, facing: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    need_kernels()
    found = []
    for fast in (False, True):
        monkeypatch.setattr(compiled, "wanted", lambda count, fast=fast: fast)
        crowd, rng = people(ground, 3, facing), np.random.default_rng(4)
        world = SimpleNamespace(ground=ground, options=SimpleNamespace(threads=1))
        step = vec.scale(vec.named(crowd.now, "push"), np.where(rng.random(N) < 0.1, 0, 0.8).astype(np.float32))
        with np.errstate(all="ignore"):
            body = tilting.bodies(world, crowd, step, DT)
            going = body.paced(step, vec.named(crowd.now, "push"))
            before = crowd.position
            crowd.position = before + going.wish
            for name, vectors in (("up", crowd.normal), ("heading", unit(rng))):
                for k, axis in enumerate("xyz"):
                    crowd.now[f"{name}.{axis}"][:] = vectors[:, k]
            body.follow(rng.random(N) < 0.2, before, DT)
        r = body.rises
        walls = {"rows": r.rows, "wall": r.wall, "ahead": r.ahead, "angle": r.angle, "far": r.far, "over": r.over, "half": r.half}
        told = {name: getattr(going, name) for name in ("at_once", "wish", "looking", "up", "size")}
        ways = {f"{name}{k}": v for name in ("step", "velocity") for k, v in enumerate(getattr(going, name))}
        found.append({**crowd.now, **told, **ways, **{f"a wall's {name}": v.copy() for name, v in walls.items()}})
    assert_same(*found)
    assert 20 < len(found[0]["a wall's rows"]) < N and (found[0]["step0"] != vec.named(crowd.start, "push")[0]).any()


def test_bodies_are_laid_and_stand_up_with_the_same_bits(ground: MeshGround, monkeypatch: pytest.MonkeyPatch) -> None:
    need_kernels()
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
    need_kernels()
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


def test_steps_along_an_obstacle_are_the_same(monkeypatch: pytest.MonkeyPatch) -> None:
    need_kernels()
    rng, found = np.random.default_rng(8), []
    scene = RayScene(*box((-2, -2, -2), (2, 3, 1)))
    place, step = (tuple((size * rng.normal(size=(3, N))).astype(np.float32)) for size in (3, 2))
    up = tuple(np.ascontiguousarray(unit(rng).T))
    for component in step:
        component[:50] = 0
    radius, clear = odd(rng, 0, -1, np.nan, np.inf), odd(rng, 0, np.inf, 1)
    for fast in (False, True):
        monkeypatch.setattr(compiled, "wanted", lambda count, fast=fast: fast)
        along = obstacles._along(scene, place, step, up, radius, clear, 1)  # type: ignore[arg-type]
        slowed = advance._slowed(People(rooms={}), step, along, place, np.float32(24), 1)  # type: ignore[arg-type]
        found.append({str(k): v for k, v in enumerate((*along, *slowed))})
    assert_same(*found)
    bent = sum(found[0][str(k)] != step[k] for k in range(3)) > 0
    assert 0.1 < bent.mean() < 0.9
