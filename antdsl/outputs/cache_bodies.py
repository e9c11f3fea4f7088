"""The bodies of a cache's species. Each is built only once, from data in the cache or from the library."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.bodies.agents.definition import Definition
from antdsl.bodies.agents.machine_clips import PlayedClip
from antdsl.bodies.library import load_library_body
from antdsl.bodies.posed_body import PosedBody
from antdsl.outputs.cache.body_arrays import load_definition
from antdsl.outputs.cache.manifest import ClipEntry, Manifest, SpeciesEntry, WornBodyEntry
from antdsl.outputs.cache.pose_arrays import list_mask_layers
from antdsl.scene.crowds.body_choice import choose_body_numbers, make_body_key
from antdsl.scene.library_bodies import BODY_WORDS, find_body_for_species


class CacheBodies:
    """The bodies of a cache's species.

    A body is identified by three numbers: its species (an index of the manifest's list), its index among the bodies of this
    species, and the mask of its layers. `static`: the arrays of the cache's `static.npz`."""

    def __init__(self, manifest: Manifest, static: Mapping[str, NDArray[Any]]) -> None:
        self._manifest, self._static = manifest, static
        self._definitions: dict[tuple[int, int], Definition] = {}
        self._worn: dict[tuple[int, int, int], PosedBody] = {}

    def keys(self, number: int) -> tuple[str, ...]:
        """Return the keys of the bodies of species `number`. Arrays of feet in frames have these keys in their names."""
        species, count = self._manifest.species[number], len(_list_entries(self._manifest.species[number]))
        return tuple(make_body_key(species.name, which, count) for which in range(count))

    def numbers(self, number: int, ids: NDArray[np.int64]) -> NDArray[np.uint8]:
        """Return, for each agent of species `number`, the index of its body, uint8[n]."""
        return find_body_numbers(self._manifest, number, ids)

    def body(self, number: int, mask: int = 0, body_index: int = 0) -> PosedBody:
        """Return a body of species `number`, with the layers of a mask. Raises BodyError if its definition in the cache is
        damaged."""
        key = number, body_index, mask
        if key not in self._worn:
            species = self._manifest.species[number]
            clips = tuple(PlayedClip(*(getattr(clip, name) for name in ClipEntry.model_fields)) for clip in species.clips)
            self._worn[key] = PosedBody(self.definition(number, body_index), clips, list_mask_layers(species, mask))
        return self._worn[key]

    def definition(self, number: int, body_index: int = 0) -> Definition:
        """Return the agent definition of a body of species `number`. Raises BodyError if it is damaged."""
        if (number, body_index) not in self._definitions:
            species = self._manifest.species[number]
            entry = _list_entries(species)[body_index]
            self._definitions[number, body_index] = (
                load_library_body(entry.body if entry.body in BODY_WORDS else find_body_for_species(species.name))
                if entry.definition is None
                else load_definition(self._manifest, self._static, entry.definition)
            )
        return self._definitions[number, body_index]

    def reach(self, number: int) -> float:
        """Return the greatest distance of a point of the species' bodies from the agent's position, in body lengths.

        It is 1, or more if bodies from files extend farther."""
        entries = _list_entries(self._manifest.species[number])
        own = [self.body(number, 0, which).reach for which, each in enumerate(entries) if each.definition is not None]
        return max([1.0, *own])


def find_body_numbers(manifest: Manifest, number: int, ids: NDArray[np.int64]) -> NDArray[np.uint8]:
    """Return, for each agent, the index of its body among the bodies of the species, uint8[n]."""
    species = manifest.species[number]
    own, merged = np.asarray(ids, np.int64), np.full(len(ids), -1)  # `own` is -1 below the level of the other cache
    levels = [own]
    for level, period in reversed(list(enumerate(species.copies))):
        if level in species.merged:
            is_merged = own >= period
            merged, own = np.where(is_merged, own - period, merged), np.where(is_merged, -1, own)
        else:
            own = np.where(own < 0, own, own % period)
        levels.insert(0, own)
    originals = np.where(merged < 0, own, merged)
    weights, name = [each.weight for each in species.bodies], species.drawn_as or species.name
    numbers = choose_body_numbers(weights, manifest.seed, name, originals)
    for each in species.replaced:
        known = levels[min(each.level, len(species.copies))]
        numbers[(known >= each.first) & (known < each.first + each.count)] = each.body
    return numbers


def _list_entries(species: SpeciesEntry) -> tuple[WornBodyEntry, ...]:
    """Return the manifest's entries for the bodies of a species, at least one."""
    return species.bodies or (WornBodyEntry(body=species.body, definition=species.definition),)
