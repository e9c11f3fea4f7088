"""How many bytes an agent of a species takes."""

from __future__ import annotations

from antdsl.plan.ir import Kind, SpeciesPlan

_BYTES = {Kind.F32: 4, Kind.BOOL: 1, Kind.I32: 4, Kind.I64: 8}
_OWN = 8  # its id


def memory(species: SpeciesPlan) -> dict[str, int]:
    """Bytes an agent by what they are for: `attribute` (the author's and those that every animal has), `memory` (states, `keep`,
    latches, waiting times), `pair` (values per pair), all kept from step to step, and `temp`, in use during a step only."""
    found = {"attribute": _OWN, "pair": 0, "memory": 0, "temp": 0}
    for register in species.registers.values():
        found[register.role] += _BYTES[register.kind]
    return found
