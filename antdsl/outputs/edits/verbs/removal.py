"""Edits that remove agents from frames: `kill` and `clip`."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from pydantic import Field, model_validator

from antdsl.outputs.cache.cache_reader import Arrays
from antdsl.outputs.cache.frame_agents import make_agent_keys
from antdsl.outputs.edits.cache_selection import select_agents
from antdsl.outputs.edits.edit_layer import AgentsLine, EditLayer
from antdsl.outputs.edits.frame_rows import keep_rows
from antdsl.scene.notes.selectors import AgentConditions, Ball, Region, Selector
from antdsl.scene.values import make_value_error


class KillLine(AgentsLine):
    """Removes agents from the frames."""

    verb = "kill"
    agents: Selector = Field(alias="kill")


class ClipLine(AgentsLine):
    """Removes agents outside `frames`, and agents outside the region `inside`."""

    verb = "clip"
    agents: Selector = Field(alias="clip")
    inside: Region | None = None

    @model_validator(mode="after")
    def _check_one(self) -> ClipLine:
        if self.frames is None and self.inside is None:
            raise make_value_error("`clip` needs `frames` or `inside`", "write `inside: {from: [0, 0, 0], to: [50, 20, 50]}`")
        return self

    def list_items(self) -> tuple[tuple[tuple[str, ...], str], ...]:
        """Return the names of items in the line outside selectors, as (keys that lead to the name, name)."""
        name = self.inside.around if isinstance(self.inside, Ball) else None
        return ((("inside", "around"), name),) if isinstance(name, str) else ()


@dataclass(frozen=True, eq=False)
class KillLayer(EditLayer):
    """A view of a cache without some agents."""

    line: KillLine
    required_arrays = ("id",)

    def change_frame(self, number: int, arrays: Arrays) -> Arrays:
        """Return a frame without the selected agents."""
        return keep_rows(arrays, self.manifest, lambda keys: ~self.selection.find(keys))


@dataclass(frozen=True, eq=False)
class ClipLayer(EditLayer):
    """A view of a cache in which some agents exist only in some frames and regions."""

    line: ClipLine

    def is_active(self, number: int) -> bool:
        """Return whether the edit changes frame `number`."""
        return self.line.inside is not None or not super().is_active(number)

    def change_frame(self, number: int, arrays: Arrays) -> Arrays:
        """Return a frame without the selected agents that are outside the line's frames or region."""
        keys, frames = make_agent_keys(arrays), self.line.frames
        removed = self.selection.find(keys)
        if self.line.inside is not None and (frames is None or frames.first <= number <= frames.last):
            region = AgentConditions.model_construct(region=self.line.inside)
            removed = removed & ~select_agents(region, arrays, self.manifest)
        return keep_rows(arrays, self.manifest, lambda agent_keys: ~np.isin(agent_keys, keys[removed]))
