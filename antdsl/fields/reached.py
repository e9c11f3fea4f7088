"""Around which cells a scent is as strong as a number, kept up from step to step by the few cells where that has changed."""

from __future__ import annotations

from functools import partial

import numpy as np
from numpy.typing import NDArray

from antdsl.fields.growing import GrowingCells
from antdsl.fields.pheromone import PheromoneField
from antdsl.numerics import compiled

_LISTED = 1 << 22  # numbers in the table of blocks of which another one is made that is as large


class Reached:
    """For which cells of a field one of the nearest `k` of their block holds as much as `least` in float32. It may say so of all:
    where `least` is not above 0, where cells grow, and where there are too many of them."""

    def __init__(self, field: PheromoneField, least: np.float32, k: int) -> None:
        self._of, self._k = (field, field.version, least), k
        cells = field.cells
        self._all = not least > 0 or isinstance(cells, GrowingCells) or len(cells) * k > _LISTED
        self._count = np.full(len(cells) + 1, self._all, np.uint8)  # of the cells around each, how many hold as much
        self._holds = np.zeros(0 if self._all else len(cells), np.bool_)
        self._changed = np.empty(len(self._holds), np.int64)

    def of(self, field: PheromoneField, least: np.float32) -> bool:
        """Whether it tells of a field, with the cells that it has now, and a strength."""
        known, version, strength = self._of
        return known is field and version == field.version and strength == least

    def now(self, threads: int = 1) -> NDArray[np.uint8]:
        """Above 0 for cells around which it is reached by what the field holds now, uint8[cells + 1], the last one for no cell;
        it is written anew by the next call."""
        if not self._all:
            changed = self._differing(threads)
            if len(changed):
                self._renew(changed)
        return self._count

    def _differing(self, threads: int) -> NDArray[np.int64]:
        """Cells that hold as much and did not before, or the other way round."""
        (field, _, least), holds = self._of, self._holds
        if compiled.wanted(len(holds)):
            from antdsl.fields.reached_compiled import differing

            work = partial(differing, field.held, least, holds, self._changed)
            return compiled.joined(compiled.in_parts(work, len(holds), threads, compiled.LIGHT), self._changed)[0]
        return np.flatnonzero((field.values.astype(np.float32) >= least) != holds)

    def _renew(self, changed: NDArray[np.int64]) -> None:
        """Count some cells, or no longer, for those around which they are."""
        field = self._of[0]
        if compiled.wanted(len(changed)):
            from antdsl.fields.reached_compiled import renew

            renew(changed, *field.askers(self._k), self._holds, self._count)
            return
        self._holds[changed] ^= True
        around, many = field.asking(changed, self._k)
        one = np.where(self._holds.take(changed), np.uint8(1), np.uint8(255))  # which is 1 less
        np.add.at(self._count, around, np.repeat(one, many))
