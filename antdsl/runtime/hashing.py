"""One number for the state of a frame: equal for any row order, chunk, threads and backend, different for any other state."""

from __future__ import annotations

from hashlib import sha256

import numpy as np

from antdsl.runtime.world import World


def state_hash(world: World) -> str:
    """First 128 bits of a SHA-256, in hexadecimal: species by name with rows in id order, then items, fields, solids,
    flows.

    SHA-256 because processors have instructions for it: half the time of BLAKE2b for the megabytes of a large crowd."""
    digest = sha256()
    digest.update(np.int64(world.frame).tobytes())
    for name in sorted(world.populations):
        population = world.populations[name]
        rows = population.in_id_order()
        digest.update(f"\0{name}\0{len(rows)}".encode())
        for array in (population.ids, population.born, population.quarantined, population.position, population.normal):
            digest.update(array.take(rows, axis=0).data)
        for array in population.footing.columns.values():
            digest.update(array.take(rows, axis=0).data)
        for register in sorted(population.now):
            if population.plan.registers[register].role != "temp":
                digest.update(register.encode() + b"\0")
                digest.update(population.now[register].take(rows).data)
        for event in sorted(population.events):
            digest.update(population.events[event].take(rows).data)
        digest.update(np.int64(population.next_id).tobytes())
    for name in sorted(world.items):
        for attribute, amounts in sorted(world.items[name].amounts.items()):
            digest.update(f"\0{name}\0{attribute}\0".encode() + amounts.tobytes())
    for name in sorted(world.fields):
        digest.update(f"\0{name}\0".encode() + world.fields[name].state_bytes())
    for name in sorted(world.solids):
        digest.update(f"\0{name}\0".encode() + world.solids[name].digest())
    for name in sorted(world.flows):
        for key, array in sorted(world.flows[name].state().items()):
            digest.update(f"\0{name}\0{key}\0".encode() + array.tobytes())
    return digest.hexdigest()[:32]
