"""The tables of crowd lines: which ids the agents of each line have, as arrays of checkpoints and after changes of the crowd.

Tables follow their lines to another scene of the same programs, and to an edited scene."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.runtime.world import World
from antdsl.scene.line_ids import LineIds
from antdsl.scene.setting import WorldSetting

_NAMES, _RANGES = "lines.names", "lines.ranges"
LineName = tuple[str, str]  # species, and the name of the line or an empty text


def list_line_names(setting: WorldSetting) -> list[LineName]:
    """Return species and name of each crowd line."""
    return [(crowd.species, crowd.name) for crowd in setting.crowds]


def reserve_ids(setting: WorldSetting) -> tuple[LineIds, ...]:
    """Return the ids of each crowd line of a scene: those of the lines above of its species come first."""
    next_ids: dict[str, int] = {}
    lines = []
    for crowd in setting.crowds:
        lines.append(LineIds(crowd.species).resize(crowd.count, next_ids.get(crowd.species, 0)))
        next_ids[crowd.species] = next_ids.get(crowd.species, 0) + crowd.count
    return tuple(lines)


def match_lines(old: Sequence[LineName], new: Sequence[LineName]) -> list[int]:
    """Return for each new line the index of the old line that corresponds to it; -1 for none.

    Lines with one name correspond. The other lines of a species correspond in their order."""
    matches = [old.index(line) if line[1] and line in old else -1 for line in new]
    left = [k for k in range(len(old)) if k not in matches]
    for number, line in enumerate(new):
        if matches[number] < 0 and (same := [k for k in left if old[k][0] == line[0]]):
            matches[number] = same[0]
            left.remove(same[0])
    return matches


def collect_line_arrays(world: World) -> dict[str, NDArray[Any]]:
    """Return the tables as arrays: species and names as text, and rows of (index of the line, first id, number of ids)."""
    text = "\n".join(" ".join(line) for line in list_line_names(world.setting))
    rows = [(number, *each) for number, line in enumerate(world.lines) for each in line.ranges]
    return {_NAMES: np.frombuffer(text.encode(), np.uint8), _RANGES: np.array(rows, np.int64).reshape(-1, 3)}


def restore_lines(world: World, arrays: Mapping[str, NDArray[Any]]) -> None:
    """Restore the tables of a checkpoint. Older checkpoints have none, and the world's own tables stay.

    Raises ValueError for arrays that do not match."""
    if _NAMES not in arrays:
        return
    text = arrays[_NAMES].astype(np.uint8).tobytes().decode()
    old: list[LineName] = [(species, name) for species, _, name in (each.partition(" ") for each in text.split("\n") if each)]
    ranges: list[list[tuple[int, int]]] = [[] for _ in old]
    for number, first, count in arrays[_RANGES].reshape(-1, 3).tolist():
        if not (0 <= number < len(old) and first >= 0 and count > 0):
            raise ValueError(f"`{_RANGES}` has an invalid row")
        ranges[number].append((first, count))
    world.lines = tuple(
        line if number < 0 else LineIds(line.species, tuple(ranges[number]))
        for number, line in zip(match_lines(old, list_line_names(world.setting)), world.lines, strict=True)
    )
