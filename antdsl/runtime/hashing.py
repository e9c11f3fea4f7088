"""One number for the state of a frame: equal for any row order, chunk, threads and backend, different for any other state."""

from __future__ import annotations

from collections.abc import Mapping
from hashlib import sha256
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.numerics.row_hash import hashed_rows, row_hash
from antdsl.runtime.world import Population, World

STATE_HASH = 2  # which way states are hashed; numbers of another way say nothing about a state

Columns = Mapping[str, NDArray[Any]]


def state_hash(world: World) -> str:
    """First 128 bits of a SHA-256, in hexadecimal, of the `row_hash` of each species, and of items, fields, solids, flows."""
    digest = sha256()
    digest.update(np.int64(world.frame).tobytes())
    for name in sorted(world.populations):
        population = world.populations[name]
        digest.update(f"\0{name}\0{len(population)}".encode())
        digest.update(hashed_rows(population.ids, _columns(population)))
        digest.update(np.int64(population.next_id).tobytes())
    for name in sorted(world.items):
        for attribute, amounts in sorted(world.items[name].amounts.items()):
            digest.update(f"\0{name}\0{attribute}\0".encode() + amounts.tobytes())
    for name in sorted(world.fields):
        values = world.fields[name].values
        digest.update(f"\0{name}\0{len(values)}".encode() + row_hash(None, [values]))
    for name in sorted(world.solids):
        digest.update(f"\0{name}\0".encode() + world.solids[name].digest())
    for name in sorted(world.flows):
        for key, array in sorted(world.flows[name].state().items()):
            digest.update(f"\0{name}\0{key}\0".encode() + array.tobytes())
    return digest.hexdigest()[:32]


def _columns(population: Population) -> Columns:
    """All that belongs to the state of agents, by name."""
    found: dict[str, NDArray[Any]] = {"born": population.born, "quarantined": population.quarantined}
    found |= {"position": population.position.T, "normal": population.normal.T}
    found |= {f"footing.{name}": array.T for name, array in population.footing.columns.items()}
    registers = population.plan.registers
    found |= {name: population.now[name] for name in sorted(population.now) if registers[name].role != "temp"}
    return found | {f"event.{name}": population.events[name] for name in sorted(population.events)}
