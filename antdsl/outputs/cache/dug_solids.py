"""Solids of a cache as dug at a frame, for drawing. The state of the last checkpoint is restored, and later digging is
repeated."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.ground.solid import Volume
from antdsl.numerics.records import select_by_prefix
from antdsl.outputs.cache.cache_reader import Cache, CacheError
from antdsl.outputs.cache.solid_pieces import Piece, join_pieces, read_start_volume
from antdsl.outputs.cut_plane import CutPlane
from antdsl.outputs.pictures.model import Solid


@dataclass(slots=True)
class _DugSolid:
    """One solid: its volume at the frame last requested, its surface by brick, and the mesh to draw."""

    volume: Volume
    surface_by_brick: dict[int, Piece] = field(default_factory=dict)
    mesh: Solid | None = None

    def update_surface(self, name: str, offset: NDArray[np.float64], scale: float, cut: CutPlane | None) -> Solid:
        """Return the current surface in scene units. Only changed bricks are meshed again, unless a plane cuts the solid."""
        if cut is not None:
            opened = cut.cut_volume(self.volume, offset, scale)
            vertices, faces = join_pieces([(v, f) for _, v, f in opened.iterate_brick_meshes(changed_only=False)])
            positions = (vertices + offset) * scale
            return Solid(
                name, positions, faces, "hill", cut.compute_section_colours(positions, 0.3 * self.volume.bricks.voxel * scale)
            )
        changed = {brick: (vertices, faces) for brick, vertices, faces in self.volume.iterate_brick_meshes()}
        if changed or self.mesh is None:
            self.surface_by_brick |= changed
            vertices, faces = join_pieces(list(self.surface_by_brick.values()))
            self.mesh = Solid(name, (vertices + offset) * scale, faces, "hill")
        return self.mesh


class DugSolids:
    """The solids of a cache as dug at any frame.

    Ascending frames are fastest. For an earlier frame, digging is repeated from the checkpoint before it."""

    def __init__(self, cache: Cache, static: Mapping[str, NDArray[Any]], cut: CutPlane | None = None) -> None:
        self.cache, self._static, self._cut_plane = cache, static, cut
        self._solid_by_name = {
            m.name: _DugSolid(read_start_volume(m.name, static)) for m in cache.manifest.meshes if m.row.is_dug
        }
        self._last_frame: int | None = None
        self._scale = 1.0 / {"mm": 1.0, "cm": 10.0, "m": 1000.0}[cache.manifest.units]

    def at(self, frame: int) -> tuple[Solid, ...]:
        """Return all solids as dug at a frame. As long as a solid is not dug, the same object is returned."""
        if not self._solid_by_name:
            return ()
        if self._last_frame is None or not self._last_frame <= frame < self._last_frame + self.cache.manifest.checkpoint:
            self._last_frame = self._restore_volumes(frame)
        for number in range(self._last_frame + 1, frame + 1):
            self._dig_frame(number)
        self._last_frame = frame
        return tuple(
            solid.update_surface(name, np.asarray(self._static[f"solid.{name}.offset"]), self._scale, self._cut_plane)
            for name, solid in self._solid_by_name.items()
        )

    def iterate_volumes(self) -> Iterator[tuple[str, Volume, NDArray[np.float64]]]:
        """Yield the name, the volume and the offset (mm) of each solid at the frame last requested."""
        for name, solid in self._solid_by_name.items():
            yield name, solid.volume, np.asarray(self._static[f"solid.{name}.offset"])

    def _dig_frame(self, frame: int) -> None:
        """Dig the balls that were dug in one frame. A frame that cannot be read is skipped."""
        try:
            arrays = self.cache.frame(frame)
        except CacheError:  # a missing frame does not prevent drawing others
            return
        for name, solid in self._solid_by_name.items():
            balls = arrays.get(f"solid.{name}.balls")
            if balls is not None:
                solid.volume.carve_balls(balls[:, :3], balls[:, 3], np.zeros(len(balls), np.int64))

    def _restore_volumes(self, frame: int) -> int:
        """Restore the volumes of the last readable checkpoint at or before `frame`, or else the undug solids.

        Return the frame of the restored state."""
        for number in sorted((n for n in self.cache.checkpoints() if n <= frame), reverse=True):
            try:
                arrays = self.cache.read_checkpoint(number)
                for name, solid in self._solid_by_name.items():
                    solid.volume.restore_changes(select_by_prefix(arrays, f"world.solid.{name}."))
                return number
            except (CacheError, ValueError, KeyError):
                continue
        for name in self._solid_by_name:
            self._solid_by_name[name] = _DugSolid(read_start_volume(name, self._static))
        return self.cache.manifest.first - 1
