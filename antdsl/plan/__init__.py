"""The plan: the intermediate form that backends run. It does not depend on the syntax of the language.

`ir` defines it: a closed table of operations, statements over nodes, and registers with one value per agent. A node is a scalar;
a vector is three nodes. Nodes are interned: equal nodes are one object. A block is the work of one phase of a step for one
species, as a list of statements. A condition makes a region of statements.

`lower` makes the plan from a checked program (`lowering`). `verify_plan` checks its rules, also between passes. `format_plan`
prints it, and `traverse` iterates over it. Nothing in this package uses NumPy, scenes or agents. The backends in
`runtime.backends` run plans. The `reference` backend, in plain Python, defines their meaning."""

from antdsl.plan.builder import PlanError
from antdsl.plan.lowering.lower import lower
from antdsl.plan.show import format_plan
from antdsl.plan.verify import verify_plan

__all__ = ["PlanError", "format_plan", "lower", "verify_plan"]
