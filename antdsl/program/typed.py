"""Expressions of the checked program. Each has a type, a rate and a span."""

from __future__ import annotations

from dataclasses import dataclass
from typing import dataclass_transform

from antdsl.program.kinds import ChangeRate, ValueType
from antdsl.source import Span


@dataclass_transform(eq_default=False, frozen_default=True)
def expression_class(cls: type) -> type:
    """Make a class of expressions an immutable dataclass with slots. Its objects compare by identity."""
    return dataclass(frozen=True, slots=True, eq=False, repr=False)(cls)


@expression_class
class Expr:
    """An expression of the checked program. `rate`: how often its value changes."""

    type: ValueType
    rate: ChangeRate
    span: Span


@expression_class
class Constant(Expr):
    """A constant number in base units (mm, s, g, rad). A bool is 0 or 1.

    The value is `number * u ** unit_power * dt ** step`. `u`: mm per scene unit. `dt`: seconds per step."""

    number: float
    unit_power: float = 0
    step: float = 0


@expression_class
class NoneRef(Expr):
    """The value `none`: no item or no agent, depending on the type."""


@expression_class
class StateConstant(Expr):
    """A state, stored as its index in its machine."""

    machine: str
    index: int


@expression_class
class ClipTest(Expr):
    """A test of the clip that a machine plays.

    If `mark` is a name, the test is true if the clip passed this mark in the last step. If `mark` is "", the test is true if the
    clip has played to its end."""

    machine: str
    mark: str


@expression_class
class ParamRef(Expr):
    """A param by its qualified name, such as `forager.smell`."""

    name: str


@expression_class
class AttributeRef(Expr):
    """An attribute of `owner`, which is an agent, item, hit or set element. If `owner` is None, it is an attribute of the agent
    that evaluates the expression.

    - Built-in names of agents: position, velocity, heading, up, speed, id, age, group, size, mass, radius, clearance, max_speed,
      max_force, max_turn and response.
    - Of items: position and radius. Of hits: distance, normal and position.
    - Of machines, always with the machine's name: `MACHINE.state`, `MACHINE.previous`, `MACHINE.next` and
      `MACHINE.time_in_state`.
    - Pair values: `likes[n]` is the agent's own value about another agent, which is in `owner`. Its declaration uses `each`."""

    owner: Expr | None
    name: str


@expression_class
class Binding:
    """A named value. The meaning of `value` and `next_value` depends on `role`:

    - `let`, `argument`: `value` is the value.
    - `keep`: `value` is the first value, and `next_value` the value for the next step.
    - `latch`: `value` is the condition that switches it on, and `next_value` the condition that switches it off.
    - `element`: the current element of a set.

    `key`: the stable identity of a memory, such as `forager.main.search.wander#1.bearing`. `is_snapshot`: whether the value is a
    `let` of a species. Such a value uses the agent's state at the start of the step."""

    name: str
    role: str
    type: ValueType
    rate: ChangeRate
    span: Span
    value: Expr | None = None
    next_value: Expr | None = None
    key: str = ""
    is_snapshot: bool = False


@expression_class
class BindingRef(Expr):
    """A use of a named value."""

    binding: Binding


@expression_class
class ThingRef(Expr):
    """The name of a thing of the world or of a species, used as an argument. Its type has the kind of the thing.

    The name `self` with the kind AGENT stands for the agent itself."""

    name: str


@expression_class
class OperationExpr(Expr):
    """A built-in operation of the vocabulary.

    - `args`: the arguments and defaults in the order of the vocabulary; None for an absent optional argument.
    - `site`: the stable identity of a random draw (`….uniform#1`) or of a ray; "" for other operations."""

    name: str
    args: tuple[Expr | None, ...]
    site: str = ""


@expression_class
class SetExpr(Expr):
    """A set over which reductions run.

    - `source`: `neighbours` (args radius, fov), `all` (args within or None), or `feelers` (args count, spread, reach).
    - `source_name`: the name of the species, items or obstacle.
    - `condition`: the condition on `element`, or None."""

    source: str
    source_name: str
    args: tuple[Expr | None, ...]
    element: Binding
    condition: Expr | None


@expression_class
class ReduceExpr(Expr):
    """A reduction over a set.

    - `reducer`: sum, mean, min, max, count, any, every, best (the element with the greatest `body`) or nearest (the nearest
      element; `body` is None).
    - `elements`: the set.
    - `element`: the name that `body` uses for an element. It may differ from `elements.element`, the name in the condition of
      the set."""

    reducer: str
    elements: SetExpr
    element: Binding
    body: Expr | None


@expression_class
class InlinedBehaviour(Expr):
    """A behaviour call, expanded for the types of its arguments. `arguments` are evaluated first, then the lets and keeps in
    `body`, then `result`."""

    behaviour_name: str
    key: str
    arguments: tuple[Binding, ...]
    body: tuple[Binding, ...]
    result: Expr
