"""Finds agents that edits affect although no edit selects them: edits make them overlap other agents, or remove agents that
they touch."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from antdsl.outputs.edits.edited_cache import EditedCache
from antdsl.outputs.edits.frame_rows import match_rows
from antdsl.outputs.edits.side_effects import Trunks, find_changed, find_overlaps, iterate_capsules, make_trunks

_MIN_TOUCH_DEPTH = -0.05  # of the smaller width: a wider gap between two bodies is no contact


def find_affected_agents_by_frame(cache: EditedCache, *, includes_touched: bool = True) -> Iterator[tuple[int, set[int]]]:
    """Yield each frame number with the keys of the agents that edits affect in this frame.

    If edits make two agents overlap, one of them is affected: the agent that no edit changes, or if edits change both, the one
    with the greater id. With `includes_touched`, an agent is also affected if edits removed or moved away an agent that it
    touched."""
    sizes = [list(iterate_capsules(each)) for each in (cache.original, cache)]
    for number in cache.frames():
        old, new = cache.original.frame(number), cache.frame(number)
        if any(name not in arrays for arrays in (old, new) for name in ("id", "P", "orient", "pscale")):
            return
        old_trunks, new_trunks = make_trunks(cache.original, old, sizes[0]), make_trunks(cache, new, sizes[1])
        yield number, _find_affected_in_frame(old_trunks, new_trunks, includes_touched)


def _find_affected_in_frame(old: Trunks, new: Trunks, includes_touched: bool) -> set[int]:
    is_changed = find_changed(old, new)
    at, is_left = match_rows(old.keys, new.keys)
    is_removed = ~is_left
    is_removed[is_left] = is_changed[at[is_left]]
    if not is_changed.any() and not is_removed.any():
        return set()
    changed, removed = set(new.keys[is_changed].tolist()), set(old.keys[is_removed].tolist())
    known = set(find_overlaps(old, np.ones(len(old.keys), np.bool_)))
    pairs = [pair for pair in find_overlaps(new, is_changed) if pair not in known]
    affected = {max(pair) if pair[0] in changed and pair[1] in changed else _pick_other(pair, changed) for pair in pairs}
    if not includes_touched:
        return affected
    touched = [pair for pair in find_overlaps(old, is_removed, _MIN_TOUCH_DEPTH) if (pair[0] in removed) != (pair[1] in removed)]
    still = set(find_overlaps(new, is_changed, _MIN_TOUCH_DEPTH)) if touched else set()
    return affected | {_pick_other(pair, removed) for pair in touched if pair not in still}


def _pick_other(pair: tuple[int, int], known_keys: set[int]) -> int:
    """Return the agent of a pair that is affected: the one that is not in `known_keys`."""
    return pair[1] if pair[0] in known_keys else pair[0]
