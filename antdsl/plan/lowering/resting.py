"""Who stands still: animals in states that steer nothing, where others of their species steer."""

from __future__ import annotations

from collections.abc import Sequence

from antdsl.plan.ir import Kind
from antdsl.plan.lowering.actions import STEER
from antdsl.plan.lowering.expressions import vector
from antdsl.plan.lowering.machines import MachineWriter
from antdsl.plan.lowering.writer import AXES, Writer


def stand_still(w: Writer, machines: Sequence[MachineWriter]) -> None:
    """Once all machines have acted: the push of those of whom no state has steered."""
    rest = w.species.rest
    if rest is None:
        return
    w.b.span = rest.span
    silent = w.b.true
    for machine in machines:
        if machine.name in rest.silent:
            silent = w.b("and", silent, machine.among(rest.silent[machine.name]))
    for axis in AXES:
        w.declare(f"{STEER}.{axis}", Kind.F32, "temp")
    with w.region(silent, rest.span):
        push = vector(w, rest.push)
        w.rested(rest, push)
        w.store_vector(STEER, push, rest.span)
