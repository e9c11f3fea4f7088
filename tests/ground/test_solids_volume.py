"""Solids as signed distances: what is inside and how far, what digging removes in any order, and what is stored."""

from __future__ import annotations

from typing import Any

import meshes
import numpy as np
import pytest

from antdsl.ground.solid import UnusableMeshReason, Volume, trilinear
from antdsl.ground.solid.bricks import UINT64_MASK, compute_fill_steps, hash_nodes
from antdsl.ground.solid_feelers import SolidProximityQueries

Dig = tuple[np.ndarray, np.ndarray, np.ndarray]


def make_solid(mesh: meshes.Mesh, voxel: float = 1.0, **options: Any) -> Volume:
    solid = Volume.from_mesh(*mesh, voxel, **options)
    assert isinstance(solid, Volume)
    return solid


def ball(radius: float = 12.0, voxel: float = 1.0) -> Volume:
    return make_solid(meshes.ball(radius, rings=24), voxel)


def random_directions(n: int, seed: int = 1) -> np.ndarray:
    v = np.random.default_rng(seed).normal(size=(n, 3))
    return v / np.linalg.norm(v, axis=1)[:, None]


def nodes(solid: Volume) -> np.ndarray:
    """Where all nodes are."""
    count = np.prod(solid.bricks.node_counts)
    return solid.low + np.stack(np.unravel_index(np.arange(count), solid.bricks.node_counts), axis=1) * solid.voxel


def digging(n: int = 60, seed: int = 3) -> Dig:
    """Balls of several sizes around the rim of `ball`, some at one place, some owners several times."""
    rng = np.random.default_rng(seed)
    centres = random_directions(n, seed) * rng.uniform(4, 14, (n, 1))
    centres[::7] = centres[0]
    radii = rng.uniform(0.5, 5, n)
    radii[::7] = 4.0
    return centres, radii, rng.integers(0, n // 2, n)


# ---- from a mesh


@pytest.mark.parametrize("voxel", [1.0, 0.7, 2.0])
def test_a_ball_is_as_far_away_as_it_should_be(voxel: float) -> None:
    mesh = meshes.ball(24.0, rings=60)
    solid, directions = make_solid(mesh, voxel), random_directions(2000)
    inner, outer = solid.distance_band
    for away, rough in ((0.0, 0.0), (0.2 * outer, 0.0), (0.5 * outer, 0.1 * voxel)):
        error = solid.sample_distances(directions * (24 + away)) - np.float32(away)
        # Facets lie inside the ball, and the field is straight between nodes.
        assert np.abs(error).max() < 0.02 + voxel * voxel / 18 + rough
    assert (solid.sample_distances(directions * (24 + 0.6 * inner)) < 0.5 * inner).all()
    assert (solid.sample_distances(directions * 3) == np.float32(inner)).all() and (
        solid.sample_distances(directions * 500) == np.float32(outer)
    ).all()
    assert abs(solid.measure_volume() / (4 / 3 * np.pi * 24**3) - 1) < 0.01


def test_a_box_has_flat_sides_where_they_should_be() -> None:
    solid = make_solid(meshes.box((-10, -6, -8), (10, 6, 8)))
    rng = np.random.default_rng(0)
    for axis, side in ((0, 10.0), (1, 6.0), (2, 8.0)):
        points = rng.uniform(-3, 3, (500, 3))
        for away in (-0.5, 0.0, 0.5, 2.0):
            points[:, axis] = side + away
            assert np.abs(solid.sample_distances(points) - away).max() < 1e-5
        # Nodes above the sides know no corner, so the slope is that of the side.
        slope = solid.sample_gradients(points)
        assert np.abs(slope - np.eye(3)[axis]).max() < 1e-5
    assert abs(solid.measure_volume() / (20 * 12 * 16) - 1) < 0.02


def test_distances_are_those_to_the_mesh() -> None:
    from antdsl.casting.rays import RayScene

    vertices, faces = meshes.ball(20.0, rings=9)
    vertices = vertices * [1.0, 0.4, 0.7] + [3.3, 0.1, -7.7]
    solid = make_solid((vertices, faces))
    points = nodes(solid)
    distances = solid.sample_distances(points)
    near = np.flatnonzero((distances > solid.distance_band[0]) & (distances < solid.distance_band[1]))
    truth = RayScene(vertices, faces).find_closest(points[near])[3]
    assert near.size > 5000
    assert np.abs(np.abs(distances[near]) - truth)[truth < 1.7].max() < 1e-5
    assert np.abs(np.abs(distances[near]) - truth).max() < 0.2


def test_the_gradient_is_that_of_the_samples() -> None:
    solid, points = ball(), random_directions(400) * np.random.default_rng(4).uniform(11, 14, (400, 1))
    step = 1e-3
    slope = solid.sample_gradients(points)
    same_cell = np.ones(400, bool)
    differences = np.empty((400, 3))
    for axis in range(3):
        ends = [points + sign * step * np.eye(3)[axis] for sign in (-1, 1)]
        cells = [np.floor((end - solid.low) / solid.voxel) for end in ends]
        same_cell &= (cells[0] == cells[1]).all(axis=1)
        differences[:, axis] = (solid.sample_distances(ends[1]).astype(float) - solid.sample_distances(ends[0])) / (2 * step)
    assert same_cell.sum() > 350
    assert np.abs(differences - slope)[same_cell].max() < 2e-3


@pytest.mark.parametrize("voxel", [1.0, 0.7])
def test_the_field_between_nodes_is_a_weighted_mean_of_eight(voxel: float) -> None:
    rng, solid = np.random.default_rng(1), ball(voxel=voxel)
    solid.carve_balls(rng.normal(size=(30, 3)) * 6, rng.uniform(1, 4, 30), np.arange(30))
    dense, count = solid.bricks.to_dense().astype(np.float64), np.array(solid.bricks.node_counts)
    points = rng.uniform(solid.low - 3, solid.high + 3, (20_000, 3))
    points[1000:3000] = solid.low + np.round((points[1000:3000] - solid.low) / voxel) * voxel  # at nodes
    at = np.clip((points - solid.bricks.origin) / voxel, 0, count - 1)
    node = np.minimum(at.astype(int), count - 2)
    part, distance, gradient = at - node, np.zeros(len(at)), np.zeros((3, len(at)))
    for corner in np.ndindex(2, 2, 2):
        share = np.where(np.array(corner), part, 1 - part)
        value = dense[tuple((node + corner).T)]
        distance += share.prod(axis=1) * value
        for axis in range(3):
            gradient[axis] += (2 * corner[axis] - 1) * np.delete(share, axis, axis=1).prod(axis=1) * value / voxel
    values, *slope = trilinear.sample_with_gradients(solid.bricks, *points.T)
    assert np.abs(values - distance).max() < 1e-12 and np.array_equal(values.astype(np.float32), solid.sample_distances(points))
    inner = ~(np.abs(at - np.round(at)) < 1e-9).any(axis=1)  # at nodes the slope is that of either side
    assert np.abs(np.stack(slope) - gradient)[:, inner].max() < 1e-10 and inner.sum() > 10_000
    assert np.abs(trilinear.sample_distances(solid.bricks, *points.T) - distance).max() < 1e-12
    far = np.array([[np.nan] * 3, [-np.inf] * 3, [1e300, 0, 0]])
    rim = solid.bricks.origin + np.array([[0, 0, 0], [0, 0, 0], [count[0] - 1, *(-solid.bricks.origin[1:] / voxel)]]) * voxel
    assert np.array_equal(trilinear.sample_distances(solid.bricks, *far.T), trilinear.sample_distances(solid.bricks, *rim.T))
    none = np.empty((3, 0))
    assert [len(each) for each in trilinear.sample_with_gradients(solid.bricks, *none)] == [0] * 4


def test_points_are_projected_by_limited_newton_steps() -> None:
    """Against the same steps for all points at once. Where the field is flat, as deep in the solid, they follow hints."""
    rng, solid = np.random.default_rng(6), ball()
    solid.carve_balls(rng.normal(size=(30, 3)) * 6, rng.uniform(1, 4, 30), np.arange(30))
    voxel, n = solid.voxel, 3000
    start, hints = rng.uniform(-15, 15, (n, 3)), random_directions(n, 7)
    start[:3] = np.nan, np.inf, -np.inf
    tolerance, landed, normals, is_on_surface = 1e-5 * voxel, np.empty((n, 3)), np.empty((n, 3)), np.empty(n, np.bool_)
    trilinear.project_points_to_surface(
        trilinear.make_brick_tables(solid.bricks), start, hints, tolerance, landed, normals, is_on_surface
    )
    place, pending = start.copy(), np.isfinite(start).all(axis=1)
    expected, expected_normals, is_expected = start.copy(), hints.copy(), np.zeros(n, np.bool_)
    for turn in range(60):
        distance, *slope = trilinear.sample_with_gradients(solid.bricks, *place.T)
        gradient = np.stack(slope, axis=1)
        size = np.linalg.norm(gradient, axis=1)
        is_new = pending & (np.abs(distance) <= tolerance)
        expected[is_new], is_expected[is_new], pending = place[is_new], True, pending & ~is_new
        unit = gradient / np.maximum(size, 1e-300)[:, None]
        expected_normals[is_new] = np.where(size[:, None] > 0, unit, hints)[is_new]
        is_flat = (size * size < 0.01) | (turn % 3 == 2)
        with np.errstate(all="ignore"):
            newton = (
                gradient
                * np.where(np.abs(distance) > voxel * size, voxel * -np.sign(distance) / size, -distance / size**2)[:, None]
            )
        place = np.where(pending[:, None], place + np.where(is_flat[:, None], -distance[:, None] * hints, newton), place)
    assert np.array_equal(is_on_surface, is_expected) and 100 < n - is_on_surface.sum() < n / 2
    assert np.abs(landed[is_on_surface] - expected[is_on_surface]).max() < 1e-9
    assert np.abs(normals - expected_normals)[is_on_surface].max() < 1e-7
    for own, other in ((landed, start), (normals, hints)):
        assert np.array_equal(own[~is_on_surface], other[~is_on_surface], equal_nan=True)


def test_a_cavity_a_shell_turned_inside_out_and_overlapping_balls_have_the_right_inside() -> None:
    v1, f1 = meshes.ball(15.0)
    v2, f2 = meshes.ball(8.0)
    hollow = make_solid((np.concatenate([v1, v2]), np.concatenate([f1, f2[:, ::-1] + len(v1)])))
    inward = make_solid((v1, f1[:, ::-1]))
    twice = make_solid((np.concatenate([v1, v1 + np.array([9.0, 0, 0])]), np.concatenate([f1, f1 + len(v1)])))
    middle = np.array([[0.0, 0, 0], [4.5, 0, 0], [11.5, 0, 0], [20.0, 0, 0]])
    assert list(hollow.sample_distances(middle) < 0) == [False, False, True, False]
    assert list(inward.sample_distances(middle) < 0) == [True, True, True, False]
    assert list(twice.sample_distances(middle) < 0) == [True, True, True, True]


def test_faces_wound_in_disorder_make_the_same_solid() -> None:
    vertices, faces = meshes.ball(12.0)
    mixed = np.where((np.arange(len(faces)) % 3 == 0)[:, None], faces[:, ::-1], faces)
    assert make_solid((vertices, mixed)).measure_volume() == make_solid((vertices, faces)).measure_volume()


@pytest.mark.parametrize("voxel", [0.0, -1.0, float("nan"), 1e-6])
def test_a_voxel_that_cannot_be_is_refused_before_memory_is_taken(voxel: float) -> None:
    problem = Volume.from_mesh(*meshes.ball(12.0), voxel)
    assert isinstance(problem, UnusableMeshReason) and problem.help


def test_too_many_voxels_name_a_size_that_will_do() -> None:
    problem = Volume.from_mesh(*meshes.ball(12.0), 0.5, cap=10_000)
    assert isinstance(problem, UnusableMeshReason) and "more than the limit of 10,000" in problem.message
    size = float(problem.help.split("voxel: ")[1].split(" mm")[0])
    assert isinstance(Volume.from_mesh(*meshes.ball(12.0), size, cap=10_000), Volume)


@pytest.mark.parametrize("mesh", [(np.zeros((0, 3)), np.zeros((0, 3), int)), (np.full((3, 3), np.nan), np.array([[0, 1, 2]]))])
def test_meshes_without_sense_are_no_solids(mesh: meshes.Mesh) -> None:
    assert isinstance(Volume.from_mesh(*mesh, 1.0), UnusableMeshReason)


def test_an_open_mesh_is_no_solid() -> None:
    vertices, faces = meshes.ball(12.0)
    problem = Volume.from_mesh(vertices, faces[:-1], 1.0)
    assert isinstance(problem, UnusableMeshReason) and "3 edges" in problem.message


# ---- digging


def test_what_is_removed_is_what_is_missing_and_what_analysis_says() -> None:
    solid = ball(20.0)
    previous_volume = solid.measure_volume()
    removed = solid.carve_balls(np.zeros((1, 3)), np.array([6.0]), np.array([0]))
    assert removed[0] == previous_volume - solid.measure_volume() == solid.removed_volume
    assert abs(removed[0] / (4 / 3 * np.pi * 216) - 1) < 0.01
    assert solid.carve_balls(np.zeros((1, 3)), np.array([5.5]), np.array([0]))[0] == 0
    directions = random_directions(500)
    points = directions * np.random.default_rng(1).uniform(5, 7, (500, 1))
    assert np.abs(solid.sample_distances(points) - (6 - np.linalg.norm(points, axis=1))).max() < 0.1


@pytest.mark.parametrize("voxel", [1.0, 0.3, 0.7])
def test_sums_are_exact_to_the_last_bit(voxel: float) -> None:
    solid = ball(voxel=voxel)
    previous_volume = solid.measure_volume()
    total = 0.0
    for seed in range(4):
        removed = solid.carve_balls(*digging(seed=seed))
        total += removed.sum()
        assert (removed >= 0).all() and previous_volume - solid.measure_volume() == total == solid.removed_volume


def test_the_order_of_digging_does_not_matter() -> None:
    centres, radii, owners = digging()
    a, b = ball(), ball()
    first = a.carve_balls(centres, radii, owners)
    order = np.random.default_rng(5).permutation(len(radii))
    second = b.carve_balls(centres[order], radii[order], owners[order])
    assert a.compute_digest() == b.compute_digest() and (a.bricks.volume_steps == b.bricks.volume_steps)
    per_owner = [np.bincount(o, r, len(radii)) for o, r in ((owners, first), (owners[order], second))]
    assert (per_owner[0] == per_owner[1]).all()


def test_digging_in_parts_ends_in_the_same_solid() -> None:
    centres, radii, owners = digging()
    a, b = ball(), ball()
    a.carve_balls(centres, radii, owners)
    for subset in np.array_split(np.random.default_rng(6).permutation(len(radii)), 7):
        b.carve_balls(centres[subset], radii[subset], owners[subset])
    assert a.compute_digest() == b.compute_digest() and a.measure_volume() == b.measure_volume()
    assert (a.sample_distances(centres) == b.sample_distances(centres)).all()


def test_what_two_dig_at_once_goes_to_the_deeper_and_at_a_tie_to_the_least_owner() -> None:
    solid = ball(20.0)
    at = np.zeros((3, 3))
    removed = solid.carve_balls(at, np.array([4.0, 4.0, 3.0]), np.array([8, 2, 1]))
    assert removed[0] == 0 and removed[2] == 0 and removed[1] > 200
    separate_volumes = solid.carve_balls(np.array([[12.0, 0, 0], [13.0, 0, 0]]), np.array([3.0, 3.0]), np.array([1, 2]))
    alone = ball(20.0).carve_balls(np.array([[12.0, 0, 0]]), np.array([3.0]), np.array([1]))
    assert 0 < separate_volumes[0] < alone[0]


@pytest.mark.parametrize("voxel", [1.0, 0.7])
def test_digging_is_that_of_every_ball_at_every_node(voxel: float) -> None:
    (vertices, faces), offset = meshes.ball(12.0, rings=24), np.array([3.3, 40.1, -7.7])
    solid = make_solid((vertices + offset, faces), voxel)
    for seed in range(3):
        centres, radii, owners = digging(60, seed)
        centres[5], radii[5] = [37.0 - seed, 3.0, 2.0], 28.0  # a great one, of another kind
        centres += offset
        old_distances, mark, points = solid.bricks.to_dense().ravel(), solid.bricks.node_hash_sum, nodes(solid)
        removed = solid.carve_balls(centres, radii, owners)
        order = np.lexsort((radii, centres[:, 2], centres[:, 1], centres[:, 0], owners))
        values = np.empty((len(order), len(points)), np.float32)
        for row, k in enumerate(order):
            x, y, z = (points - centres[k]).T
            brush = (radii[k] - np.sqrt((x * x + y * y) + z * z)).astype(np.float32)
            values[row] = np.minimum(brush, np.float32(solid.bricks.max_distance))
        new_distances, first = np.maximum(old_distances, values.max(axis=0)), values.argmax(axis=0)
        assert np.array_equal(solid.bricks.to_dense().ravel(), new_distances)
        lost = compute_fill_steps(old_distances, voxel) - compute_fill_steps(new_distances, voxel)
        expected = np.zeros(len(order))
        expected[order] = (
            np.bincount(first, np.where(new_distances > old_distances, lost, 0), len(order)) * solid.bricks.step_volume
        )
        assert np.array_equal(removed, expected) and (removed > 0).sum() > 10
        i, j, k = np.unravel_index(np.arange(len(points)), solid.bricks.node_counts)
        brick = ((i >> 4) * solid.bricks.shape[1] + (j >> 4)) * solid.bricks.shape[2] + (k >> 4)
        number = (brick << 12) + ((i & 15) << 8) + ((j & 15) << 4) + (k & 15)
        change = (hash_nodes(number, new_distances) - hash_nodes(number, old_distances)).sum(dtype=np.uint64)
        assert solid.bricks.node_hash_sum == (mark + int(change)) & UINT64_MASK


def test_balls_without_sense_and_far_away_dig_nothing_and_great_ones_everything() -> None:
    solid = ball()
    previous_digest = solid.compute_digest()
    centres = np.array([[np.nan, 0, 0], [0.0, 0, 0], [0.0, 0, 0], [900.0, 0, 0], [np.inf, 0, 0]])
    removed = solid.carve_balls(centres, np.array([2.0, np.nan, -1.0, 5.0, 2.0]), np.arange(5))
    assert not removed.any() and solid.compute_digest() == previous_digest
    removed = solid.carve_balls(np.zeros((2, 3)), np.array([1e9, 40.0]), np.array([5, 6]))
    assert removed[1] == 0 or removed[0] == 0
    assert solid.measure_volume() == 0 and removed.sum() == solid.removed_volume


def test_a_great_ball_digs_as_a_small_one() -> None:
    solid = ball(60.0, 2.0)
    points = nodes(solid)
    old_distances = solid.sample_distances(points)
    solid.carve_balls(np.array([[60.0, 0, 0]]), np.array([70.0]), np.array([0]))
    brush = 70 - np.linalg.norm(points - [60.0, 0, 0], axis=1)
    want = np.clip(np.maximum(old_distances, brush), *solid.distance_band)
    assert (old_distances != want).mean() > 0.1
    assert np.abs(solid.sample_distances(points) - want).max() < 1e-5


# ---- keeping


def test_a_state_is_restored_even_where_more_was_dug() -> None:
    a, b = ball(), ball()
    first, second = digging(), digging(seed=9)
    a.carve_balls(*first)
    state, digest = a.get_changes(), a.compute_digest()
    a.carve_balls(*second)
    b.restore_changes(a.get_changes())
    assert b.compute_digest() == a.compute_digest() != digest and a.measure_volume() == b.measure_volume()
    for solid in (a, b):
        solid.restore_changes(state)
        assert solid.compute_digest() == digest and solid.carve_balls(*first).sum() == 0
    assert (a.carve_balls(*second) == b.carve_balls(*second)).all() and a.compute_digest() == b.compute_digest()


def test_a_state_of_something_else_is_refused() -> None:
    solid = ball()
    solid.carve_balls(*digging())
    state = solid.get_changes()
    for wrong in (
        ball(voxel=0.9).get_changes(),
        state | {"values": state["values"][:-1]},
        state | {"bricks": state["bricks"] + 10_000},
        state | {"values": np.full_like(state["values"], np.nan)},
    ):
        with pytest.raises(ValueError, match="solid"):
            solid.restore_changes(wrong)


def test_memory_is_that_of_the_surface() -> None:
    solid = ball(60.0)
    assert solid.nbytes < 0.6 * np.prod(solid.bricks.node_counts) * 4
    assert solid.sample_distances(np.full((1, 3), np.nan)).shape == (1,)


def test_a_ray_without_measure_ends_where_nothing_solid_is_left() -> None:
    """From within reach the same hits to the bit as with a short reach; from far away the one that stands in the way."""
    feelers = SolidProximityQueries(ball())
    start, directions = 30 * random_directions(200, 4), -random_directions(200, 4) + 0.6 * random_directions(200, 5)
    directions /= np.linalg.norm(directions, axis=1)[:, None]
    short, endless = (feelers.cast_feelers(start.T, directions.T, reach) for reach in (90.0, 3e38))
    assert 50 < short.hit.sum() < 200
    for name in ("hit", "t", "nx", "ny", "nz"):
        assert np.array_equal(getattr(short, name), getattr(endless, name))
    far = feelers.cast_feelers(np.array([[1e6, 0, 0], [1e6, 90, 0]]).T, np.array([[-1.0, 0, 0]] * 2).T, 3e38)
    assert far.hit.tolist() == [True, False] and abs(far.t[0] - (1e6 - 12)) < 0.5
