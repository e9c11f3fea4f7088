"""The notes that are active in a step, their weights and their agents."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from antdsl.numerics.easing import compute_ease_weight
from antdsl.runtime.world import Population, World

if TYPE_CHECKING:
    from antdsl.scene.notes.notes_model import Note

Rows = NDArray[np.intp]


@dataclass(frozen=True, slots=True, eq=False)
class ActiveNote:
    """A note in one step. `key`: identifies it in the memory. `weight`: its share from 0 to 1, below 1 where it begins and ends.
    `rows`: its living agents, by species; species without any are left out."""

    note: Note
    key: str
    weight: float
    rows: dict[str, Rows]


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
    def weight(self) -> float:
        return self.active.weight

    @property
    def ids(self) -> NDArray[np.int64]:
        return self.population.ids[self.rows]

    def read_memory(self, name: str, default: NDArray[Any]) -> NDArray[Any]:
        """Return an array that the note remembers for this species; `default` if there is none."""
        assert self.world.notes is not None
        return self.world.notes.memory.get(f"{self.active.key}.{self.population.name}.{name}", default)

    def store_memory(self, name: str, array: NDArray[Any]) -> None:
        """Remember an array for the next step."""
        assert self.world.notes is not None
        self.world.notes.memory[f"{self.active.key}.{self.population.name}.{name}"] = array


def compute_weight(note: Note, frame: int) -> float:
    """Return the share of a note in a frame: 1 in its frames, rising and falling smoothly in the frames of its ease."""
    return compute_ease_weight(note.first_frame, note.last_frame, note.ease_frames, frame)
