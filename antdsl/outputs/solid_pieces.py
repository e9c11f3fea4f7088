"""The surface of solids in a cache: the whole at the start, then in each frame the bricks that were dug since; and back.

static.npz  mesh.NAME.vertices, .faces, and .bricks int32: the brick that each face is in
a frame     mesh.NAME.changed int32: bricks whose faces these are instead, with .vertices, .faces and .bricks as above; every so
            many frames (the manifest's `checkpoint`) all bricks that were ever dug, so that no frame needs more than those since
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.runtime.world import World

Arrays = dict[str, NDArray[Any]]
Piece = tuple[NDArray[np.float64], NDArray[np.int32]]


class PieceMaker:
    """Makes what frames hold of solids. Asks each volume for what changed since it asked last."""

    def __init__(self, first: int, every: int, scale: float) -> None:
        self.first, self.every, self.scale = first, every, scale
        self._dug: dict[str, dict[int, Piece]] = {}

    def frame(self, world: World) -> Arrays:
        """Arrays of the frame that the world stands at."""
        arrays: Arrays = {}
        whole = (world.frame - self.first) % self.every == 0
        for name, volume in world.solids.items():
            dug = self._dug.setdefault(name, {})
            changed = {brick: (vertices, faces) for brick, vertices, faces in volume.surface()}
            dug |= changed
            pieces = dug if whole else changed
            if pieces:
                arrays[f"mesh.{name}.changed"] = np.array(sorted(pieces), np.int32)
                arrays |= _joined(name, pieces, world.origin, self.scale)
        return arrays


def start_pieces(world: World, scale: float) -> Arrays:
    """What stands in static.npz of all solids as they are; no frame's change has them again."""
    arrays: Arrays = {}
    for name, volume in world.solids.items():
        pieces = {brick: (vertices, faces) for brick, vertices, faces in volume.surface(changed_only=False)}
        arrays |= _joined(name, pieces, world.origin, scale)
    return arrays


def forget_changes(world: World) -> None:
    """Let what is dug so far count as written."""
    for volume in world.solids.values():
        for _ in volume.surface():
            pass


def _joined(name: str, pieces: Mapping[int, Piece], origin: NDArray[np.float64], scale: float) -> Arrays:
    order = sorted(pieces)
    counts = [len(pieces[brick][0]) for brick in order]
    shift = np.cumsum([0, *counts])
    vertices = [pieces[brick][0] for brick in order]
    faces = [pieces[brick][1] + np.int32(start) for brick, start in zip(order, shift, strict=False)]
    return {
        f"mesh.{name}.vertices": (np.concatenate([np.empty((0, 3)), *vertices]) + origin) * scale,
        f"mesh.{name}.faces": np.concatenate([np.empty((0, 3), np.int32), *faces]).astype(np.int32),
        f"mesh.{name}.bricks": np.repeat(np.array(order, np.int32), [len(pieces[brick][1]) for brick in order]),
    }


class Surface:
    """A solid's surface, brought up to date by the arrays of frames."""

    def __init__(self, name: str, static: Mapping[str, NDArray[Any]]) -> None:
        self.name = name
        self.mesh = _mesh(name, static)

    def change(self, arrays: Mapping[str, NDArray[Any]]) -> bool:
        """Put a frame's bricks in place of what was there; whether there were any."""
        changed = arrays.get(f"mesh.{self.name}.changed")
        if changed is None:
            return False
        vertices, faces, bricks = self.mesh
        kept = ~np.isin(bricks, changed)
        more = _mesh(self.name, arrays)
        whole = np.concatenate([faces[kept], more[1] + np.int32(len(vertices))])
        used, renumbered = np.unique(whole, return_inverse=True)
        self.mesh = (
            np.concatenate([vertices, more[0]])[used],
            renumbered.reshape(whole.shape).astype(np.int32),
            np.concatenate([bricks[kept], more[2]]),
        )
        return True


def _mesh(name: str, arrays: Mapping[str, NDArray[Any]]) -> tuple[NDArray[np.float64], NDArray[np.int32], NDArray[np.int32]]:
    return (
        np.asarray(arrays[f"mesh.{name}.vertices"], np.float64),
        np.asarray(arrays[f"mesh.{name}.faces"], np.int32),
        np.asarray(arrays[f"mesh.{name}.bricks"], np.int32),
    )
