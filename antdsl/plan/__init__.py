"""The plan: what the backends run. `lower` makes it, `verify` holds it to its rules, `show` prints it."""

from antdsl.plan.lowering.builder import PlanError
from antdsl.plan.lowering.lower import lower
from antdsl.plan.show import show
from antdsl.plan.verify import verify

__all__ = ["PlanError", "lower", "show", "verify"]
