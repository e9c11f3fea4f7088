"""The plan: the intermediate form of a program that backends run. It does not depend on the syntax of the language.

`ir` defines the plan: a closed table of operations, nodes, statements that use nodes, and registers with one value per agent. A
node is a scalar, so a vector is three nodes. Nodes are interned: equal nodes are one object. A block is a list of statements for
one species in one phase of a step. A region is a block with a condition; it runs for the agents that fulfil the condition.

`lower` makes the plan from a checked program (`lowering`). `verify_plan` checks that a plan is valid, also between passes.
`format_plan` prints a plan, and `traverse` iterates over one. Nothing in this package uses NumPy, scenes or agents. The backends
in `runtime.backends` run plans. The `reference` backend, in plain Python, defines the meaning of plans."""

from antdsl.plan.builder import PlanError
from antdsl.plan.lowering.lower import lower
from antdsl.plan.show import format_plan
from antdsl.plan.verify import verify_plan

__all__ = ["PlanError", "format_plan", "lower", "verify_plan"]
