"""Removes the agents that the notes `without` and `thin` exclude. They are removed at birth, before they act.

Their ids and start positions stay reserved, so all other agents are the same as without the note."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from antdsl.numerics.randomness import draw_uniform
from antdsl.runtime.sensing.selectable_agents import collect_selectable_frame
from antdsl.runtime.world import World, retain_rows
from antdsl.scene.notes.notes_model import Note, ThinNote, WithoutNote
from antdsl.scene.notes.selection import select_rows as select_agents

_THINNING_RANDOM_SITE = "note.thin"


def remove_agents_of_absence_notes(world: World, notes: Iterable[Note], first_rows: dict[str, int], is_start: bool) -> None:
    """Remove newborn agents that notes exclude. `first_rows`: by species, the row of the first newborn agent.

    `is_start`: whether these are agents that the scene places; only such agents are thinned out."""
    absences = [note for note in notes if isinstance(note, WithoutNote) or (is_start and isinstance(note, ThinNote))]
    if not absences:
        return
    frame = collect_selectable_frame(world)
    is_absent = {name: np.zeros(len(population), np.bool_) for name, population in world.populations.items()}
    for note in absences:
        for name, mask in select_agents(note.selector, frame).items():
            is_absent[name] |= _draw_agents_to_remove(world, name, mask, note.to) if isinstance(note, ThinNote) else mask
    for name, first in first_rows.items():
        is_absent[name][:first] = False
        if is_absent[name].any():
            retain_rows(world.populations[name], np.flatnonzero(~is_absent[name]))


def _draw_agents_to_remove(world: World, species: str, mask: NDArray[np.bool_], share: float) -> NDArray[np.bool_]:
    """Return a mask of the agents in `mask` to remove. The fraction `share` of them, with the least random draws, remains."""
    rows = np.flatnonzero(mask)
    ids = world.populations[species].ids[rows]
    draws = draw_uniform(world.setting.seed, 0, species, _THINNING_RANDOM_SITE, 0, ids)
    absent = np.zeros(len(mask), np.bool_)
    absent[rows[np.lexsort((ids, draws))[round(share * len(rows)) :]]] = True
    return absent
