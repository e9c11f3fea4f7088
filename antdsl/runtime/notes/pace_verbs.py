"""Verbs that change how fast agents move. They return, for each agent, the fraction of its speed at which it moves."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from antdsl.runtime.notes.active_notes import NotedAgents
from antdsl.scene.notes.notes_model import RetimeNote

Shares = NDArray[np.float32]


def compute_hold_shares(agents: NotedAgents) -> Shares:
    """Return the speed fractions for a `hold` or `release` note, which stops agents."""
    return _blend_speed_share(agents, 0.0)


def compute_retime_shares(agents: NotedAgents) -> Shares:
    """Return the speed fractions for a `retime` note."""
    assert isinstance(agents.active.note, RetimeNote)
    return _blend_speed_share(agents, agents.active.note.speed)


def _blend_speed_share(agents: NotedAgents, share: float) -> Shares:
    return (1.0 - agents.weight * (1.0 - share)).astype(np.float32)
