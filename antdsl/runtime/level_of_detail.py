"""Levels of detail: agents farther from the camera sense the bounding boxes of an obstacle's pieces instead of its triangles,
or nothing at all. The level depends only on the agent's position at the start of its step. Levels affect only senses:
obstacles stop agents at every level."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from antdsl.casting.rays import RayScene
from antdsl.numerics import vectors as vec
from antdsl.runtime.world import AXES, Population, World
from antdsl.scene.geometry.live_faces import number_connected_components
from antdsl.scene.setting import DetailLevelData, MeshData

BoxArrays = tuple[NDArray[np.float32], NDArray[np.float32]]  # least and greatest corners

_GRID_CELLS_PER_AXIS = 32  # cells of the coarse grid
DETAIL_LEVELS = ("triangles", "boxes", "nothing")
_BOX_CORNERS = np.array([[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], np.float64)
_BOX_TRIANGLES = np.array(
    [
        [0, 1, 3], [0, 3, 2], [4, 6, 7], [4, 7, 5], [0, 4, 5], [0, 5, 1],
        [2, 3, 7], [2, 7, 6], [0, 2, 6], [0, 6, 4], [1, 5, 7], [1, 7, 3],
    ],
    np.int32,
)  # fmt: skip


class DetailLevels:
    """The levels of detail of one world.

    `counts` int64[4]: the number of steps so far, then the number of agents at each of `DETAIL_LEVELS`, summed over these
    steps."""

    def __init__(self, data: DetailLevelData, origin: NDArray[np.float64], obstacles: Mapping[str, MeshData]) -> None:
        self._camera = np.asarray(data.camera, np.float64).reshape(-1, 3) - origin
        self._near_distance, self._far_distance, self._start_frame = (
            data.near_distance,
            max(data.far_distance, data.near_distance),
            data.first,
        )
        self._pieces = {name: MeshPieces(mesh) for name, mesh in obstacles.items()}
        self._boxes: dict[str, BoxArrays] = {}
        self._scenes: dict[str, RayScene] = {}
        for name, mesh in obstacles.items():
            self.update_boxes(name, mesh.vertices)
        self.counts = np.zeros(1 + len(DETAIL_LEVELS), np.int64)

    def update_boxes(self, name: str, vertices: NDArray[np.float64]) -> None:
        """Move the bounding boxes of an obstacle's pieces to the current `vertices` of the obstacle."""
        self._boxes[name] = self._pieces[name].compute_bounding_boxes(vertices)
        self._scenes[name] = _make_box_scene(*self._boxes[name])

    def count_agents_of_step(self, world: World) -> None:
        """Add the current number of agents at each level to `counts`, at the start of a step."""
        self.counts[0] += 1
        self.counts[1:] += self.count_agents(world)

    def count_agents(self, world: World) -> NDArray[np.int64]:
        """Return the current number of agents at each of `DETAIL_LEVELS`, int64[3]."""
        each = [
            np.bincount(self._get_positions_and_levels(world, p)[1], minlength=len(DETAIL_LEVELS))
            for p in world.populations.values()
        ]
        return np.sum(each, axis=0, dtype=np.int64) if each else np.zeros(len(DETAIL_LEVELS), np.int64)

    def summarise_counts(self, world: World) -> dict[str, dict[str, float]]:
        """Return the number of agents at each level, by the name of the level: `end`, at the end of the run, and `mean` over
        all steps."""
        steps = max(int(self.counts[0]), 1)
        return {
            "end": {name: int(count) for name, count in zip(DETAIL_LEVELS, self.count_agents(world), strict=True)},
            "mean": {name: round(int(count) / steps, 3) for name, count in zip(DETAIL_LEVELS, self.counts[1:], strict=True)},
        }

    def find_levels(self, world: World, population: Population, name: str) -> NDArray[np.int8] | None:
        """Return the level at which each agent senses an obstacle, int8[n], as an index of `DETAIL_LEVELS`.

        None for things without levels of detail. An agent inside the bounding box of a piece, for example in a house, senses
        triangles instead of boxes. The result is cached for the step."""
        if name not in self._boxes:
            return None
        key = (population.name, f"~level of {name}", population.version)
        felt_levels: NDArray[np.int8] | None = world.clearances.get(key)
        if felt_levels is None:
            place, levels = self._get_positions_and_levels(world, population)
            felt_levels = levels.copy()
            middle = np.flatnonzero(felt_levels == 1)
            felt_levels[middle[is_in_boxes(place[middle], *self._boxes[name])]] = 0
            world.clearances[key] = felt_levels
        return felt_levels

    def get_box_scene(self, name: str) -> RayScene:
        """Return a ray scene of the bounding boxes of an obstacle's pieces. Feelers hit these boxes instead of the obstacle."""
        return self._scenes[name]

    def get_box_clearance(self, world: World, population: Population, name: str) -> NDArray[np.float32]:
        """Return a distance (mm, float32[n]) from each agent within which there is no bounding box of the obstacle. Cached for
        the step."""
        key = (population.name, f"~boxes of {name}", population.version)
        distances: NDArray[np.float32] | None = world.clearances.get(key)
        if distances is None:
            distances = self._scenes[name].measure_clearance(
                *vec.get_vector_registers(population.start, "position"), world.options.threads
            )
            world.clearances[key] = distances
        return distances

    def _get_positions_and_levels(self, world: World, population: Population) -> tuple[NDArray[np.float32], NDArray[np.int8]]:
        """Return the agents' positions, float32[n,3], and the level of detail of each agent. Cached for the step."""
        place = _read_positions(population)
        key = (population.name, "~level", population.version)
        levels: NDArray[np.int8] | None = world.clearances.get(key)
        if levels is None:
            levels = world.clearances[key] = self._find_levels_at(place, world.frame)
        return place, levels

    def _find_levels_at(self, place: NDArray[np.float32], frame: int) -> NDArray[np.int8]:
        away = place.astype(np.float64) - self._camera[min(max(frame - self._start_frame, 0), len(self._camera) - 1)]
        distance: NDArray[np.float64] = np.sqrt((away[:, 0] * away[:, 0] + away[:, 1] * away[:, 1]) + away[:, 2] * away[:, 2])
        return (distance > self._near_distance).astype(np.int8) + (distance > self._far_distance).astype(np.int8)


def _read_positions(population: Population) -> NDArray[np.float32]:
    return np.stack([population.start[f"position.{axis}"] for axis in AXES], axis=1)


class MeshPieces:
    """The connected pieces of a mesh. Two faces are connected if they have a common vertex, or vertices at the same position."""

    def __init__(self, mesh: MeshData) -> None:
        self._used_vertices = np.unique(mesh.faces)
        self._piece_numbers = _number_mesh_pieces(mesh, self._used_vertices)
        self._piece_count = int(self._piece_numbers.max(initial=-1)) + 1

    def compute_bounding_boxes(self, vertices: NDArray[np.float64]) -> BoxArrays:
        """Return the least and the greatest corner of each piece's bounding box, float32[m,3], for vertices at `vertices`."""
        low, high = np.full((self._piece_count, 3), np.inf), np.full((self._piece_count, 3), -np.inf)
        np.minimum.at(low, self._piece_numbers, vertices[self._used_vertices])
        np.maximum.at(high, self._piece_numbers, vertices[self._used_vertices])
        return low.astype(np.float32), high.astype(np.float32)


def _number_mesh_pieces(mesh: MeshData, used_vertices: NDArray[np.int32]) -> NDArray[np.int64]:
    """Return, for each of `used_vertices`, the number of the piece to which it belongs."""
    if not len(mesh.faces):
        return np.zeros(0, np.int64)
    points, same = np.unique(mesh.vertices, axis=0, return_inverse=True)
    faces = same.reshape(-1)[mesh.faces]
    of_place = number_connected_components(np.concatenate([faces[:, :2], faces[:, 1:]]), len(points))
    numbers: NDArray[np.int64] = np.unique(of_place[same.reshape(-1)[used_vertices]], return_inverse=True)[1].reshape(-1)
    return numbers


def _make_box_scene(low: NDArray[np.float32], high: NDArray[np.float32]) -> RayScene:
    corners = low[:, None, :].astype(np.float64) + _BOX_CORNERS * (high.astype(np.float64) - low)[:, None, :]
    faces = _BOX_TRIANGLES[None] + 8 * np.arange(len(low), dtype=np.int32)[:, None, None]
    return RayScene(corners.reshape(-1, 3), faces.reshape(-1, 3))


def is_in_boxes(place: NDArray[np.float32], low: NDArray[np.float32], high: NDArray[np.float32]) -> NDArray[np.bool_]:
    """Return a mask of the points [n,3] that are in at least one box, bool[n]. A coarse grid excludes most points quickly."""
    is_inside = np.zeros(len(place), np.bool_)
    if not len(place) or not len(low):
        return is_inside
    least, most = low.min(axis=0), high.max(axis=0)
    width = np.maximum(most - least, np.float32(1e-6)) / np.float32(_GRID_CELLS_PER_AXIS)

    def find_grid_cells(points: NDArray[np.float32]) -> NDArray[np.intp]:  # monotonic, so that no box is missed
        at: NDArray[np.intp] = np.clip(np.floor((points - least) / width), 0, _GRID_CELLS_PER_AXIS - 1).astype(np.intp)
        return at

    reached = np.zeros((_GRID_CELLS_PER_AXIS, _GRID_CELLS_PER_AXIS, _GRID_CELLS_PER_AXIS), np.bool_)
    for (a, b, c), (d, e, f) in zip(find_grid_cells(low), find_grid_cells(high), strict=True):
        reached[a : d + 1, b : e + 1, c : f + 1] = True
    maybe = np.flatnonzero(reached[tuple(find_grid_cells(place).T)])
    order = maybe[np.argsort(place[maybe, 0], kind="stable")]
    x = place[order, 0]
    first, last = np.searchsorted(x, low[:, 0], "left"), np.searchsorted(x, high[:, 0], "right")
    for k in np.flatnonzero(first < last):
        rows = order[first[k] : last[k]]
        within = place[rows, 1:]
        is_inside[rows[((within >= low[k, 1:]) & (within <= high[k, 1:])).all(axis=1)]] = True
    return is_inside
