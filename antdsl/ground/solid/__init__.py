"""Solids: what agents can dig. A sparse signed distance to sample, carve, mesh and walk on.

`voxelising` turns a closed mesh into `bricks` of nodes (inside by winding numbers, near distances by `triangles`), `volume`
is the door and gives the zero level as triangles: `trilinear` samples between nodes, `carving` digs balls out, `walking` keeps
feet on the zero level."""

from __future__ import annotations

from antdsl.ground.solid.volume import UnusableMesh, Volume
from antdsl.ground.solid.walking import move

__all__ = ["UnusableMesh", "Volume", "move"]
