"""Short rays and near faces by the grid of triangles: the same face and bits as by Open3D with its answers decided in float64.

Of a million rays against eight meshes 24 differ, of 100,000 places none. A loop over all faces says of each of these that the
grid's face is the first; Open3D named another or none. They are of three kinds:

- 4 pass along a side of the ball or the hills, and cross both of its faces at parts of the way that differ by rounding alone;
- 10 meet one face 1,500 mm wide, in its middle, two of them a hair from their start: Open3D named none, or one up to 517 hairs
  behind it;
- 10 cross a face of the box near its rim or graze one of the soup: Open3D named none. Why it misses those of the box is not
  known.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from antdsl.casting import triangle_grid
from antdsl.casting.faces import TriangleFaces, find_nearest_on_triangle
from antdsl.casting.rays import RayScene
from antdsl.casting.tolerances import FACE_BEYOND_GRID, MAX_RAY_CUBES, NO_FACE
from antdsl.casting.triangle_grid import TriangleGrid
from antdsl.numerics.vector_rows import dot
from tests.meshes import Mesh, ball, box, terrain

EXCEPTIONS = 1.2e-4  # of the rays at one mesh, or the places near it, at most


def soup(count: int = 4000) -> Mesh:
    """Triangles through each other, of all shapes."""
    rng = np.random.default_rng(1)
    corners = rng.uniform(-150, 150, (count, 1, 3)) + rng.normal(0, 6, (count, 3, 3))
    return corners.reshape(-1, 3), np.arange(3 * count, dtype=np.int32).reshape(-1, 3)


def blades() -> Mesh:
    """Hills with faces that are 60 times longer than wide."""
    vertices, faces = terrain(300, 40)
    return vertices * np.array([1.0, 1.0, 1 / 60]), faces


def moved(mesh: Mesh, by: tuple[float, float, float]) -> Mesh:
    return mesh[0] + np.array(by), mesh[1]


MESHES: dict[str, Callable[[], list[Mesh]]] = {
    "hills": lambda: [terrain(400, 100)],
    "ball": lambda: [ball(60.0, (0, 0, 0), 40)],
    "box": lambda: [box((-30, -20, -10), (30, 20, 10))],
    "a few of them": lambda: [terrain(300, 40), ball(30.0, (-80, 40, 60), 16), box((50, 40, -60), (90, 80, 10))],
    "soup": lambda: [soup()],
    "blades": lambda: [blades()],
    "stones on a wide floor": lambda: [terrain(3000, 2), ball(12.0, (40, 0, 30), 20), ball(3.0, (10, 2, -60), 20)],
    "far away": lambda: [moved(terrain(300, 40), (50_000.0, 0.0, -8_000.0))],
}


def rays(scene: RayScene, grid: TriangleGrid, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Near faces, at corners and sides of them, from them, along their axes, and some that are long."""
    rng = np.random.default_rng(len(scene._faces.corners))
    corners, width = scene._faces.corners, grid.tables[0][3]
    weights = rng.dirichlet((1, 1, 1), count)
    weights[::7] = np.eye(3)[rng.integers(0, 3, len(weights[::7]))]
    weights[1::7, 2] = 0.0
    weights /= weights.sum(axis=1)[:, None]
    aim = (corners[rng.integers(0, len(corners), count)] * weights[:, :, None]).sum(axis=1)
    displacement = rng.normal(size=(count, 3))
    displacement[2::9] = np.eye(3)[rng.integers(0, 3, len(displacement[2::9]))]
    displacement *= (
        width
        * rng.choice([0.3, 1.0, 1.3, 3.0, 20.0], count, p=[0.2, 0.3, 0.3, 0.17, 0.03])
        / np.sqrt(dot(displacement, displacement))
    )[:, None]
    fraction = rng.uniform(-0.5, 1.5, count)
    fraction[3::11] = 0.0  # from a face itself
    fraction[4::11] = 1.0  # ending on one
    return aim - displacement * fraction[:, None], displacement


def sample_points(scene: RayScene, grid: TriangleGrid, count: int) -> np.ndarray:
    origin, _ = rays(scene, grid, count)
    return origin + np.random.default_rng(3).normal(0, grid.tables[0][3] / 2, origin.shape)


def by_open3d(scene: RayScene, origin: np.ndarray, displacement: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    t, face = np.full(len(origin), np.inf), np.full(len(origin), NO_FACE)
    rows, part, named, _ = scene._find_open3d_hits(origin, displacement, 1.0, 2)
    t[rows], face[rows] = part, named
    return t, face


def of_all(faces: TriangleFaces, origin: np.ndarray, displacement: np.ndarray) -> np.ndarray:
    """For one ray, after what part it meets each face (inf = it does not)."""
    every = np.arange(len(faces.corners))
    t, _, inside, _ = faces.intersect_planes(every, np.tile(origin, (len(every), 1)), np.tile(displacement, (len(every), 1)))
    hair = faces.tolerance / np.sqrt(
        (displacement[0] * displacement[0] + displacement[1] * displacement[1]) + displacement[2] * displacement[2]
    )
    return np.where(inside & (t > hair) & (t <= 1.0), t, np.inf)


def same_rays(scene: RayScene, grid: TriangleGrid, origin: np.ndarray, displacement: np.ndarray) -> int:
    """How many rays meet another face or place by Open3D; a reason is known for each."""
    t, face = grid.find_first_faces(origin, displacement)
    near = face != FACE_BEYOND_GRID
    assert near.mean() > 0.95 and (face >= 0).sum() > len(face) // 20
    other_t, other = by_open3d(scene, origin, displacement)
    differing = np.flatnonzero(near & ((face != other) | (t != other_t)))
    for k in differing[:200]:
        parts = of_all(scene._faces, origin[k], displacement[k])
        first = int(np.argmin(parts))
        assert t[k] == parts[first] and face[k] == (first if np.isfinite(parts[first]) else NO_FACE)
        # Open3D names nothing or a later face, or one beside it that is as near but for rounding.
        assert other_t[k] > t[k] or (other_t[k] == t[k] and other[k] > face[k])
    return len(differing)


def same_places(scene: RayScene, grid: TriangleGrid, points: np.ndarray) -> int:
    place, square, face = grid.find_nearest(points)
    near = np.flatnonzero(face != FACE_BEYOND_GRID)
    assert len(near) > len(points) // 2
    closest, distance, other = scene._find_closest_by_open3d(points[near], 2, np.full(len(near), np.inf))
    differing = np.flatnonzero((other != face[near]) | (distance != np.sqrt(square[near])) | (closest != place[near]).any(axis=1))
    corners = scene._faces.corners
    for k in near[differing[:200]]:
        gap = find_nearest_on_triangle(np.tile(points[k], (len(corners), 1)), corners) - points[k]
        assert int(np.argmin(dot(gap, gap))) == face[k] and dot(gap, gap).min() == square[k]
    return len(differing)


def make_grid(name: str) -> tuple[RayScene, TriangleGrid]:
    scene = RayScene.from_meshes(MESHES[name]())
    grid = TriangleGrid.from_faces(scene._faces, scene.origin)
    assert grid is not None
    return scene, grid


@pytest.mark.parametrize("name", MESHES)
def test_short_rays_equal_open3d(name: str):
    scene, grid = make_grid(name)
    count = 4000
    assert same_rays(scene, grid, *rays(scene, grid, count)) <= 1
    assert same_places(scene, grid, sample_points(scene, grid, count // 4)) <= 1


@pytest.mark.slow
@pytest.mark.parametrize("name", MESHES)
def test_a_million_short_rays_equal_open3d(name: str):
    scene, grid = make_grid(name)
    count = 125_000
    assert same_rays(scene, grid, *rays(scene, grid, count)) <= EXCEPTIONS * count
    assert same_places(scene, grid, sample_points(scene, grid, count // 10)) <= EXCEPTIONS * count


@pytest.mark.parametrize("name", MESHES)
def test_short_rays_equal_a_test_of_all_faces(name: str):
    scene, grid = make_grid(name)
    origin, displacement = rays(scene, grid, 150)
    displacement[[5, 7]] = grid.tables[0][3]
    origin[5], displacement[6], origin[7], displacement[8] = np.nan, np.nan, np.inf, 0.0
    points = sample_points(scene, grid, 100)
    points[3], points[4] = np.nan, 1e30
    (t, face), (place, square, nearest) = grid.find_first_faces(origin, displacement), grid.find_nearest(points)
    assert (
        (face[[5, 6, 7, 8]] == NO_FACE).all() and np.isinf(t[[5, 6, 7, 8]]).all() and (nearest[[3, 4]] == FACE_BEYOND_GRID).all()
    )
    corners, (_, _, _, width, *_) = scene._faces.corners, grid.tables[0]
    for k in np.setdiff1d(np.arange(150), [5, 6, 7, 8]):
        parts, first = of_all(scene._faces, origin[k], displacement[k]), int(face[k])
        assert t[k] == (np.inf if first < 0 else parts[first]) and (np.abs(displacement[k]).sum() > MAX_RAY_CUBES * width) == (
            first == FACE_BEYOND_GRID
        )
        assert first == FACE_BEYOND_GRID or parts.min() == t[k] or np.isnan(parts).all()
        assert first < 0 or not (parts[:first] <= t[k]).any()
    for k in np.setdiff1d(np.arange(100), [3, 4]):
        nearest_points = find_nearest_on_triangle(np.tile(points[k], (len(corners), 1)), corners)
        squares = dot(nearest_points - points[k], nearest_points - points[k])
        if nearest[k] == FACE_BEYOND_GRID:
            assert squares.min() > width * width
        else:
            assert nearest[k] == np.argmin(squares) and square[k] == squares.min()
            assert np.array_equal(place[k], nearest_points[nearest[k]])
    assert len(grid.find_first_faces(origin[:0], displacement[:0])[0]) == 0 and len(grid.find_nearest(points[:0])[0]) == 0


@pytest.mark.parametrize("threads", [1, 2])
@pytest.mark.parametrize("name", MESHES)
def test_hit_normals_are_those_of_the_first_face(name: str, threads: int):
    scene, _ = make_grid(name)
    grid = scene._get_triangle_grid()
    assert grid is not None
    origin, displacement = rays(scene, grid, 2000)
    origin, named = origin + scene.origin, np.random.default_rng(4).permutation(len(scene._faces.corners))
    normals = np.random.default_rng(5).normal(size=(3, len(named)))
    short = np.flatnonzero(grid.find_first_faces(origin - scene.origin, displacement)[1] != FACE_BEYOND_GRID)
    assert 0 < len(short) < len(origin)
    for subset in (slice(None), short, slice(0, 0)):  # of some rays, and of none, the grid cannot tell
        which, part, normal = scene.find_hit_normals(origin[subset], displacement[subset], normals, named, threads)
        rows, at, face = scene._find_hits_within(origin[subset] - scene.origin, displacement[subset], 1)
        assert np.array_equal(which, rows) and np.array_equal(part, at) and (len(rows) > 100 or isinstance(subset, slice))
        assert np.array_equal(normal, normals[:, named[face]])
    assert grid.find_hit_normals(origin[short], displacement[short], normals, named, threads)[1] == 0


def test_feelers_and_distances_are_equal_with_and_without_a_grid():
    scene, grid = make_grid("a few of them")
    far = RayScene.from_meshes(MESHES["a few of them"]())
    far._has_built_grid = True
    origin, displacement = rays(scene, grid, 3000)
    length = np.sqrt(dot(displacement, displacement))
    place, direction = (np.ascontiguousarray(v.T, np.float32) for v in (origin, displacement / length[:, None]))
    reach = length.astype(np.float32)
    clear = scene.measure_clearance(*place)
    asking = np.arange(3000) % 2 == 0
    answers = []
    for which in (scene, far):
        contacts = which.cast_feelers(place, direction, reach)
        gap, out = which.measure_signed_distances(*place, reach)
        near = which.find_nearest_within(*place, reach)
        results = np.zeros(3000, np.bool_), np.full(3000, np.inf, np.float32), *np.zeros((3, 3000), np.float32)
        left = which.cast_feeler_batch(
            (*place, clear), [(~asking & asking, (*direction, reach), results), (asking, (*direction, reach), results)]
        )
        assert [number for number, rows in left if rows.size] == [1]
        remaining_rows = left[-1][1]
        assert len(remaining_rows) < 100 if which is scene else len(remaining_rows) == 1500
        answers.append((contacts.t, contacts.nx, contacts.ny, contacts.nz, gap, out, near.t, near.nx))
        if which is scene:
            assert not results[0][~asking].any() and np.isinf(results[1][~asking]).all()
            answered_rows = np.setdiff1d(np.flatnonzero(asking), remaining_rows)
            x, y, z = (each[answered_rows] for each in direction)
            size = np.sqrt((x * x + y * y) + z * z)
            same = which.cast_feelers([v[answered_rows] for v in place], (x / size, y / size, z / size), reach[answered_rows])
            hit, t, nx, *_ = (part[answered_rows] for part in results)
            assert np.array_equal(hit, same.hit) and np.array_equal(t, same.t) and np.array_equal(nx, same.nx)
    assert np.isfinite(answers[0][0]).sum() > 500 and (answers[0][4] < 0).any()
    for other in answers[1:]:
        for one, two in zip(answers[0], other, strict=True):
            assert np.array_equal(one, two)


def test_grids_are_built_only_if_small_and_useful(monkeypatch: pytest.MonkeyPatch):
    vertices, faces = terrain(100, 20)
    assert RayScene(vertices, faces, is_short_lived=True)._get_triangle_grid() is None
    assert TriangleGrid.from_faces(TriangleFaces(np.empty((0, 3, 3))), np.zeros(3)) is None
    dense = RayScene.from_meshes([terrain(10_000, 1), ball(1.0, (0, 200, 0), 60)])
    assert dense._get_triangle_grid() is None  # thousands of faces in one cube
    listed = []
    monkeypatch.setattr(triangle_grid, "iterate_triangle_cells", lambda *a, **k: listed.append(a) or iter(()))
    monkeypatch.setattr(triangle_grid, "_MAX_LISTED_FACES", 4000)
    assert RayScene(vertices, faces)._get_triangle_grid() is None and not listed
