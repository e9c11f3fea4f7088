"""Plan to plan: the same effects with less work. The order of PASSES is the order in which they run."""

from __future__ import annotations

from collections.abc import Callable

from antdsl.passes.drop_unused import drop_unread, drop_unused
from antdsl.passes.fold import fold, open_known
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
# The same to the same plan where somebody waits for it: the nodes of a plan that was just lowered are made anew once, by `hoist`.
_QUICK: tuple[Callable[[Plan], Plan], ...] = (open_known, drop_unread, merge, hoist, narrow, keep)


def optimise(plan: Plan, *, thorough: bool = True) -> Plan:
    """Run all passes on a plan that was just lowered. It is verified before the first and after each, or after the last where
    somebody waits for it and would not ask which pass it was; both give the same plan."""
    if thorough:
        verify(plan)
    for run in PASSES if thorough else _QUICK:
        plan = run(plan)
        if thorough:
            verify(plan)
    if not thorough:
        verify(plan)
    return plan


__all__ = ["PASSES", "optimise"]
