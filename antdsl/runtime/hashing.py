"""One number for the state of a frame: equal for any row order, chunk, threads and backend, different for any other state."""

from __future__ import annotations

from hashlib import sha256

import numpy as np

from antdsl.numerics.row_hash import named
from antdsl.runtime.world import Population, World

STATE_HASH = 2  # which way states are hashed; numbers of another way say nothing about a state
_ALWAYS = ("born", "quarantined", "position", "normal")


def state_hash(world: World) -> str:
    """First 128 bits of a SHA-256, in hexadecimal, of the `row_hash` of each species, and of items, fields, solids, flows."""
    digest, threads = sha256(), world.options.threads
    digest.update(np.int64(world.frame).tobytes())
    for name in sorted(world.populations):
        population = world.populations[name]
        digest.update(f"\0{name}\0{len(population)}".encode())
        digest.update(_rows(population, threads))
        digest.update(np.int64(population.next_id).tobytes())
    for name in sorted(world.items):
        for attribute, amounts in sorted(world.items[name].amounts.items()):
            digest.update(f"\0{name}\0{attribute}\0".encode() + amounts.tobytes())
    for name in sorted(world.fields):
        values = world.fields[name].values
        digest.update(f"\0{name}\0{len(values)}".encode() + world.fields[name].hashed.of(None, [values], threads))
    for name in sorted(world.solids):
        digest.update(f"\0{name}\0".encode() + world.solids[name].digest())
    for name in sorted(world.flows):
        for key, array in sorted(world.flows[name].state().items()):
            digest.update(f"\0{name}\0{key}\0".encode() + array.tobytes())
    return digest.hexdigest()[:32]


def _rows(population: Population, threads: int) -> bytes:
    """The hash of all that belongs to the state of agents."""
    names, footing, now = population.state_registers(), population.footing.columns, population.now
    events = sorted(population.events)
    told = (*_ALWAYS, *map("footing.{}".format, footing), *names, *map("event.{}".format, events))
    columns = [population.born, population.quarantined, population.position, population.normal, *footing.values()]
    columns += [now[name] for name in names]
    columns += [population.events[name] for name in events]
    return named(told, columns) + population.hashed.of(population.ids, columns, threads)
