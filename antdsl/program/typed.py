"""Expressions of the checked program: each with its type, its rate and its place in the text."""

from __future__ import annotations

from dataclasses import dataclass
from typing import dataclass_transform

from antdsl.program.kinds import ChangeRate, ValueType
from antdsl.source import Span


@dataclass_transform(eq_default=False, frozen_default=True)
def expression_class(cls: type) -> type:
    return dataclass(frozen=True, slots=True, eq=False, repr=False)(cls)


@expression_class
class Expr:
    type: ValueType
    rate: ChangeRate
    span: Span


@expression_class
class Constant(Expr):
    """A number in base units (mm, s, g, rad; bool as 0 or 1), times `unit ** u` (mm per scene unit) and `dt ** step`."""

    number: float
    u: float = 0
    step: float = 0


@expression_class
class NoneRef(Expr):
    """No item or no agent; the type says of what."""


@expression_class
class StateConstant(Expr):
    """A state's index within its machine."""

    machine: str
    index: int


@expression_class
class ClipTest(Expr):
    """Whether the clip of a machine has been played to its end, or has come to a `mark` ("": its end) in the last step."""

    machine: str
    mark: str


@expression_class
class ParamRef(Expr):
    """A param by its qualified name, `forager.smell`."""

    name: str


@expression_class
class AttributeRef(Expr):
    """An attribute of the agent itself (`of` None), or of the agent, item, hit or set element in `of`.

    Built-in names are attributes too: position velocity heading up speed id age group size mass radius clearance max_speed
    max_force max_turn response; items' position and radius; a hit's distance, normal and position. A machine has `MACHINE.state`,
    `MACHINE.previous`, `MACHINE.next` and `MACHINE.time_in_state`, always with the machine. `likes[n]`, the agent's own value
    about another, has that other as `of`; its declaration uses `each`."""

    of: Expr | None
    name: str


@expression_class
class Binding:
    """A named value: `let` (value), `argument` (value), `keep` (value is the first, `then` the next), `element` of a set,
    `latch` (value switches on, `then` off). `key` is the stable identity of memories: `forager.main.search.wander#1.bearing`.
    A species-level `let` reads the agent as it was at the start of the step (`snapshot`)."""

    name: str
    role: str
    type: ValueType
    rate: ChangeRate
    span: Span
    value: Expr | None = None
    then: Expr | None = None
    key: str = ""
    snapshot: bool = False


@expression_class
class BindingRef(Expr):
    """A use of a binding."""

    binding: Binding


@expression_class
class ThingRef(Expr):
    """A thing of the world or a species as an argument: its name, and the kind of thing. `self` (AGENT) is the agent."""

    name: str


@expression_class
class OperationExpr(Expr):
    """A built-in operation of vocabulary.OPS with its arguments in the vocabulary's order, defaults filled in (an absent
    optional argument is None). `site` is the stable identity of a draw (`….uniform#1`) or of a ray, else empty."""

    name: str
    args: tuple[Expr | None, ...]
    site: str = ""


@expression_class
class SetExpr(Expr):
    """A set: `source` is `neighbours` (args radius, fov), `all` (args within or None), `feelers` (args count, spread, reach);
    `of` names the species, items or obstacle; `where` is the condition on `element` (or None)."""

    source: str
    of: str
    args: tuple[Expr | None, ...]
    element: Binding
    where: Expr | None


@expression_class
class ReduceExpr(Expr):
    """`how`: sum mean min max count any every best (the element with the greatest body) nearest (the element with the least
    distance; body None). `element` is bound in `body`; it may differ from `over.element`, which is bound in its `where`."""

    how: str
    over: SetExpr
    element: Binding
    body: Expr | None


@expression_class
class InlinedBehaviour(Expr):
    """A behaviour call, expanded for the types of this call: bind `arguments`, then `body` (lets, keeps), then `result`."""

    behaviour: str
    key: str
    arguments: tuple[Binding, ...]
    body: tuple[Binding, ...]
    result: Expr
