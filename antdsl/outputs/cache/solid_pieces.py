"""Solids in a cache: their start state, the balls dug in each frame, and their surface at every checkpoint interval.

static.npz  mesh.NAME.vertices, .faces, .bricks: the surface, and the brick of each face
            solid.NAME.values, .table, .shape, .origin, .voxel, .band, .offset: the distances, to repeat the digging
a frame     solid.NAME.balls float64 (k, 4): centre and radius of each ball dug since the frame before, in mm
            mesh.NAME.changed int32, and .vertices, .faces, .bricks as above: at every checkpoint interval (the
            manifest's `checkpoint`), the current state of all bricks ever dug"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.ground.solid import Volume
from antdsl.ground.solid.bricks import NODES_PER_BRICK, BrickGrid
from antdsl.runtime import World, take_dug_balls

Arrays = dict[str, NDArray[Any]]
Piece = tuple[NDArray[np.float64], NDArray[np.int32]]


class PieceMaker:
    """Builder of the arrays of solids in frames. Each call returns the changes since the previous call."""

    def __init__(self, first: int, interval: int, scale: float) -> None:
        self.first, self.every, self.scale = first, interval, scale
        self._pieces_by_solid: dict[str, dict[int, Piece]] = {}

    def frame(self, world: World) -> Arrays:
        """Return the arrays of solids for the world's current frame."""
        arrays: Arrays = {}
        dug_now = take_dug_balls(world)
        for name, volume in world.solids.items():
            if name in dug_now:
                arrays[f"solid.{name}.balls"] = dug_now[name]
            if (world.frame - self.first) % self.every:
                continue
            dug = self._pieces_by_solid.setdefault(name, {})
            dug |= {brick: (vertices, faces) for brick, vertices, faces in volume.iterate_brick_meshes()}
            if dug:
                arrays[f"mesh.{name}.changed"] = np.array(sorted(dug), np.int32)
                arrays |= _join_arrays(name, dug, self.scale)
        return arrays


def make_start_arrays(world: World, scale: float) -> Arrays:
    """Return the arrays of all undug solids for `static.npz`.

    The array `offset` (mm) is 0, because the manifest contains the origin. `scale`: scene units per millimetre."""
    arrays: Arrays = {}
    for name, volume in world.solids.items():
        bricks = volume.bricks
        arrays |= {
            f"solid.{name}.{key}": np.array(value)
            for key, value in {
                "values": bricks.values[: bricks.used_slots * NODES_PER_BRICK], "table": bricks.table, "shape": bricks.shape,
                "origin": bricks.origin, "voxel": bricks.voxel, "band": (bricks.min_distance, bricks.max_distance),
                "offset": np.zeros(3),
            }.items()
        }  # fmt: skip
        pieces = {brick: (vertices, faces) for brick, vertices, faces in volume.iterate_brick_meshes(changed_only=False)}
        arrays |= _join_arrays(name, pieces, scale)
    return arrays


def read_start_volume(name: str, static: Mapping[str, NDArray[Any]]) -> Volume:
    """Return the volume of an undug solid."""

    def read_array(key: str) -> NDArray[Any]:
        return np.array(static[f"solid.{name}.{key}"])

    values = read_array("values")
    least, most = (float(end) for end in read_array("band"))
    a, b, c = (int(side) for side in read_array("shape"))
    bricks = BrickGrid(
        read_array("origin"),
        float(read_array("voxel")),
        (a, b, c),
        least,
        most,
        read_array("table"),
        values,
        len(values) // NODES_PER_BRICK,
    )
    bricks.record_start_values()
    return Volume(bricks)


def _join_arrays(name: str, pieces: Mapping[int, Piece], scale: float) -> Arrays:
    """Return the arrays of a solid's surface in scene units, given the meshes of its bricks."""
    order = sorted(pieces)
    vertices, faces = join_pieces([pieces[brick] for brick in order])
    return {
        f"mesh.{name}.vertices": (vertices + 0.0) * scale,
        f"mesh.{name}.faces": faces,
        f"mesh.{name}.bricks": np.repeat(np.array(order, np.int32), [len(pieces[brick][1]) for brick in order]),
    }


def join_pieces(pieces: list[Piece]) -> Piece:
    """Return several meshes joined to one mesh."""
    shift = np.cumsum([0, *(len(vertices) for vertices, _ in pieces)])
    faces = [faces + np.int32(start) for (_, faces), start in zip(pieces, shift, strict=False)]
    return (
        np.concatenate([np.empty((0, 3)), *(vertices for vertices, _ in pieces)]),
        np.concatenate([np.empty((0, 3), np.int32), *faces]).astype(np.int32),
    )
