"""Solids of a cache as they are at a frame, to be drawn."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from numpy.typing import NDArray

from antdsl.outputs.cache import Cache, CacheError
from antdsl.outputs.pictures.model import Solid
from antdsl.outputs.solid_pieces import Surface


class DugSolids:
    """Solids frame by frame. Frames asked for in order are quickest; any other reads those since the last whole one."""

    def __init__(self, cache: Cache, static: Mapping[str, NDArray[Any]]) -> None:
        self.cache, self._static = cache, static
        self._names = [mesh.name for mesh in cache.manifest.meshes if mesh.kind == "solid"]
        self._surfaces: dict[str, Surface] = {}
        self._solids: dict[str, Solid] = {}
        self._at: int | None = None

    def at(self, frame: int) -> tuple[Solid, ...]:
        """All solids; the same objects as long as nothing was dug."""
        if not self._names:
            return ()
        manifest = self.cache.manifest
        whole = frame - (frame - manifest.first) % manifest.checkpoint
        begin = whole if self._at is None or not whole <= self._at <= frame else self._at + 1
        if begin == whole or not self._surfaces:
            self._surfaces = {name: Surface(name, self._static) for name in self._names}
            self._solids = {}
        for number in range(begin, frame + 1):
            try:
                arrays = self.cache.frame(number)
            except CacheError:  # a frame that is missing keeps no other from being drawn
                continue
            for name, surface in self._surfaces.items():
                if surface.change(arrays):
                    self._solids.pop(name, None)
        self._at = frame
        for name, surface in self._surfaces.items():
            if name not in self._solids:
                self._solids[name] = Solid(name, surface.mesh[0], surface.mesh[1], "hill")
        return tuple(self._solids[name] for name in self._names)
