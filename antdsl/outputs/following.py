"""Where the agents of a picture are in the frame after, row by row, for what moves while a shutter is open."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields, is_dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.outputs.pictures.model import Crowd

_MOVED = ("position", "orient", "plays", "feet", "driven")


def followed(now: Crowd, later: Crowd) -> Crowd:
    """The agents of `now`, in its order, as they are in `later`, which has them in any order; who is gone by then stays as it
    is. Both have ids."""
    own, ids = np.asarray(now.ids), np.asarray(later.ids)
    order = np.argsort(ids, kind="stable")
    at, there = matched(own, ids[order])
    rows = len(ids) + np.arange(len(own))
    rows[there] = order[at[there]]
    whole = {
        name: _joined(getattr(later, name), getattr(now, name)) for name in ("position", "orient", "plays", "feet", "driven")
    }
    kept = replace(now, **whole, paths=None)
    return replace(
        now,
        position=kept.position[rows],
        orient=kept.orient[rows],
        plays=tuple(each.rows(rows) for each in kept.plays),
        feet=None if kept.feet is None else kept.feet.rows(rows),
        driven=kept.driven.rows(rows),
        after=None,
    )


def matched(ids: NDArray[np.int64], others: NDArray[np.int64]) -> tuple[NDArray[np.intp], NDArray[np.bool_]]:
    """Where each id stands among others, which ascend, and whether it does."""
    if len(ids) == len(others) and np.array_equal(ids, others):
        return np.arange(len(ids)), np.ones(len(ids), np.bool_)
    at = np.minimum(np.searchsorted(others, ids), max(len(others) - 1, 0))
    return at, others[at] == ids if len(others) else np.zeros(len(ids), np.bool_)


def _joined(one: Any, other: Any) -> Any:
    """The rows of both, one after the other; None where one has none."""
    if one is None or other is None:
        return None
    if isinstance(one, np.ndarray):
        return np.concatenate([one, other])
    if isinstance(one, Mapping):
        return {name: _joined(each, other[name]) for name, each in one.items() if name in other}
    if isinstance(one, tuple):
        return tuple(_joined(a, b) for a, b in zip(one, other, strict=False))
    if not is_dataclass(one) or isinstance(one, type):
        return one  # the same for all rows
    return type(one)(*(_joined(getattr(one, field.name), getattr(other, field.name)) for field in fields(one)))
