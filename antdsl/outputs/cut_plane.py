"""Section views: geometry beyond a plane is omitted, so that the inside of solids is visible."""

from __future__ import annotations

import re
from copy import deepcopy
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from antdsl.ground.solid import Volume
from antdsl.ground.solid.bricks import NODES_PER_BRICK, NODES_PER_BRICK_SIDE
from antdsl.outputs.pictures.model import Picture, Solid
from antdsl.scene.quantities import QuantityError, parse_number

_SECTION_COLOUR = (0.33, 0.24, 0.17)  # display values of cut soil
_PLANE = re.compile(r"\s*([xyz])\s*([<>])(.*)", re.DOTALL)


@dataclass(frozen=True, slots=True)
class CutPlane:
    """A plane perpendicular to an axis. Points with a coordinate above `at` (scene units) are cut away or, with `cuts_below`,
    those below it."""

    axis: int
    at: float
    cuts_below: bool

    @staticmethod
    def parse(text: str) -> CutPlane | None:
        """Return the plane that a text such as `z > 0` describes. None for any other text."""
        match = _PLANE.fullmatch(text)
        try:
            return None if match is None else CutPlane("xyz".index(match[1]), parse_number(match[3]), match[2] == "<")
        except QuantityError:
            return None

    def is_cut_away(self, points: NDArray[np.float64]) -> NDArray[np.bool_]:
        """Return a mask of the points [n, 3] that are cut away."""
        along = points[:, self.axis]
        return along < self.at if self.cuts_below else along > self.at

    def compute_section_colours(self, points: NDArray[np.float64], max_distance: float) -> NDArray[np.float64]:
        """Return the colours [n, 3] for vertices of a solid: dark within `max_distance` of the plane, NaN elsewhere.

        So the cut surface is dark, and cavities are visible in it."""
        colour = np.full((len(points), 3), np.nan)
        colour[np.abs(points[:, self.axis] - self.at) < max_distance] = _SECTION_COLOUR
        return colour

    def cut_volume(self, volume: Volume, offset: NDArray[np.float64], scale: float) -> Volume:
        """Return a copy of a volume without the part beyond the plane.

        Each signed distance becomes max(distance, depth beyond the plane). `offset`: the position of the volume in mm. `scale`:
        scene units per mm."""
        copied = deepcopy(volume)
        bricks = copied.bricks
        nodes = bricks.origin[self.axis] + np.arange(bricks.node_counts[self.axis]) * bricks.voxel
        depth = (nodes + offset[self.axis]) * scale - self.at
        depth = (-depth if self.cuts_below else depth) / scale
        low = depth.reshape(-1, NODES_PER_BRICK_SIDE).max(axis=1) > bricks.min_distance  # layers of bricks that the plane changes
        index = np.unravel_index(np.arange(bricks.table.size), bricks.shape)[self.axis]
        changed = np.flatnonzero(low[index] & (bricks.table != 0))
        bricks.allocate_bricks(changed)
        pool = bricks.values.reshape(-1, NODES_PER_BRICK)
        shape = [1, 1, 1, 1]
        shape[self.axis + 1] = NODES_PER_BRICK_SIDE
        cut = np.minimum(
            depth.reshape(-1, NODES_PER_BRICK_SIDE)[index[changed]].astype(np.float32), np.float32(bricks.max_distance)
        )
        slots = bricks.table[changed]
        spread = cut.reshape([len(changed), *shape[1:]])
        pool[slots] = np.maximum(
            pool[slots].reshape(-1, NODES_PER_BRICK_SIDE, NODES_PER_BRICK_SIDE, NODES_PER_BRICK_SIDE), spread
        ).reshape(-1, NODES_PER_BRICK)
        return copied

    def cut_picture(self, picture: Picture) -> Picture:
        """Return a picture without the agents, items, scent and mesh faces beyond the plane. Solids must already be cut."""
        return replace(
            picture,
            solids=tuple(self._cut_mesh(solid) for solid in picture.solids),
            crowds=tuple(crowd.select_rows(~self.is_cut_away(crowd.position)) for crowd in picture.crowds),
            items=tuple(item for item in picture.items if not self.is_cut_away(np.array([item.position]))[0]),
            trails=tuple(replace(t, strength=np.where(self.is_cut_away(t.position), 0.0, t.strength)) for t in picture.trails),
        )

    def _cut_mesh(self, solid: Solid) -> Solid:
        """Return a mesh without the faces that have all corners beyond the plane."""
        is_removed = self.is_cut_away(solid.vertices)
        is_visible = ~is_removed[solid.faces].all(axis=1)
        return solid if is_visible.all() else replace(solid, faces=solid.faces[is_visible])
