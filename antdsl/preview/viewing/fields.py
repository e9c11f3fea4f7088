"""Fields as numbers on their meshes, a few times a second, of those that some page looks at."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from antdsl.preview.binary_packets import pack
from antdsl.preview.viewing.field_meshes import FieldMesh, cells_in_use, field_mesh
from antdsl.preview.viewing.seen import Packets, Seen
from antdsl.runtime import World

_EVERY = 0.125  # seconds between two showings while it plays
_MESH_EVERY = 1.0  # the same of meshes that grow
_FULL = 100.0  # what is shown as full where a field has no limit
LEAST, DECADES = 1e-8, 16  # the values that a byte can tell: 1 is the least of them, 255 is so many powers of ten more


def full(limit: float) -> float:
    """What is shown as full at first. It goes by the program alone, so that a frame looks the same whatever was played before."""
    return float(limit) if np.isfinite(limit) and limit > 1e-3 else _FULL


def in_bytes(values: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Values on a scale of powers of ten, with steps of 16 %: 0 for what is below `LEAST`."""
    there = values >= LEAST
    level = 1 + np.log10(np.where(there, values, LEAST) / LEAST) * (254 / DECADES)
    return np.where(there, np.clip(np.rint(level), 1, 255), 0).astype(np.uint8)


class Fields:
    """The slots `fieldmesh:NAME` and `field:NAME`: a byte a vertex, see `in_bytes`."""

    def __init__(self) -> None:
        self._world: World | None = None
        self._cells: dict[str, tuple[object, int, float]] = {}  # what a mesh was made of, and when
        self._moving: set[str] = set()  # meshes
        self._meshes: dict[str, FieldMesh] = {}
        self._shown: dict[str, int] = {}  # the frame shown last
        self._last = -1.0

    def packets(self, seen: Seen) -> Packets:
        world = seen.world
        wanted = sorted(seen.wanted.fields & world.fields.keys())
        if world is not self._world:  # the same cells, often, and other values
            self._world = world
            self._shown = dict.fromkeys(self._shown, -1)
            moving = set(world.setting.moves.meshes)
            if moving != self._moving:
                self._moving = moving
                self._cells.clear()
        for gone in self._meshes.keys() - set(wanted):  # asked for again it is sent again
            del self._meshes[gone]
            self._cells.pop(gone, None)
            self._shown.pop(gone, None)
        if not wanted or (seen.going and seen.now - self._last < _EVERY and self._shown.keys() >= set(wanted)):
            return
        self._last = seen.now
        for name in wanted:
            yield from self._field(seen, name)

    def _field(self, seen: Seen, name: str) -> Packets:
        world, field = seen.world, seen.world.fields[name]
        made_of, count, when = self._cells.get(name, (None, 0, -_MESH_EVERY))
        grown = count != cells_in_use(field) and (seen.now - when >= _MESH_EVERY or not seen.going)
        if made_of is not field.cells or grown:
            mesh = field_mesh(world, name)
            self._meshes[name], self._cells[name] = mesh, (field.cells, cells_in_use(field), seen.now)
            self._shown.pop(name, None)
        if self._shown.get(name) == world.frame:
            return
        mesh = self._meshes[name]
        if name not in self._shown or mesh.carried:
            slot = f"fieldmesh:{name}"
            yield slot, pack(slot, {"position": mesh.places(world), "face": mesh.face})
        self._shown[name] = world.frame
        value = in_bytes(mesh.shown(field.values))
        yield f"field:{name}", pack(f"field:{name}", {"value": value}, frame=world.frame)
