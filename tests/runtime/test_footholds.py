"""Kernels that find ground for feet, against all triangles of a mesh and against whole arrays in NumPy's float64."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import trimesh
from foot_frames import Points
from test_foot_steps import COUNT, F32, LEGS, Crowd, close

from antdsl.casting.rays import RayScene
from antdsl.casting.tolerances import MAX_RAY_CUBES, MAX_SEARCH_RINGS
from antdsl.runtime.feet import foothold_kernels, stepping
from antdsl.runtime.feet.feet_state import NO_GROUND_NUMBER
from antdsl.runtime.feet.foothold_kernels import NEAR_HIT_LEG_SHARE, RAY_LENGTH_FACTOR, REQUEST_FACE_BITS
from antdsl.runtime.feet.foothold_search import GroundHits
from antdsl.runtime.feet.gaits import MAX_SINK_SHARE
from tests.meshes import terrain

RAYS = 400
NO_RINGS = np.empty(0), np.empty(0, np.int32), np.empty(0, np.float32)


def hill() -> tuple[RayScene, Points, Points]:
    """A mesh as a scene of rays, the corners of its triangles and their greatest edge."""
    vertices, faces = terrain(60.0, 12)
    vertices += np.array([100.0, -40.0, 30.0])
    corners = vertices[faces]
    return RayScene(vertices, faces), corners, np.linalg.norm(corners[:, 1] - corners[:, 0], axis=1).max()


def first_hits(corners: Points, origin: Points, displacement: Points) -> tuple[Points, Any]:
    """Part of the ray and face of the first hit of each ray [3, k], by linear equations for every face; inf without a hit."""
    edges = np.stack([corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]], axis=2)
    part, face = np.full(origin.shape[1], np.inf), np.full(origin.shape[1], -1)
    for k in range(origin.shape[1]):
        matrices = np.concatenate([edges, np.broadcast_to(-displacement[:, k, None], (len(corners), 3, 1))], axis=2)
        a, b, t = np.linalg.solve(matrices, (origin[:, k] - corners[:, 0])[:, :, None])[:, :, 0].T
        t = np.where((a >= 0) & (b >= 0) & (a + b <= 1) & (t >= 0) & (t <= 1), t, np.inf)
        part[k], face[k] = t.min(), int(t.argmin()) if np.isfinite(t.min()) else -1
    return part, face


def is_in_box(low: Points, high: Points, box: tuple[Points, Points]) -> Any:
    """Which of the boxes from `low` to `high` [3, k] touch another box."""
    least, greatest = box
    return (low <= greatest[:, None]).all(axis=0) & (high >= least[:, None]).all(axis=0)


@pytest.mark.parametrize("walks", [True, False])
def test_rays_of_feet_hit_the_first_of_all_faces(walks: bool) -> None:
    scene, corners, edge = hill()
    rng, tables = np.random.default_rng(3), scene.get_tables()
    assert tables is not None
    below = rng.integers(0, len(corners), RAYS)
    origin = np.ascontiguousarray(corners[below].mean(axis=1).T)
    origin[1] += rng.uniform(-0.1, 1.0, RAYS) * edge * rng.choice([0.3, 1.0], RAYS)
    displacement = rng.normal(0, 0.5, (3, RAYS)) * edge
    displacement[1] -= rng.uniform(0, 2, RAYS) * edge
    displacement[:, ::10] *= 80  # longer than the grid answers
    starts = np.where(rng.random(RAYS) < 0.5, 2 << REQUEST_FACE_BITS | below, -1)
    starts[::7] = 1 << REQUEST_FACE_BITS | below[::7]  # of another mesh
    # Rays beyond the box are left out, where no walk answers them.
    box = corners.min(axis=(0, 1)), corners.max(axis=(0, 1)) - [0.0 if walks else edge, 0, 0]
    hits, far = GroundHits.empty(RAYS), np.full(RAYS, -1)
    hits.ray_fraction[::5], hits.position[:, ::5] = 0.02, 7.0  # hit before, on nearer ground
    rings = scene.get_ring_tables() if walks else NO_RINGS
    assert rings is not None
    first_starts, left = starts.copy(), []
    for part in ((0, 150), (150, RAYS)):
        first, many = foothold_kernels.cast_foot_rays_on_mesh(
            tables, rings, box, 2, origin, displacement, starts, hits.columns, far, *part
        )
        assert first == part[0]
        left += far[first : first + many].tolist()

    low, high = np.minimum(origin, origin + displacement), np.maximum(origin, origin + displacement)
    inside = is_in_box(low, high, box)
    cubes = np.abs(displacement).sum(axis=0) / tables[0][3]
    part, face = first_hits(corners, origin, displacement)
    short, long = np.ones(RAYS, np.bool_), np.zeros(RAYS, np.bool_)
    short[left], long[left] = False, True
    assert (cubes[left] > MAX_RAY_CUBES - 3).all() and inside[left].all() and len(left) > 15 and (long == ~short).all()
    better = inside & short & (part < np.where(np.arange(RAYS) % 5 == 0, 0.02, np.inf))
    assert better.sum() > 100 and (~inside & np.isfinite(part)).any() != walks
    previous_part = np.where(np.arange(RAYS) % 5 == 0, 0.02, np.inf)
    close(hits.ray_fraction, np.where(better, part, previous_part), 1e-9)
    close(hits.position.T[better], (origin + displacement * part).T[better], 1e-9)
    assert (hits.position.T[~better] == np.where(previous_part[~better] < 1, 7, 0)[:, None]).all()
    assert (hits.thing_numbers == np.where(better, 2, NO_GROUND_NUMBER)).all() and not hits.face.any() and not hits.weight.any()
    changed = starts != first_starts
    assert (starts[changed] == (2 << REQUEST_FACE_BITS | face)[changed]).all() and changed.any() == walks
    assert not (changed & (first_starts >> REQUEST_FACE_BITS != 2)).any()


def test_the_nearest_ground_is_that_of_all_faces() -> None:
    scene, corners, edge = hill()
    rng, tables = np.random.default_rng(4), scene.get_tables()
    assert tables is not None
    points = np.ascontiguousarray(corners[rng.integers(0, len(corners), RAYS)].mean(axis=1).T) + rng.normal(0, edge, (3, RAYS))
    reach = rng.uniform(0, 1.5, RAYS) * edge
    reach[::9] = 5 * tables[0][3]  # farther than the grid answers
    reach[1::9] = MAX_SEARCH_RINGS * tables[0][3]
    greatest_reach, box = reach.copy(), (corners.min(axis=(0, 1)), corners.max(axis=(0, 1)) - [2 * edge, 0, 0])
    hits, far = GroundHits.empty(RAYS), np.full(RAYS, -1)
    left = []
    for part in ((0, 150), (150, RAYS)):
        first, many = foothold_kernels.find_nearest_on_mesh(tables, box, 3, points, reach, hits.columns, far, *part)
        assert first == part[0]
        left += far[first : first + many].tolist()
    inside = is_in_box(points - greatest_reach, points + greatest_reach, box)
    mesh = trimesh.Trimesh(corners.reshape(-1, 3), np.arange(3 * len(corners)).reshape(-1, 3), process=False)
    place, distance, _ = trimesh.proximity.closest_point_naive(mesh, points.T)
    assert left == np.flatnonzero(inside & (greatest_reach > MAX_SEARCH_RINGS * tables[0][3])).tolist() and len(left) > 20
    short = inside.copy()
    short[left] = False
    hit = short & (distance < greatest_reach)
    assert hit.sum() > 100 and (short & ~hit).sum() > 50 and (~inside & (distance < greatest_reach)).any()
    close(reach, np.where(hit, distance, greatest_reach), 1e-9)
    close(hits.ray_fraction, np.where(hit, distance, np.inf), 1e-9)
    close(hits.position, np.where(hit, place.T, 0), 1e-8)
    assert (hits.thing_numbers == np.where(hit, 3, NO_GROUND_NUMBER)).all()


def test_feet_look_for_ground_from_where_their_hips_will_be() -> None:
    rng, crowd = np.random.default_rng(6), Crowd(7)
    targets = (*rng.normal(0, 0.4, (2, LEGS, COUNT)).astype(F32), rng.uniform(0, 9, (LEGS, COUNT)).astype(F32))
    what = rng.integers(0, 4, (LEGS, COUNT)).astype(np.uint8)
    agent, leg = np.sort(rng.integers(0, COUNT, 300)), rng.integers(0, LEGS, 300)
    requests, standing = agent << stepping.REQUEST_LEG_BITS | leg, rng.integers(-1, 9, COUNT)
    buffer = np.zeros((14, 300))
    seekers = buffer[:3], buffer[3:6], buffer[6:9], buffer[12], buffer[13]
    steps, starts, quick = buffer[9:12], np.zeros(300, np.int64), np.zeros(300, np.bool_)
    measures, trunks = (crowd.gaits.legs, crowd.gaits.exact_legs), (crowd.phase, crowd.rise, crowd.slope)
    aim = requests, crowd.bodies, crowd.covered, measures, trunks, (*targets, what), standing, seekers, (steps, starts), quick
    for part in ((0, 100), (100, 300)):
        foothold_kernels.aim_first_rays(*aim, *part)
    hips = crowd.hips(crowd.slope, crowd.rise / crowd.frames.size)
    hips[[0, 2]] += crowd.covered * targets[2].astype(float)
    goals = np.stack([targets[0], np.zeros((LEGS, COUNT)), targets[1]])
    hip, goal = (crowd.world(each)[:, leg, agent] for each in (hips, goals))
    close(seekers[0], hip, 1e-5), close(seekers[1], goal, 1e-5), close(steps, (goal - hip) * RAY_LENGTH_FACTOR, 1e-4)
    assert np.array_equal(seekers[2], crowd.frames.axes[agent, 1].T) and np.array_equal(starts, standing[agent])
    size = crowd.frames.size[agent]
    close(seekers[3], crowd.legs.length[leg] * size * 0.97, 1e-12), close(seekers[4], crowd.legs.foot[leg, 1] * size, 1e-12)
    assert np.array_equal(quick, what[leg, agent] == stepping.LIFTING_FOOT)


class Seekers:
    """Random seekers [k] with hips over their target positions, and hits near them."""

    def __init__(self, seed: int, count: int) -> None:
        self.rng, self.count = np.random.default_rng(seed), count
        up = self.rng.normal(size=(3, count))
        self.up = up / np.linalg.norm(up, axis=0)
        self.longest, self.sole = self.rng.uniform(1, 4, count), self.rng.uniform(0, 0.3, count)
        self.goal = self.rng.normal(0, 30, (3, count))
        self.hip = self.goal + self.up * self.longest * self.rng.uniform(-0.2, 1.1, count)
        self.hip += self.rng.normal(0, 0.3, (3, count)) * self.longest

    @property
    def columns(self) -> Any:
        return self.hip, self.goal, self.up, self.longest, self.sole

    def hits(self, rows: Any, spread: float, share: float = 0.8) -> GroundHits:
        """Hits near the target positions of a share of the rows."""
        hits = GroundHits.empty(len(rows))
        present = self.rng.random(len(rows)) < share
        hits.ray_fraction[present] = self.rng.uniform(0, 1, present.sum())
        hits.position[:] = self.goal[:, rows] + self.rng.normal(0, spread, (3, len(rows))) * self.longest[rows]
        hits.thing_numbers[:], hits.face[:] = self.rng.integers(-1, 5, len(rows)), self.rng.integers(0, 99, len(rows))
        hits.thing_numbers[~present] = NO_GROUND_NUMBER
        hits.weight[:] = self.rng.uniform(0, 1, (2, len(rows)))
        return hits

    def reaches(self, hits: GroundHits, rows: Any) -> Any:
        """Which hits the legs of rows reach: the hip's ball, flattened below by as much as trunks come down."""
        joint = hits.position + self.up[:, rows] * self.sole[rows] - self.hip[:, rows]
        high = (joint * self.up[:, rows]).sum(axis=0)
        level = np.linalg.norm(joint - self.up[:, rows] * high, axis=0)
        sunk = np.where(high < 0, np.minimum(high + MAX_SINK_SHARE * self.longest[rows], 0), high)
        return np.isfinite(hits.ray_fraction) & (np.hypot(level, sunk) <= self.longest[rows])

    def misses(self, hits: GroundHits, rows: Any) -> Points:
        return np.asarray(np.linalg.norm(hits.position - self.goal[:, rows], axis=0))


def copy_of(hits: GroundHits) -> GroundHits:
    return GroundHits(*(each.copy() for each in hits.columns))


def assert_hits(hits: GroundHits, choices: list[Any], sources: list[GroundHits | None]) -> None:
    """Each column of `hits` comes from the chosen source; without one it is that of no hit."""
    assert sum(each.astype(int) for each in choices).max() <= 1
    for k, column in enumerate(hits.columns):
        expected = GroundHits.empty(len(hits.ray_fraction)).columns[k]
        for chosen, source in zip(choices, sources, strict=True):
            expected = np.where(chosen, (source or GroundHits.empty(len(hits.ray_fraction))).columns[k], expected)
        assert np.array_equal(column, expected), k


def test_hits_in_reach_are_used_and_others_searched_for() -> None:
    seekers = Seekers(11, 500)
    every = np.arange(500)
    hits, quick = seekers.hits(every, 0.25), seekers.rng.random(500) < 0.3
    fits, rows, listed = np.zeros(500, np.bool_), np.full(500, -1), []
    for part in ((0, 180), (180, 500)):
        first, many = foothold_kernels.mark_reachable_hits(seekers.columns, hits.columns, quick, fits, rows, *part)
        assert first == part[0]
        listed += rows[first : first + many].tolist()
    reached, near = seekers.reaches(hits, every), seekers.misses(hits, every) <= NEAR_HIT_LEG_SHARE * seekers.longest
    assert np.array_equal(fits, reached & ~quick)
    assert listed == np.flatnonzero(~quick & ~(reached & near)).tolist()
    assert (reached & ~near).sum() > 30 and (~reached & near & np.isfinite(hits.ray_fraction)).sum() > 10

    rows = np.array(listed)
    above, level, down, origins = np.zeros((4, 3, len(rows)))
    foothold_kernels.aim_detour_rays(seekers.columns, rows, above, level, down, origins, 0, 40)
    foothold_kernels.aim_detour_rays(seekers.columns, rows, above, level, down, origins, 40, len(rows))
    hip, goal, up = (each[:, rows] for each in seekers.columns[:3])
    height = np.maximum(((hip - goal) * up).sum(axis=0), 0.2 * seekers.longest[rows])
    close(above, goal + up * height, 1e-12), close(origins + level, above, 1e-12)
    assert np.array_equal(origins, hip)
    close(down, -up * (2 * height + seekers.longest[rows]), 1e-12)


def test_the_hit_nearest_to_the_target_is_chosen() -> None:
    seekers = Seekers(12, 800)
    every, rows = np.arange(800), np.arange(0, 800, 2)
    hits, level, down = seekers.hits(every, 0.4), seekers.hits(rows, 0.4, 0.5), seekers.hits(rows, 0.4)
    fits = seekers.reaches(hits, every)
    original, lost, reach, listed = copy_of(hits), np.full(400, -1), np.full(400, np.nan), []
    inputs = seekers.columns, rows, hits.columns, fits, level.columns, down.columns, lost, reach
    for part in ((0, 150), (150, 400)):
        first, many = foothold_kernels.choose_nearest_hits(*inputs, *part)
        assert first == part[0]
        listed += list(zip(lost[first : first + many].tolist(), reach[first : first + many].tolist(), strict=True))
    blocked = np.isfinite(level.ray_fraction)
    miss = np.stack([
        np.where(fits[rows], seekers.misses(original, every)[rows], np.inf),
        np.where(blocked & seekers.reaches(level, rows), seekers.misses(level, rows), np.inf),
        np.where(~blocked & seekers.reaches(down, rows), seekers.misses(down, rows), np.inf),
    ])  # fmt: skip
    best, least = miss.argmin(axis=0), miss.min(axis=0)
    chosen = [np.isfinite(least) & (best == k) for k in range(3)]
    assert all(each.sum() > 40 for each in chosen)
    first_hit = GroundHits(*(each[..., rows] for each in original.columns))
    assert_hits(GroundHits(*(each[..., rows] for each in hits.columns)), chosen, [first_hit, level, down])
    for old, new in zip(original.columns, hits.columns, strict=True):
        assert np.array_equal(old[..., 1::2], new[..., 1::2])
    far = np.flatnonzero(least > 2 * NEAR_HIT_LEG_SHARE * seekers.longest[rows])
    assert [n for n, _ in listed] == far.tolist()
    close([each for _, each in listed], np.minimum(seekers.longest[rows], least)[far], 1e-12)


def test_near_ground_is_accepted_where_the_hip_sees_it() -> None:
    seekers = Seekers(13, 600)
    every, rows = np.arange(600), np.arange(1, 600, 2)
    hits, near, sight = seekers.hits(every, 0.3), seekers.hits(rows, 0.3), seekers.hits(rows, 0.3)
    gap = seekers.rng.normal(0, 1, (3, 300))
    gap *= seekers.longest[rows] * seekers.rng.choice([5e-4, 9.9e-4, 1.1e-3, 0.1], 300) / np.linalg.norm(gap, axis=0)
    sight.position[:] = near.position + gap
    original = copy_of(hits)
    foothold_kernels.accept_visible_positions(seekers.columns, rows, near.columns, sight.columns, hits.columns, 0, 100)
    foothold_kernels.accept_visible_positions(seekers.columns, rows, near.columns, sight.columns, hits.columns, 100, 300)
    visible = ~np.isfinite(sight.ray_fraction) | (np.linalg.norm(gap, axis=0) < 1e-3 * seekers.longest[rows])
    used = visible & seekers.reaches(near, rows)
    assert 60 < used.sum() < 200 and (~visible).sum() > 60
    previous = GroundHits(*(each[..., rows] for each in original.columns))
    assert_hits(GroundHits(*(each[..., rows] for each in hits.columns)), [used, ~used], [near, previous])
    assert np.array_equal(hits.position[:, ::2], original.position[:, ::2])


def test_feet_stand_on_what_was_found_or_hang_over_their_target() -> None:
    seekers = Seekers(14, 200)
    hits = seekers.hits(np.arange(200), 0.3)
    rng = np.random.default_rng(9)
    numbers = rng.permutation(50 * LEGS)[:200]
    agent, leg = numbers // LEGS, numbers % LEGS
    place, weight = np.full((3, LEGS, 50), -1.0), np.full((2, LEGS, 50), -1.0)
    on, face = np.full((LEGS, 50), 77, np.int16), np.full((LEGS, 50), 77, np.int32)
    inputs = agent << stepping.REQUEST_LEG_BITS | leg, seekers.columns, hits.columns, place, on, face, weight
    foothold_kernels.store_footholds(*inputs, 0, 90)
    assert (on == 77).sum() == 50 * LEGS - 90
    foothold_kernels.store_footholds(*inputs, 90, 200)
    hangs = hits.thing_numbers == NO_GROUND_NUMBER
    assert np.array_equal(place[:, leg, agent], np.where(hangs, seekers.goal, hits.position)) and 20 < hangs.sum() < 80
    assert np.array_equal(on[leg, agent], hits.thing_numbers) and np.array_equal(face[leg, agent], hits.face)
    assert np.array_equal(weight[:, leg, agent], hits.weight)
    assert (on == 77).sum() == (face == 77).sum() == (weight[0] == -1).sum() == 50 * LEGS - 200
