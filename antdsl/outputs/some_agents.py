"""A cache less all agents but some: what reads it sees a cache of these alone."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from antdsl.outputs.cache.cache_reader import Arrays, Cache

_OF_AGENTS = ("v_ground",)  # beside the attributes of the manifest
_OF_SPECIES = ("clips", "feet", "wears", "channels", "looks", "leans")  # arrays of the agents of a species, `WORD.SPECIES…`


@dataclass(frozen=True, eq=False)
class SomeAgents(Cache):
    """Another cache's agents of some `ids`, in all species; all else as it is there."""

    ids: frozenset[int] = frozenset()

    def frame(self, number: int, only: frozenset[str] | None = None) -> Arrays:
        """The arrays of a frame, with the rows of the chosen agents."""
        arrays = super().frame(number, None if only is None else only | {"id", "species"} | self._beside(only))
        if "id" not in arrays:
            return arrays
        ids = np.asarray(arrays["id"], np.int64)
        chosen = np.isin(ids, sorted(self.ids))
        which = np.asarray(arrays["species"], np.int64) if "species" in arrays else np.zeros(len(ids), np.int64)
        by_species = {entry.name: chosen[which == k] for k, entry in enumerate(self.manifest.species)}
        named = {*self.manifest.attributes, *_OF_AGENTS}
        found = {}
        for name, array in arrays.items():
            rows = chosen if name in named else self._rows(name, arrays, by_species)
            found[name] = array if rows is None or array.ndim == 0 or len(array) != len(rows) else array[rows]
        return found if only is None else {name: array for name, array in found.items() if name in only or name == "frame"}

    def _beside(self, only: frozenset[str]) -> set[str]:
        """The ids that say whose some arrays are."""
        return {f"{name.rpartition('.')[0]}.id" for name in only if name.startswith(("pairs.", "events."))}

    def _rows(self, name: str, arrays: Arrays, by_species: dict[str, NDArray[np.bool_]]) -> NDArray[np.bool_] | None:
        """The rows of an array of one species that are chosen; None for one that is of no agents."""
        word, _, rest = name.partition(".")
        if word in ("pairs", "events"):
            whose = arrays.get(f"{name.rpartition('.')[0]}.id")
            return None if whose is None else np.isin(np.asarray(whose), sorted(self.ids))
        return by_species.get(rest.partition(".")[0]) if word in _OF_SPECIES else None
