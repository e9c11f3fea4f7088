"""Agents near agents: a sorted cell grid takes positions and answers with (query, neighbour) pairs within a radius.
The pairs are the same bits, in the same order, whatever the rows' order, the chunk or the cell size."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.limits import NEIGHBOURS
from antdsl.numerics import compiled
from antdsl.senses.cell_order import ordered

Floats = NDArray[np.float32]
Rows = NDArray[np.intp]  # an index of another type is converted at every use

View = tuple[Floats, Floats, Floats, Floats]

_QUERIES_PER_CHUNK = 16_384
_CANDIDATES_PER_CHUNK = 1 << 16  # arrays of this length stay in the cache
_SLACK = 1.0 + 1e-6  # float32 distances err by a few 2**-24; candidates must be a superset


class TooManyWithin(Exception):
    """More others lie within the radius of one query than were to be looked through."""


@dataclass(frozen=True, slots=True)
class Pairs:
    """Pairs within reach, sorted by `i`, then the neighbour's cell, then its id. All arrays have one length.

    The order of rows is not observable in them; the order within one `i` may change with the whole crowd's extent.

    `i` counts queries from 0, `j` is the row of the neighbour in the grid, `dx dy dz` is neighbour minus query and
    `distance` its length, in float32 millimetres.
    """

    i: Rows
    j: Rows
    dx: Floats
    dy: Floats
    dz: Floats
    distance: Floats

    def pick(self, keep: Rows) -> Pairs:
        arrays: Any = (a.take(keep) for a in (self.i, self.j, self.dx, self.dy, self.dz, self.distance))
        return Pairs(*arrays)


class CellGrid:
    """Agents sorted into cells: rows along the crowd's longest axis, cut four times finer than across.

    `x y z` are float32[n] in millimetres, `ids` int64[n] unique, `cell` the usual radius of a query: any radius works,
    this one fastest. An agent at a place that is not finite is nobody's neighbour.
    """

    def __init__(self, x: Floats, y: Floats, z: Floats, ids: NDArray[np.int64], cell: float) -> None:
        self.x, self.y, self.z, self.ids = x, y, z, ids
        order = ordered(x, y, z, ids, cell)
        shape = order.shape
        self._axes, self._low, self._width, self._size = shape.axes, shape.low, shape.width, shape.size
        self._rows, self._keys, self._sorted, self._starts = order.rows, order.keys, order.places, order.starts

    @cached_property
    def _sorted_ids(self) -> NDArray[np.int64]:
        return self.ids.take(self._rows)

    @cached_property
    def tables(self) -> dict[str, NDArray[Any] | None]:
        """What machine code searches by: `places` of agents in the order of cells and their rows, x, y, z float32 and the bits of
        an int32, with eight spare ones behind the last; `x y z` alone; their `keys` int64; `starts` int32, first agent of each
        cell, where it is listed; `at` int32, for each row its place in that order, -1 for none; `floats`: low, width and its
        inverse of cells along the fast, middle and slow axis; `whole`: these axes, numbers of cells, number of agents."""
        places = np.zeros((self._rows.size + 8, 4), np.float32)
        for axis, values in enumerate(self._sorted):
            places[: self._rows.size, axis] = values
        places.view(np.int32)[: self._rows.size, 3] = self._rows
        at = np.full(len(self.ids) + 8, -1, np.int32)
        at[self._rows] = np.arange(self._rows.size)
        found: dict[str, NDArray[Any] | None] = {"places": places, "at": at}
        found |= {name: np.concatenate([a, np.zeros(8, a.dtype)]) for name, a in zip("xyz", self._sorted, strict=True)}
        found |= {
            "keys": self._keys,
            "starts": self._starts,
            "floats": np.array([*self._low, *self._width, *(1 / w for w in self._width)]),
        }
        found["whole"] = np.array([*self._axes, *self._size, self._rows.size], np.int64)
        return found

    def pairs(
        self,
        rows: Rows | None,
        radius: Floats | float,
        *,
        qx: Floats | None = None,
        qy: Floats | None = None,
        qz: Floats | None = None,
        qid: NDArray[np.int64] | None = None,
        view: View | None = None,
        threads: int = 1,
        limit: int | None = None,
    ) -> Pairs:
        """Neighbours of the agents `rows` (all when None) within `radius` (one, or one for each of `rows`).

        Without `qx qy qz` the grid's own agents ask, and nobody is their own neighbour. With them those agents ask: `rows`
        selects from them, and `qid` says who they are when they are the grid's own, where the grid has them. At most
        `limits.NEIGHBOURS` of an agent are kept, the nearest by (distance, id). `view`, one value for each query, leaves
        those of them in its field of view. Raises TooManyWithin, before much is spent, where more than `limit` others lie
        within the radius of one.
        """
        if qx is None or qy is None or qz is None:
            qx, qy, qz, qid = self.x, self.y, self.z, self.ids
        if rows is not None:
            qx, qy, qz = qx[rows], qy[rows], qz[rows]
            qid = None if qid is None else qid[rows]
        qx, qy, qz = (np.asarray(q, np.float32) for q in (qx, qy, qz))
        reach = np.asarray(radius, np.float32)
        if reach.shape != qx.shape:
            reach = np.broadcast_to(reach, qx.shape)
        if compiled.wanted(max(qx.size, self.ids.size)):
            pairs = self._compiled((qx, qy, qz), reach, qid, view, threads)
            if pairs is not None:
                return pairs
        pairs = self._searched((qx, qy, qz), reach, qid, threads, limit)
        return pairs if view is None else pairs.pick(seen(pairs, view))

    def _compiled(
        self, query: tuple[Floats, Floats, Floats], reach: Floats, qid: NDArray[np.int64] | None, view: View | None, threads: int
    ) -> Pairs | None:
        """`pairs` by a compiled kernel; None where somebody has more neighbours than the cap."""
        from antdsl.senses.neighbours_compiled import find

        none = np.empty(0, np.float32)
        starts = np.empty(0, np.int32) if self._starts is None else self._starts
        cells = tuple(self._low), tuple(self._width), tuple(self._size)
        grid = (*self._sorted, self._rows, self._sorted_ids, self._keys, starts, self._axes, *cells)
        who = np.empty(0, np.int64) if qid is None else qid
        values: tuple[NDArray[Any], ...] = (*query, who, reach, *(view or (none,) * 4))

        def part(begin: int, end: int) -> tuple[NDArray[Any], ...] | None:
            found = find(grid, tuple(np.ascontiguousarray(value[begin:end]) for value in values), NEIGHBOURS)
            if found is not None:
                found[0][:] += begin
            return found

        found = compiled.in_parts(part, query[0].size, threads)
        good = [columns for columns in found if columns is not None]
        if len(good) < len(found):
            return None
        return Pairs(*good[0]) if len(good) == 1 else Pairs(*(np.concatenate(column) for column in zip(*good, strict=True)))

    def _searched(
        self, query: tuple[Floats, ...], reach: Floats, qid: NDArray[np.int64] | None, threads: int, limit: int | None
    ) -> Pairs:
        """`pairs` with NumPy, chunk by chunk."""
        qx, qy, qz = query
        jobs: list[tuple[Any, ...]] = []
        for a in range(0, qx.size, _QUERIES_PER_CHUNK):
            part = slice(a, a + _QUERIES_PER_CHUNK)
            query = (qx[part], qy[part], qz[part])
            first, count, each = self._ranges(query, reach[part])
            # A crowd on one spot has n² candidates, so a chunk is cut again by what it would hold in memory.
            ends = np.cumsum(each)
            b = 0
            while b < ends.size:
                last = (ends[b - 1] if b else 0) + _CANDIDATES_PER_CHUNK
                e = max(b + 1, int(np.searchsorted(ends, last, side="right")))
                sub = tuple(q[b:e] for q in query)
                who = None if qid is None else qid[part][b:e]
                jobs.append((a + b, sub, reach[part][b:e], who, first[b:e], count[b:e], each[b:e], limit))
                b = e
        parted = compiled.in_parts(lambda a, b: [self._within(*job) for job in jobs[a:b]], len(jobs), threads, 1)
        found = [columns for part in parted for columns in part]
        if not found:
            empty = np.empty(0, np.float32)
            return Pairs(np.empty(0, np.intp), np.empty(0, np.intp), empty, empty, empty, empty)
        if len(found) == 1:
            return Pairs(*found[0])
        return Pairs(*(np.concatenate(column) for column in zip(*found, strict=True)))

    def _ranges(
        self, query: tuple[Floats, Floats, Floats], radius: Floats
    ) -> tuple[NDArray[np.int32], NDArray[np.int32], NDArray[np.int64]]:
        """First sorted agent and number of agents of each row of cells that a query may reach, as (m, rows), and its sum [m].

        Here x, y, z stand for the grid's fast, middle and slow axis.
        """
        m = query[0].size
        qx, qy, qz = (query[axis].astype(np.float64) for axis in self._axes)
        usable = np.isfinite(qx) & np.isfinite(qy) & np.isfinite(qz) & (radius >= 0)
        r = np.where(usable, radius, -1.0).astype(np.float64)
        qx, qy, qz = (np.where(usable, q, low) for q, low in zip((qx, qy, qz), self._low, strict=True))
        largest = max(float(np.abs(q).max(initial=0.0)) for q in (qx, qy, qz))
        r = np.where(usable, r * _SLACK + 1e-14 * largest + 1e-18, -1.0)
        y0, y1 = self._span(qy, r, 1)
        sheet = self._size[2] == 1 and float(np.abs(qz - self._low[2]).max(initial=0.0)) <= self._width[2]
        z0, z1 = (np.zeros(m, np.int64),) * 2 if sheet else self._span(qz, r, 2)
        tall = int((y1 - y0).max(initial=-1)) + 1
        deep = int((z1 - z0).max(initial=-1)) + 1
        if self._rows.size == 0 or tall <= 0 or deep <= 0:
            return np.zeros((m, 1), np.int32), np.zeros((m, 1), np.int32), np.zeros(m, np.int64)
        firsts, counts = [], []
        for dz in range(deep):
            cz = z0 + dz
            off_z = np.zeros(m) if sheet else self._off(qz, cz, 2)
            for dy in range(tall):
                cy = y0 + dy
                off_y = self._off(qy, cy, 1)
                left = r * r - off_y * off_y - off_z * off_z
                open_row = (cz <= z1) & (cy <= y1) & (left >= 0) & usable
                x0, x1 = self._span(qx, np.sqrt(np.maximum(left, 0.0)) * _SLACK + 1e-14 * largest, 0)
                base = (cz * self._size[1] + cy) * self._size[0]
                open_row &= x0 <= x1
                firsts.append(self._lookup(np.where(open_row, base + x0, 0)))
                counts.append(np.where(open_row, self._lookup(np.where(open_row, base + x1 + 1, 0)) - firsts[-1], 0))
        each = np.zeros(m, np.int64)
        for count in counts:
            each += count
        return np.stack(firsts, axis=1), np.stack(counts, axis=1).astype(np.int32), each

    def _span(self, q: NDArray[Any], r: NDArray[Any], axis: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Lowest and highest cell along an axis that [q - r, q + r] meets; empty (low > high) when outside."""
        low, width, size = self._low[axis], self._width[axis], self._size[axis]
        first = np.floor(np.clip((q - r - low) / width, 0.0, float(size)))
        last = np.floor(np.clip((q + r - low) / width, -1.0, size - 1.0))
        return first.astype(np.int64), last.astype(np.int64)

    def _off(self, q: NDArray[Any], cell: NDArray[Any], axis: int) -> NDArray[Any]:
        """Least distance along an axis from q to a cell, rounded down."""
        low = self._low[axis] + cell * self._width[axis]
        gap: NDArray[Any] = np.maximum(np.maximum(low - q, q - (low + self._width[axis])), 0.0) * (1.0 - 1e-6)
        return gap

    def _lookup(self, key: NDArray[np.int64]) -> NDArray[np.int32]:
        """How many sorted agents lie in cells before `key`."""
        if self._starts is not None:
            return self._starts[key]
        return np.searchsorted(self._keys, key, side="left").astype(np.int32)

    def _within(
        self,
        before: int,
        query: tuple[Floats, ...],
        radius: Floats,
        who: NDArray[np.int64] | None,
        first: NDArray[np.int32],
        count: NDArray[np.int32],
        each: NDArray[np.int64],
        limit: int | None,
    ) -> tuple[NDArray[Any], ...]:
        """Measure the candidates of some queries, that come after `before` others, and keep those in reach."""
        flat = count.ravel()
        total = int(each.sum())
        at = np.repeat(first.ravel() - (np.cumsum(flat) - flat), flat)
        at += np.arange(total)
        i = np.repeat(np.arange(each.size), each)
        with np.errstate(over="ignore", invalid="ignore"):  # beyond float32 is beyond any radius but an infinite one
            dx, dy, dz = (s.take(at) - q.repeat(each) for s, q in zip(self._sorted, query, strict=True))
            distance = np.sqrt((dx * dx + dy * dy) + dz * dz)
        inside = distance <= radius.repeat(each)
        if who is not None:
            here = np.flatnonzero(distance == 0)  # oneself is one of these
            inside[here[self.ids.take(self._rows.take(at.take(here))) == who.take(i.take(here))]] = False
        keep = np.flatnonzero(inside)
        i, j = i.take(keep), self._rows.take(at.take(keep))
        chosen = self._nearest(i, j, distance.take(keep), limit) if int(each.max(initial=0)) > NEIGHBOURS else None
        if chosen is not None:
            keep, i, j = keep[chosen], i[chosen], j[chosen]
        i += before
        return i, j, dx.take(keep), dy.take(keep), dz.take(keep), distance.take(keep)

    def _nearest(self, i: Rows, j: Rows, distance: Floats, limit: int | None) -> NDArray[np.int64] | None:
        """Which pairs stay when a query has more than the cap: its nearest by (distance, id); None when all stay."""
        most = int(np.bincount(i).max(initial=0))
        if limit is not None and most > limit:
            raise TooManyWithin
        if most <= NEIGHBOURS:
            return None
        order = np.lexsort((self.ids[j], distance, i))
        return np.sort(order[_rank(i[order]) < NEIGHBOURS])


def seen(pairs: Any, view: View) -> Rows:
    """Which pairs lie in the field of view of who asks: heading x, y, z and the cosine of half its angle, for each query."""
    hx, hy, hz, cosine = (part.take(pairs.i) for part in view)
    ahead = (pairs.dx * hx + pairs.dy * hy) + pairs.dz * hz
    return np.flatnonzero(ahead >= cosine * pairs.distance)


def _rank(i: Rows) -> NDArray[np.int64]:
    """Place of every entry within its run of equal values; `i` is sorted."""
    if i.size == 0:
        return np.empty(0, np.int64)
    number = np.arange(i.size)
    starts = np.flatnonzero(np.concatenate(([True], i[1:] != i[:-1])))
    return number - np.repeat(starts, np.diff(np.append(starts, i.size)))
