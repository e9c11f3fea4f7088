"""Rounds of contacts: who is led in one, and what it leaves for the next."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from antdsl.machine_code.kernels import BOOL, F64, I64, Array1, Array2, Strided2, independent, kernel
from antdsl.numerics.kernel_vectors import dot, minus, of, plus, put
from antdsl.runtime.moving.capsules import Near

Floats = NDArray[np.float64]
Rows = NDArray[np.intp]
Flags = NDArray[np.bool_]

_SEEN = 0.05  # of the room of two: an overlap for which more is walked
_MISSED = 0.05  # of a radius: who ends so far from where it was to is looked at again
_HELD = 0.5  # of the way it was to go: who comes on by less is held by an obstacle, a border or a fall, and others make the room


def led(asked: Floats) -> tuple[Rows, Floats]:
    """Which rows are `asked` to go (3, k) mm anywhere, and how far these are."""
    some, wanted = np.empty(asked.shape[1], np.intp), np.empty_like(asked)
    count = _led(asked, some, wanted)
    return some[:count], wanted[:, :count]


def missed(near: Near, some: Rows, wanted: Floats, got: Floats, held: Flags) -> Flags:
    """Which rows (k) are looked at again, of `some` that were `wanted` to go (3, ..) mm and `got` so far. They stand there now;
    who came on by too little of it is `held` (k) besides those who are."""
    touched = np.zeros(len(held), np.bool_)
    _missed(some, wanted, got, near.radius, near.middle, held, touched)
    return touched


def visible(near: Near, touched: Flags) -> Flags | None:
    """Which pairs (m) have a row that is `touched` (k); None where none of them is an overlap that more is walked for."""
    which = np.empty(len(near.i), np.bool_)
    return which if _visible(near.i, near.j, near.gap, near.radius, touched, which) else None


@kernel
def _led(asked: Array2[F64], some: Array1[I64], wanted: Array2[F64]) -> I64:
    """How many rows go anywhere, which are the first of `some` and `wanted` (3, k)."""
    count = 0
    for k in range(some.size):
        way = of(asked, k)
        some[count] = k  # written whatever it is: no branch that is hard to foretell
        put(wanted, count, way)
        count += (way[0] != 0) | (way[1] != 0) | (way[2] != 0)
    return count


@kernel
def _missed(
    some: Array1[I64],
    wanted: Strided2[F64],
    got: Strided2[F64],
    radius: Array1[F64],
    middle: Strided2[F64],
    held: Array1[BOOL],
    touched: Array1[BOOL],
) -> None:
    for n in independent(0, some.size):
        row, to, on = some[n], of(wanted, n), of(got, n)
        short, far = minus(to, on), _MISSED * radius[row]
        put(middle, row, plus(of(middle, row), on))
        if dot(short, short) > far * far:
            touched[row] = True
            if dot(on, to) < _HELD * dot(to, to):
                held[row] = True


@kernel
def _visible(
    i: Array1[I64], j: Array1[I64], gap: Array1[F64], radius: Array1[F64], touched: Array1[BOOL], which: Array1[BOOL]
) -> BOOL:
    """Which pairs have a row that is `touched`; says whether there are any that more is walked for."""
    for pair in independent(0, i.size):
        which[pair] = touched[i[pair]] | touched[j[pair]]
    found = False
    for pair in range(i.size):
        if which[pair]:
            found |= gap[pair] < -((radius[i[pair]] + radius[j[pair]]) * _SEEN)
    return found
