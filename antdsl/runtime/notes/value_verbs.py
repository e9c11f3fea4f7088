"""The verb `set`, which replaces values of attributes."""

from __future__ import annotations

import numpy as np

from antdsl.plan.ir import ValueKind
from antdsl.runtime.notes.active_notes import NotedAgents, compute_note_weight
from antdsl.runtime.notes.regions import select_agents_inside
from antdsl.scene.notes.notes_model import SetNote


def apply_attribute_notes(agents: NotedAgents) -> None:
    """Set attributes to the values that a `set` note lists, after the layers of the program have run."""
    agents = select_agents_inside(agents)
    note, p, rows, setting = agents.active.note, agents.population, agents.rows, agents.world.setting
    assert isinstance(note, SetNote)
    weight, previous = agents.weight, compute_note_weight(note, agents.delays, agents.world.display_frame - 1)
    growth = np.maximum(weight - previous, 0.0) / np.maximum(1.0 - previous, 1e-9)  # of what is left to the value
    for name, value in note.to.items():
        if name not in p.now:
            continue  # another species of the selection has it
        register = p.now[name]
        if p.plan.registers[name].kind is ValueKind.BOOL:
            register[rows[weight == 1.0]] = bool(value)
            continue
        goal = np.float32(value if isinstance(value, bool) else value.to_base_units(setting.unit_mm, setting.dt))
        own = register[rows]
        # the program may set the value in each step, or it may have stayed as the last step left it
        share = np.where((own != p.start[name][rows]) | (weight == 1.0), weight, growth).astype(np.float32)
        register[rows] = np.where(weight < 1.0, own + (goal - own) * share, goal)
