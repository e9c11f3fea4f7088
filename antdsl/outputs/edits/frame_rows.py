"""Finds the rows of agents in the arrays of a frame, selects rows, and merges the rows of two frames."""

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
# Of rows without a value, by the field of the array; others get 0.
_FILL_BY_FIELD = {"clip": -1, "before": -1, "earlier": -1, "weight": 1, "tilt": (0, 0, 0, 1), "normal": (0, 1, 0)}
_FLOAT_FILLS = {"channels": np.nan}


class FrameRows:
    """The rows of the arrays of one frame, by the agents to which they belong. Agents are identified by `make_agent_keys`."""

    def __init__(self, arrays: Arrays, manifest: Manifest) -> None:
        self.arrays, self.manifest = arrays, manifest
        self.keys = make_agent_keys(arrays)
        self._agent_names = {*manifest.attributes, *ALWAYS_SAVED_ARRAYS, *IDENTITY_ARRAYS}
        self._number_by_species = {entry.name: number for number, entry in enumerate(manifest.species)}
        self._rows_by_body: dict[str, NDArray[np.intp]] = {}

    def find_body_rows(self, body: str) -> NDArray[np.intp]:
        """Return the rows of a species, or of the agents with one of its bodies (`SPECIES#1`)."""
        if body not in self._rows_by_body:
            number = self._number_by_species.get(find_species_of_key(body), -1)
            rows = np.flatnonzero(get_species_numbers(self.arrays) == number)
            if body != find_species_of_key(body):
                ids = get_agent_ids(self.arrays)[rows]
                rows = rows[find_body_numbers(self.manifest, number, ids) == find_number_of_key(body)]
            self._rows_by_body[body] = rows
        return self._rows_by_body[body]

    def find_row_keys(self, name: str) -> LongArray | None:
        """Return the key of the agent to which each row of an array belongs. None for an array that is not about agents.

        For pairs and events, it is the agent that owns the row."""
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
        """Yield (name, agent key of each row) for each array with one row per agent."""
        for name in self.arrays:
            keys = self.find_row_keys(name)
            if keys is not None:
                yield name, keys


def keep_rows(arrays: Arrays, manifest: Manifest, is_chosen: Callable[[LongArray], NDArray[np.bool_]]) -> dict[str, NDArray[Any]]:
    """Return a frame that contains only the rows of chosen agents. `is_chosen`: returns a mask of the chosen agents for an array
    of keys."""
    rows = FrameRows(arrays, manifest)
    return {**arrays, **{name: arrays[name][is_chosen(keys)] for name, keys in rows.iterate_agent_arrays()}}


def join_frames(first: Arrays, second: Arrays, manifest: Manifest) -> dict[str, NDArray[Any]]:
    """Return a frame with the agents of both frames, sorted by species and id. All other arrays are those of `first`.

    If an array exists in only one of the frames, the agents of the other frame get neutral values. No agent may be in both
    frames."""
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
    """Return the keys of the agents that need a row in an array that their frame does not contain."""
    subject = find_array_subject(name)
    if subject in ("pair", "event"):
        return np.empty(0, np.int64)
    return table.keys[table.find_body_rows(name.split(".")[1])] if subject == "one" else table.keys


def _make_neutral_rows(name: str, sample: NDArray[Any], count: int) -> NDArray[Any]:
    """Return `count` rows that have no effect, for an array of this name. `sample`: an array with the type and shape of the
    rows."""
    fill = _FLOAT_FILLS.get(name.partition(".")[0], _FILL_BY_FIELD.get(name.rpartition(".")[2], 0))
    rows = np.empty((count, *sample.shape[1:]), sample.dtype)
    rows[...] = (0, 0, 0, 0, 0, 0, 1) if name.startswith("joints.") else fill
    return rows


def _sort_rows(name: str, array: NDArray[Any], keys: LongArray) -> NDArray[Any]:
    """Return the rows of an array sorted by species and id. Rows of events keep their order."""
    if find_array_subject(name) == "event":
        return array
    return array[np.lexsort((keys // SPECIES_PER_KEY, keys % SPECIES_PER_KEY))]


def _sort_pairs(arrays: dict[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    """Return a frame in which values of pairs are sorted by the ids of both agents."""
    for name in [each for each in arrays if find_array_subject(each) == "pair" and each.endswith(".other")]:
        start = name.removesuffix("other")
        order = np.lexsort((arrays[name], arrays[f"{start}id"]))
        arrays |= {f"{start}{field}": arrays[f"{start}{field}"][order] for field in ("id", "other", "value")}
    return arrays


def match_rows(keys: LongArray, others: LongArray) -> tuple[NDArray[np.intp], NDArray[np.bool_]]:
    """Return the row of each key in `others`, which may have any order, and a mask of the keys that `others` contains."""
    if not len(others):
        return np.zeros(len(keys), np.intp), np.zeros(len(keys), np.bool_)
    order = np.argsort(others, kind="stable")
    at, is_there = match_ids(keys, others[order])
    return order[at], is_there


def _split_name(name: str) -> tuple[str, str]:
    """Return the first and the last word of an array's name.

    The last word is empty if it is in capitals, because it is then a placeholder."""
    first, dot, rest = name.partition(".")
    last = rest.rpartition(".")[2]
    return (first, "" if last.isupper() and len(last) > 1 else last) if dot else ("", name)


_BETWEEN_BY_FIELD = {_split_name(column.frame_name): column.interpolation for column in FRAME_COLUMNS if column.interpolation}


def find_interpolation(name: str) -> str:
    """Return how to interpolate an array between two frames: the `interpolation` of its column."""
    first, last = _split_name(name)
    return _BETWEEN_BY_FIELD.get((first, last), _BETWEEN_BY_FIELD.get((first, ""), ""))
