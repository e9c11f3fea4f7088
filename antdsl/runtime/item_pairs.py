"""Items near agents: pairs of an asking row and an item, by both, each with the way there (mm, float32) and its length.

Few items are measured from everybody at once, by a compiled loop where there is one; of many, those that are too far off along
two axes are left out first. Every way gives the same bits."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.numerics import compiled
from antdsl.numerics.vectors import Vector
from antdsl.runtime.world import AXES, Items

Floats = NDArray[np.float32]
Columns = tuple[NDArray[Any], ...]  # row, item, x, y, z, distance

_MEASURED = 1 << 16  # pairs of an agent and an item at once
_MANY_ITEMS = 128  # above it those that are too far off along an axis are not measured
_WIDER, _TINY = 1 + 1e-5, 1e-15  # of a radius, and mm: more than float32 rounds, and than squares of it lose


def items_within(items: Items, own: tuple[Floats, ...], radius: Any, crowd: int) -> Columns:
    """Items within a radius (mm, one or float[n]) of places (three float32[n]), of whom a crowd of so many asks."""
    reach = np.full(len(own[0]), radius, np.float32) if np.ndim(radius) == 0 else np.asarray(radius, np.float32)
    if len(items) > _MANY_ITEMS:
        return along(items, own, reach)
    if compiled.wanted(crowd):
        from antdsl.runtime.pairs_compiled import within

        x, y, z = own
        return within(*_seen_at(items), x, y, z, reach)
    return each(items, own, reach)


def _seen_at(items: Items) -> Vector:
    x, y, z = (np.asarray(items.seen[axis], np.float32) for axis in AXES)
    return x, y, z


def each(items: Items, own: tuple[Floats, ...], reach: Floats) -> Columns:
    """All items measured from all rows."""
    n, m = len(own[0]), len(items)
    x, y, z = _seen_at(items)
    rows = max(1, _MEASURED // max(m, 1))
    parts: list[Columns] = []
    for a in range(0, n, rows):
        px, py, pz = (place[a : a + rows] for place in own)
        dx, dy, dz = x[:, None] - px, y[:, None] - py, z[:, None] - pz
        distance = np.sqrt((dx * dx + dy * dy) + dz * dz)
        near = np.flatnonzero(distance <= reach[a : a + rows])
        first = near.searchsorted(np.arange(m + 1) * px.size)
        j = np.repeat(np.arange(m), np.diff(first))
        i = near - j * px.size
        order = np.argsort(i, kind="stable")
        near = near.take(order)
        parts.append((i.take(order) + a, j.take(order), *(v.ravel().take(near) for v in (dx, dy, dz, distance))))
    return _joined(parts)


def along(items: Items, own: tuple[Floats, ...], reach: Floats) -> Columns:
    """Items measured from rows from which, along the two axes that items are most spread on, they are not too far off."""
    n, there = len(own[0]), _seen_at(items)
    with np.errstate(invalid="ignore"):
        one, two = sorted(range(3), key=lambda k: -float(np.nan_to_num(np.ptp(there[k]))))[:2]
        order = np.argsort(there[one], kind="stable")
        far = reach.astype(np.float64) * _WIDER + _TINY
        far[~np.isfinite(far)] = np.inf
        place = np.where(far < np.inf, own[one], np.float32(0)).astype(np.float64)
        first_axis, second_axis = (there[axis].astype(np.float64)[order] for axis in (one, two))
        first, last = first_axis.searchsorted(place - far, "left"), first_axis.searchsorted(place + far, "right")
    count = np.maximum(last - first, 0)
    ends = np.cumsum(count)
    parts: list[Columns] = []
    a = 0
    while a < n:
        before = int(ends[a - 1]) if a else 0
        b = max(a + 1, int(ends.searchsorted(before + _MEASURED, "right")))
        some = count[a:b]
        at = np.arange(int(some.sum())) + np.repeat(first[a:b] - (np.cumsum(some) - some), some)
        apart = second_axis.take(at) - np.repeat(own[two][a:b].astype(np.float64), some)
        near = np.flatnonzero(~(np.abs(apart) > np.repeat(far[a:b], some)))
        i, j = np.repeat(np.arange(a, b), some).take(near), order.take(at.take(near))
        dx, dy, dz = (t.take(j) - place.take(i) for t, place in zip(there, own, strict=True))
        distance = np.sqrt((dx * dx + dy * dy) + dz * dz)
        keep = np.flatnonzero(distance <= reach.take(i))
        keep = keep[np.lexsort((j[keep], i[keep]))]
        parts.append(tuple(column.take(keep) for column in (i, j, dx, dy, dz, distance)))
        a = b
    return _joined(parts)


def _joined(parts: list[Columns]) -> Columns:
    if len(parts) == 1:
        return parts[0]
    if not parts:
        return np.empty(0, np.intp), np.empty(0, np.intp), *np.empty((4, 0), np.float32)
    return tuple(np.concatenate(column) for column in zip(*parts, strict=True))
