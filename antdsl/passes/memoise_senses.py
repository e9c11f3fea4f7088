"""Finds the senses that several regions use, so that each is computed once per step and stored until the step ends."""

from __future__ import annotations

from dataclasses import replace

from antdsl.plan.ir import Plan
from antdsl.plan.traverse import find_shared_senses


def memoise_senses(plan: Plan) -> Plan:
    """Return the plan with `memoised_senses` recomputed for each species. This is needed because other passes change which
    regions use a sense."""
    return replace(
        plan,
        species={n: replace(s, memoised_senses=find_shared_senses(s.decide, s.act, s.blend)) for n, s in plan.species.items()},
    )
