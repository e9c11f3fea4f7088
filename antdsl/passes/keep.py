"""Note which senses are kept for the rest of the step once they are computed."""

from __future__ import annotations

from dataclasses import replace

from antdsl.plan.ir import Plan
from antdsl.plan.traverse import lazy


def keep(plan: Plan) -> Plan:
    """The plan with each species' `lazy` made anew: other passes change which regions ask."""
    return replace(plan, species={n: replace(s, lazy=lazy(s.decide, s.act, s.blend)) for n, s in plan.species.items()})
