"""What agents emitted, kept for whoever writes it down: no state, and nothing in a step reads it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from antdsl.plan import ir
from antdsl.plan.traverse import placed
from antdsl.runtime.world import Emitted, Population, World

_KINDS = (("species", np.int16, ()), ("id", np.int64, ()), ("event", np.int16, ()), ("place", np.float64, (3,)),
          ("normal", np.float32, (3,)))  # fmt: skip


def event_names(world: World) -> tuple[str, ...]:
    """The events that some species may hear or emit, by name; `Emitted.event` counts these."""
    plans = [population.plan for population in world.populations.values()]
    found = {name for plan in plans for name in plan.handles}
    for plan in plans:
        for block in (plan.decide, plan.act, plan.blend, plan.born):
            found.update(each.of for _, each in placed(block) if isinstance(each, ir.Request) and each.op == "emit")
    return tuple(sorted(found))


def note(world: World, population: Population, rows: NDArray[np.intp], event: str) -> None:
    """Keep who emitted an event, where it was."""
    if world.emitted is None:
        return
    names = event_names(world)
    species = sorted(world.populations).index(population.name)
    count = len(rows)
    world.emitted.append(
        Emitted(
            np.full(count, species, np.int16), population.ids[rows], np.full(count, names.index(event), np.int16),
            population.position[rows], population.normal[rows],
        )
    )  # fmt: skip


def emitted_since(world: World) -> Emitted:
    """What was emitted since this was asked last, by species, id and event."""
    found, world.emitted = world.emitted or [], None if world.emitted is None else []
    arrays = {
        name: np.concatenate([np.empty((0, *wide), kind), *(getattr(each, name) for each in found)])
        for name, kind, wide in _KINDS
    }
    order = np.lexsort((arrays["event"], arrays["id"], arrays["species"]))
    return Emitted(*(array[order] for array in arrays.values()))
