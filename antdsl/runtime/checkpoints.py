"""Everything that a world needs to go on as if it had never stopped, as named arrays; and back."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.runtime.motion import Motion
from antdsl.runtime.world import Population, World

Arrays = dict[str, NDArray[Any]]


class CheckpointError(ValueError):
    """Arrays that are not of this plan; the message names the first that does not fit."""


def checkpoint(world: World) -> Arrays:
    """The state between two steps, by name; the arrays are copies."""
    found: Arrays = {"frame": np.array(world.frame, np.int64), "faults": np.array(world.faults.count, np.int64)}
    for name, value in world.params.items():
        found[f"param.{name}"] = np.array(value)
    for name, population in world.populations.items():
        for key, array in _arrays(population).items():
            found[f"species.{name}.{key}"] = array.copy()
        found[f"species.{name}.next_id"] = np.array(population.next_id, np.int64)
    for name, items in world.items.items():
        for attribute, amounts in items.amounts.items():
            found[f"items.{name}.{attribute}"] = amounts.copy()
    for name, field in world.fields.items():
        found[f"field.{name}"] = field.values.copy()
    names = sorted(world.transitions)
    found["transitions.names"] = np.frombuffer("\n".join(names).encode(), np.uint8).copy()
    found["transitions.counts"] = np.array([world.transitions[name] for name in names], np.int64)
    return found | {f"motion.{name}": array for name, array in world.motion.arrays().items()}


def restore(world: World, arrays: Mapping[str, NDArray[Any]]) -> None:
    """Put a world, bound to the same plan and setting, into a state. Raises CheckpointError, and then the world is of no use."""
    world.frame = int(_take(arrays, "frame"))
    world.faults.count = int(_take(arrays, "faults"))
    for name in world.params:
        world.params[name] = np.float32(_take(arrays, f"param.{name}"))
    for name, population in world.populations.items():
        _restore_population(population, arrays, f"species.{name}.")
    for name, items in world.items.items():
        for attribute, amounts in items.amounts.items():
            amounts[:] = _take(arrays, f"items.{name}.{attribute}", amounts.shape)
        items.show()
    for name, field in world.fields.items():
        field.values[:] = _take(arrays, f"field.{name}", field.values.shape)
    text = _take(arrays, "transitions.names").astype(np.uint8).tobytes().decode()
    counts = _take(arrays, "transitions.counts")
    world.transitions = dict(zip(text.split("\n") if text else [], (int(c) for c in counts), strict=True))
    world.motion = Motion.of(
        {name.removeprefix("motion."): array for name, array in arrays.items() if name.startswith("motion.")}
    )
    world.grids.clear()
    world.clearances.clear()


def _arrays(population: Population) -> Arrays:
    found: Arrays = {name: getattr(population, name) for name in ("ids", "born", "quarantined", "position")}
    found |= {f"footing.{name}": getattr(population.footing, name) for name in type(population.footing).__dataclass_fields__}
    found |= {f"event.{name}": flags for name, flags in population.events.items()}
    kept = (name for name, register in population.plan.registers.items() if register.role != "temp")
    return found | {f"register.{name}": population.now[name] for name in kept}


def _restore_population(population: Population, arrays: Mapping[str, NDArray[Any]], prefix: str) -> None:
    count = len(_take(arrays, f"{prefix}ids"))
    now = _arrays(population)
    taken = {}
    for key, like in now.items():
        array = _take(arrays, prefix + key, (count, *like.shape[1:]))
        if array.dtype != like.dtype:
            raise CheckpointError(f"`{prefix}{key}` holds {array.dtype}, not {like.dtype}")
        taken[key] = array.copy()
    population.ids, population.born = taken["ids"], taken["born"]
    population.quarantined, population.position = taken["quarantined"], taken["position"]
    footing = type(population.footing)
    population.footing = footing(*(taken[f"footing.{name}"] for name in footing.__dataclass_fields__))
    for name in population.events:
        population.events[name] = taken[f"event.{name}"]
        population.raised[name] = np.zeros(count, np.bool_)
    for name, register in population.plan.registers.items():
        shared = population.start[name] is population.now[name]
        old = population.now[name]
        population.now[name] = np.full(count, register.zero, old.dtype) if register.role == "temp" else taken[f"register.{name}"]
        population.start[name] = population.now[name] if shared else population.now[name].copy()
    population.cells.clear()
    population.next_id = int(_take(arrays, f"{prefix}next_id"))
    population.version += 1


def _take(arrays: Mapping[str, NDArray[Any]], name: str, shape: tuple[int, ...] | None = None) -> NDArray[Any]:
    if name not in arrays:
        raise CheckpointError(f"`{name}` is missing")
    array = arrays[name]
    if shape is not None and array.shape != shape:
        raise CheckpointError(f"`{name}` has the shape {array.shape}, not {shape}")
    return array
