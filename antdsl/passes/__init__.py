"""Passes over plans. Each pass returns an equivalent plan that needs less work. They run in the order of PASSES."""

from __future__ import annotations

from collections.abc import Callable

from antdsl.passes.drop_unused import drop_unused_stores
from antdsl.passes.fold import fold_regions
from antdsl.passes.hoist import hoist_factors
from antdsl.passes.memoise_senses import memoise_senses
from antdsl.passes.merge_regions import merge_regions
from antdsl.passes.split_conditions import split_conditions
from antdsl.plan.ir import Plan
from antdsl.plan.verify import verify_plan

PASSES: tuple[Callable[[Plan], Plan], ...] = (
    fold_regions,  # first: a constant condition removes complete regions
    drop_unused_stores,  # before `merge_regions`: an empty region between two others prevents merging
    merge_regions,  # needs shared conditions
    hoist_factors,  # needs the merged regions; rebuilds all nodes once
    split_conditions,  # after `merge_regions`, which could not join the two halves
    memoise_senses,  # last, when regions and nodes are final
)


def optimise_plan(plan: Plan, *, thorough: bool = True) -> Plan:
    """Return the plan after all passes. `plan`: a newly lowered plan.

    If `thorough` is true, the plan is verified before the first pass and after each pass. If it is false, it is verified only
    after the last pass, which is faster."""
    if thorough:
        verify_plan(plan)
    for run in PASSES:
        plan = run(plan)
        if thorough:
            verify_plan(plan)
    if not thorough:
        verify_plan(plan)
    return plan


__all__ = ["PASSES", "optimise_plan"]
