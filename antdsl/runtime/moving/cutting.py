"""Steps that would lead agents into others are bent along these, and then cut: nobody goes farther than half of what is free."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from antdsl.numerics import compiled
from antdsl.numerics.vectors import dot
from antdsl.runtime.moving.capsules import Near

Floats = NDArray[np.float64]
Rows = NDArray[np.intp]
Flags = NDArray[np.bool_]

_FINE = 40  # digits of a term in a sum, below the widest overlap
_GOES = 0.5  # of its way: who goes less is stopped
_BENDS = 3  # times that a step is bent along those in its way, before it is cut


def cut(near: Near, came: Floats, mass: Floats, walked: Floats, gap: Floats, way: Floats) -> tuple[Floats, Rows, Flags]:
    """By what (3, k) mm steps of rows that `walked` (3, k) mm are cut and bent so that nobody enters another; who goes less than
    half of its way, and so is stopped; and who of all (k) is cut or stopped. They `came` (3, k) mm in a time as long before this
    one; `gap` (m) and `way` (3, m) of pairs are those from before the steps.

    As in J. van den Berg et al., Reciprocal n-Body Collision Avoidance, 2011, each agent by itself keeps to half-planes: towards
    each other one it goes no farther than half of the gap, and than what that one withdraws if it goes on as it came. What all
    share in is so found without anybody waiting for others, and a crowd that presses stands still. Of two masses the heavier is
    cut less."""
    most = max(walked.max(), -walked.min(), 1e-30)
    magic = np.ldexp(1.5, int(np.frexp(most)[1]) + 2 - _FINE + 52)
    if compiled.wanted(len(gap)):
        from antdsl.runtime.moving.cutting_compiled import bent

        rows, pairs = len(near.rows), len(gap)
        (short, sums), part, changed = np.empty((2, 3, rows)), np.empty(rows), np.empty(rows, np.bool_)
        met, some, stopped = np.empty((3, rows), np.intp)
        room = (np.empty((2, pairs)), sums, part, met, some, np.empty(pairs, np.intp))
        count = bent(near.i, near.j, gap, way, came, mass, walked, magic, *room, short, stopped, changed)
        return short, stopped[:count], changed
    step = _bent(near, _free(near, came, mass, walked, gap, way), walked, way, magic)
    short, halted = step - walked, dot(step, step) < _GOES**2 * dot(walked, walked)
    return short, np.flatnonzero(halted), halted | (short != 0).any(axis=0)


def _free(near: Near, came: Floats, mass: Floats, walked: Floats, gap: Floats, way: Floats) -> Floats:
    """How far (2 m) mm the first and then the second of each pair may go towards the other."""
    both, other = np.concatenate([near.i, near.j]), np.concatenate([near.j, near.i])
    ways = np.concatenate([way, -way], axis=1)
    free = np.maximum(gap, 0.0) * 0.5
    free = np.concatenate([free, free]) + np.maximum(-dot(ways, came.take(other, axis=1)), 0.0)
    heavier = 1 - lightness(mass.take(both), mass.take(other))
    if heavier.any():
        free += heavier * np.maximum(-dot(ways, walked.take(both, axis=1)) - free, 0.0)
    found: Floats = free
    return found


def _bent(near: Near, free: Floats, walked: Floats, way: Floats, magic: float) -> Floats:
    """Steps (3, k) mm of rows that `walked` so, of which what leads farther towards another than is `free` (2 m) is left out, one
    half-plane after the other, and at last what yet does is cut."""
    i, j, count = near.i, near.j, len(near.rows)
    both, ways = np.concatenate([i, j]), np.concatenate([way, -way], axis=1)
    along = np.concatenate([both, both + count, both + 2 * count])
    step = walked
    for _ in range(_BENDS):
        over = -dot(ways, step.take(both, axis=1)) - free
        into = over > 0
        if not into.any():
            break
        terms = ways * np.where(into, over, 0.0)
        terms = (terms + magic) - magic
        met = np.maximum(np.bincount(both, into, count), 1)
        step = step + np.bincount(along, terms.ravel(), 3 * count).reshape(3, -1) / met
    towards = -dot(ways, step.take(both, axis=1))
    part = np.ones(count)
    np.minimum.at(part, both, np.where(towards > free, free / np.maximum(towards, 1e-300), 1.0))
    step = step * part
    return step


def lightness(mass: Floats, other: Floats) -> Floats:
    """Up to which share of an even one those of a mass make room for others, 1 for the lighter."""
    share: Floats = np.minimum(2 * other / (mass + other), 1.0)
    return share
