"""Ground and obstacles as meshes, once; those that move again in each frame, and without faces where there are none any more."""

from __future__ import annotations

import numpy as np

from antdsl.preview.binary_packets import pack
from antdsl.preview.viewing.seen import Packets, Seen
from antdsl.runtime import World
from antdsl.runtime.moving.moving_geometry import vertices_at
from antdsl.scene.setting import MeshData


class Meshes:
    """The slots `mesh:NAME`. A mesh that an edit left alone is not sent again."""

    def __init__(self) -> None:
        self._world: World | None = None
        self._frame = 0
        self._given: dict[str, tuple[MeshData, bytes] | None] = {}  # None: it moves

    def packets(self, seen: Seen) -> Packets:
        world, moves = seen.world, seen.world.setting.moves.meshes
        if world is self._world and (not moves or world.frame == self._frame):
            return
        fresh, self._world, self._frame = world is not self._world, world, world.frame
        for name in sorted(self._given.keys() - world.setting.surfaces.keys() - world.setting.obstacles.keys()):
            del self._given[name]
            nothing = {"position": np.empty(0, np.float32), "face": np.empty(0, np.uint32)}
            yield f"mesh:{name}", pack(f"mesh:{name}", nothing, role="", moves=False)
        for role, meshes in (("ground", world.setting.surfaces), ("obstacle", world.setting.obstacles)):
            for name, mesh in meshes.items():
                if name in moves:
                    self._given[name] = None
                elif not fresh or self._known(name, mesh, world):
                    continue
                vertices = vertices_at(world, name, world.frame) if name in moves else mesh.vertices - world.origin
                slot = f"mesh:{name}"
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
        before, origin = self._given.get(name) or (None, b"")
        same = (
            before is not None
            and origin == world.origin.tobytes()
            and (before is mesh or (np.array_equal(before.vertices, mesh.vertices) and np.array_equal(before.faces, mesh.faces)))
        )
        self._given[name] = mesh, world.origin.tobytes()
        return same
