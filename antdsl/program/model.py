"""The checked program: every name resolved, every expression with its type and rate, every behaviour call expanded.

`check` makes these values and nothing else does. All are frozen and compare by identity; each keeps its Span.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING, dataclass_transform

from antdsl.program.kinds import Dim as Dim
from antdsl.program.kinds import Kind as Kind
from antdsl.program.kinds import Rate as Rate
from antdsl.program.kinds import Type as Type
from antdsl.source import Span
from antdsl.syntax import nodes

if TYPE_CHECKING:
    from antdsl.program.expected import Spec


@dataclass_transform(eq_default=False, frozen_default=True)
def value(cls: type) -> type:
    return dataclass(frozen=True, slots=True, eq=False, repr=False)(cls)


# --- expressions -----------------------------------------------------------------------------------------------------


@value
class Expr:
    type: Type
    rate: Rate
    span: Span


@value
class Const(Expr):
    """A number in base units (mm, s, g, rad; bool as 0 or 1), times `unit ** u` (mm per scene unit) and `dt ** step`."""

    number: float
    u: float = 0
    step: float = 0


@value
class NoneRef(Expr):
    """No item or no agent; the type says of what."""


@value
class StateConst(Expr):
    """A state's index within its machine."""

    machine: str
    index: int


@value
class ParamRef(Expr):
    """A param by its qualified name, `forager.smell`."""

    name: str


@value
class Attribute(Expr):
    """An attribute of the agent itself (`of` None), or of the agent, item, hit or set element that `of` gives.

    Given names are attributes too: position velocity heading up speed id age group size mass radius clearance max_speed
    max_force max_turn response, items' position and radius, a hit's distance, normal and position.
    A machine's: `MACHINE.state`, `MACHINE.previous`, `MACHINE.next`, `MACHINE.time_in_state`, always with the machine.
    `likes[n]`, the agent's own value about another, has that other as `of`; its declaration says `each`."""

    of: Expr | None
    name: str


@value
class Binding:
    """A named value: `let` (value), `argument` (value), `keep` (value is the first, `then` the next), `element` of a set,
    `latch` (value switches on, `then` off). `key` is the stable identity of memories: `forager.main.search.wander#1.bearing`.
    A species-level `let` reads the agent as it was at the start of the step (`snapshot`)."""

    name: str
    role: str
    type: Type
    rate: Rate
    span: Span
    value: Expr | None = None
    then: Expr | None = None
    key: str = ""
    snapshot: bool = False


@value
class Local(Expr):
    """A use of a binding."""

    binding: Binding


@value
class Thing(Expr):
    """A thing of the world or a species as an argument: its name; its kind says what it is. `self` (AGENT) is the agent."""

    name: str


@value
class Op(Expr):
    """A built-in operation of vocabulary.OPS with its arguments in the vocabulary's order, defaults filled in (an absent
    optional argument is None). `site` is the stable identity of a draw (`….uniform#1`) or of a ray, else empty."""

    name: str
    args: tuple[Expr | None, ...]
    site: str = ""


@value
class SetOf(Expr):
    """A set: `source` is `neighbours` (args radius, fov), `all` (args within or None), `feelers` (args count, spread, reach);
    `of` names the species, items or obstacle; `where` is the condition on `element` (or None)."""

    source: str
    of: str
    args: tuple[Expr | None, ...]
    element: Binding
    where: Expr | None


@value
class Reduce(Expr):
    """`how`: sum mean min max count any every best (the element with the greatest body) nearest (the element with the least
    distance; body None). `element` is bound in `body`; it may differ from `over.element`, which is bound in its `where`."""

    how: str
    over: SetOf
    element: Binding
    body: Expr | None


@value
class Inline(Expr):
    """A behaviour call, expanded for the types of this call: bind `arguments`, then `body` (lets, keeps), then `result`."""

    behaviour: str
    key: str
    arguments: tuple[Binding, ...]
    body: tuple[Binding, ...]
    result: Expr


# --- statements ------------------------------------------------------------------------------------------------------


@value
class Steer:
    push: Expr
    span: Span


@value
class Assign:
    """`op` is `=`, `+=` or `-=`. In a state's body an added value is a rate (per second; `per_second` True: multiply by dt)."""

    attribute: str
    op: str
    value: Expr
    per_second: bool
    span: Span
    of: Expr | None = None  # `likes[other]`: the other agent


@value
class Deposit:
    field: str
    amount: Expr
    per_second: bool
    span: Span


@value
class Give:
    """`amount` None gives all. `to` has type ITEM, or ITEMS: then the nearest one."""

    attribute: str
    amount: Expr | None
    to: Expr
    per_second: bool
    span: Span


@value
class Emit:
    event: str
    within: Expr | None
    span: Span


@value
class SpawnAgent:
    species: str
    span: Span
    key: str = ""


@value
class Die:
    span: Span


@value
class Carve:
    """`toward` None: straight ahead. `into`: the attribute that what is dug out is added to."""

    solid: str
    radius: Expr
    span: Span
    toward: Expr | None = None
    into: str | None = None


@value
class Play:
    clip: str
    span: Span


Statement = Steer | Assign | Deposit | Give | Emit | SpawnAgent | Die | Carve | Play


@value
class Take:
    """`source` has type ITEM."""

    attribute: str
    amount: Expr
    source: Expr
    span: Span


ANYWHERE = "from any"  # in the keys of those changes: no state can have this name


@value
class Transition:
    """`condition` None is always true. All parts given must hold: `after` (time in the state), `condition` for `held`."""

    key: str  # forager.main.search->approach#1
    interrupt: bool
    condition: Expr | None
    after: Expr | None
    held: Expr | None
    take: Take | None
    target: int | None  # state index; None with `choices` or for previous
    previous: bool
    choices: tuple[tuple[int, Expr], ...]
    actions: tuple[Statement, ...]
    span: Span


@value
class State:
    name: str
    index: int
    label: str
    colour: tuple[float, float, float]
    at_least: Expr | None
    transitions: tuple[Transition, ...]  # in order of evaluation: interrupts, `from any`, the others
    enter: tuple[Statement, ...]
    exit: tuple[Statement, ...]
    body: tuple[Statement, ...]
    span: Span


@value
class Machine:
    name: str  # `main` where the states stand straight in the species
    start: int
    states: tuple[State, ...]
    span: Span


@value
class AttributeDecl:
    """`default` is evaluated once, at birth (params, draws allowed). `given` marks size, max_speed and the like."""

    name: str
    type: Type
    default: Expr
    given: bool
    help: str
    span: Span
    relax_to: Expr | None = None
    relax_over: Expr | None = None
    each: str | None = None  # species, for a value per pair
    strongest: int = 0


@value
class Param:
    """`name` is qualified with its species. Numbers in base units; `unit` as the author wrote it."""

    name: str
    type: Type
    default: Const
    low: Const | None
    high: Const | None
    unit: str
    help: str
    span: Span


@value
class Handler:
    """`event`: spawn, collision, or an emitted one. `other` is bound for a collision."""

    event: str
    other: Binding | None
    actions: tuple[Statement, ...]
    span: Span


@value
class Layer:
    """`push` None is the word `state`: what the states steer."""

    push: Expr | None
    condition: Expr | None
    text: str
    span: Span
    key: str = ""


@value
class Layers:
    mode: str  # budget, sum, first
    layers: tuple[Layer, ...]
    span: Span


@value
class Species:
    name: str
    help: str
    attributes: tuple[AttributeDecl, ...]
    params: tuple[Param, ...]
    lets: tuple[Binding, ...]
    latches: tuple[Binding, ...]
    handlers: tuple[Handler, ...]
    machines: tuple[Machine, ...]
    layers: Layers
    span: Span


@value
class ItemAttribute:
    name: str
    type: Type
    default: Const
    help: str
    span: Span


@value
class WorldThing:
    """`kind`: surface obstacle solid items curve flow map species."""

    name: str
    kind: str
    attributes: tuple[ItemAttribute, ...]
    help: str
    span: Span


@value
class Field:
    """Settings absent are None. `keeps` is a factor per step; `combine` is add or max."""

    name: str
    surfaces: tuple[str, ...]
    cell: Expr
    half_life: Expr | None
    evaporate: Expr | None
    keeps: Expr | None
    diffuse: Expr | None
    combine: str
    limit: Expr | None
    span: Span


@value
class Program:
    """All files together. A species of one file may be met by one of another."""

    species: dict[str, Species]
    world: dict[str, WorldThing]
    fields: dict[str, Field]
    params: dict[str, Param]
    events: tuple[str, ...]
    specs: tuple[Spec, ...]
    sources: tuple[nodes.File, ...] = field(default=())
