"""Solids: what agents can dig. A sparse signed distance to sample, carve, mesh and walk on."""

from __future__ import annotations

from antdsl.ground.solid.volume import Unusable, Volume
from antdsl.ground.solid.walking import move

__all__ = ["Unusable", "Volume", "move"]
