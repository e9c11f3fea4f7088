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
    """A note in one step. `key`: the key of the note in the memory. `rows`: by species, the living agents to which the note
    applies, without species that have none. `delays`: by species, the delay of the note in frames for each of these agents."""

    note: Note
    key: str
    rows: dict[str, Rows]
    delays: dict[str, Delays]


@dataclass(frozen=True, slots=True, eq=False)
class NotedAgents:
    """The agents of one species to which an active note applies, passed to the functions of its verb."""

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
        """Return the strength (k,) of the note for each agent, 0 to 1. It is below 1 while the note begins or ends."""
        return compute_note_weight(self.active.note, self.delays, self.world.display_frame)

    @property
    def ids(self) -> NDArray[np.int64]:
        return self.population.ids[self.rows]

    def split_by_species(self) -> list[NotedAgents]:
        """Return the agents of the note, as one NotedAgents per species."""
        return [replace(self, population=self.world.populations[name]) for name in sorted(self.active.rows)]

    def select_agents(self, chosen: NDArray[Any]) -> NotedAgents:
        """Return the agents given by indices or by a mask."""
        name = self.population.name
        rows, delays = {name: self.rows[chosen]}, {name: self.delays[chosen]}
        return replace(self, active=replace(self.active, rows=rows, delays=delays))

    def read_stored_values(self, name: str, default: NDArray[Any]) -> NDArray[Any]:
        """Return the array that the note has stored under this name for the species, or `default`."""
        assert self.world.notes is not None
        return self.world.notes.stored_arrays.get(f"{self.active.key}.{self.population.name}.{name}", default)

    def store_values(self, name: str, array: NDArray[Any]) -> None:
        """Store an array in the note's memory for later steps."""
        assert self.world.notes is not None
        self.world.notes.stored_arrays[f"{self.active.key}.{self.population.name}.{name}"] = array


def compute_note_weight(note: Note, delays: Delays, frame: int) -> NDArray[np.float64]:
    """Return the strength of a note in a frame, 0 to 1, for agents with delays (k,).

    It is 1 in the frames of the note, and changes smoothly in the ease frames before and after them."""
    return compute_ease_weight(
        np.float64(note.first_frame) + delays, find_last_active_frames(note, delays), note.ease_frames, frame
    )


def find_last_active_frames(note: Note, delays: Delays) -> NDArray[np.float64]:
    """Return the last frame in which a note has its full strength, for agents with delays (k,)."""
    ends_later = note.delay_rule is None or note.delay_rule.ends == "later"
    return np.float64(note.last_frame) + delays * np.float64(ends_later)
