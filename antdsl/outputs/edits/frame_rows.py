"""Rows of agents in a frame's arrays: the agents that they belong to, a choice of them, and the rows of two frames in one."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.numerics.records import match_ids
from antdsl.outputs.cache.cache_reader import Arrays
from antdsl.outputs.cache.frame_agents import (
    ALWAYS_SAVED_ARRAYS,
    IDENTITY_ARRAYS,
    LongArray,
    find_array_subject,
    get_agent_ids,
    get_species_numbers,
    make_agent_keys,
)
from antdsl.outputs.cache.manifest import Manifest
from antdsl.outputs.cache_bodies import find_body_numbers
from antdsl.program.tables.columns import FRAME_COLUMNS
from antdsl.scene.crowds.body_choice import find_number_of_key, find_species_of_key

SPECIES_PER_KEY = 4096  # of `make_agent_keys`
_FILL_BY_FIELD = {"clip": -1, "before": -1, "earlier": -1, "weight": 1, "tilt": (0, 0, 0, 1)}  # of rows without a value; else 0
_FLOAT_FILLS = {"channels": np.nan}


class FrameRows:
    """The rows of one frame's arrays, by the agents that they belong to. Agents are named by `make_agent_keys`."""

    def __init__(self, arrays: Arrays, manifest: Manifest) -> None:
        self.arrays, self.manifest = arrays, manifest
        self.keys = make_agent_keys(arrays)
        self._agent_names = {*manifest.attributes, *ALWAYS_SAVED_ARRAYS, *IDENTITY_ARRAYS}
        self._number_by_species = {entry.name: number for number, entry in enumerate(manifest.species)}
        self._rows_by_body: dict[str, NDArray[np.intp]] = {}

    def find_body_rows(self, body: str) -> NDArray[np.intp]:
        """Return the rows of the agents of a species, or of one of its bodies, `SPECIES#1`."""
        if body not in self._rows_by_body:
            number = self._number_by_species.get(find_species_of_key(body), -1)
            rows = np.flatnonzero(get_species_numbers(self.arrays) == number)
            if body != find_species_of_key(body):
                ids = get_agent_ids(self.arrays)[rows]
                rows = rows[find_body_numbers(self.manifest, number, ids) == find_number_of_key(body)]
            self._rows_by_body[body] = rows
        return self._rows_by_body[body]

    def find_row_keys(self, name: str) -> LongArray | None:
        """Return the agent of each row of an array; of pairs and events, the owner. None for an array that is not about
        agents."""
        subject, array = find_array_subject(name), self.arrays[name]
        keys: LongArray | None = None
        if name in self._agent_names:
            keys = self.keys
        elif subject == "one":
            keys = self.keys[self.find_body_rows(name.split(".")[1])]
        elif subject in ("pair", "event"):
            start = name.rpartition(".")[0]
            ids, numbers = self.arrays.get(f"{start}.id"), self.arrays.get(f"{start}.species")
            if ids is not None:
                number = self._number_by_species.get(name.split(".")[1], 0) if numbers is None else np.asarray(numbers, np.int64)
                keys = np.asarray(ids, np.int64) * SPECIES_PER_KEY + number
        return keys if keys is not None and array.ndim and len(array) == len(keys) else None

    def iterate_agent_arrays(self) -> Iterator[tuple[str, LongArray]]:
        """Yield the names of the arrays with rows of agents, and the agent of each row."""
        for name in self.arrays:
            keys = self.find_row_keys(name)
            if keys is not None:
                yield name, keys


def keep_rows(arrays: Arrays, manifest: Manifest, is_chosen: Callable[[LongArray], NDArray[np.bool_]]) -> dict[str, NDArray[Any]]:
    """Return a frame with the rows of some agents. `is_chosen`: returns which agents, by their keys."""
    rows = FrameRows(arrays, manifest)
    return {**arrays, **{name: arrays[name][is_chosen(keys)] for name, keys in rows.iterate_agent_arrays()}}


def join_frames(first: Arrays, second: Arrays, manifest: Manifest) -> dict[str, NDArray[Any]]:
    """Return a frame with the agents of both: species after species, by id. All else is of `first`.

    A frame that lacks an array of agents gets neutral values for it. `first` and `second` have no agent in common."""
    tables = FrameRows(first, manifest), FrameRows(second, manifest)
    named = [dict(table.iterate_agent_arrays()) for table in tables]
    joined = dict(first)
    for name in dict.fromkeys((*named[0], *named[1])):
        sample = first[name] if name in named[0] else second[name]
        parts, keys = [], []
        for table, names in zip(tables, named, strict=True):
            own = names[name] if name in names else _find_lacking_keys(table, name)
            parts.append(table.arrays[name] if name in names else _make_neutral_rows(name, sample, len(own)))
            keys.append(own)
        joined[name] = _sort_rows(name, np.concatenate(parts), np.concatenate(keys))
    return _sort_pairs(joined)


def _find_lacking_keys(table: FrameRows, name: str) -> LongArray:
    """Return the agents that an array would have rows of, if the frame had it."""
    subject = find_array_subject(name)
    if subject in ("pair", "event"):
        return np.empty(0, np.int64)
    return table.keys[table.find_body_rows(name.split(".")[1])] if subject == "one" else table.keys


def _make_neutral_rows(name: str, sample: NDArray[Any], count: int) -> NDArray[Any]:
    fill = _FLOAT_FILLS.get(name.partition(".")[0], _FILL_BY_FIELD.get(name.rpartition(".")[2], 0))
    rows = np.empty((count, *sample.shape[1:]), sample.dtype)
    rows[...] = (0, 0, 0, 0, 0, 0, 1) if name.startswith("joints.") else fill
    return rows


def _sort_rows(name: str, array: NDArray[Any], keys: LongArray) -> NDArray[Any]:
    """Return rows in the order of species and ids. Events stay in their order."""
    if find_array_subject(name) == "event":
        return array
    return array[np.lexsort((keys // SPECIES_PER_KEY, keys % SPECIES_PER_KEY))]


def _sort_pairs(arrays: dict[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    """Return a frame in which the values per pair are by owner and other."""
    for name in [each for each in arrays if find_array_subject(each) == "pair" and each.endswith(".other")]:
        start = name.removesuffix("other")
        order = np.lexsort((arrays[name], arrays[f"{start}id"]))
        arrays |= {f"{start}{field}": arrays[f"{start}{field}"][order] for field in ("id", "other", "value")}
    return arrays


def match_rows(keys: LongArray, others: LongArray) -> tuple[NDArray[np.intp], NDArray[np.bool_]]:
    """Return the row of each key among `others`, in any order, and whether there is one."""
    if not len(others):
        return np.zeros(len(keys), np.intp), np.zeros(len(keys), np.bool_)
    order = np.argsort(others, kind="stable")
    at, is_there = match_ids(keys, others[order])
    return order[at], is_there


def _split_name(name: str) -> tuple[str, str]:
    """Return the first and the last word of an array's name. The last one is empty for a word in capitals, which stands for
    any."""
    first, dot, rest = name.partition(".")
    last = rest.rpartition(".")[2]
    return (first, "" if last.isupper() and len(last) > 1 else last) if dot else ("", name)


_BETWEEN_BY_FIELD = {_split_name(column.frame_name): column.interpolation for column in FRAME_COLUMNS if column.interpolation}


def find_interpolation(name: str) -> str:
    """Return the `between` of an array's column: how its values change between two frames."""
    first, last = _split_name(name)
    return _BETWEEN_BY_FIELD.get((first, last), _BETWEEN_BY_FIELD.get((first, ""), ""))
