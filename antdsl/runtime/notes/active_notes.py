"""The notes that are active in a step, their weights and their agents."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from antdsl.numerics.easing import compute_ease_weight
from antdsl.runtime.world import Population, World

if TYPE_CHECKING:
    from antdsl.scene.notes.notes_model import Note

Rows = NDArray[np.intp]
Delays = NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class ActiveNote:
    """A note in one step. `key`: identifies it in the memory. `rows`: the living agents for which it holds, by species;
    species without such agents are omitted. `delays`: by species, by how many frames the note is delayed for each agent."""

    note: Note
    key: str
    rows: dict[str, Rows]
    delays: dict[str, Delays]


@dataclass(frozen=True, slots=True, eq=False)
class NoteAgents:
    """The agents of one species in an active note, for the function of its verb."""

    world: World
    active: ActiveNote
    population: Population

    @property
    def rows(self) -> Rows:
        return self.active.rows[self.population.name]

    @property
    def delays(self) -> Delays:
        return self.active.delays[self.population.name]

    @property
    def weight(self) -> NDArray[np.float64]:
        """Return the strength (k,) of the note from 0 to 1. It is below 1 in the frames in which the note begins and ends."""
        return compute_weight(self.active.note, self.delays, self.world.display_frame)

    @property
    def ids(self) -> NDArray[np.int64]:
        return self.population.ids[self.rows]

    def list_species(self) -> list[NoteAgents]:
        """Return the agents of the note, separated by species."""
        return [replace(self, population=self.world.populations[name]) for name in sorted(self.active.rows)]

    def select(self, chosen: NDArray[Any]) -> NoteAgents:
        """Return a subset of these agents, given by indices or a mask."""
        name = self.population.name
        rows, delays = {name: self.rows[chosen]}, {name: self.delays[chosen]}
        return replace(self, active=replace(self.active, rows=rows, delays=delays))

    def read_memory(self, name: str, default: NDArray[Any]) -> NDArray[Any]:
        """Return an array that the note remembers for this species; `default` if there is none."""
        assert self.world.notes is not None
        return self.world.notes.memory.get(f"{self.active.key}.{self.population.name}.{name}", default)

    def store_memory(self, name: str, array: NDArray[Any]) -> None:
        """Store an array in the note's memory, for the next step."""
        assert self.world.notes is not None
        self.world.notes.memory[f"{self.active.key}.{self.population.name}.{name}"] = array


def compute_weight(note: Note, delays: Delays, frame: int) -> NDArray[np.float64]:
    """Return the strength of a note in a frame, for agents with delays (k,). It is 1 in the note's frames, and changes
    smoothly in the ease frames before and after."""
    return compute_ease_weight(np.float64(note.first_frame) + delays, find_last_frames(note, delays), note.ease_frames, frame)


def find_last_frames(note: Note, delays: Delays) -> NDArray[np.float64]:
    """Return the last frame in which a note holds completely, for agents with delays (k,)."""
    ends_later = note.delay_rule is None or note.delay_rule.ends == "later"
    return np.float64(note.last_frame) + delays * np.float64(ends_later)
