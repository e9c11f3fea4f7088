"""Verbs that change how fast agents move. They return, for each agent, the fraction of its speed at which it moves."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from antdsl.runtime.notes.active_notes import NoteAgents
from antdsl.scene.notes.notes_model import RetimeNote

Shares = NDArray[np.float32]


def hold_agents(agents: NoteAgents) -> Shares:
    """Return the speed fractions for a `hold` or `release` note, which stops agents."""
    return _mix_shares(agents, 0.0)


def retime_agents(agents: NoteAgents) -> Shares:
    """Return the speed fractions for a `retime` note."""
    assert isinstance(agents.active.note, RetimeNote)
    return _mix_shares(agents, agents.active.note.speed)


def _mix_shares(agents: NoteAgents, share: float) -> Shares:
    return (1.0 - agents.weight * (1.0 - share)).astype(np.float32)
