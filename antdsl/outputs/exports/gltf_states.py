"""The states of agents over the frames of a glTF file, written as `extras` of their nodes."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from antdsl.outputs.cache.frame_agents import IDENTITY_ARRAYS, find_species_rows, get_agent_ids
from antdsl.outputs.gallery import Gallery

_STATE_ARRAYS = IDENTITY_ARRAYS | {"state"}


@dataclass(slots=True, eq=False)
class StateChanges:
    """The state changes of agents: by species and agent id, the frames in which states begin, and the names of these states.

    Empty if the cache does not contain states."""

    changes: dict[tuple[str, int], list[dict[str, Any]]] = field(default_factory=dict)

    @staticmethod
    def gather(gallery: Gallery, frames: list[int]) -> StateChanges:
        """Return the state changes of all agents in `frames`."""
        output = StateChanges()
        last: dict[str, dict[int, int]] = {}
        for frame in frames:
            arrays = gallery.cache.frame(frame, _STATE_ARRAYS)
            if "state" not in arrays:
                continue
            for number, species in enumerate(gallery.manifest.species):
                if not species.machines:
                    continue
                rows = find_species_rows(arrays, number)
                current = dict(zip(get_agent_ids(arrays)[rows].tolist(), np.asarray(arrays["state"])[rows].tolist(), strict=True))
                for one, state in current.items() - last.get(species.name, {}).items():
                    entry = {"frame": frame, "state": species.machines[0].states[state].name}
                    output.changes.setdefault((species.name, one), []).append(entry)
                last[species.name] = current
        return output

    def describe_agent(self, species: str, agent_id: int) -> dict[str, Any]:
        """Return `extras` with the states of an agent. Empty if its states are unknown."""
        changes = self.changes.get((species, agent_id))
        return {} if changes is None else {"states": changes}
