"""Creates agents of crowd lines during the run. In each frame, the agents that are due get their positions and ids.

How many agents a line has created depends only on the frame, and their ids are reserved in `World.crowd_lines`. So no id is used
twice, and a run that continues from a checkpoint creates the same agents."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from antdsl import limits
from antdsl.runtime.binding.agent_placement import initialise_agents, place_new_agents
from antdsl.runtime.line_tables import find_created_ids

if TYPE_CHECKING:
    from antdsl.runtime.world import World
    from antdsl.scene.crowds.crowd_data import CrowdData


def release_agents(world: World) -> None:
    """Add the agents that crowd lines release in the frame of the current step."""
    frame = world.display_frame
    joining: list[tuple[CrowdData, NDArray[np.int64]]] = []
    capacity = limits.MAX_AGENTS - len(world)
    for crowd, line in zip(world.setting.crowds, world.crowd_lines, strict=True):
        if crowd.release is None:
            continue
        ids = find_created_ids(crowd, line, frame - 1, frame)
        if len(ids) > capacity:
            world.faults.rejected_births += len(ids) - capacity
            ids = ids[:capacity]
        capacity -= len(ids)
        if len(ids):
            joining.append((crowd, ids))
    if joining:
        with np.errstate(all="ignore"):
            initialise_agents(world, place_new_agents(world, joining))
