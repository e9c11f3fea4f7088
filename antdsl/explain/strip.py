"""An agent's states over time, from the frames that a cache has."""

from __future__ import annotations

from antdsl.explain.model import Stretch
from antdsl.outputs.cache import Cache

_NAMES = frozenset(("id", "state", "species"))


def strip(cache: Cache, species: str, agent: int) -> tuple[tuple[Stretch, ...], tuple[int, int] | None]:
    """Its states, one stretch after the other, and the first and last frame in which it lives; None where no frame has it.

    Where the cache keeps no states each stretch has an empty state. CacheError when a frame is damaged."""
    names = [entry.name for entry in cache.manifest.species]
    number = names.index(species)
    machines = cache.manifest.species[number].machines
    states = [state.name for state in machines[0].states] if machines else []
    found: list[Stretch] = []
    for frame in cache.frames():
        state = _state(cache, frame, number, agent)
        if state is None:
            continue
        name = states[state] if 0 <= state < len(states) else ""
        if found and found[-1].state == name and found[-1].last == frame - 1:
            found[-1] = Stretch(name, found[-1].first, frame)
        else:
            found.append(Stretch(name, frame, frame))
    return tuple(found), (found[0].first, found[-1].last) if found else None


def _state(cache: Cache, frame: int, species: int, agent: int) -> int | None:
    """The index of the agent's state in a frame, -1 where states are not kept; None where it does not live."""
    arrays = cache.frame(frame, _NAMES)
    if "id" not in arrays:
        return None
    mine = arrays["id"] == agent
    if "species" in arrays:
        mine &= arrays["species"] == species
    rows = mine.nonzero()[0]
    if not len(rows):
        return None
    return int(arrays["state"][rows[0]]) if "state" in arrays else -1
