"""Finds bodies that touch at the start of a step, and contacts that begin, for `on collision`.

Two bodies begin to touch when the gap between their capsules falls below a small fraction of the sum of their collision radii.
The contact ends only when the gap is several times larger. So two bodies that press against each other and jitter do not
collide again and again."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.runtime.moving.contacts.capsules import CapsuleCrowd, find_near_pairs
from antdsl.runtime.world import Population, World
from antdsl.senses.touching import TouchingAgents

Ids = NDArray[np.int64]
Rows = NDArray[np.intp]

_CONTACT_BEGIN_OVERLAP_SHARE = 0.02  # share of the sum of two radii: a contact begins below this gap
_CONTACT_END_GAP_SHARE = 0.25  # share of the sum of two radii: a contact ends above this gap


def find_new_contacts(world: World, population: Population, other_species: str, rows: Rows, touched_ids: Ids) -> tuple[Ids, Ids]:
    """Return the contact that begins for each agent (n), and the ids (n, k) of all agents that it now touches.

    A contact that begins is the id of an agent of `other_species`, -1 for none. If several begin, the one with the deepest
    overlap is returned. `touched_ids` (n, k): the ids that the agent touched in the previous step, -1 for none. If all k
    entries are in use, new contacts are ignored."""
    contact_ids = np.full(len(rows), -1, np.int64)
    known = _get_touching_agents(world).get((population.name, other_species))
    if known is None:
        return contact_ids, np.full_like(touched_ids, -1)
    first, count = known.partner_starts.take(rows), known.partner_starts.take(rows + 1) - known.partner_starts.take(rows)
    who = np.repeat(np.arange(len(rows)), count)
    pairs = np.arange(len(who)) - np.repeat(np.cumsum(count) - count, count) + np.repeat(first, count)
    ids = known.partner_ids.take(pairs)
    same = touched_ids.take(who, axis=0) == ids[:, None]
    lasting = np.zeros(touched_ids.shape, np.bool_)
    pair, slot = np.nonzero(same)
    lasting[who.take(pair), slot] = True
    touched_ids = np.where(lasting, touched_ids, -1)
    free = touched_ids == -1
    new = np.flatnonzero(known.can_start_contact.take(pairs) & ~same.any(axis=1) & free.any(axis=1).take(who))
    noticing, deepest = np.unique(who.take(new), return_index=True)
    contact_ids[noticing] = ids.take(new.take(deepest))
    touched_ids[noticing, free[noticing].argmax(axis=1)] = contact_ids[noticing]
    return contact_ids, touched_ids


def _get_touching_agents(world: World) -> Mapping[tuple[str, str], TouchingAgents]:
    """Return the agents that touched at the start of the step, by the names of both species. The result is cached for the
    step."""
    if world.touching_agents is None:
        world.touching_agents = _find_touching_agents(CapsuleCrowd(world, start=True))
    return world.touching_agents


def _find_touching_agents(crowd: CapsuleCrowd) -> dict[tuple[str, str], TouchingAgents]:
    """Return the touching agents by the names of both species: all pairs with a gap at which an existing contact continues."""
    contacts: dict[tuple[str, str], TouchingAgents] = {}
    if len(crowd) < 2:
        return contacts
    pairs = find_near_pairs(crowd)
    gap = pairs.gap
    radius_sum = pairs.radius.take(pairs.first_indices) + pairs.radius.take(pairs.second_indices)
    close_rows = np.flatnonzero(gap < _CONTACT_END_GAP_SHARE * radius_sum)
    i, j = pairs.rows.take(pairs.first_indices.take(close_rows)), pairs.rows.take(pairs.second_indices.take(close_rows))
    one, other, gap = np.concatenate([i, j]), np.concatenate([j, i]), np.tile(gap.take(close_rows), 2)
    near = gap < _CONTACT_BEGIN_OVERLAP_SHARE * np.tile(radius_sum.take(close_rows), 2)
    kinds: Any = [np.searchsorted(crowd.first, rows, "right") - 1 for rows in (one, other)]
    for a, species in enumerate(crowd.species):
        for b, other_species in enumerate(crowd.species):
            subset = np.flatnonzero((kinds[0] == a) & (kinds[1] == b))
            if not len(subset):
                continue
            row, ids = one.take(subset) - crowd.first[a], other_species.ids.take(other.take(subset) - crowd.first[b])
            order = np.lexsort((ids, gap.take(subset), row))
            starts = np.searchsorted(row.take(order), np.arange(len(species) + 1))
            contacts[species.name, other_species.name] = TouchingAgents(starts, ids.take(order), near.take(subset).take(order))
    return contacts
