"""The plan: what the backends run. It is the program without the language.

`ir` is the definition: a closed table of operations with a sentence each, statements over nodes, and registers with one value per
agent. A node is a scalar; a vector is three of them. Nodes are interned, so equal nodes are one object. A block is what one phase
of a step does for one species: a list of statements with regions as conditions.

`lower` makes the plan from a checked program (`lowering`), `verify` checks its rules, also between passes, and `show` prints it.
`traverse` goes over it for all readers. Nothing here knows NumPy, scenes or agents. The backends in `runtime.backends` run it;
one of them is its definition in plain Python."""

from antdsl.plan.builder import PlanError
from antdsl.plan.lowering.lower import lower
from antdsl.plan.show import show
from antdsl.plan.verify import verify

__all__ = ["PlanError", "lower", "show", "verify"]
