"""Solids: volumes that agents can dig. A sparse signed distance field to sample, carve, mesh and walk on.

`voxelising` turns a closed mesh into `bricks` of nodes (inside by winding numbers, near distances by `triangles`). `volume` is
the interface for other packages and gives the zero level as triangles. `trilinear` samples between nodes, `carving` digs balls
out, and `walking` moves feet along the zero level."""

from __future__ import annotations

from antdsl.ground.solid.volume import UnusableMesh, Volume
from antdsl.ground.solid.walking import move

__all__ = ["UnusableMesh", "Volume", "move"]
