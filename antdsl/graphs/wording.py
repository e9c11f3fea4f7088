"""Finds room for the words on arrows: on their own line or beside it, clear of boxes, of other words, of lines if it can be.

Every arrow has places where its words could stand; the arrows with the fewest choose first, and then all choose again in turn
until nobody finds a better one (a local search in the discrete placement of labels, Christensen, Marks, Shieber 1995)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise
from math import dist
from typing import Any

import numpy as np

from antdsl.graphs.model import Placed, Point

Size = tuple[float, float]
Way = tuple[Point, ...]
Array = np.ndarray[Any, np.dtype[Any]]

_STEP = 9.0  # px between two places on one line
_END = 10.0  # px of a line that stay free before its box, where the head is
_CLEAR = 3.0  # px between words and what they may not touch
_ROUNDS = 6
# What a place costs: for each box or word and each line or head that it touches, for a turn that it hides, for being beside the
# line, and for being off the middle.
_BLOCKED, _CROSSING, _TURN, _OFF, _MIDDLE = 1000.0, 25.0, 4.0, 2.0, 6.0


@dataclass(frozen=True, slots=True)
class Found:
    """A place for each arrow's words, None for no words. `touching` is how many could not be kept clear of boxes and other words,
    `crossed` how many lines and heads are hidden by words."""

    places: tuple[Placed | None, ...]
    touching: int
    crossed: int


@dataclass(frozen=True, slots=True, eq=False)
class _Spots:
    """Where words of one size could stand: centres [n, 2], px; what each costs whatever the others do [n]; lines hidden [n]."""

    size: Size
    centres: Array
    costs: Array
    hidden: Array

    def place(self, number: int) -> Placed:
        x, y = self.centres[number].tolist()
        return Placed((x, y), *self.size)


def place_words(boxes: Sequence[Placed], ways: Sequence[Way], sizes: Sequence[Size | None]) -> Found:
    """Places for the words on arrows, by the arrows' ways, upright and level with few slants, and the words' sizes."""
    spots = {number: _spots(number, boxes, ways, size) for number, size in enumerate(sizes) if size}
    order = sorted(spots, key=lambda n: (int((spots[n].costs < _CROSSING).sum()), n))
    chosen: dict[int, int] = {}
    for _ in range(_ROUNDS):
        before = dict(chosen)
        for number in order:
            others = [spots[n].place(k) for n, k in chosen.items() if n != number]
            costs = spots[number].costs + _BLOCKED * _touched(spots[number].centres, spots[number].size, others)
            chosen[number] = int(np.argmin(costs))
        if chosen == before:
            break
    places = {n: spots[n].place(k) for n, k in chosen.items()}
    touching = sum(spots[n].costs[k] >= _BLOCKED for n, k in chosen.items())
    for n, place in places.items():
        centre = np.array([place.centre])
        touching += _touched(centre, spots[n].size, [other for m, other in places.items() if m < n])[0]
    crossed = sum(int(spots[n].hidden[k]) for n, k in chosen.items())
    return Found(tuple(places.get(n) for n in range(len(sizes))), int(touching), crossed)


def _spots(number: int, boxes: Sequence[Placed], ways: Sequence[Way], size: Size) -> _Spots:
    """Places along an arrow's way, on the line and beside it."""
    way = ways[number]
    centres, costs = _along(way, size)
    others = [part for n, other in enumerate(ways) if n != number for part in pairwise(other)]
    corners = np.abs(centres[:, None] - np.array(way)) < np.array(size) / 2 + _CLEAR
    turns = corners.all(axis=2)
    hidden = _lines(centres, size, others) + turns[:, -1]  # the tip of its own head is hidden like a line of others
    costs = costs + _TURN * turns.sum(axis=1) + _CROSSING * hidden + _BLOCKED * _touched(centres, size, boxes)
    return _Spots(size, centres, costs, hidden)


def _along(way: Way, size: Size) -> tuple[Array, Array]:
    """Centres [n, 2] and what they cost by themselves [n]."""
    found: list[Point] = []
    costs: list[float] = []
    length = sum(dist(a, b) for a, b in pairwise(way)) or 1.0
    gone = 0.0
    for begin, end in pairwise(way):
        long = dist(begin, end)
        upright = abs(begin[0] - end[0]) < 0.01
        for k in range(1 + max(0, int((long - 2 * _END) / _STEP))):
            share = min(1.0, (_END + k * _STEP) / long) if long > 2 * _END else 0.5
            x, y = begin[0] + (end[0] - begin[0]) * share, begin[1] + (end[1] - begin[1]) * share
            middle = abs((gone + long * share) / length - 0.42)  # a little nearer to where the arrow comes from
            for aside in (0.0, -1.0, 1.0):
                right, down = (aside * (size[0] / 2 + 2), 0.0) if upright else (0.0, aside * (size[1] / 2 + 2))
                found.append((x + right, y + down))
                costs.append(_OFF * abs(aside) + _MIDDLE * middle)
        gone += long
    return np.array(found), np.array(costs)


def _touched(centres: Array, size: Size, others: Sequence[Placed]) -> Array:
    """How many of the others each place touches, int [n]."""
    if not others:
        return np.zeros(len(centres), int)
    middles = np.array([other.centre for other in others])
    room = (np.array([(other.width, other.height) for other in others]) + np.array(size)) / 2 + _CLEAR
    return np.asarray((np.abs(centres[:, None] - middles) < room).all(axis=2).sum(axis=1))


def _lines(centres: Array, size: Size, parts: Sequence[tuple[Point, Point]]) -> Array:
    """How many straight parts of other lines go through each place, int [n]."""
    if not parts:
        return np.zeros(len(centres), int)
    ends, half = np.array(parts), np.array(size) / 2 + 1
    low, high = ends.min(axis=1), ends.max(axis=1)
    met = (low < (centres + half)[:, None]) & (high > (centres - half)[:, None])
    return np.asarray(met.all(axis=2).sum(axis=1))
