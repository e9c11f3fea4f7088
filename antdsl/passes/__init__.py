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
    fold,  # first: a known condition takes whole regions away, and what is equal becomes the same node (share)
    drop_unused,  # before regions are joined: an empty region between two others keeps them apart
    merge,  # needs shared conditions
    hoist,  # needs the final regions to know what is the same for all pairs of a set
    narrow,  # after merge, which could not join the halves again
    keep,  # last: regions and nodes are final
)


def optimise(plan: Plan, *, thorough: bool = True) -> Plan:
    """Run all passes; the plan is verified before the first and after each, or only after the last where somebody waits for it
    and would not ask which pass it was."""
    if thorough:
        verify(plan)
    for run in PASSES:
        plan = run(plan)
        if thorough or run is PASSES[-1]:
            verify(plan)
    return plan


__all__ = ["PASSES", "optimise"]
