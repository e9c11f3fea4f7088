"""Verbs that change how fast agents move: they return a share of the speed for each agent."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from antdsl.numerics.easing import apply_smoothstep
from antdsl.numerics.randomness import draw_uniform
from antdsl.runtime.notes.active_notes import NoteAgents
from antdsl.scene.notes.notes_model import ReleaseNote, RetimeNote

Shares = NDArray[np.float32]
_RELEASE_SITE = "note.release"


def hold_agents(agents: NoteAgents) -> Shares:
    """Return the share of a `hold`: none."""
    return _mix_shares(agents, 0.0)


def retime_agents(agents: NoteAgents) -> Shares:
    """Return the share of a `retime`."""
    assert isinstance(agents.active.note, RetimeNote)
    return _mix_shares(agents, agents.active.note.speed)


def release_agents(agents: NoteAgents) -> Shares:
    """Return the share of a `release`: none before the frame of each agent, then rising."""
    note, world = agents.active.note, agents.world
    assert isinstance(note, ReleaseNote)
    delays = np.zeros(len(agents.rows))
    if note.spread:
        draws = draw_uniform(world.setting.seed, 0, agents.population.name, _RELEASE_SITE, 0, agents.ids)
        delays = np.floor(draws.astype(np.float64) * (note.spread + 1))
    return apply_smoothstep((world.display_frame - note.frame - delays + 1) / (note.ease_frames + 1)).astype(np.float32)


def _mix_shares(agents: NoteAgents, share: float) -> Shares:
    return np.full(len(agents.rows), 1.0 - agents.weight * (1.0 - share), np.float32)
