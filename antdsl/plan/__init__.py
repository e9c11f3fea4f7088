"""The plan: what the backends run. It is the program without the language.

`ir` is the definition: a closed table of operations with a sentence each, statements over nodes, and registers, of which every
agent has one value. A node is a scalar; a vector is three of them. Nodes are interned, so what is equal is one object. A block
is what one phase of a step does for one species: a list of statements whose conditions are regions.

`lower` makes the plan out of a checked program (`lowering`), `verify` holds it to its rules, also between passes, `show`
prints it. `traverse` goes over it for all who read one. Nothing here knows NumPy, scenes or agents: the backends in
`runtime.backends` run it, and one of them is its definition in plain Python."""

from antdsl.plan.builder import PlanError
from antdsl.plan.lowering.lower import lower
from antdsl.plan.show import show
from antdsl.plan.verify import verify

__all__ = ["PlanError", "lower", "show", "verify"]
