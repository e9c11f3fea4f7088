"""What rays meet and which place is nearest does not depend on the last bits of Open3D, which are another processor's others."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from antdsl.casting.faces import TriangleFaces, _find_largest_index, find_nearest_on_face, find_nearest_on_triangle
from antdsl.casting.rays import RayScene
from tests.meshes import ball, box, terrain

R = 300.0


class Shaken:
    """Open3D's scene as another processor may have it: all its results are off by some bits of float32."""

    def __init__(self, scene: Any, seed: int) -> None:
        self._scene, self._rng = scene, np.random.default_rng(seed)

    def _moved(self, tensor: Any, error: float) -> Any:
        rays = tensor.numpy().copy()
        rays[:, :3] += self._rng.uniform(-error, error, (len(rays), 3)).astype(np.float32)
        if rays.shape[1] == 6:
            long = np.abs(rays[:, 3:]).max(axis=1, keepdims=True) * 1e-7
            rays[:, 3:] += (long * self._rng.uniform(-1, 1, (len(rays), 3))).astype(np.float32)
        return RayScene._to_tensor(rays)

    def cast_rays(self, rays: Any, nthreads: int = 0) -> Any:
        return self._scene.cast_rays(self._moved(rays, 1e-7 * R), nthreads=nthreads)

    def test_occlusions(self, rays: Any, **options: Any) -> Any:
        return self._scene.test_occlusions(self._moved(rays, 1e-7 * R), **options)

    def compute_closest_points(self, points: Any, nthreads: int = 0) -> Any:
        return self._scene.compute_closest_points(self._moved(points, 1e-7 * R), nthreads=nthreads)


def shaken(scene: RayScene, seed: int) -> RayScene:
    scene._open3d_scene = Shaken(scene._widened_scene, seed)
    scene._exact_scene = Shaken(scene._build_scene(scene._faces.corners.reshape(-1, 3).astype(np.float32)), seed)
    return scene


def meshes() -> list[tuple[np.ndarray, np.ndarray]]:
    """Hills, a ball and a box: many edges and corners, some borders and some sides that rays go along."""
    return [terrain(R, 30), ball(30.0, (-80, 40, 60), 12), box((50, 40, -60), (90, 80, 10))]


def rays_at_edges() -> tuple[np.ndarray, np.ndarray]:
    """Rays at all corners and at the middles of all sides of these, from three sides, a third of which end there."""
    corners = np.concatenate([v[f] for v, f in meshes()])
    at = np.concatenate([corners[:, 0], (corners[:, 0] + corners[:, 1]) / 2])
    displacements = np.array([(0.31, -60.0, 0.77), (30.7, -50.3, 7.1), (-45.1, -10.9, -50.7)])
    origin = np.concatenate([at - displacement * part for displacement, part in zip(displacements, (0.7, 1.0, 0.4), strict=True)])
    displacement = np.repeat(displacements, len(at), axis=0)
    # Less those that pass a face at its edge almost along it: no rounding tells on which side.
    scene = RayScene.from_meshes(meshes())
    first = scene.find_first_hits(origin, displacement)
    hit = np.flatnonzero(first.is_hit)
    face = scene._first_face_of_mesh[first.mesh[hit]] + first.face[hit]
    weights = np.stack([1 - first.u - first.v, first.u, first.v], axis=1)[hit]
    which, other = scene._faces.find_faces_at_corner(face, weights)
    slope = np.abs((scene._faces.get_normals(other) * displacement[hit[which]]).sum(axis=1)) / np.sqrt(
        (displacement[hit[which]] ** 2).sum(axis=1)
    )
    along = np.zeros(len(origin), bool)
    along[hit[which[slope < 0.03]]] = True
    assert along.mean() < 0.1
    return origin[~along], displacement[~along]


def make_scene(brief: bool) -> RayScene:
    """A scene of the meshes, with tables of all faces and a grid or, `brief`, without."""
    scene = RayScene.__new__(RayScene)
    scene._is_short_lived = brief
    scene._set_meshes(meshes())
    return scene


def answers(scene: RayScene) -> dict[str, np.ndarray]:
    origin, displacement = rays_at_edges()
    rows, part, mesh, face = scene.find_hits_along_step(origin, displacement)
    for one, other in zip((rows, part, mesh, face), scene.find_hits_along_step(origin, displacement, most_hit=True), strict=True):
        assert np.array_equal(one, other)
    first = scene.find_first_hits(origin, displacement)
    x, y, z = (np.ascontiguousarray(v, np.float32) for v in origin.T)
    size = np.sqrt((displacement**2).sum(axis=1))
    dx, dy, dz = (np.ascontiguousarray(v, np.float32) for v in (displacement / size[:, None]).T)
    contacts = scene.cast_feelers((x, y, z), (dx, dy, dz), size.astype(np.float32))
    away = origin[:: len(origin) // 3000] + np.array([0.0, 3.0, 0.0])
    _, near, place, distance = scene.find_closest(away)
    touched = scene.find_nearest_within(*(np.ascontiguousarray(v, np.float32) for v in away.T), 20.0)
    return {
        "rows": rows, "part": part, "mesh": mesh, "face": face, "t": first.t, "first": first.face, "u": first.u,
        "felt": contacts.t, "normal": contacts.nx, "near": near, "place": place, "distance": distance, "touched": touched.t,
        "off": touched.nx,
    }  # fmt: skip


@pytest.mark.parametrize("brief", [False, True])
def test_rays_at_edges_and_corners_give_the_same_bits_whatever_open3d_rounds(brief: bool):
    known = answers(make_scene(brief))
    assert len(known["rows"]) > 3000 and np.isfinite(known["felt"]).sum() > 3000
    for seed in range(4):
        again = answers(shaken(make_scene(brief), seed))
        for name, value in known.items():
            assert np.array_equal(value, again[name]), f"{name} {(value != again[name]).sum()} of {len(value)}"


def test_rays_hit_the_face_that_float64_computes():
    """All triangles tested in float64, at edges too: the least distance, then the first face."""
    scene = RayScene.from_meshes(meshes())
    origin, displacement = (v[::41] for v in rays_at_edges())
    faces = scene._faces
    every = np.arange(len(faces.corners))
    hits = scene.find_first_hits(origin, displacement)
    firsts = np.cumsum([0, *(len(f) for _, f in meshes())])
    for k in range(len(origin)):
        t, _, inside, _ = faces.intersect_planes(
            every, np.repeat(origin[k : k + 1], len(every), 0), np.repeat(displacement[k : k + 1], len(every), 0)
        )
        t = np.where(inside & (t > 1e-4), t, np.inf)
        assert hits.t[k] == t.min() or (np.isinf(hits.t[k]) and np.isinf(t.min()))
        if hits.face[k] >= 0:
            assert firsts[hits.mesh[k]] + hits.face[k] == int(np.argmin(t))


def test_widened_triangles_cover_their_faces():
    corners = np.concatenate([v[f] for v, f in meshes()])
    faces = TriangleFaces(corners)
    wide = faces.compute_widened_corners().reshape(-1, 3, 3).astype(np.float64)
    outer = TriangleFaces(wide)
    for k in range(3):
        _, weights, _, _ = outer.intersect_planes(
            np.arange(len(wide)), corners[:, k] + 0.0, np.cross(*(wide[:, j] - wide[:, 0] for j in (1, 2)))
        )
        high = 2 * np.sqrt((np.cross(wide[:, 1] - wide[:, 0], wide[:, 2] - wide[:, 0]) ** 2).sum(axis=1))
        assert (weights.min(axis=1) * high > 0).all()


def test_coincident_faces_are_ordered_by_number():
    sheet = terrain(R, 12)
    scene = RayScene.from_meshes([sheet, sheet, sheet])
    origin = np.random.default_rng(3).uniform(-100, 100, (500, 3)) + np.array([0, 200, 0])
    down = np.broadcast_to([0.0, -400.0, 0.0], origin.shape)
    alone, among = RayScene.from_meshes([sheet]).find_first_hits(origin, down), scene.find_first_hits(origin, down)
    assert np.array_equal(alone.t, among.t) and np.array_equal(alone.face, among.face)
    assert (among.mesh == 0).all() and (scene.find_closest(origin)[0] == 0).all()


def test_short_lived_scenes_give_the_same_results():
    results = [answers(make_scene(brief)) for brief in (True, False)]
    for name, value in results[0].items():
        assert np.array_equal(value, results[1][name]), name


def test_nearest_points_of_scalars_and_arrays_are_equal():
    rng = np.random.default_rng(8)
    corners, points = rng.normal(size=(3000, 3, 3)), rng.normal(size=(3000, 3))
    corners[::7, 2] = corners[::7, 0]
    place = find_nearest_on_triangle(points, corners)
    for k in range(0, 3000, 3):
        assert find_nearest_on_face(corners, k, tuple(points[k])) == tuple(place[k])


@pytest.mark.parametrize(
    "weights",
    [(1, 2, 3), (3, 2, 1), (2, 3, 1), (2, 2, 1), (1, 2, 2), (2, 1, 2), (np.nan, 1, 2), (1, np.nan, np.nan), (1, 2, np.nan)],
)
def test_greatest_weights_select_the_same_corner(weights: tuple[float, float, float]):
    assert _find_largest_index(*map(float, weights)) == int(np.argmax(weights))
