"""Rounds of contacts: who is led in one, and what it leaves for the next."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from antdsl.numerics import compiled
from antdsl.numerics.vectors import dot
from antdsl.runtime.moving.capsules import Near

Floats = NDArray[np.float64]
Rows = NDArray[np.intp]
Flags = NDArray[np.bool_]

_SEEN = 0.05  # of the room of two: an overlap for which more is walked
_MISSED = 0.05  # of a radius: who ends so far from where it was to is looked at again
_HELD = 0.5  # of the way it was to go: who comes on by less is held by an obstacle, a border or a fall, and others make the room


def led(asked: Floats) -> tuple[Rows, Floats]:
    """Which rows are `asked` to go (3, k) mm anywhere, and how far these are."""
    if compiled.wanted(asked.shape[1]):
        from antdsl.runtime.moving import rounds_compiled

        some, wanted = np.empty(asked.shape[1], np.intp), np.empty_like(asked)
        count = rounds_compiled.led(asked, some, wanted)
        return some[:count], wanted[:, :count]
    some = np.flatnonzero(moved(asked))
    return some, asked.take(some, axis=1)


def missed(near: Near, some: Rows, wanted: Floats, got: Floats, held: Flags) -> Flags:
    """Which rows (k) are looked at again, of `some` that were `wanted` to go (3, ..) mm and `got` so far. They stand there now;
    who came on by too little of it is `held` (k) besides those who are."""
    touched = np.zeros(len(held), np.bool_)
    if compiled.wanted(len(some)):
        from antdsl.runtime.moving import rounds_compiled

        rounds_compiled.missed(some, wanted, got, near.radius, near.middle, held, touched)
        return touched
    near.middle[:, some] += got
    short = wanted - got
    again = dot(short, short) > (_MISSED * near.radius.take(some)) ** 2
    held[some[again & (dot(got, wanted) < _HELD * dot(wanted, wanted))]] = True
    touched[some[again]] = True
    return touched


def visible(near: Near, touched: Flags) -> Flags | None:
    """Which pairs (m) have a row that is `touched` (k); None where none of them is an overlap that more is walked for."""
    if compiled.wanted(len(near.i)):
        from antdsl.runtime.moving import rounds_compiled

        which = np.empty(len(near.i), np.bool_)
        return which if rounds_compiled.visible(near.i, near.j, near.gap, near.radius, touched, which) else None
    which = touched.take(near.i) | touched.take(near.j)
    least = (near.radius.take(near.i) + near.radius.take(near.j)) * _SEEN
    return which if (which & (near.gap < -least)).any() else None


def moved(gone: Floats) -> Flags:
    """Who goes (3, k) anywhere."""
    found: Flags = (gone[0] != 0) | (gone[1] != 0) | (gone[2] != 0)
    return found
