"""Short rays by walks over faces: what a loop over all faces hits first, to the bit, wherever the walk begins."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import open_shapes
import pytest

from antdsl.casting.faces import TriangleFaces, find_nearest_on_triangle
from antdsl.casting.grid_rays import GridTables
from antdsl.casting.ray_walks import CLEAR_BALL_OFFSET, SIDE_LINK_OFFSET, WORDS_PER_RING_ROW, RingTables, find_hit_by_walk
from antdsl.casting.rays import RayScene
from antdsl.casting.tolerances import NEAREST_FACE_UNKNOWN, NO_FACE
from antdsl.machine_code.kernels import F64, I64, Array1, Strided2, kernel, simd_range
from antdsl.numerics.vector_rows import dot
from tests.meshes import Mesh, ball, box, grid, terrain

RAYS = 1500


def rough(slope: float, cells: int = 16) -> Mesh:
    """A floor with random heights: `slope` edges up or down."""
    vertices, faces = grid(float(cells), cells)
    vertices[:, 1] = np.random.default_rng(5).uniform(-slope, slope, len(vertices))
    return vertices, faces


def folded() -> Mesh:
    """A strip that is folded back over itself."""
    points = np.array([[0, 0, 0], [4, 0, 0], [8, 0.5, 0], [9, 1, 0], [8, 1.5, 0], [4, 1, 0], [0, 1, 0], [-3, 0.2, 0]], float)
    return open_shapes.triangle_strip(points, np.array([0.0, 0, 6]))


def sheets(gap: float, same_side: bool) -> Mesh:
    """Two rough floors, one `gap` above the other, wound alike or not."""
    vertices, faces = rough(0.2)
    return open_shapes.joined([(vertices, faces), (vertices + np.array([0, gap, 0]), faces if same_side else faces[:, ::-1])])


def doubled() -> Mesh:
    """A floor with some faces that are there twice."""
    vertices, faces = rough(0.2)
    return vertices, np.concatenate([faces, faces[::5]])


def far_away() -> Mesh:
    vertices, faces = rough(0.3)
    return vertices + np.array([50_000.0, 0, -8_000]), faces


# And the least share of the rays near them that walks answer.
SHAPES: dict[str, tuple[Callable[[], Mesh], float]] = {
    "hills": (lambda: terrain(40, 16), 0.2),
    "rough": (lambda: rough(0.3), 0.25),
    "rough, seen from below": (lambda: (rough(0.3)[0], rough(0.3)[1][:, ::-1]), 0.25),
    "steep": (lambda: rough(2.0), 0.0),
    "ball": (lambda: ball(6.0, (0, 0, 0), 16), 0.3),
    "box": (lambda: box((-3, -2, -1), (3, 2, 1)), 0.0),
    "folded": (folded, 0.0),
    "two sides of a sheet": (lambda: sheets(0.05, False), 0.0),
    "sheets": (lambda: sheets(0.3, True), 0.0),
    "sheets far apart": (lambda: sheets(1.5, True), 0.25),
    "doubled": (doubled, 0.0),
    "far away": (far_away, 0.25),
    "tees": (open_shapes.tees, 0.0),
    "bows": (open_shapes.bows, 0.0),
    "slivers": (open_shapes.slivers, 0.0),
    "book": (open_shapes.book, 0.0),
    "soup": (open_shapes.soup, 0.0),
    "ribbon": (open_shapes.ribbon, 0.0),
}


@kernel
def walk_all(
    grid: GridTables,
    rings: RingTables,
    starts: Array1[I64],
    origin: Strided2[F64],
    direction: Strided2[F64],
    t: Array1[F64],
    face: Array1[I64],
) -> None:
    """Walk along all rays."""
    for i in simd_range(0, starts.size):
        a, w = (origin[i, 0], origin[i, 1], origin[i, 2]), (direction[i, 0], direction[i, 1], direction[i, 2])
        t[i], face[i] = find_hit_by_walk(grid, rings, starts[i], a, w)


def walked(scene: RayScene, starts: np.ndarray, origin: np.ndarray, direction: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    tables, rings = scene.get_tables(), scene.get_ring_tables()
    assert tables is not None and rings is not None
    t, face = np.empty(len(starts)), np.empty(len(starts), np.int64)
    walk_all(tables, rings, starts, origin, direction, t, face)
    return t, face


def first_of_all(faces: TriangleFaces, origin: np.ndarray, direction: np.ndarray) -> tuple[float, int]:
    """What a ray hits first, by a loop over all faces."""
    every = np.arange(len(faces.corners))
    t, _, inside, _ = faces.intersect_planes(every, np.tile(origin, (len(every), 1)), np.tile(direction, (len(every), 1)))
    with np.errstate(divide="ignore"):
        hair = faces.tolerance / np.sqrt(
            (direction[0] * direction[0] + direction[1] * direction[1]) + direction[2] * direction[2]
        )
    parts = np.where(inside & (t > hair) & (t <= 1.0), t, np.inf)
    first = int(np.argmin(parts))
    return float(parts[first]), first if parts[first] < np.inf else NO_FACE


def rays(corners: np.ndarray, edge: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Faces, places above and below them, and ways that mostly lead to faces nearby; some in faces, along and to their sides."""
    rng = np.random.default_rng(len(corners))
    starts = rng.integers(0, len(corners), RAYS)
    weights = rng.dirichlet((1, 1, 1), RAYS)
    weights[::11] = np.eye(3)[rng.integers(0, 3, len(weights[::11]))]
    weights[1::11, 2] = 0.0
    weights /= weights.sum(axis=1)[:, None]
    three = corners[starts]
    normal = np.cross(three[:, 1] - three[:, 0], three[:, 2] - three[:, 0])
    normal /= np.maximum(np.sqrt(dot(normal, normal)), 1e-12)[:, None]
    place = (three * weights[:, :, None]).sum(axis=1)
    height = rng.choice([0.0, 1e-9, 0.05, 0.3, 0.8], RAYS) * edge * rng.choice([1, -1], RAYS)
    origin = place + normal * height[:, None]
    direction = rng.normal(0, 0.5, (RAYS, 3)) * edge - 1.2 * normal * height[:, None]
    level = direction - normal * dot(direction, normal)[:, None]
    direction[3::7] = level[3::7]
    direction[4::7] = three[4::7, 0] - origin[4::7]
    direction[5::97] = 0.0
    return starts, origin, direction


@pytest.mark.parametrize("name", SHAPES)
def test_walks_hit_what_a_loop_over_all_faces_hits(name: str) -> None:
    make, share = SHAPES[name]
    scene = RayScene(*make())
    faces = scene._faces
    starts, origin, direction = rays(faces.corners, scene.get_tables()[0][3])  # type: ignore[index]
    t, face = walked(scene, starts, origin, direction)
    for k in np.flatnonzero(face != NEAREST_FACE_UNKNOWN):
        assert (t[k], face[k]) == first_of_all(faces, origin[k], direction[k])
    assert (face != NEAREST_FACE_UNKNOWN).mean() >= share
    # A walk from elsewhere answers the same or not at all.
    other_t, other = walked(scene, np.random.default_rng(2).integers(0, len(faces.corners), RAYS), origin, direction)
    both = (face != NEAREST_FACE_UNKNOWN) & (other != NEAREST_FACE_UNKNOWN)
    assert (t[both] == other_t[both]).all() and (face[both] == other[both]).all()


def test_balls_contain_only_faces_of_the_ring() -> None:
    """Links lead to the face with the same side, and no face that has no corner in common is in a ball. Rims have no rings."""
    scene = RayScene(*rough(0.3, 10))
    corners, rings = scene._faces.corners, scene.get_ring_tables()
    assert rings is not None
    links, balls = (
        rings[1].reshape(-1, WORDS_PER_RING_ROW)[:, SIDE_LINK_OFFSET : SIDE_LINK_OFFSET + 3],
        rings[2].reshape(-1, WORDS_PER_RING_ROW)[:, CLEAR_BALL_OFFSET:],
    )
    points = (np.round(corners * 1e6).astype(np.int64) @ np.array([1, 10**9, 10**5])).reshape(-1, 3)
    for f in range(len(links)):
        near = np.isin(points, points[f]).any(axis=1)
        middle = corners[f].mean(axis=0)
        gap = find_nearest_on_triangle(np.tile(middle, ((~near).sum(), 1)), corners[~near]) - middle
        assert balls[f, 3] <= dot(gap, gap).min() and np.allclose(balls[f, :3], middle, atol=1e-5)
        for corner, g in enumerate(links[f]):
            shared = np.isin(points, np.delete(points[f], corner)).sum(axis=1) == 2
            assert np.flatnonzero(shared & (np.arange(len(links)) != f)).tolist() == ([g] if g >= 0 else [])
    inner = np.abs(corners[:, :, [0, 2]]).max(axis=(1, 2)) < 5
    assert ((balls[:, 3] > 0) == inner).all()
