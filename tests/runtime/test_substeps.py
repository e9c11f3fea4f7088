"""Substeps of crowds against one agent after another in float64; bodies that are laid and stand up again."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

from antdsl.ground.mesh.surface import MeshGround
from antdsl.ground.plane import PlaneGround
from antdsl.runtime.moving import crowd_substep, tilting
from antdsl.runtime.moving.clearance import walls_ahead
from antdsl.runtime.moving.velocities import LEANING_BODY_STATE, STANDING_BODY_STATE
from antdsl.runtime.world import Population
from tests.meshes import box, terrain
from tests.motion_oracle import Agent, find_walls, laid, substep

N = 300
DT = np.float32(1 / 24)


class People(SimpleNamespace):
    """What bodies read of a population."""

    get_buffers, vector = Population.get_buffers, Population.read_vector

    def __len__(self) -> int:
        return len(self.position)


def unit(rng: np.random.Generator, n: int = N) -> np.ndarray:
    random_vectors = rng.normal(size=(n, 3))
    return (random_vectors / np.linalg.norm(random_vectors, axis=1, keepdims=True)).astype(np.float32)


def odd(rng: np.random.Generator, *values: float) -> np.ndarray:
    return rng.choice([2.0, 3.0, 4.0, *values], N).astype(np.float32)


def people(ground: MeshGround, seed: int, facing: bool) -> People:
    """A crowd on a ground of which some lean, some stand upside down and some have sizes and limits that are none."""
    rng = np.random.default_rng(seed)
    points = rng.uniform(ground.low, ground.high, (N, 3))
    is_among_pieces = rng.random(N) < 0.7
    points[is_among_pieces] = rng.uniform((-8, -1, -9), (8, 1, 9), (N, 3))[is_among_pieces]  # where pieces cut each other
    footing, _ = ground.find_nearest(points)
    normal = ground.normal(footing).astype(np.float32)
    up, heading = normal.copy(), unit(rng)
    heading -= normal * (heading * normal).sum(axis=1, keepdims=True)
    heading /= np.linalg.norm(heading, axis=1, keepdims=True)
    heading[12:16] = up[12:16]  # straight up
    leans = rng.random(N) < 0.3
    up[leans] = unit(rng)[leans]
    up[:9] = -normal[:9]
    now = {"size": odd(rng, 0, -1, np.nan, np.inf), "max_speed": odd(rng, 0, -1, 30, 60)}
    now |= {"max_turn": odd(rng, 0, -1, np.inf, np.inf, np.nan), "max_force": odd(rng, 1e3, np.inf, np.nan, 200)}
    now |= {"mass": odd(rng, 0, np.nan), "response": odd(rng, 0, DT), "radius": odd(rng)}
    velocity = (unit(rng) * rng.choice([0, 1, 40], (N, 1))).astype(np.float32)
    velocity[rng.random(N) < 0.02] = rng.choice([-0.0, np.inf, np.nan], 3)
    push = unit(rng) * rng.choice(np.float32([0.5, 3]), (N, 1))
    for name, vectors in (("up", up), ("heading", heading), ("push", push), ("velocity", velocity), ("position", 0 * up)):
        now |= {f"{name}.{axis}": np.ascontiguousarray(vectors[:, k]) for k, axis in enumerate("xyz")}
    if facing:
        wish = unit(rng) * rng.choice([0, 1], (N, 1)).astype(np.float32)
        now |= {f"~face.{axis}": np.ascontiguousarray(wish[:, k]) for k, axis in enumerate("xyz")}
    start = {name: array.copy() for name, array in now.items()}
    place, alone = ground.position(footing), rng.random(N) < 0.05
    stands = {"normal": normal, "footing": footing, "position": place}
    plan = SimpleNamespace(settings=(), has_body_clearance=False)
    return People(now=now, start=start, laid=None, buffers={}, quarantined=alone, plan=plan, **stands)


@pytest.fixture(scope="module")
def ground() -> MeshGround:
    hills, faces = terrain(24, 8)
    return MeshGround({"hills": (hills, faces), "a": box((-7, -3, -8), (-2, 4, 3)), "b": box((3, -3, 2), (7, 4, 8))})


def by_rays() -> MeshGround:
    return MeshGround({"a": box((-7, -3, -8), (7, 4, 3))}, by_rays=True)


# An agent that its least speed drives straight back has its heading opposite to that, and turns to either side.
@pytest.mark.parametrize(
    "of, facing, keeps, number, undecided",
    [
        ("meshes", False, False, 0, 0.007),
        ("meshes", True, False, 1, 0.007),
        ("plane", True, True, 0, 0.007),
        ("rays", False, True, 0, 0.03),
    ],
)
def test_substeps_are_those_of_one_agent_after_another(
    ground: MeshGround, of: str, facing: bool, keeps: bool, number: int, undecided: float
) -> None:
    world_ground = {"meshes": ground, "rays": by_rays(), "plane": PlaneGround(np.array([0.36, 0.48, 0.8]))}[of]
    crowd = people(ground, 3, facing)
    if of != "meshes":
        crowd.footing = world_ground.find_nearest(crowd.position)[0]
        crowd.position = world_ground.position(crowd.footing)
    else:
        crowd.footing.mesh[16:19] = -1  # nowhere
    if keeps:
        crowd.now["min_speed"] = odd(np.random.default_rng(4), 0, -1, np.nan, np.inf)
    setting = SimpleNamespace(substeps=2, orient="normal", crowds=())
    options, plan = SimpleNamespace(threads=2), SimpleNamespace(obstacles=(), list_things_of_kind=lambda kind: ())
    world = SimpleNamespace(
        ground=world_ground, options=options, dt=float(DT), setting=setting, plan=plan, solids={}, up=(0, 1, 0), notes=None
    )
    walls = 0
    with np.errstate(all="ignore"):
        for _ in range(2):
            agents = substep(world_ground, crowd, float(DT), float(np.float32(DT / 2)), number == 0)
            crowd_substep.move_agents(world, crowd, number)  # type: ignore[arg-type]
            walls += sum(agent.wall is not None for agent in agents)
            for name, own in (("velocity", 2e-3), ("heading", 2e-3), ("up", 2e-3)):
                expected = np.array([getattr(agent, name) for agent in agents])
                result = np.stack([crowd.now[f"{name}.{axis}"] for axis in "xyz"], axis=1)
                off = np.abs(result - expected).max(axis=1) / np.maximum(1, np.abs(expected).max(axis=1))
                assert (off > own).mean() <= undecided, name
            place = np.array([agent.place for agent in agents])
            assert (np.abs(crowd.position - place).max(axis=1) > 1e-4).mean() <= undecided
            registers = np.stack([crowd.now[f"position.{axis}"] for axis in "xyz"], axis=1)
            assert np.array_equal(crowd.position.astype(np.float32), registers)
    leans = sum(crowd.now[f"up.{axis}"] != crowd.normal[:, k] for k, axis in enumerate("xyz")) > 0
    assert 10 < leans.sum() < N and (of != "meshes" or walls > 20)


def standing(crowd: People) -> tuple[dict[str, np.ndarray], dict[str, np.ndarray]]:
    return ({name: array.copy() for name, array in registers.items()} for registers in (crowd.now, crowd.start))  # type: ignore


def test_bodies_that_lean_are_laid_along_the_ground_and_stand_up_again(ground: MeshGround) -> None:
    crowd = people(ground, 5, False)
    old_registers, start = standing(crowd)
    up, heading = (np.stack([old_registers[f"{name}.{axis}"] for axis in "xyz"], axis=1) for name in ("up", "heading"))
    tilting.align_leaning_bodies_with_ground(crowd, 2)
    leans = (up != crowd.normal).any(axis=1)
    for registers in (crowd.now, crowd.start):
        assert np.array_equal(np.stack([registers[f"up.{axis}"] for axis in "xyz"], axis=1), crowd.normal)
        laid_heading = np.stack([registers[f"heading.{axis}"] for axis in "xyz"], axis=1)
        expected = [laid(*(v[i].astype(float) for v in (heading, up, crowd.normal))) for i in np.flatnonzero(leans)]
        assert np.array_equal(laid_heading[~leans], heading[~leans]) and np.allclose(laid_heading[leans], expected, atol=1e-6)
    assert 60 < leans.sum() < N - 60
    is_changed = np.random.default_rng(6).random(N) < 0.2
    for axis in "xyz":
        other = crowd.now[f"heading.{axis}"].copy()
        crowd.now[f"heading.{axis}"][is_changed] += np.float32(0.5)  # by one component only
        tilting.restore_leaning_bodies(crowd)
        assert crowd.laid is None
        for name in old_registers:
            same = ~is_changed | ~leans | (not name.startswith("heading")) if name != f"heading.{axis}" else ~is_changed
            assert np.array_equal(crowd.now[name][same], old_registers[name][same], equal_nan=True), name
            assert np.array_equal(crowd.start[name], start[name], equal_nan=True), name
        assert np.array_equal(crowd.now[f"heading.{axis}"][is_changed], other[is_changed] + np.float32(0.5))
        crowd.now |= {name: array.copy() for name, array in old_registers.items()}
        tilting.align_leaning_bodies_with_ground(crowd)


def test_bodies_that_begin_before_a_wall_are_tilted_for_it(ground: MeshGround) -> None:
    crowd = people(ground, 7, False)
    for k, axis in enumerate("xyz"):
        crowd.now[f"up.{axis}"] = crowd.normal[:, k].copy()
    old_registers, start = standing(crowd)
    agents = [Agent.of(crowd, i) for i in range(N)]
    for agent in agents:
        agent.step = np.zeros(3)
    find_walls(ground, crowd, agents)
    chosen = np.random.default_rng(8).random(N) < 0.7
    chosen[min(i for i, agent in enumerate(agents) if agent.wall is not None)] = True
    rows = np.flatnonzero(chosen)
    world = SimpleNamespace(ground=ground, options=SimpleNamespace(threads=1), up=(0, 1, 0))
    with np.errstate(all="ignore"):
        tilting.tilt_new_bodies(world, crowd, rows)  # type: ignore[arg-type]
    tilts = 0
    for i, agent in enumerate(agents):
        up, heading = agent.normal, agent.heading
        if i in rows and agent.wall is not None:
            up = agent.tilted(agent.normal, np.zeros(3))
            heading, tilts = laid(heading, agent.normal, up), tilts + (up @ agent.normal < 0.99)
            for name, expected in (("up", up), ("heading", heading)):
                for registers in (crowd.now, crowd.start):
                    assert np.allclose([registers[f"{name}.{axis}"][i] for axis in "xyz"], expected, atol=1e-5)
        else:
            assert all(np.array_equal(crowd.now[name][i], old_registers[name][i], equal_nan=True) for name in old_registers)
            assert all(np.array_equal(crowd.start[name][i], start[name][i], equal_nan=True) for name in start)
    assert tilts > 5


@pytest.mark.parametrize("facing", [False, True])
def test_walls_are_those_that_bodies_tilt_for(ground: MeshGround, facing: bool) -> None:
    crowd = people(ground, 9, facing)
    agents = [Agent.of(crowd, i) for i in range(N)]
    for agent, step in zip(agents, unit(np.random.default_rng(10)) * np.float32(0.7), strict=True):
        agent.step = step.astype(float)
    find_walls(ground, crowd, agents)
    step = tuple(np.ascontiguousarray([agent.step[k] for agent in agents], np.float32) for k in range(3))
    looking = tuple(np.ascontiguousarray([agent.looking[k] for agent in agents], np.float32) for k in range(3))
    state = np.array([LEANING_BODY_STATE if agent.leans else STANDING_BODY_STATE for agent in agents], np.int32)
    reach, world = np.empty(N), SimpleNamespace(ground=ground, options=SimpleNamespace(threads=1), up=(0, 1, 0))
    walls_ahead.write_wall_reach(crowd.now["size"], reach)
    assert np.allclose(reach, [3 * agent.half for agent in agents])
    nearby_walls = walls_ahead.find_walls(world, crowd, looking, step, reach, state)  # type: ignore[arg-type]
    walls = [agent.wall for agent in agents]
    assert (
        np.array_equal(state >= 0, [wall is not None for wall in walls])
        and (state >= 0).sum() == len(nearby_walls.distances) > 20
    )
    for k, wall in ((state[i], wall) for i, wall in enumerate(walls) if wall is not None):
        assert np.allclose(nearby_walls.normals[:, k], wall.normal, atol=1e-5) and np.allclose(
            nearby_walls.directions[:, k], wall.ahead, atol=1e-5
        )
        own = [nearby_walls.angles[k], nearby_walls.distances[k], nearby_walls.tilt_distances[k], nearby_walls.half_lengths[k]]
        assert np.allclose(own, [wall.angle, wall.far, wall.over, wall.half], atol=1e-4)
