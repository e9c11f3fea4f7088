"""What agents play, in the frames of a cache: `clips.SPECIES.MACHINE.FIELD`, one row an agent of the species, by id.

`clip`, `before` and `earlier` int16 count the clips of the species in the manifest, -1 for none; `turns`, `weight`, `fade` and
the like float32. What concerns `earlier` is in a frame only where anybody has such a clip."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.bodies.agents.machine_clips import EARLIER, FIELDS, MachineClips
from antdsl.numerics import parallel
from antdsl.outputs.cache import frame_loops
from antdsl.outputs.cache.manifest import SpeciesEntry
from antdsl.runtime.world import Population

Arrays = Mapping[str, NDArray[Any]]
# By field, the register behind `MACHINE.` and its type in a frame.
_REGISTERS = {
    "clip": ("clip", np.int16), "turns": ("clip_turns", np.float32), "weight": ("clip_weight", np.float32),
    "before": ("clip_before", np.int16), "before_turns": ("clip_before_turns", np.float32),
    "before_weight": ("clip_before_weight", np.float32), "fade": ("clip_fade", np.float32),
    "earlier": ("clip_earlier", np.int16), "earlier_turns": ("clip_earlier_turns", np.float32),
    "earlier_weight": ("clip_earlier_weight", np.float32), "earlier_fade": ("clip_earlier_fade", np.float32),
}  # fmt: skip
_USUAL = tuple(field for field in FIELDS if field not in EARLIER)
_CLIPS, _SHARES = ("clip", "before"), ("turns", "weight", "before_turns", "before_weight", "fade")


def playing(population: Population) -> Iterator[str]:
    """The machines that play clips, in text order."""
    return (machine.name for machine in population.plan.machines if f"{machine.name}.clip" in population.plan.registers)


def clips_playing(population: Population, rows: NDArray[np.intp] | None = None, threads: int = 1) -> dict[str, NDArray[Any]]:
    """The arrays of a species: of its agents at some rows, of all by id where none are given."""
    found: dict[str, NDArray[Any]] = {}
    for machine in playing(population):
        now = {field: population.now[f"{machine}.{register}"] for field, (register, _) in _REGISTERS.items()}
        early = now["earlier_fade"] > 0
        fields = FIELDS if early.any() and (early & (now["fade"] > 0)).any() else _USUAL
        named = f"clips.{population.name}.{machine}."
        found |= {named + field: array for field, array in _told(population, rows, now, fields, threads).items()}
    return found


def _told(
    population: Population, rows: NDArray[np.intp] | None, now: Arrays, fields: Sequence[str], threads: int
) -> dict[str, NDArray[Any]]:
    """The first of the fields, the usual ones or more."""
    found: dict[str, NDArray[Any]] = {}
    if rows is None:
        found = {field: np.empty(len(population), _REGISTERS[field][1]) for field in _USUAL}
        of = [tuple([arrays[field] for field in some]) for arrays in (now, found) for some in (_CLIPS, _SHARES)]
        work = partial(frame_loops.playing, of[0], of[1], population.ranks(), of[2], of[3])
        parallel.in_parts(work, len(population), threads)
    rows = population.in_id_order() if rows is None else rows
    for field in fields[len(found) :]:
        found[field] = now[field].take(rows).astype(_REGISTERS[field][1], copy=False)
    return found


def machine_clips(species: str, machine: str, arrays: Arrays, count: int) -> MachineClips | None:
    """What a machine of `count` agents plays; None where the arrays do not say."""
    parts: list[NDArray[Any] | None] = []
    for field in FIELDS:
        found = arrays.get(f"clips.{species}.{machine}.{field}")
        if found is not None and found.shape == (count,):
            parts.append(np.nan_to_num(np.asarray(found, _REGISTERS[field][1])))
        elif field in EARLIER:
            parts.append(None)
        else:
            return None
    return MachineClips(*parts)  # type: ignore[arg-type]


def machines_of(species: SpeciesEntry, arrays: Arrays, count: int) -> tuple[MachineClips, ...] | None:
    """What the machines of a species play in a frame with `count` agents of it; None where the frame does not say."""
    found = [machine_clips(species.name, machine, arrays, count) for machine in species.playing]
    return None if any(each is None for each in found) else tuple(each for each in found if each is not None)
