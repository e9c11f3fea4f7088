"""The spacing of agents at the start. Each agent gets the first of its random positions where its disc touches no earlier agent.

Method: random sequential addition of discs (dart throwing), in rounds over all agents at once. In a round, each agent without a
position tries the next of its random positions. If two agents touch, the later one tries again. So the position of an agent
depends only on earlier agents, and adding agents does not move them.

Random discs of one size cover at most 54.7 % of a plane and approach that ever more slowly. The number of tries is therefore
limited (J. Feder, Random sequential adsorption, J. Theor. Biol. 87, 1980)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.ground.protocol import Floats, Footing
from antdsl.numerics.near_pairs import find_pairs_between

Rows = NDArray[np.intp]
Flags = NDArray[np.bool_]

# Positions tried in each round, by the share of the previous batch without space: 384, 128 or 4 in total.
_TRIES_PER_ROUND = (1,) * 8 + (2,) * 4 + (4,) * 4 + (8,) * 4 + (16,) * 4
_SPACING_ROUNDS = ((0.005, _TRIES_PER_ROUND + (32,) * 8), (0.1, _TRIES_PER_ROUND), (1.0, (1,) * 4))
RELEASE_TRIES_PER_ROUND = (1,) * 4 + (2,) * 2 + (4,) * 2  # for agents that are created during the run: 16 positions
_FIRST_BATCH_SIZE = 64  # agents of the first batch; each later batch is as large as all earlier ones together
_CONTACT_DISTANCE_FACTOR = 1.001  # factor on the distance at contact, because float32 rounds
# Smaller neighbours of the first query; each further query doubles the number until the result is certain
_FIRST_QUERY_NEIGHBOURS = 8
_CELLS_PER_BODY_RADIUS = 8  # cells per body length; of agents that may overlap, each cell uses one


@dataclass(frozen=True, slots=True, eq=False)
class StartPositionCandidates:
    """Drawn start positions: footings, positions (n, 3) mm, up directions (n, 3), and flags whether an agent may start there."""

    footing: Footing
    position: Floats
    up: Floats
    is_allowed: Flags

    def select_rows(self, rows: Rows) -> StartPositionCandidates:
        """Return copies of the given rows."""
        return StartPositionCandidates(self.footing.select_rows(rows), self.position[rows], self.up[rows], self.is_allowed[rows])

    def replace_rows(self, rows: Rows, other: StartPositionCandidates) -> None:
        """Replace the given rows by those of `other`."""
        self.footing.write_rows(rows, other.footing)
        self.position[rows], self.up[rows], self.is_allowed[rows] = other.position, other.up, other.is_allowed


PositionDrawer = Callable[[NDArray[np.int64], range], StartPositionCandidates]
"""Places for agents by their ids: the tries of a range one after the other, all agents within each."""


@dataclass(frozen=True, eq=False)
class _DiscsOfSimilarSize:
    """Discs of similar size: positions (k, 3) mm, entry numbers in `OccupiedDiscs`, and the largest radius (mm)."""

    position: Floats
    entries: Rows
    max_radius: float

    @cached_property
    def tree(self) -> Any:
        """Return a k-d tree of the discs' positions."""
        from scipy.spatial import cKDTree

        return cKDTree(self.position)


class OccupiedDiscs:
    """The positions that are already occupied, as discs, called entries.

    An entry has a position, a radius, and a number in the order in which agents start. If two entries overlap, the later one must
    move. `rounding`: the precision of positions (mm)."""

    def __init__(self, rounding: float = 0.0) -> None:
        self._rounding = rounding
        self._place = np.empty((0, 3))
        self._radius = np.empty(0)
        self._order = np.empty(0, np.intp)
        self._is_present = np.empty(0, np.bool_)
        self._groups: list[_DiscsOfSimilarSize] = []

    def add_fixed_discs(self, place: Floats, radius: Floats) -> None:
        """Add agents that are already placed and cannot move. They may overlap each other."""
        rows = np.flatnonzero(has_extent(radius))
        rows = rows[_find_first_per_cell(place[rows], radius[rows], _CELLS_PER_BODY_RADIUS)]
        self.add_discs(place[rows], radius[rows], np.full(len(rows), -1))

    def add_discs(self, place: Floats, radius: Floats, order: Rows) -> Rows:
        """Add discs at `place` (n, 3; mm). Return their entry numbers. `order`: their numbers in the start order."""
        first = len(self._order)
        self._place = np.concatenate([self._place, place])
        self._radius = np.concatenate([self._radius, radius])
        self._order = np.concatenate([self._order, order])
        self._is_present = np.concatenate([self._is_present, np.ones(len(order), np.bool_)])
        entries = np.arange(first, len(self._order))
        self._rebuild_groups(np.concatenate([entries, *(group.entries for group in self._groups)]))
        return entries

    def remove_discs(self, entries: Rows) -> None:
        """Mark entries as removed. They remain in the groups until `forget_removed_discs` is called."""
        self._is_present[entries] = False

    def forget_removed_discs(self) -> None:
        """Delete the removed entries from all groups."""
        self._rebuild_groups(np.flatnonzero(self._is_present))

    def _rebuild_groups(self, entries: Rows) -> None:
        """Make the groups again from these entries, one group for each size class."""
        classes = _compute_size_class(self._radius[entries])
        chosen = [entries[classes == size] for size in np.unique(classes)]
        self._groups = [_DiscsOfSimilarSize(self._place[each], each, float(self._radius[each].max())) for each in chosen]

    def find_overlaps(self, place: Floats, radius: Floats, order: Rows | None = None) -> tuple[Rows, Rows, Floats]:
        """Return pairs of a given disc and an entry that overlap: indices of discs, entry numbers, and relative distances.

        A relative distance is the distance divided by the distance at which the discs touch. `order`: the numbers of the given
        discs in the start order; if set, only earlier entries count. A disc may overlap thousands of smaller entries, so only the
        worst overlap of each disc is returned."""
        pairs: list[tuple[Rows, Rows, Floats]] = []
        classes = _compute_size_class(radius)
        for size in np.unique(classes):
            rows = np.flatnonzero(classes == size)
            widest = float(radius[rows].max())
            for group in self._groups:
                if order is not None and 2 * group.max_radius < widest:
                    i, entry, share = self._find_worst_overlap(place, radius, order, rows, group)
                else:
                    reach = (widest + group.max_radius) * _CONTACT_DISTANCE_FACTOR * 1.001 + self._rounding
                    i, entry = find_pairs_between(place[rows], group.position, reach)
                    i, entry = rows[i], group.entries[entry]
                    share = self._compute_distance_share(place[i], radius[i], entry)
                meets = (share < 1) & self._is_present[entry]
                if order is not None:
                    meets &= self._order[entry] < order[i]
                pairs.append((i[meets], entry[meets], share[meets]))
        if not pairs:
            return np.empty(0, np.intp), np.empty(0, np.intp), np.empty(0)
        i, entry, share = (np.concatenate(part) for part in zip(*pairs, strict=True))
        return i, entry, share

    def _compute_distance_share(self, place: Floats, radius: Floats, entry: Rows) -> Floats:
        """Return the distance of each disc from its entry, divided by the distance at which the two touch."""
        displacement = place - self._place[entry]
        square = (
            displacement[..., 0] * displacement[..., 0]
            + displacement[..., 1] * displacement[..., 1]
            + displacement[..., 2] * displacement[..., 2]
        )
        share: Floats = np.sqrt(square) / ((radius + self._radius[entry]) * _CONTACT_DISTANCE_FACTOR + self._rounding)
        return share

    def _find_worst_overlap(
        self, place: Floats, radius: Floats, order: Rows, rows: Rows, group: _DiscsOfSimilarSize
    ) -> tuple[Rows, Rows, Floats]:
        """Find the worst overlap of each disc in `rows` with an earlier entry of a group. Return the rows that have one, the
        entries, and the relative distances (see `find_overlaps`). Entries are checked from the nearest outwards, until none
        farther away can overlap more."""
        entry, least = np.zeros(len(rows), np.intp), np.full(len(rows), np.inf)
        pending_discs, count = np.arange(len(rows)), _FIRST_QUERY_NEIGHBOURS
        while pending_discs.size:
            count = min(count, len(group.entries))
            at, wide = place[rows[pending_discs]], radius[rows[pending_discs]]
            away, near = group.tree.query(at, np.arange(1, count + 1))
            near = group.entries[near]
            share = self._compute_distance_share(at[:, None], wide[:, None], near)
            share[~self._is_present[near] | (self._order[near] >= order[rows[pending_discs], None])] = np.inf
            best = share.argmin(axis=1)
            entry[pending_discs], least[pending_discs] = (
                near[np.arange(len(pending_discs)), best],
                share[np.arange(len(pending_discs)), best],
            )
            beyond = away[:, -1] / ((wide + group.max_radius) * _CONTACT_DISTANCE_FACTOR + self._rounding)
            pending_discs = pending_discs[(beyond < np.minimum(least[pending_discs], 1.0)) & (count < len(group.entries))]
            count *= 2
        return rows, entry, least

    def measure_free_distances(self, place: Floats, radius: Floats, order: Rows) -> Floats:
        """Return the freedom (n) of discs: 1 without overlap with an earlier entry, down to 0 at the centre of such an entry."""
        i, _, share = self.find_overlaps(place, radius, order)
        least = np.ones(len(place))
        np.minimum.at(least, i, share)
        return least

    def find_displaced_entries(self, entries: Rows) -> tuple[Rows, Floats]:
        """Return the entries that must move because the given entries were added, and the freedom of their positions.

        Given entries may be among them. For the freedom see `measure_free_distances`."""
        i, entry, share = self.find_overlaps(self._place[entries], self._radius[entries])
        own = entries[i]
        loser = np.where(self._order[entry] < self._order[own], own, entry)
        different = self._order[entry] != self._order[own]
        who, which = np.unique(loser[different], return_inverse=True)
        least = np.ones(len(who))
        np.minimum.at(least, which, share[different])
        return who, least

    def get_placement_order(self, entries: Rows) -> Rows:
        """Return the number of each entry in the start order."""
        return self._order[entries]


def has_extent(radius: NDArray[np.floating[Any]]) -> Flags:
    """Return a mask of the radii that are positive and not NaN. Only agents with such a radius occupy space."""
    wide: Flags = np.isfinite(radius) & (radius > 0)
    return wide


def spread_agents(
    occupancy: OccupiedDiscs,
    draw: PositionDrawer,
    ids: NDArray[np.int64],
    radius: Floats,
    first: int,
    max_rounds: tuple[int, ...] | None = None,
) -> tuple[StartPositionCandidates, Flags]:
    """Return positions for the agents `ids`, in this order, and a mask of the agents that touch no other agent there.

    An agent without a free position gets the one with the least overlap. Only agents with a free position are added to
    `occupancy`. `first`: the number of the first agent in the start order. `max_rounds`: the number of positions that an agent
    tries in each round; None for as many as are worthwhile."""
    chosen: StartPositionCandidates | None = None
    fits = np.zeros(len(ids), np.bool_)
    rounds: tuple[int, ...] = _SPACING_ROUNDS[0][1] if max_rounds is None else max_rounds
    begin, size = 0, _FIRST_BATCH_SIZE
    while begin < len(ids):
        part = slice(begin, begin + size)
        drawn, held = _place_agent_batch(occupancy, draw, ids[part], radius[part], first + begin, rounds)
        fits[part] = held
        chosen = drawn if chosen is None else _join_draws(chosen, drawn)
        failed = np.count_nonzero(~held)
        rounds = max_rounds or next(rounds for share, rounds in _SPACING_ROUNDS if failed <= share * held.size)
        begin += size
        size = begin
    return draw(ids, range(1)) if chosen is None else chosen, fits


def _place_agent_batch(
    occupancy: OccupiedDiscs, draw: PositionDrawer, ids: NDArray[np.int64], radius: Floats, first: int, rounds: tuple[int, ...]
) -> tuple[StartPositionCandidates, Flags]:
    """Place one batch of agents in rounds. Return their positions, and a mask of the positions that are free."""
    n, wide = len(ids), has_extent(radius)
    held, best, entry_of = np.zeros(n, np.bool_), np.full(n, -2.0), np.full(n, -1, np.intp)
    order = np.arange(first, first + n)
    chosen: StartPositionCandidates | None = None
    attempt = 0
    for tries in rounds:
        left = np.flatnonzero(~held)
        if not left.size:
            break
        drawn = draw(ids[left], range(attempt, attempt + tries))
        attempt += tries
        score = _score_start_positions(occupancy, drawn, np.tile(left, tries), radius, wide, order).reshape(tries, len(left))
        pick = score.argmax(axis=0)  # the first free position, else the one with the least overlap
        score = score[pick, np.arange(len(left))]
        drawn = drawn.select_rows(pick * len(left) + np.arange(len(left)))
        if chosen is None:
            chosen = drawn
            best[left] = score
        else:
            better = np.flatnonzero(score > best[left])
            chosen.replace_rows(left[better], drawn.select_rows(better))
            best[left[better]] = score[better]
        new = left[score >= 1]
        held[new] = True
        new = new[wide[new]]
        clear_rows = new[_find_first_per_cell(chosen.position[new], radius[new], 1)]
        crowded = np.setdiff1d(new, clear_rows, assume_unique=True)
        held[crowded], best[crowded] = False, 0.0
        entry_of[clear_rows] = occupancy.add_discs(chosen.position[clear_rows], radius[clear_rows], order[clear_rows])
        losing, share = occupancy.find_displaced_entries(entry_of[clear_rows])
        occupancy.remove_discs(losing)
        displaced_rows = occupancy.get_placement_order(losing) - first
        held[displaced_rows], best[displaced_rows] = False, share
    occupancy.forget_removed_discs()
    assert chosen is not None
    return chosen, held


def _score_start_positions(
    occupancy: OccupiedDiscs, draws: StartPositionCandidates, rows: Rows, radius: Floats, is_wide: Flags, order: Rows
) -> Floats:
    """Return a score for each drawn position: 1 if it is free, less if it is occupied, -1 if no agent may start there."""
    score = np.where(draws.is_allowed, 1.0, -1.0)
    good_rows = np.flatnonzero(draws.is_allowed & is_wide[rows])
    score[good_rows] = occupancy.measure_free_distances(
        draws.position[good_rows], radius[rows[good_rows]], order[rows[good_rows]]
    )
    return score


def _join_draws(first: StartPositionCandidates, second: StartPositionCandidates) -> StartPositionCandidates:
    place, up = np.concatenate([first.position, second.position]), np.concatenate([first.up, second.up])
    return StartPositionCandidates(
        Footing.concatenate(first.footing, second.footing), place, up, np.concatenate([first.is_allowed, second.is_allowed])
    )


def _compute_size_class(radius: Floats) -> NDArray[np.int64]:
    """Return the size class of each radius. Radii of the same class differ by less than a factor of 2."""
    return np.frexp(radius)[1].astype(np.int64)


def _find_first_per_cell(place: Floats, radius: Floats, subdivisions: int) -> Rows:
    """Return, in ascending order, the first disc of each size class in each cell of a grid.

    Two discs in the same cell overlap, even without `subdivisions` of cells. So few discs remain, and their pairs can be
    counted."""
    size = _compute_size_class(radius)
    smallest = np.ldexp(0.5, size)  # smallest radius of the class
    cell = np.floor(place / (2.0 * smallest / (np.sqrt(3.0) * subdivisions))[:, None])
    by = np.lexsort((np.arange(len(place)), cell[:, 0], cell[:, 1], cell[:, 2], size))
    same = (cell[by[1:]] == cell[by[:-1]]).all(axis=1) & (size[by[1:]] == size[by[:-1]])
    first = np.ones(len(place), np.bool_)
    first[1:] = ~same
    return np.sort(by[first])
