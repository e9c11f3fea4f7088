"""The agents of a frame: their ids and species, and the names of arrays that have one row per agent."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.program.tables.columns import FRAME_COLUMNS

Arrays = Mapping[str, NDArray[Any]]
LongArray = NDArray[np.int64]
ALWAYS_SAVED_ARRAYS = frozenset(
    each.name for each in FRAME_COLUMNS if each.row_kind == "species" and each.save_mode == "always"
)  # these exist also without `output`

IDENTITY_ARRAYS = frozenset(("id", "species"))
_SUBJECT_BY_ARRAY_PREFIX = {each.name.partition(".")[0]: each.row_kind for each in FRAME_COLUMNS}  # by the first word of a name


def find_array_subject(name: str) -> str | None:
    """Return what a row of an array stands for (`one` agent, `pair` or `event`). It follows from the first word of the name. None
    for other arrays."""
    return _SUBJECT_BY_ARRAY_PREFIX.get(name.partition(".")[0]) if "." in name else None


def list_special_arrays(form: str) -> frozenset[str]:
    """Return the names of the arrays that the file format `form` writes as special attributes."""
    return frozenset(each.frame_name for each in FRAME_COLUMNS if form in each.exports.split())


def iterate_other_numbers(arrays: Arrays, form: str) -> Iterator[tuple[str, NDArray[Any]]]:
    """Yield (name, values) of all arrays with one number per agent that the file format `form` does not write as a special
    attribute."""
    own, count = list_special_arrays(form), len(arrays["P"])
    for name, values in arrays.items():
        if name not in own and "." not in name.removesuffix(".state") and values.shape == (count,):
            yield name, values


def get_agent_ids(arrays: Arrays) -> LongArray:
    """Return the id of each agent, or its row index if the frame has no ids."""
    return np.asarray(arrays["id"], np.int64) if "id" in arrays else np.arange(_count_agents(arrays))


def get_species_numbers(arrays: Arrays) -> LongArray:
    """Return the species number of each agent."""
    return np.asarray(arrays["species"], np.int64) if "species" in arrays else np.zeros(_count_agents(arrays), np.int64)


def find_species_rows(arrays: Arrays, number: int) -> NDArray[np.intp]:
    """Return the rows of the agents of species `number`."""
    return np.flatnonzero(get_species_numbers(arrays) == number)


def make_agent_keys(arrays: Arrays) -> LongArray:
    """Return a key for each agent: a number that identifies the agent within the cache, in all frames."""
    return get_agent_ids(arrays) * 4096 + get_species_numbers(arrays)


def _count_agents(arrays: Arrays) -> int:
    """Return the number of agents in a frame."""
    return next((len(arrays[name]) for name in ("id", "P", "orient") if name in arrays), 0)
