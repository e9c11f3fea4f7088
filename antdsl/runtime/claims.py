"""Resolves the agents' claims on items and field cells, after `decide` and before `act`, and their gifts to items.

No amount is lost or created by rounding. The register that receives a claim is float32; amounts of items and cells are
float64. An amount decreases by exactly the increase of the register. Claims on fields are multiples of `DEPOSIT_QUANTUM`, like
deposits. As long as registers contain only such multiples, so do cells."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.fields.pheromone import DEPOSIT_QUANTUM
from antdsl.machine_code.kernels import BOOL, F32, F64, I64, Array1, inlined, kernel
from antdsl.numerics import randomness
from antdsl.runtime.requests import ClaimEntry, GiftEntry
from antdsl.runtime.world import Population, World

ClaimEntries = list[tuple[Population, ClaimEntry]]


def resolve_claims(world: World) -> None:
    """Resolve all claims. For each amount, claims are granted in random order (ties by id) as long as enough remains."""
    item_claims: dict[tuple[str, str], ClaimEntries] = {}
    of_fields: dict[str, ClaimEntries] = {}
    for population in world.populations.values():
        population.claimed_totals.clear()
        for entry in population.effects.claims:
            if not len(entry.rows):
                continue
            if entry.statement.item is None:
                of_fields.setdefault(entry.statement.target, []).append((population, entry))
            else:
                item_claims.setdefault((entry.statement.target, entry.statement.attribute), []).append((population, entry))
        population.effects.claims = []
    for (items, attribute), entries in sorted(item_claims.items(), key=lambda pair: pair[0]):
        entries = _merge_by_statement(entries)
        item, amount = _join_arrays([e.item for _, e in entries]), _join_arrays([e.amount for _, e in entries])
        _resolve_claims_on_amount(world, world.items[items].amounts[attribute], item, amount, 0.0, entries)
    for name, entries in sorted(of_fields.items()):
        entries = _merge_by_statement(entries)
        field = world.fields[name]
        cells, which = np.unique(_join_arrays([e.item for _, e in entries]), return_inverse=True)
        somewhere = int(np.searchsorted(cells, 0))
        cells = cells[somewhere:]
        rest = field.amounts[cells]
        amount = _join_arrays([e.amount for _, e in entries]).astype(np.float64)
        amount = np.where(np.isinf(amount), amount, np.rint(amount / DEPOSIT_QUANTUM) * DEPOSIT_QUANTUM).astype(np.float32)
        _resolve_claims_on_amount(world, rest, which - somewhere, amount, DEPOSIT_QUANTUM, entries)
        field.set_remaining_amounts(cells, rest)


def _merge_by_statement(entries: ClaimEntries) -> ClaimEntries:
    """Merge the claims of each statement into one entry, so that results do not depend on how rows were divided into chunks."""
    if len(entries) == 1:
        return entries
    groups: dict[tuple[str, int], ClaimEntries] = {}
    for population, entry in entries:
        groups.setdefault((population.name, entry.order), []).append((population, entry))
    merged_entries: ClaimEntries = []
    for (_, order), group in groups.items():
        rows, item, amount = (_join_arrays([getattr(e, name) for _, e in group]) for name in ("rows", "item", "amount"))
        population, first = group[0]
        merged_entries.append((population, ClaimEntry(first.statement, order, rows, item, amount)))
    return merged_entries


def _join_arrays(arrays: list[NDArray[Any]]) -> NDArray[Any]:
    """Concatenate arrays. If there is only one, return it without a copy."""
    return arrays[0] if len(arrays) == 1 else np.concatenate(arrays)


def _resolve_claims_on_amount(
    world: World,
    rest: NDArray[np.float64],
    item: NDArray[np.integer],
    amount: NDArray[np.float32],
    unit: float,
    entries: ClaimEntries,
) -> None:
    """Resolve the claims in `entries` on the amounts `rest`. Subtract from `rest` what agents get.

    `item`: for each claim, the index in `rest`, -1 for none. `amount`: the claimed amount; inf claims everything that is left,
    in multiples of `unit`."""
    draw = _join_arrays([_draw_claim_order(world, p, e) for p, e in entries])
    ids = _join_arrays([p.ids[e.rows] for p, e in entries])
    row = _join_arrays([e.rows for _, e in entries])
    if len(entries) == 1 and _try_to_resolve_by_kernel(rest, (ids, draw, item), row, amount, *entries[0]):
        return
    valid = (item >= 0) & (item < len(rest)) & (amount >= 0)
    if len(entries) == 1:
        _grant_claims(rest, np.flatnonzero(valid), (ids, draw, item), row, amount, unit, entries, None)
        return
    names = list(world.populations)
    species, place, source = (
        np.repeat(numbers, [len(e.rows) for _, e in entries])
        for numbers in ([names.index(p.name) for p, _ in entries], [e.order for _, e in entries], np.arange(len(entries)))
    )
    turn = _number_claims_of_agents(species, ids, place)
    for number in range(int(turn.max()) + 1):  # the second claim of an agent reads its register after the first claim
        now = np.flatnonzero(valid & (turn == number))
        _grant_claims(rest, now, (place, species, ids, draw, item), row, amount, unit, entries, source)


def _try_to_resolve_by_kernel(
    rest: NDArray[np.float64],
    keys: tuple[NDArray[Any], ...],
    row: NDArray[np.intp],
    amount: NDArray[np.float32],
    population: Population,
    entry: ClaimEntry,
) -> bool:
    """Resolve the claims of one statement with a kernel, if each of them adds a fixed amount to a register. Return whether
    this was possible. If not, nothing has changed. `keys`: the sort keys of the claims; the last is the primary key."""
    statement = entry.statement
    if statement.register is None or statement.amount is None:
        return False
    item, claimed, (change, got) = keys[-1].astype(np.int64, copy=False), np.empty(len(row), np.int64), np.empty((2, len(row)))
    now, order = population.now, np.lexsort(keys)
    is_settled: bool = _resolve_claims_in_order(
        rest, order, item, row, amount, now[statement.register], now[statement.won_register], claimed, change, got
    )
    return is_settled


def _grant_claims(
    rest: NDArray[np.float64],
    claim_indices: NDArray[np.intp],
    keys: tuple[NDArray[Any], ...],
    row: NDArray[np.intp],
    amount: NDArray[np.float32],
    unit: float,
    entries: ClaimEntries,
    source: NDArray[np.intp] | None,
) -> None:
    """Serve the claims with indices `claim_indices`, at most one of each agent, in the order of `keys`. The last key, the
    item, is the primary key. `source`: the index in `entries` of each claim; None if there is only one entry."""
    claim_indices = claim_indices[np.lexsort([key[claim_indices] for key in keys])]
    item, row, amount = keys[-1][claim_indices], row[claim_indices], amount[claim_indices]
    asks = _OrderedClaims(
        np.empty(len(claim_indices)),
        np.isinf(amount),
        np.zeros(len(claim_indices), np.float32),
        np.zeros(len(claim_indices), np.bool_),
        unit,
    )
    every = np.arange(len(claim_indices))
    owners = [every] if source is None else [np.flatnonzero(source[claim_indices] == k) for k in range(len(entries))]
    for (population, entry), mine in zip(entries, owners, strict=True):
        asks.store_claims(population, entry, mine, row[mine], amount[mine])
    got = _grant_amounts(rest, item, asks)
    for (population, entry), mine in zip(entries, owners, strict=True):
        mine = mine[got[mine] >= 0]
        population.now[entry.statement.won_register][row[mine]] = True
        if entry.statement.register is not None:
            _add_granted_amounts(population, entry, row[mine], amount[mine], got[mine])


def _add_granted_amounts(
    population: Population,
    entry: ClaimEntry,
    rows: NDArray[np.intp],
    amount: NDArray[np.float32],
    granted_amounts: NDArray[np.float64],
) -> None:
    """Add the granted amounts to the agents' registers. `granted_amounts`: float64, the exact amount for each of `rows`."""
    assert entry.statement.register is not None
    own = population.now[entry.statement.register]
    if entry.statement.amount is not None:
        own[rows] += amount
        return
    own[rows] = own[rows].astype(np.float64) + granted_amounts
    taken = population.claimed_totals.setdefault(entry.statement.site, np.zeros(len(population)))
    taken[rows] = granted_amounts


class _OrderedClaims:
    """Claims in the order in which they are served.

    `changes` float64: the exact increase of the register that receives the claim; without a register, the claimed amount.
    `claims_all`: whether the claim is for everything that is left. `has_register`: whether a register receives the claim.
    `register_values`: the current value of this register."""

    def __init__(
        self,
        change: NDArray[np.float64],
        claims_everything: NDArray[np.bool_],
        previous_amounts: NDArray[np.float32],
        has_register: NDArray[np.bool_],
        unit: float,
    ) -> None:
        self.changes, self.claims_all, self.register_values, self.has_register, self.unit = (
            change,
            claims_everything,
            previous_amounts,
            has_register,
            unit,
        )

    def store_claims(
        self,
        population: Population,
        entry: ClaimEntry,
        positions: NDArray[np.intp],
        rows: NDArray[np.intp],
        amount: NDArray[np.float32],
    ) -> None:
        """Store the claims of one statement. `positions`: the position of each claim in the order of serving."""
        if entry.statement.register is None:
            self.changes[positions] = amount
            return
        had = population.now[entry.statement.register][rows]
        with np.errstate(invalid="ignore"):
            self.changes[positions] = (had + amount).astype(np.float64) - had.astype(np.float64)
        self.register_values[positions], self.has_register[positions] = had, True

    def compute_total_amounts(self, positions: NDArray[np.intp], remaining_amounts: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return what each claim for everything that is left gets, given `remaining_amounts`.

        These amounts are multiples of `unit` by which a float32 register can increase exactly."""
        had = self.register_values[positions].astype(np.float64)
        with np.errstate(all="ignore"):
            rounded_amount = np.floor(remaining_amounts / self.unit) * self.unit if self.unit else remaining_amounts
            then = (had + rounded_amount).astype(np.float32)
            then = np.where(then.astype(np.float64) - had > rounded_amount, np.nextafter(then, np.float32(-np.inf)), then)
            part = np.where(self.has_register[positions], then.astype(np.float64) - had, rounded_amount)
            return np.where(np.isfinite(part) & (part <= remaining_amounts), part, 0.0)


def _draw_claim_order(world: World, population: Population, entry: ClaimEntry) -> NDArray[np.uint64]:
    """Return a random word for each claim. Claims are served in the order of these words."""
    ids = population.ids[entry.rows]
    return randomness.draw_word(world.setting.seed, world.frame, population.name, entry.statement.site, 0, ids)


def _number_claims_of_agents(species: NDArray[np.int64], ids: NDArray[np.int64], place: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the position of each claim among the claims of its agent, in source order."""
    order = np.lexsort((place, ids, species))
    fresh = np.ones(len(order), np.bool_)
    fresh[1:] = (ids[order][1:] != ids[order][:-1]) | (species[order][1:] != species[order][:-1])
    starts = np.flatnonzero(fresh)
    turn = np.empty(len(order), np.int64)
    turn[order] = np.arange(len(order)) - np.repeat(starts, np.diff(np.append(starts, len(order))))
    return turn


def _grant_amounts(rest: NDArray[np.float64], item_numbers: NDArray[np.integer], claims: _OrderedClaims) -> NDArray[np.float64]:
    """Grant claims. Return the amount that each claim gets (-1 if not granted), and subtract these amounts from `rest`.

    `item_numbers`: for each claim, its index in `rest`, ascending."""
    item: NDArray[np.int64] = item_numbers.astype(np.int64, copy=False)
    got = np.full(len(item), -1.0)
    if not claims.claims_all.any():
        _grant_claims_in_order(rest, item, claims.changes, got)
        return got
    starts = np.flatnonzero(np.concatenate(([True], item[1:] != item[:-1])))
    ends = np.append(starts[1:], len(item))
    every = np.logical_or.reduceat(claims.claims_all, starts)
    simple_rows = np.flatnonzero(np.repeat(~every, ends - starts))
    part = np.full(len(simple_rows), -1.0)
    _grant_claims_in_order(rest, item[simple_rows], claims.changes[simple_rows], part)
    got[simple_rows] = part
    alone = starts[every & (ends - starts == 1)]
    part = claims.compute_total_amounts(alone, rest[item[alone]])
    winners, part = alone[part > 0], part[part > 0]
    got[winners] = part
    rest[item[winners]] -= part
    several = every & (ends - starts > 1)
    for begin, end in zip(starts[several].tolist(), ends[several].tolist(), strict=True):
        _grant_claims_on_item(rest, item[begin:end], begin, claims, got[begin:end])
    return got


def _grant_claims_on_item(
    rest: NDArray[np.float64], item: NDArray[np.int64], begin: int, claims: _OrderedClaims, obtained_amounts: NDArray[np.float64]
) -> None:
    """Serve the claims on one item in order, until one of them exceeds what is left. Some claims are for all that is left.

    `begin`: the index in `claims` of the item's first claim. `obtained_amounts`: receives the amount that each claim gets."""
    first, change = 0, claims.changes[begin : begin + len(item)]
    for stop in (*np.flatnonzero(claims.claims_all[begin : begin + len(item)]).tolist(), len(item)):
        _grant_claims_in_order(rest, item[first:stop], change[first:stop], obtained_amounts[first:stop])
        if stop == len(item) or (obtained_amounts[first:stop] < 0).any():
            return
        part = float(claims.compute_total_amounts(np.array([begin + stop]), rest[item[:1]])[0])
        if not part > 0:
            return
        obtained_amounts[stop] = part
        rest[item[0]] -= part
        first = stop + 1


def resolve_gifts(world: World) -> None:
    """Add the agents' gifts to the items, smallest first, so that rounding does not depend on the order of agents."""
    gifts: dict[tuple[str, str], list[GiftEntry]] = {}
    for population in world.populations.values():
        for entry in population.effects.gifts:
            gifts.setdefault((entry.statement.items, entry.statement.attribute), []).append(entry)
        population.effects.gifts = []
    for (items, attribute), entries in gifts.items():
        item, amount = (np.concatenate([getattr(entry, name) for entry in entries]) for name in ("item", "amount"))
        order = np.lexsort((amount, item))
        np.add.at(world.items[items].amounts[attribute], item[order], amount[order])


@kernel
def _grant_claims_in_order(rest: Array1[F64], item: Array1[I64], change: Array1[F64], obtained_amounts: Array1[F64]) -> None:
    """Serve claims in order. Write the amount that each claim gets to `obtained_amounts`, and subtract it from `rest`.

    A claim gets its `change` if enough is left for it and for all earlier claims on the same item. `item`: for each claim, its
    index in `rest`, ascending."""
    _grant_claims_one_by_one(rest, item, change, obtained_amounts, item.size)


@kernel
def _resolve_claims_in_order(
    rest: Array1[F64],
    order: Array1[I64],
    item: Array1[I64],
    row: Array1[I64],
    amount: Array1[F32],
    own_amounts: Array1[F32],
    is_winner: Array1[BOOL],
    claimed_items: Array1[I64],
    change: Array1[F64],
    obtained_amounts: Array1[F64],
) -> BOOL:
    """Resolve the claims of one statement, at most one of each agent. `order`: the claims in the order of serving, item by
    item. Each served agent gets its `amount` added to its register `own_amounts`, and its `is_winner` is set. If any claim is
    for everything that is left, nothing is resolved and the result is False. `item`, `row`, `amount` [n]: values of each
    claim. `claimed_items`, `change`, `obtained_amounts` [n]: buffers for intermediate values."""
    for k in range(order.size):
        if amount[k] == np.inf:
            return False
    count = 0
    for k in range(order.size):
        n = order[k]
        if item[n] >= 0 and item[n] < rest.size and amount[n] >= np.float32(0.0):
            had = own_amounts[row[n]]
            order[count], claimed_items[count], obtained_amounts[count] = n, item[n], -1.0
            change[count] = np.float64(had + amount[n]) - np.float64(had)
            count += 1
    _grant_claims_one_by_one(rest, claimed_items, change, obtained_amounts, count)
    for k in range(count):
        n = order[k]
        if obtained_amounts[k] >= 0.0:
            own_amounts[row[n]] += amount[n]
            is_winner[row[n]] = True
    return True


@inlined
def _grant_claims_one_by_one(
    rest: Array1[F64], item: Array1[I64], change: Array1[F64], obtained_amounts: Array1[F64], count: I64
) -> None:
    """Serve the claims item by item, in order, until one of an item's claims exceeds what is left of the item."""
    k = 0
    while k < count:
        which, begin, taken, enough = item[k], k, 0.0, True
        while k < count and item[k] == which:
            together = change[k] if k == begin else taken + change[k]
            enough = enough and together <= rest[which]
            if enough:
                taken, obtained_amounts[k] = together, change[k]
            k += 1
        if obtained_amounts[begin] >= 0.0:
            rest[which] -= taken
