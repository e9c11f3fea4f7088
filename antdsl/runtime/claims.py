"""Claims on items, settled between decide and act, and gifts to them. What one side loses the other gets, to the last bit.

An agent's own register is float32, an item's amount float64: the item changes by exactly the difference that the register made.
"""

from __future__ import annotations

from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from antdsl.numerics import randomness
from antdsl.runtime.requests import ClaimEntry, GiveEntry
from antdsl.runtime.world import Population, World


def settle(world: World) -> None:
    """Serve the claims on each amount in the order of (draw, id), while the rest suffices."""
    asked: dict[tuple[str, str], list[tuple[Population, ClaimEntry]]] = {}
    for population in world.populations.values():
        for entry in population.effects.claims:
            if len(entry.rows):
                asked.setdefault((entry.statement.items, entry.statement.attribute), []).append((population, entry))
        population.effects.claims = []
    for (items, attribute), entries in sorted(asked.items(), key=lambda pair: pair[0]):
        _settle_one(world, items, attribute, entries)


def _settle_one(world: World, items: str, attribute: str, entries: list[tuple[Population, ClaimEntry]]) -> None:
    rest = world.items[items].amounts[attribute]
    names = list(world.populations)
    draw = np.concatenate([_draws(world, p, e) for p, e in entries])
    ids = np.concatenate([p.ids[e.rows] for p, e in entries])
    species = np.concatenate([np.full(len(e.rows), names.index(p.name)) for p, e in entries])
    place = np.concatenate([np.full(len(e.rows), e.order) for _, e in entries])
    source = np.concatenate([np.full(len(e.rows), k) for k, (_, e) in enumerate(entries)])
    row = np.concatenate([e.rows for _, e in entries])
    item = np.concatenate([e.item for _, e in entries])
    amount = np.concatenate([e.amount for _, e in entries])
    valid = (item >= 0) & (item < len(rest)) & (amount >= 0)
    turn = _turn(species, ids, place)
    for number in range(int(turn.max()) + 1):  # who asks twice in one step has changed its own register in between
        now = np.flatnonzero(valid & (turn == number))
        now = now[np.lexsort((place[now], species[now], ids[now], draw[now], item[now]))]
        change = np.empty(len(now))
        for k, (population, entry) in enumerate(entries):
            mine = np.flatnonzero(source[now] == k)
            change[mine] = _change(population, entry, row[now[mine]], amount[now[mine]])
        won = _served(rest, item[now], change)
        for k, (population, entry) in enumerate(entries):
            mine = now[won & (source[now] == k)]
            population.now[entry.statement.won][row[mine]] = True
            if entry.statement.own is not None:
                population.now[entry.statement.own][row[mine]] += amount[mine]


def _draws(world: World, population: Population, entry: ClaimEntry) -> NDArray[np.uint64]:
    ids = population.ids[entry.rows]
    return randomness.word(world.setting.seed, world.frame, population.name, entry.statement.site, 0, ids)


def _turn(species: NDArray[np.int64], ids: NDArray[np.int64], place: NDArray[np.int64]) -> NDArray[np.int64]:
    """Number of each claim among those of the same agent, in text order."""
    order = np.lexsort((place, ids, species))
    fresh = np.ones(len(order), np.bool_)
    fresh[1:] = (ids[order][1:] != ids[order][:-1]) | (species[order][1:] != species[order][:-1])
    starts = np.flatnonzero(fresh)
    turn = np.empty(len(order), np.int64)
    turn[order] = np.arange(len(order)) - np.repeat(starts, np.diff(np.append(starts, len(order))))
    return turn


def _change(
    population: Population, entry: ClaimEntry, rows: NDArray[np.intp], amount: NDArray[np.float32]
) -> NDArray[np.float64]:
    """What winning would add to the agents' own registers, in full; without one, the amount."""
    if entry.statement.own is None:
        return amount.astype(np.float64)
    had = population.now[entry.statement.own][rows]
    return (had + amount).astype(np.float64) - had.astype(np.float64)


def _served(rest: NDArray[np.float64], item: NDArray[np.int32], change: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Who is served; `item` is sorted. Takes what they get from the rest."""
    won = np.zeros(len(item), np.bool_)
    if not len(item):
        return won
    starts = [0, *(np.flatnonzero(item[1:] != item[:-1]) + 1).tolist(), len(item)]
    for begin, end in pairwise(starts):
        k = item[begin]
        taken = np.add.accumulate(change[begin:end])
        count = end - begin
        if not taken[-1] <= rest[k]:  # nobody adds less than nothing, so that else all are served
            served = taken <= rest[k]
            count = count if served.all() else int(np.argmin(served))
        if count:
            rest[k] -= taken[count - 1]
        won[begin : begin + count] = True
    return won


def give(world: World) -> None:
    """Add what agents gave to the items, the least first: so that the agents' order is nothing where a sum is rounded."""
    given: dict[tuple[str, str], list[GiveEntry]] = {}
    for population in world.populations.values():
        for entry in population.effects.gives:
            given.setdefault((entry.statement.items, entry.statement.attribute), []).append(entry)
        population.effects.gives = []
    for (items, attribute), entries in given.items():
        item, amount = (np.concatenate([getattr(entry, name) for entry in entries]) for name in ("item", "amount"))
        order = np.lexsort((amount, item))
        np.add.at(world.items[items].amounts[attribute], item[order], amount[order])
