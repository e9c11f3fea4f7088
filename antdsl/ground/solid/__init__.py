"""Solids: volumes that agents can dig. A solid is a sparse signed distance field that can be sampled, carved, meshed and
walked on.

- `voxelising`: turns a closed mesh into `bricks` of nodes. Winding numbers decide what is inside; `triangles` measures
  distances near the surface
- `volume`: the interface for other packages; it also returns the zero level as triangles
- `trilinear`: samples between nodes
- `carving`: digs balls out of the solid
- `walking`: moves feet along the zero level"""

from __future__ import annotations

from antdsl.ground.solid.volume import UnusableMeshReason, Volume
from antdsl.ground.solid.walking import move_over_solid

__all__ = ["UnusableMeshReason", "Volume", "move_over_solid"]
