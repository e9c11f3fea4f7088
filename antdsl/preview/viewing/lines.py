"""Curves as their points, and flows as arrows on the ground."""

from __future__ import annotations

import numpy as np

from antdsl.outputs.flow_arrows import arrows
from antdsl.preview.binary_packets import pack
from antdsl.preview.viewing.seen import Packets, Seen
from antdsl.runtime import World
from antdsl.scene.setting import SolvedFlow

_AGAIN = 1.0  # seconds after which flows that are solved while it runs are shown again


class Curves:
    """The slots `curve:NAME`; those that move in each frame."""

    def __init__(self) -> None:
        self._world: World | None = None
        self._frame = 0

    def packets(self, seen: Seen) -> Packets:
        world = seen.world
        moves = world.setting.moves
        if world is self._world and (not moves.curves or world.frame == self._frame):
            return
        fresh, self._world, self._frame = world is not self._world, world, world.frame
        for name, points in world.setting.curves.items():
            if not fresh and name not in moves.curves:
                continue
            if name in moves.curves:
                points = moves.points(moves.curves[name], world.frame)
            closed = len(points) > 2 and bool(np.array_equal(points[0], points[-1]))
            slot = f"curve:{name}"
            yield slot, pack(slot, {"point": (points - world.origin).astype(np.float32)}, closed=closed)


class Flows:
    """The slots `flow:NAME` of those that some page looks at."""

    def __init__(self) -> None:
        self._world: World | None = None
        self._given: set[str] = set()
        self._solved = 0.0

    def packets(self, seen: Seen) -> Packets:
        world = seen.world
        if world is not self._world:
            self._world, self._given = world, set()
        solved = {name for name in seen.wanted.flows if isinstance(world.setting.flows.get(name), SolvedFlow)}
        if solved and seen.now - self._solved >= _AGAIN:
            self._given -= solved
            self._solved = seen.now
        wanted = (seen.wanted.flows & world.flows.keys()) - self._given
        if not wanted:
            return
        self._given |= wanted
        found = arrows(world, 1.0)
        for name in sorted(wanted):
            if f"flow.{name}.P" in found:
                slot = f"flow:{name}"
                yield slot, pack(slot, {"from": found[f"flow.{name}.P"], "way": found[f"flow.{name}.V"]})
