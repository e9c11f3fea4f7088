"""Rays: exact distances, several meshes, far-away sets, same bits for any batch and thread count, and feelers culled or not."""

from __future__ import annotations

import subprocess
import sys

import numpy as np
import pytest

from antdsl.casting.distance_grid import DistanceGrid
from antdsl.casting.faces import find_nearest_on_triangle
from antdsl.casting.rays import RayScene
from tests.meshes import ball, box, grid, outward, terrain


def random_rays(n: int, extent: float, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    direction = rng.normal(size=(n, 3))
    return rng.uniform(-extent, extent, (n, 3)), direction / np.linalg.norm(direction, axis=1, keepdims=True)


def test_test_meshes_are_closed_with_outward_normals():
    assert outward(box((0, 0, 0), (1, 2, 3))) and outward(ball(5.0))


def test_distances_faces_and_normals_on_a_box():
    scene = RayScene(*box((-10, 0, -10), (10, 4, 10)))
    origin = np.array([[0, 10, 0], [0, 10, 0], [30, 2, 3], [0, 2, 0]], np.float64)
    direction = np.array([[0, -2, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0]], np.float64)
    hits = scene.find_first_hits(origin, direction)
    assert hits.t[0] == pytest.approx(3.0) and np.isinf(hits.t[1]) and hits.t[2] == pytest.approx(20.0)
    assert hits.face[1] == -1 and hits.mesh[1] == -1 and hits.is_hit.tolist() == [True, False, True, True]
    assert np.allclose(hits.normal, [[0, 1, 0], [0, 0, 0], [1, 0, 0], [0, 1, 0]])  # from inside it looks inside
    vertices, faces = box((-10, 0, -10), (10, 4, 10))
    corner = vertices[faces[hits.face[2]]]
    place = corner[0] * (1 - hits.u[2] - hits.v[2]) + corner[1] * hits.u[2] + corner[2] * hits.v[2]
    assert np.allclose(place, [10, 2, 3], atol=1e-5)


def test_mesh_and_face_of_several_meshes():
    meshes = [box((0, 0, 0), (1, 1, 1)), (np.empty((0, 3)), np.empty((0, 3), np.int32)), ball(1.0, (5, 0, 0))]
    scene = RayScene.from_meshes(meshes)
    hits = scene.find_first_hits(np.array([[0.4, 5, 0.3], [5.1, 5, 0.1]]), np.array([[0, -1, 0], [0, -1, 0]], np.float64))
    assert hits.mesh.tolist() == [0, 2]
    v, f = meshes[2]
    assert v[f[hits.face[1]]][:, 1].min() > 0.5
    mesh, face, _place, distance = scene.find_closest(np.array([[5.0, 3.0, 0.0]]))
    assert mesh[0] == 2 and distance[0] == pytest.approx(2.0, abs=0.02) and 0 <= face[0] < len(f)


def test_scenes_far_from_the_origin_have_the_same_precision():
    vertices, faces = terrain(400, 40)
    origin, direction = random_rays(2000, 180.0)
    near_hits = RayScene(vertices, faces).find_first_hits(origin, direction)
    far = np.array([3e6, -1e6, 2e6])
    far_hits = RayScene(vertices + far, faces).find_first_hits(origin + far, direction)
    assert np.array_equal(near_hits.face, far_hits.face) and near_hits.is_hit.sum() > 500
    assert np.allclose(near_hits.t[near_hits.is_hit], far_hits.t[near_hits.is_hit], atol=1e-3)


def test_results_do_not_depend_on_batches_and_threads():
    scene = RayScene(*terrain(400, 50))
    origin, direction = random_rays(3000, 190.0)
    one = scene.find_first_hits(origin, direction, threads=1)
    two = scene.find_first_hits(origin, direction, threads=2)
    order = np.random.default_rng(1).permutation(3000)
    mixed = scene.find_first_hits(origin[order], direction[order], threads=2)
    for name in ("t", "face", "u", "v", "normal"):
        assert np.array_equal(getattr(one, name), getattr(two, name)), name
        assert np.array_equal(getattr(one, name)[order], getattr(mixed, name)), name
    for k in range(0, 3000, 37):
        alone = scene.find_first_hits(origin[k : k + 1], direction[k : k + 1])
        assert alone.t[0] == one.t[k] and alone.face[0] == one.face[k] and alone.u[0] == one.u[k]


def test_empty_scenes_have_no_hits():
    scene = RayScene(np.empty((0, 3)), np.empty((0, 3), np.int32))
    hits = scene.find_first_hits(np.zeros((2, 3)), np.ones((2, 3)))
    assert np.isinf(hits.t).all() and not scene.find_occluded_rays(np.zeros((2, 3)), np.ones((2, 3))).any()
    zero = np.zeros(2, np.float32)
    assert not scene.cast_feelers((zero, zero, zero), (zero, zero, zero + 1), 5.0).hit.any()
    assert np.isinf(scene.find_closest(np.zeros((2, 3)))[3]).all()


def test_feelers_equal_uncut_rays():
    stones = [ball(9.0, (x, 0, z), 8) for x, z in ((-60, 20), (40, 50), (90, -80), (0, 0))]
    scene = RayScene.from_meshes([*stones, box((-150, -5, 100), (150, 20, 103))])
    n = 20_000
    rng = np.random.default_rng(4)
    x, y, z = (rng.uniform(-a, a, n).astype(np.float32) for a in (160, 6, 160))
    turn = rng.uniform(0, 2 * np.pi, n)
    dx, dy, dz = np.cos(turn).astype(np.float32), np.zeros(n, np.float32), np.sin(turn).astype(np.float32)
    reach = rng.uniform(1, 25, n).astype(np.float32)
    contacts = scene.cast_feelers((x, y, z), (dx, dy, dz), reach)
    rays = np.stack([dx, dy, dz], axis=1).astype(np.float64) * reach[:, None]
    all_of_them = scene.find_first_hits(np.stack([x, y, z], axis=1).astype(np.float64), rays)
    expected = all_of_them.t <= 1.0
    assert 300 < expected.sum() < n / 2
    assert np.array_equal(contacts.hit, expected)
    assert np.array_equal(contacts.t[expected], (all_of_them.t * reach).astype(np.float32)[expected])
    assert np.isinf(contacts.t[~expected]).all()
    assert np.array_equal(np.stack([contacts.nx, contacts.ny, contacts.nz], axis=1)[expected], all_of_them.normal[expected])
    assert ((contacts.nx * dx + contacts.ny * dy + contacts.nz * dz)[expected] <= 0).all()


@pytest.mark.parametrize("mesh", [ball(20.0, (5, 1, 2)), grid(300, 1), box((-80, -1, -80), (80, 60, -79))])
def test_distance_bounds_are_valid_and_above_zero(mesh):
    grid_of = DistanceGrid(mesh[0][mesh[1]], target_cells=20_000)
    points = np.random.default_rng(2).uniform(-250, 250, (4000, 3))
    true = RayScene(*mesh).find_closest(points)[3]
    least = grid_of.compute_lower_bounds(*points.T)
    assert (least <= true).all()
    assert np.mean(least > 0.5 * true) > 0.8


def test_non_finite_positions_have_no_hits():
    mesh = ball(20.0, (5, 1, 2))
    odd = np.array([[np.nan, 0, 0], [np.nan] * 3, [np.inf, -np.inf, 0], [1e30, 1e38, -1e30], [0, 0, 0]])
    with np.errstate(all="ignore"):
        least = DistanceGrid(mesh[0][mesh[1]], target_cells=20_000).compute_lower_bounds(*odd.T)
        _, face, _, distance = RayScene(*mesh).find_closest(odd)
    assert (least[2:4] > 1e29).all() and least[4] < 20
    assert ((face >= 0) & (face < len(mesh[1]))).all() and np.isnan(distance[:2]).all() and distance[4] < 20


def test_nearest_point_of_a_triangle_against_many_samples():
    rng = np.random.default_rng(6)
    corners = rng.normal(size=(60, 3, 3))
    points = rng.normal(size=(60, 3)) * 2
    place = find_nearest_on_triangle(points, corners)
    weights = rng.dirichlet([0.5, 0.5, 0.5], 4000)
    samples = np.einsum("kc,nca->nka", weights, corners)
    best = np.sqrt(((samples - points[:, None]) ** 2).sum(axis=2)).min(axis=1)
    mine = np.sqrt(((place - points) ** 2).sum(axis=1))
    assert (mine <= best + 1e-12).all() and (best - mine).max() < 0.3
    line = np.array([[[0, 0, 0], [1, 0, 0], [2, 0, 0]]], np.float64)
    assert np.allclose(find_nearest_on_triangle(np.array([[1.5, 1, 0]]), line), [[1.5, 0, 0]])


def test_a_missing_library_is_an_error_with_its_package():
    code = (
        "import sys; sys.modules['open3d'] = None\n"
        "from antdsl.casting import rays\nfrom antdsl.ground.mesh import surface\n"
        "try: rays.RayScene(__import__('numpy').eye(3), __import__('numpy').arange(3).reshape(1, 3))\n"
        "except ImportError as e: print(e)"
    )
    output = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True).stdout
    for word in ("open3d-cpu", "libegl1", "libgl1", "libusb-1.0-0"):
        assert word in output


def test_few_and_many_feelers_have_equal_hits(monkeypatch: pytest.MonkeyPatch):
    """Few rays go on beyond their reach, many are tested first for a hit within it."""
    from antdsl.casting import rays

    mesh = ball(12)
    scene, (origin, direction) = RayScene(*mesh), random_rays(5000, 15)
    start, touched = scene._faces.corners.mean(axis=1).take(np.arange(5000) % len(mesh[1]), axis=0), []
    origin = np.where(np.arange(5000)[:, None] % 2, origin, start)  # every other one begins on a face
    reach = np.random.default_rng(1).choice([1e-6, 1e-4, 0.1, 3.0, 30.0], 5000)
    for few in (0, 5000):
        monkeypatch.setattr(rays, "_MAX_RAYS_IN_ONE_CAST", few)
        touched.append(scene.find_hits_along_step(origin, direction * reach[:, None]))
    assert 400 < len(touched[0][0]) < 4500
    for many, few in zip(*touched, strict=True):
        assert np.array_equal(many, few)
