"""Plan to plan: the same effects with less work. The order of PASSES is the order in which they run."""

from __future__ import annotations

from collections.abc import Callable

from antdsl.passes.drop_unused import drop_unused
from antdsl.passes.fold import fold
from antdsl.passes.hoist import hoist
from antdsl.passes.keep import keep
from antdsl.passes.merge import merge
from antdsl.passes.narrow import narrow
from antdsl.plan.ir import Plan
from antdsl.plan.verify import verify

PASSES: tuple[Callable[[Plan], Plan], ...] = (
    fold,  # first: a known condition takes whole regions away
    drop_unused,  # before regions are joined: an empty region between two others keeps them apart
    merge,  # needs shared conditions
    hoist,  # needs the final regions to know what is the same for all pairs of a set; makes all nodes anew, once
    narrow,  # after merge, which could not join the halves again
    keep,  # last: regions and nodes are final
)


def optimise(plan: Plan, *, thorough: bool = True) -> Plan:
    """Run all passes on a plan that was just lowered. It is verified before the first and after each, or, where somebody waits
    for it and would not ask which pass it was, after the last."""
    if thorough:
        verify(plan)
    for run in PASSES:
        plan = run(plan)
        if thorough:
            verify(plan)
    if not thorough:
        verify(plan)
    return plan


__all__ = ["PASSES", "optimise"]
