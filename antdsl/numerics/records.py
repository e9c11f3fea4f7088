"""Selects and joins the rows of records. A record is an array with one row per agent, or a dataclass, tuple or mapping of such
arrays."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import fields, is_dataclass, replace
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray

Record = TypeVar("Record")


def select_record_rows(record: Record, row_selection: NDArray[np.bool_] | NDArray[np.intp]) -> Record:
    """Return a copy of a record with only the selected rows of each array. Values other than arrays are unchanged."""
    rows: Record = _map_arrays(lambda array: array[row_selection], record)
    return rows


def join_record_rows(first: Any, second: Any) -> Any:
    """Return a record with the rows of `first` followed by those of `second`. A value that is None in one of them is None in
    the result."""
    return _map_arrays(lambda *arrays: np.concatenate(arrays), first, second)


def _map_arrays(function: Callable[..., NDArray[Any]], first: Any, *others: Any) -> Any:
    """Return a record like `first` with each array replaced by the result of `function`. The arguments of `function` are the
    corresponding arrays of all records."""
    if any(each is None for each in (first, *others)):
        return None
    if isinstance(first, np.ndarray):
        return function(first, *others)
    if isinstance(first, Mapping):
        names = [name for name in first if all(name in other for other in others)]
        return {name: _map_arrays(function, *(each[name] for each in (first, *others))) for name in names}
    if isinstance(first, tuple):
        return tuple(_map_arrays(function, *parts) for parts in zip(first, *others, strict=False))
    if not is_dataclass(first) or isinstance(first, type):
        return first
    parts = {field.name: [getattr(each, field.name) for each in (first, *others)] for field in fields(first)}
    return replace(first, **{name: _map_arrays(function, *part) for name, part in parts.items()})


def select_by_prefix(arrays: Mapping[str, NDArray[Any]], prefix: str) -> dict[str, NDArray[Any]]:
    """Return the arrays with names that begin with a prefix. The keys of the result are the names without the prefix."""
    return {name.removeprefix(prefix): array for name, array in arrays.items() if name.startswith(prefix)}


def match_ids(ids: NDArray[np.int64], others: NDArray[np.int64]) -> tuple[NDArray[np.intp], NDArray[np.bool_]]:
    """Return the index of each id in the ascending array `others`, and whether `others` contains it. If it does not, the index
    has no meaning."""
    if len(ids) == len(others) and np.array_equal(ids, others):
        return np.arange(len(ids)), np.ones(len(ids), np.bool_)
    indices = np.minimum(np.searchsorted(others, ids), max(len(others) - 1, 0))
    return indices, others[indices] == ids if len(others) else np.zeros(len(ids), np.bool_)
