"""The compiled walk in rounds: a loop over all agents until each is done or needs rays, then the rays of all who wait at once."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.runtime import compiled
from antdsl.runtime.senses import walk_compiled as loop
from antdsl.runtime.senses.candidates import Candidates
from antdsl.runtime.senses.clearances import Parts
from antdsl.runtime.senses.packing import pack, packed
from antdsl.runtime.senses.surroundings import LIFT, Around
from antdsl.runtime.senses.topology import Topology
from antdsl.runtime.senses.walk import Walkers, border, climb

Floats = NDArray[np.float64]


class Walk:
    """Steps of a crowd by the compiled loop: `table` with the mesh int32[m] of each face and the first face of each mesh."""

    def __init__(self, table: Topology, mesh: NDArray[np.int32], first: NDArray[np.int64]) -> None:
        self._table, self._mesh, self._first = table, mesh, first
        self._packed = packed(table, mesh)

    def changed(self, faces: slice) -> None:
        """Some faces have another shape in the table."""
        pack(self._packed, self._table, self._mesh, faces)

    def step(
        self,
        around: Around,
        parts: Parts,
        candidates: Candidates,
        noise: float,
        body: Floats,
        at: tuple[Any, ...],
        vectors: tuple[Floats, Floats, Floats],
        to: tuple[Any, ...],
        threads: int,
    ) -> NDArray[np.bool_]:
        """Move agents with wish, heading and up (3, n) from footings `at` to the arrays of a result, `to`; says who was moved.
        Others are nowhere, or their numbers are not finite."""
        n = body.size
        done = np.empty(n, np.bool_)
        table = (self._packed, self._table.link, self._table.forked, self._first)
        near = (*table, parts.first, parts.count, parts.least, parts.reach, LIFT, noise)

        def part(begin: int, end: int) -> tuple[Floats, NDArray[np.int64]]:
            reals, wholes = np.empty((loop.REALS, end - begin)), np.empty((loop.WHOLES, end - begin), np.int64)
            waiting = loop.walk_all(*near, *at, body, *vectors, reals, wholes, done, *to[:-1], begin, end)
            return reals[:, :waiting], wholes[:, :waiting]

        reals, wholes = (np.concatenate(half, axis=1) for half in zip(*compiled.in_parts(part, n, threads), strict=True))
        if wholes.size:
            asking = around.of(wholes[loop.AGENT])
            known = (candidates.body, candidates.margin, candidates.ahead.arrays(), candidates.beyond.arrays())
            loop.walk_on(*near, *known, body, reals, wholes, done, *to)
            while wholes[loop.EVENT].any():
                self._meet(asking, reals, wholes)
                loop.walk_on(*near, *known, body, reals, wholes, done, *to)
        return done

    def _meet(self, around: Around, reals: Floats, wholes: NDArray[np.int64]) -> None:
        """Cast the rays of all who wait, and do with them what `walk` does."""
        columns: Any = (wholes[loop.FACE], *reals[: loop.GONE + 1], wholes[loop.BLOCKED])
        w = Walkers(*columns)
        near: Any = wholes[loop.NEAR]
        spent: Any = wholes[loop.SPENT]
        stopped, edge = np.flatnonzero(wholes[loop.EVENT] == loop.BORDER), wholes[loop.EDGE]
        looking = np.flatnonzero(wholes[loop.EVENT] == loop.AHEAD)
        on = stopped
        if looking.size:
            met = climb(self._table, w, looking, near, reals[loop.LENGTH].take(looking), spent, around)
            looked = np.ones(looking.size, bool) if met is None else ~met
            wholes[loop.LOOKED, looking] = looked
            on = np.concatenate([on, looking[~looked]])
        if stopped.size:
            border(self._table, w, stopped, 3 * w.face.take(stopped) + edge.take(stopped), near, spent, around)
        wholes[loop.TURN, on] += 1
        wholes[loop.EVENT, np.concatenate([stopped, looking])] = loop.MET
