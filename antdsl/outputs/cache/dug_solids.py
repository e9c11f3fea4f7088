"""Solids of a cache at a frame, for drawing. They are dug again, starting from the last checkpoint."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.ground.solid import Volume
from antdsl.numerics.records import part_of
from antdsl.outputs.cache.cache_reader import Cache, CacheError
from antdsl.outputs.cache.solid_pieces import Piece, join_pieces, start_volume
from antdsl.outputs.cutting import CutPlane
from antdsl.outputs.pictures.model import Solid


@dataclass(slots=True)
class _DugSolid:
    """One solid: its volume at the last requested frame, its surface by brick, and the mesh to draw."""

    volume: Volume
    pieces: dict[int, Piece] = field(default_factory=dict)
    drawn: Solid | None = None

    def surface(self, name: str, offset: NDArray[np.float64], scale: float, cut: CutPlane | None) -> Solid:
        """Return the current surface in scene units. Only bricks that changed are meshed again, unless a plane cuts the solid."""
        if cut is not None:
            opened = cut.cut_volume(self.volume, offset, scale)
            vertices, faces = join_pieces([(v, f) for _, v, f in opened.surface(changed_only=False)])
            positions = (vertices + offset) * scale
            return Solid(name, positions, faces, "hill", cut.section_colours(positions, 0.3 * self.volume.bricks.voxel * scale))
        changed = {brick: (vertices, faces) for brick, vertices, faces in self.volume.surface()}
        if changed or self.drawn is None:
            self.pieces |= changed
            vertices, faces = join_pieces(list(self.pieces.values()))
            self.drawn = Solid(name, (vertices + offset) * scale, faces, "hill")
        return self.drawn


class DugSolids:
    """Solids frame by frame. Ascending frames are fastest. For any other frame, digging starts again at the checkpoint before
    it."""

    def __init__(self, cache: Cache, static: Mapping[str, NDArray[Any]], cut: CutPlane | None = None) -> None:
        self.cache, self._static, self._cut = cache, static, cut
        self._kept = {m.name: _DugSolid(start_volume(m.name, static)) for m in cache.manifest.meshes if m.row.is_dug}
        self._at: int | None = None
        self._scale = 1.0 / {"mm": 1.0, "cm": 10.0, "m": 1000.0}[cache.manifest.units]

    def at(self, frame: int) -> tuple[Solid, ...]:
        """Return all solids at a frame. A solid is the same object until it is dug again."""
        if not self._kept:
            return ()
        if self._at is None or not self._at <= frame < self._at + self.cache.manifest.checkpoint:
            self._at = self._begin(frame)
        for number in range(self._at + 1, frame + 1):
            self._dig(number)
        self._at = frame
        return tuple(
            solid.surface(name, np.asarray(self._static[f"solid.{name}.offset"]), self._scale, self._cut)
            for name, solid in self._kept.items()
        )

    def volumes(self) -> Iterator[tuple[str, Volume, NDArray[np.float64]]]:
        """Yield name, volume and offset (mm) of each solid at the last requested frame."""
        for name, solid in self._kept.items():
            yield name, solid.volume, np.asarray(self._static[f"solid.{name}.offset"])

    def _dig(self, frame: int) -> None:
        """Dig the balls of one frame. A frame that cannot be read is skipped."""
        try:
            arrays = self.cache.frame(frame)
        except CacheError:  # other frames can be drawn without a missing one
            return
        for name, solid in self._kept.items():
            balls = arrays.get(f"solid.{name}.balls")
            if balls is not None:
                solid.volume.carve(balls[:, :3], balls[:, 3], np.zeros(len(balls), np.int64))

    def _begin(self, frame: int) -> int:
        """Restore the volumes to the last complete checkpoint, or to the start. Return the last frame to dig."""
        for number in sorted((n for n in self.cache.checkpoints() if n <= frame), reverse=True):
            try:
                arrays = self.cache.checkpoint(number)
                for name, solid in self._kept.items():
                    solid.volume.restore(part_of(arrays, f"world.solid.{name}."))
                return number
            except (CacheError, ValueError, KeyError):
                continue
        for name in self._kept:
            self._kept[name] = _DugSolid(start_volume(name, self._static))
        return self.cache.manifest.first - 1
