"""Passes transform a plan into an equivalent plan with less work. They run in the order of PASSES."""

from __future__ import annotations

from collections.abc import Callable

from antdsl.passes.drop_unused import drop_unused
from antdsl.passes.fold import fold
from antdsl.passes.hoist import hoist
from antdsl.passes.keep import keep_senses
from antdsl.passes.merge import merge
from antdsl.passes.narrow import narrow
from antdsl.plan.ir import Plan
from antdsl.plan.verify import verify

PASSES: tuple[Callable[[Plan], Plan], ...] = (
    fold,  # first: a constant condition removes complete regions
    drop_unused,  # before `merge`: an empty region between two others prevents merging
    merge,  # needs shared conditions
    hoist,  # needs the merged regions; rebuilds all nodes once
    narrow,  # after `merge`, which could not join the two halves
    keep_senses,  # last, when regions and nodes are final
)


def optimise(plan: Plan, *, thorough: bool = True) -> Plan:
    """Run all passes on a plan that was just lowered. The plan is verified before the first pass and after each pass. If not
    `thorough`, it is verified only after the last pass, which is faster."""
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
