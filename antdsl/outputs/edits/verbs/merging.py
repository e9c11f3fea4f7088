"""The edit `merge`, which adds the agents of another cache."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from pydantic import Field

from antdsl import limits
from antdsl.outputs.cache.cache_reader import CACHE_ENTRY_NAMES, Arrays, Cache, CacheError
from antdsl.outputs.cache.frame_agents import find_array_subject, get_species_numbers
from antdsl.outputs.cache.manifest import Manifest, SpeciesEntry, WornBodyEntry
from antdsl.outputs.edits.edit_layer import EditFile, EditInputs, EditLayer, EditLine, NotEditable
from antdsl.outputs.edits.edit_values import FrameOffset
from antdsl.outputs.edits.frame_rows import SPECIES_PER_KEY, join_frames
from antdsl.outputs.edits.verbs.placing import convert_displacement
from antdsl.scene.values import FilePath, PointValue

_COMPARED_FIELDS = ("units", "up", "fps", "seed")


class MergeLine(EditLine):
    """Adds the agents of another cache, displaced `by` a vector and delayed by `later` frames. Edits of the other cache do not
    apply.

    The agent i of a species gets the id i + N, with N the first id of the species that no agent has, or 0 for a species that this
    cache lacks."""

    verb = "merge"
    path: FilePath = Field(alias="merge")
    by: PointValue | None = None
    later: FrameOffset = 0

    def list_files(self, manifest: Manifest) -> tuple[EditFile, ...]:
        """Return the other cache, as a file that the line names."""
        return (EditFile("merge", self.path, "cache"),)


@dataclass(frozen=True, eq=False)
class MergeLayer(EditLayer):
    """A view of a cache with the agents of another cache. Species with equal descriptions are merged; others are added."""

    line: MergeLine

    @classmethod
    def change_manifest(cls, manifest: Manifest, line: Any, inputs: EditInputs) -> Manifest:
        """Return the manifest with the species and bodies of the other cache."""
        other = inputs.caches[line.path].manifest
        for name in _COMPARED_FIELDS:
            if getattr(other, name) != getattr(manifest, name):
                own, theirs = getattr(manifest, name), getattr(other, name)
                raise NotEditable(
                    f"`{line.path}` has `{name}: {theirs}`, this cache `{own}`; merge only caches with equal values"
                )
        numbers, entries = find_matching_species(manifest, other), list(manifest.species)
        for number, species in zip(numbers, other.species, strict=True):
            if number < len(manifest.species):
                copies, merged = entries[number].copies, entries[number].merged
                period = max(inputs.next_ids[species.name], 1)
                change = {"copies": (*copies, period), "merged": (*merged, len(copies))}
                entries[number] = entries[number].model_copy(update=change)
            else:
                entries.append(_renumber_bodies(species, len(manifest.bodies), {each.name for each in entries}))
        if len(entries) > SPECIES_PER_KEY:
            raise NotEditable(f"the caches have more than {SPECIES_PER_KEY} species together")
        attributes = manifest.attributes if "species" in manifest.attributes else (*manifest.attributes, "species")
        update = {"species": tuple(entries), "bodies": (*manifest.bodies, *other.bodies), "attributes": attributes}
        return manifest.model_copy(update=update)

    def pass_inputs(self) -> EditInputs:
        """Return the inputs for the next edit. Next ids are greater than those of the other cache."""
        next_ids = {entry.name: self._id_offsets[k] + self._counts[k] for k, entry in enumerate(self.manifest.species)}
        return replace(self.inputs, next_ids=next_ids)

    def read_static(self) -> Arrays:
        """Return the arrays that apply to all frames, including the bodies of the other cache."""
        first, others = len(self.source.manifest.bodies), self._other.read_static()
        bodies = {}
        for name, array in others.items():
            if name.startswith("body."):
                _, number, part = name.split(".", 2)
                bodies[f"body.{first + int(number)}.{part}"] = array
        return {**self.source.read_static(), **bodies}

    def find_source_files(self) -> list[Path]:
        """Return the files from which the view was made, including those of the other cache."""
        own = (self._other.folder / name for name in CACHE_ENTRY_NAMES)
        return [*super().find_source_files(), *self._other.find_source_files(), *own]

    @property
    def _other(self) -> Cache:
        """Return the other cache."""
        return self.inputs.caches[self.line.path]

    @cached_property
    def _numbers(self) -> NDArray[np.int64]:
        """Return, for each species of the other cache, its number in the merged cache."""
        return np.array(find_matching_species(self.source.manifest, self._other.manifest), np.int64)

    @cached_property
    def _id_offsets(self) -> list[int]:
        """Return, for each species of the merged cache, the offset that is added to the ids of agents from the other cache."""
        own = [max(self.inputs.next_ids[entry.name], 1) for entry in self.source.manifest.species]
        return own + [0] * (len(self.manifest.species) - len(own))

    @cached_property
    def _counts(self) -> list[int]:
        """Return, for each species of the merged cache, a number that is greater than all ids in the other cache."""
        counts = [1] * len(self.manifest.species)
        for frame in self._other.frames():
            arrays = self._other.frame(frame, frozenset(("id", "species")))
            for number, target in enumerate(self._numbers.tolist()):
                own = arrays["id"][get_species_numbers(arrays) == number]
                counts[target] = max(counts[target], int(own.max(initial=-1)) + 1)
        return counts

    def is_active(self, number: int) -> bool:
        """Return whether a frame contains agents of the other cache."""
        return True

    def change_frame(self, number: int, arrays: Arrays) -> Arrays:
        """Return a frame with the agents of the other cache. Its events are omitted if its list of events differs from this
        one's."""
        count = len(arrays["id"])
        own = arrays if "species" in arrays else {**arrays, "species": np.zeros(count, np.int16)}
        time = number - self.line.later
        if not super().is_active(number) or time not in self._other.frames():
            return own
        others = self._other.frame(time)
        if count + len(others["id"]) > limits.MAX_AGENTS:
            raise CacheError(f"the caches have more than {limits.MAX_AGENTS:,} agents together in frame {number}")
        return join_frames(own, self._convert_agents(others), self.manifest)

    def _convert_agents(self, arrays: Arrays) -> dict[str, NDArray[Any]]:
        """Return the arrays of agents of the other cache, with the ids, species numbers and positions that they have in this
        cache."""
        entries, other = self.manifest.species, self._other.manifest
        shift = np.array(other.origin) - self.manifest.origin
        shift = shift + (convert_displacement(self.line.by, self.manifest) if self.line.by else 0)
        names = {species.name: entries[number].name for species, number in zip(other.species, self._numbers, strict=True)}
        offsets = np.array([self._id_offsets[number] for number in self._numbers], np.int64)
        converted: dict[str, NDArray[Any]] = {}
        for name, array in arrays.items():
            subject, parts = find_array_subject(name), name.split(".")
            if subject in ("one", "pair"):
                key = parts[1].partition("#")
                parts[1] = names.get(key[0], key[0]) + key[1] + key[2]
            if subject == "event" and other.events != self.manifest.events:
                continue
            last = parts[-1]
            if name == "P" or (last == "P" and parts[0] in ("feet", "events")):
                array = (array + shift).astype(array.dtype)
            elif name == "species" or (subject == "event" and last in ("species", "other_species")):
                array = self._numbers[np.asarray(array, np.int64)].astype(np.int16)
            elif name == "id":
                array = array + offsets[get_species_numbers(arrays)]
            elif subject == "event" and last in ("id", "other"):
                species = arrays.get(f"events.{parts[1]}.{'other_species' if last == 'other' else 'species'}")
                array = array + offsets[np.zeros(len(array), np.int64) if species is None else species]
            elif subject == "pair" and last == "id":
                array = array + offsets[next(k for k, each in enumerate(other.species) if names[each.name] == parts[1])]
            converted[".".join(parts)] = array
        if "species" not in converted:
            converted["species"] = np.full(len(arrays["id"]), self._numbers[0] if len(self._numbers) else 0, np.int16)
        return converted


def find_matching_species(manifest: Manifest, other: Manifest) -> list[int]:
    """Return, for each species of another cache, the index of the equal species in this cache, or the index at which it is added.

    A species with copies or replaced bodies is always added, because its bodies depend on its ids."""
    numbers, added = [], len(manifest.species)
    for species in other.species:
        described = _describe_species(species, other)
        equal = (k for k, each in enumerate(manifest.species) if _describe_species(each, manifest) == described)
        match = None if species.copies or species.replaced else next(equal, None)
        numbers.append(added if match is None else match)
        added += match is None
    return numbers


def _describe_species(species: SpeciesEntry, manifest: Manifest) -> Any:
    """Return a value that is equal for two species if they can be merged."""
    worn = species.bodies or (WornBodyEntry(body=species.body, definition=species.definition),)
    digests = [None if each.definition is None else manifest.bodies[each.definition].digest for each in worn]
    plain = species.model_dump(exclude={"definition", "bodies", "copies", "merged"})
    return plain, digests, [(each.body, each.weight) for each in worn]


def _renumber_bodies(species: SpeciesEntry, first: int, names: set[str]) -> SpeciesEntry:
    """Return a species with body numbers that follow those of `first` other bodies. It is renamed if `names` contains its
    name."""
    name = next(each for k in range(len(names) + 1) if (each := f"{species.name}_{k + 1}" if k else species.name) not in names)
    bodies = tuple(each.model_copy(update={"definition": _add_offset(each.definition, first)}) for each in species.bodies)
    change = {"name": name, "definition": _add_offset(species.definition, first), "bodies": bodies}
    return species.model_copy(update={**change, "drawn_as": species.drawn_as or (species.name if name != species.name else "")})


def _add_offset(number: int | None, first: int) -> int | None:
    """Return `number` + `first`, or None if `number` is None."""
    return None if number is None else number + first
