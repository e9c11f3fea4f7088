"""What agents play, in the frames of a cache: `clips.SPECIES.MACHINE.FIELD`, one row an agent of the species, by id.

`clip` and `before` int16 count the clips of the species in the manifest, -1 for none; `turns`, `before_turns`, `weight`,
`before_weight` and `fade` float32."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.bodies.agents.machine_clips import FIELDS, MachineClips
from antdsl.outputs.cache.manifest import SpeciesEntry
from antdsl.runtime.world import Population

Arrays = Mapping[str, NDArray[Any]]
# By field, the register behind `MACHINE.` and its type in a frame.
_REGISTERS = {
    "clip": ("clip", np.int16), "turns": ("clip_turns", np.float32), "weight": ("clip_weight", np.float32),
    "before": ("clip_before", np.int16), "before_turns": ("clip_before_turns", np.float32),
    "before_weight": ("clip_before_weight", np.float32), "fade": ("clip_fade", np.float32),
}  # fmt: skip


def playing(population: Population) -> Iterator[str]:
    """The machines that play clips, in text order."""
    return (machine.name for machine in population.plan.machines if f"{machine.name}.clip" in population.plan.registers)


def clips_playing(population: Population, rows: NDArray[np.intp]) -> dict[str, NDArray[Any]]:
    """The arrays of a species: of its agents at some rows."""
    return {
        f"clips.{population.name}.{machine}.{field}": population.now[f"{machine}.{register}"][rows].astype(kind)
        for machine in playing(population)
        for field, (register, kind) in _REGISTERS.items()
    }


def machines_of(species: SpeciesEntry, arrays: Arrays, count: int) -> tuple[MachineClips, ...] | None:
    """What the machines of a species play in a frame with `count` agents of it; None where the frame does not say."""
    found = []
    for machine in species.playing:
        values = [arrays.get(f"clips.{species.name}.{machine}.{field}") for field in FIELDS]
        if any(each is None or each.shape != (count,) for each in values):
            return None
        numbers = (np.nan_to_num(np.asarray(v, _REGISTERS[field][1])) for v, field in zip(values, FIELDS, strict=True))
        found.append(MachineClips(*numbers))
    return tuple(found)
