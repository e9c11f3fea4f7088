"""Ground and obstacles as meshes, once; those that move again in each frame."""

from __future__ import annotations

import numpy as np

from antdsl.preview.packing import pack
from antdsl.preview.viewing.seen import Packets, Seen
from antdsl.runtime import World
from antdsl.runtime.carrying import vertices_at
from antdsl.scene.setting import MeshData


class Meshes:
    """The slots `mesh:NAME`. A mesh that an edit left alone is not sent again; one that is gone is sent without faces."""

    def __init__(self) -> None:
        self._world: World | None = None
        self._frame = 0
        self._given: dict[str, tuple[MeshData, bytes]] = {}
        self._shown: set[str] = set()  # slots

    def packets(self, seen: Seen) -> Packets:
        world, moves = seen.world, seen.world.setting.moves.meshes
        if world is self._world and (not moves or world.frame == self._frame):
            return
        fresh, self._world, self._frame = world is not self._world, world, world.frame
        there = {*world.setting.surfaces, *world.setting.obstacles}
        for slot in sorted(self._shown - {f"mesh:{name}" for name in there}):
            self._shown.remove(slot)
            yield slot, pack(slot, {"position": np.empty(0, np.float32), "face": np.empty(0, np.uint32)}, role="", moves=False)
        self._given = {name: given for name, given in self._given.items() if name in there}
        for role, meshes in (("ground", world.setting.surfaces), ("obstacle", world.setting.obstacles)):
            for name, mesh in meshes.items():
                if name not in moves and (not fresh or self._known(name, mesh, world)):
                    continue
                vertices = vertices_at(world, name, world.frame) if name in moves else mesh.vertices - world.origin
                slot = f"mesh:{name}"
                self._shown.add(slot)
                yield (
                    slot,
                    pack(
                        slot,
                        {"position": vertices.astype(np.float32), "face": mesh.faces.astype(np.uint32)},
                        role=role,
                        moves=name in moves,
                    ),
                )

    def _known(self, name: str, mesh: MeshData, world: World) -> bool:
        before, origin = self._given.get(name, (None, b""))
        same = (
            before is not None
            and origin == world.origin.tobytes()
            and (before is mesh or (np.array_equal(before.vertices, mesh.vertices) and np.array_equal(before.faces, mesh.faces)))
        )
        self._given[name] = mesh, world.origin.tobytes()
        return same
