"""Solids: volumes that agents can dig. A solid is a sparse signed distance field that can be sampled, carved, meshed and walked
on.

- `voxelising`: converts a closed mesh to `bricks` of nodes. Winding numbers show which nodes are inside; `triangles` measures
  their distances from the surface
- `volume`: the interface for other packages; it also returns the surface (the zero level of the field) as triangles
- `trilinear`: interpolates between nodes
- `carving`: digs balls out of the solid
- `walking`: moves agents along the surface"""

from __future__ import annotations

from antdsl.ground.solid.volume import UnusableMeshReason, Volume
from antdsl.ground.solid.walking import move_over_solid

__all__ = ["UnusableMeshReason", "Volume", "move_over_solid"]
