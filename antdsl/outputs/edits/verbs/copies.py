"""The edit `duplicate`, which adds copies of agents."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Annotated, Any

import numpy as np
from numpy.typing import NDArray
from pydantic import BeforeValidator, Field

from antdsl import limits
from antdsl.outputs.cache.cache_reader import Arrays, CacheError
from antdsl.outputs.cache.frame_agents import find_array_subject, get_species_numbers
from antdsl.outputs.cache.manifest import MAX_COUNTED_ID, Manifest
from antdsl.outputs.edits.edit_layer import EditInputs, EditLayer, NotEditable
from antdsl.outputs.edits.edit_values import FrameOffset
from antdsl.outputs.edits.frame_rows import join_frames
from antdsl.outputs.edits.grounding import Grounds, move_on_ground
from antdsl.outputs.edits.verbs.agent_moves import make_moves, move_agents
from antdsl.outputs.edits.verbs.placing import REQUIRED_ARRAYS, GroundLine, convert_displacement
from antdsl.outputs.edits.verbs.timing import TimeMap, read_shifted
from antdsl.scene.notes.selectors import Selector
from antdsl.scene.values import PointValue, parse_integer_between

MAX_COPIES = 1000


class DuplicateLine(GroundLine):
    """Adds `count` copies of agents. Each copy is displaced `by` a vector and delayed by `later` frames, relative to the copy
    before.

    Copy k of agent i has the id i + k N, with N the first id of the species that no agent has."""

    verb = "duplicate"
    agents: Selector = Field(alias="duplicate")
    by: PointValue | None = None
    later: FrameOffset = 0
    count: Annotated[int, BeforeValidator(parse_integer_between(1, MAX_COPIES))] = 1


@dataclass(frozen=True, eq=False)
class DuplicateLayer(EditLayer):
    """A view of a cache with copies of some agents."""

    line: DuplicateLine
    required_arrays = REQUIRED_ARRAYS
    stored_frames = 4

    @classmethod
    def change_manifest(cls, manifest: Manifest, line: Any, inputs: EditInputs) -> Manifest:
        """Return the manifest, in which the copies have the bodies of their originals."""
        for species in manifest.species:
            if inputs.next_ids[species.name] * (line.count + 1) > MAX_COUNTED_ID:
                raise NotEditable(
                    f"so many copies of copies of `{species.name}` need ids that are too large: use `duplicate` fewer times"
                )
        entries = (
            each.model_copy(update={"copies": (*each.copies, max(inputs.next_ids[each.name], 1))}) for each in manifest.species
        )
        return manifest.model_copy(update={"species": tuple(entries)})

    def pass_inputs(self) -> EditInputs:
        """Return the inputs for the next edit. Next ids are greater than those of the copies."""
        next_ids = {name: number * (self.line.count + 1) for name, number in self.inputs.next_ids.items()}
        return replace(self.inputs, next_ids=next_ids)

    def change_frame(self, number: int, arrays: Arrays) -> Arrays:
        """Return a frame with the copies added."""
        by = np.zeros(3) if self.line.by is None else convert_displacement(self.line.by, self.manifest)
        ground = self.inputs.ground.at(number) if self.line.ground == "follow" and self.inputs.ground else None
        joined = arrays
        for k in range(1, self.line.count + 1):
            times = TimeMap(self.manifest.first, self.manifest.last, shift=-float(k * self.line.later))
            agents: Arrays = read_shifted(self.source, times, number, self.selection)
            moves = make_moves(np.arange(len(agents["id"])), np.asarray(agents["P"], np.float64) + k * by)
            if len(joined["id"]) + len(moves.rows) > limits.MAX_AGENTS:
                raise CacheError(f"copies in frame {number} are more than the limit of {limits.MAX_AGENTS:,} agents")
            if by.any():
                agents = (
                    move_agents(agents, self.source.manifest, moves)
                    if ground is None
                    else move_on_ground(agents, self.source.manifest, moves, Grounds(ground, ground))
                )
            joined = join_frames(joined, self._assign_copy_ids(agents, k), self.manifest)
        return joined

    def _assign_copy_ids(self, agents: Arrays, k: int) -> dict[str, NDArray[Any]]:
        """Return the arrays of agents, with the ids of copy number k."""
        offsets = np.array([k * self.inputs.next_ids[entry.name] for entry in self.manifest.species], np.int64)
        number_by_species = {entry.name: number for number, entry in enumerate(self.manifest.species)}
        renamed = dict(agents)
        renamed["id"] = agents["id"] + offsets[get_species_numbers(agents)]
        for name in agents:
            subject, start = find_array_subject(name), name.removesuffix(".id")
            if name.endswith(".id") and subject in ("pair", "event"):
                numbers = agents.get(f"{start}.species", np.int64(number_by_species.get(name.split(".")[1], 0)))
                renamed[name] = agents[name] + offsets[np.asarray(numbers, np.int64)]
        return renamed
