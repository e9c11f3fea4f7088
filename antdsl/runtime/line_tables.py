"""Tables of the ids that belong to each crowd line. Checkpoints contain these tables as arrays. If a scene is edited, or
continues another scene, each of its lines takes over the table of the corresponding old line."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.runtime.world import World
from antdsl.scene.crowds.line_ids import CrowdLineIds
from antdsl.scene.setting import CrowdData, WorldSetting

_NAMES, _RANGES, _CREATED = "lines.names", "lines.ranges", "lines.created"
CrowdLineName = tuple[str, str]  # species, and the name of the line or an empty text


def list_line_names(setting: WorldSetting) -> list[CrowdLineName]:
    """Return (species, line name) for each crowd line."""
    return [(crowd.species, crowd.name) for crowd in setting.crowds]


def reserve_line_ids(setting: WorldSetting) -> tuple[CrowdLineIds, ...]:
    """Return the reserved ids of each crowd line. The lines of a species get consecutive ranges of ids."""
    next_ids: dict[str, int] = {}
    lines = []
    for crowd in setting.crowds:
        lines.append(CrowdLineIds(crowd.species).resize(crowd.count, next_ids.get(crowd.species, 0)))
        next_ids[crowd.species] = next_ids.get(crowd.species, 0) + crowd.count
    return tuple(lines)


def count_released_agents(crowd: CrowdData, line: CrowdLineIds, frame: int) -> int:
    """Return how many ids of a line's table belong to agents that were created up to and including a frame. Ids at the end of
    the table are for agents still to be created. Ids at its beginning may come from another scene that this scene continues."""
    return len(line) - crowd.count + crowd.count_created(frame)


def find_created_ids(crowd: CrowdData, line: CrowdLineIds, previous_frame: int | None, frame: int) -> NDArray[np.int64]:
    """Return the ids of a line's agents that are created after `previous_frame`, up to and including `frame`.

    If `previous_frame` is None, return the ids of all agents that are created up to `frame`."""
    first = 0 if previous_frame is None else count_released_agents(crowd, line, previous_frame)
    return line.list_ids_between(first, count_released_agents(crowd, line, frame) - 1)


def match_crowd_lines(old: Sequence[CrowdLineName], new: Sequence[CrowdLineName]) -> list[int]:
    """Return, for each new line, the index of the corresponding old line; -1 for none.

    Lines with the same species and name correspond. The remaining lines of a species correspond in order."""
    matches = [old.index(line) if line[1] and line in old else -1 for line in new]
    left = [k for k in range(len(old)) if k not in matches]
    for number, line in enumerate(new):
        if matches[number] < 0 and (same := [k for k in left if old[k][0] == line[0]]):
            matches[number] = same[0]
            left.remove(same[0])
    return matches


def collect_line_arrays(world: World) -> dict[str, NDArray[Any]]:
    """Return the tables as named arrays: the lines' species and names, their id ranges, and the number of agents created so
    far. A range is a row (index of the line, first id, number of ids)."""
    crowds = world.setting.crowds
    text = "\n".join(" ".join(line) for line in list_line_names(world.setting))
    rows = [(number, *each) for number, line in enumerate(world.crowd_lines) for each in line.ranges]
    created = [count_released_agents(*each, world.frame) for each in zip(crowds, world.crowd_lines, strict=True)]
    return {
        _NAMES: np.frombuffer(text.encode(), np.uint8),
        _RANGES: np.array(rows, np.int64).reshape(-1, 3),
        _CREATED: np.array(created, np.int64),
    }


def restore_line_tables(world: World, arrays: Mapping[str, NDArray[Any]], *, is_run_start: bool = False) -> None:
    """Restore the tables of a checkpoint. For an older checkpoint without tables, the tables of the world do not change.

    With `is_run_start`, the checkpoint is the start of another scene, and its lines are continued: agents to be created get new
    ids. Raises ValueError if the arrays do not match."""
    if _NAMES not in arrays:
        return
    text = arrays[_NAMES].astype(np.uint8).tobytes().decode()
    old: list[CrowdLineName] = [
        (species, name) for species, _, name in (each.partition(" ") for each in text.split("\n") if each)
    ]
    created = arrays[_CREATED].astype(np.int64).reshape(len(old)).tolist()
    ranges: list[list[tuple[int, int]]] = [[] for _ in old]
    for number, first, count in arrays[_RANGES].reshape(-1, 3).tolist():
        if not (0 <= number < len(old) and first >= 0 and count > 0):
            raise ValueError(f"`{_RANGES}` has an invalid row")
        ranges[number].append((first, count))
    lines = []
    matches = match_crowd_lines(old, list_line_names(world.setting))
    for crowd, number, line in zip(world.setting.crowds, matches, world.crowd_lines, strict=True):
        stored = CrowdLineIds(crowd.species, tuple(ranges[number])) if number >= 0 else CrowdLineIds(crowd.species)
        if is_run_start:
            population = world.populations[crowd.species]
            stored = stored.resize(min(created[number], len(stored)) if number >= 0 else 0, 0)
            due = crowd.count - crowd.count_created(world.frame)
            lines.append(stored.resize(len(stored) + due, population.next_id))
            population.next_id += due
        else:
            lines.append(stored if number >= 0 else line)
    world.crowd_lines = tuple(lines)
