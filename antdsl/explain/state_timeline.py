"""The states of an agent over time, read from the frames of a cache."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from antdsl.explain.model import StateInterval
from antdsl.outputs.cache.cache_reader import Cache

_FRAME_ARRAYS = frozenset(("id", "state", "species"))


def read_state_timeline(cache: Cache, species: str, agent: int) -> tuple[tuple[StateInterval, ...], tuple[int, int] | None]:
    """Return the intervals of frames in which the first machine of an agent was in one state. Also return the first and the last
    frame of the agent's life.

    The second result is None if the agent is in no frame. If the cache stores no states, each interval has the state "". Raises
    CacheError if a frame is damaged."""
    names = [entry.name for entry in cache.manifest.species]
    number = names.index(species)
    machine = next(iter(cache.manifest.species[number].machines), None)
    states = [state.name for state in machine.states] if machine is not None else []
    numbers_by_frame = ((frame, _find_state(cache, frame, number, agent)) for frame in cache.frames())
    frame_states = ((frame, _find_state_name(states, state)) for frame, state in numbers_by_frame if state is not None)
    parts = merge_state_frames("" if machine is None else machine.name, frame_states)
    return parts, (parts[0].first, parts[-1].last) if parts else None


def merge_state_frames(machine: str, frame_states: Iterable[tuple[int, str]]) -> tuple[StateInterval, ...]:
    """Return one interval for each run of consecutive frames with the same state. `frame_states`: pairs (frame, state), with
    frames ascending."""
    parts: list[StateInterval] = []
    for frame, state in frame_states:
        if parts and parts[-1].state == state and parts[-1].last == frame - 1:
            parts[-1] = StateInterval(machine, state, parts[-1].first, frame)
        else:
            parts.append(StateInterval(machine, state, frame, frame))
    return tuple(parts)


def _find_state_name(states: Sequence[str], state: int) -> str:
    return states[state] if 0 <= state < len(states) else ""


def _find_state(cache: Cache, frame: int, species: int, agent: int) -> int | None:
    """Return the number of the agent's state in a frame; -1 if states are not stored, or None if the agent is not alive."""
    arrays = cache.frame(frame, _FRAME_ARRAYS)
    if "id" not in arrays:
        return None
    is_agent = arrays["id"] == agent
    if "species" in arrays:
        is_agent &= arrays["species"] == species
    rows = is_agent.nonzero()[0]
    if not len(rows):
        return None
    return int(arrays["state"][rows[0]]) if "state" in arrays else -1
