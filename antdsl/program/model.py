"""The checked program: every name resolved, every expression with its type and rate, every behaviour call expanded.

`check` makes these values and nothing else does. All are frozen and compare by identity; each keeps its Span.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import field
from typing import TYPE_CHECKING

from antdsl.program.kinds import ChangeRate as ChangeRate
from antdsl.program.kinds import Dimension as Dimension
from antdsl.program.kinds import TypeKind as TypeKind
from antdsl.program.kinds import ValueType as ValueType
from antdsl.program.names.bindings import NameBindings as NameBindings
from antdsl.program.typed import AttributeRef as AttributeRef
from antdsl.program.typed import Binding as Binding
from antdsl.program.typed import BindingRef as BindingRef
from antdsl.program.typed import ClipTest as ClipTest
from antdsl.program.typed import Constant as Constant
from antdsl.program.typed import Expr as Expr
from antdsl.program.typed import InlinedBehaviour as InlinedBehaviour
from antdsl.program.typed import NoneRef as NoneRef
from antdsl.program.typed import OperationExpr as OperationExpr
from antdsl.program.typed import ParamRef as ParamRef
from antdsl.program.typed import ReduceExpr as ReduceExpr
from antdsl.program.typed import SetExpr as SetExpr
from antdsl.program.typed import StateConstant as StateConstant
from antdsl.program.typed import ThingRef as ThingRef
from antdsl.program.typed import expression_class as expression_class
from antdsl.source import Span
from antdsl.syntax import nodes

if TYPE_CHECKING:
    from antdsl.program.expectations import Spec


# --- statements ------------------------------------------------------------------------------------------------------


@expression_class
class Steer:
    push: Expr
    span: Span


@expression_class
class FaceLine:
    """Turn the body towards `direction`; only its direction counts."""

    direction: Expr
    span: Span


@expression_class
class Assign:
    """`op` is `=`, `+=` or `-=`. In a state's body an added value is a rate (per second; `per_second` True: multiply by dt)."""

    attribute: str
    op: str
    value: Expr
    per_second: bool
    span: Span
    of: Expr | None = None  # `likes[other]`: the other agent
    over: SetExpr | None = None  # `likes[n in SET]`: the set, and what stands for each of it in the value
    element: Binding | None = None


@expression_class
class EffectRequest:
    """A request of the row `op` of `antdsl.program.tables.effects` to `of`. `args` are the row's `numbers` in order (None:
    absent). `own` is the attribute that the result is added to. `per_second`: the first of `args` is a rate, to be multiplied by
    dt. `key`: the site of its random numbers."""

    op: str
    of: str
    args: tuple[Expr | None, ...]
    span: Span
    own: str | None = None
    per_second: bool = False
    key: str = ""


@expression_class
class Give:
    """`amount` None gives all. `to` has type ITEM, or ITEMS for the nearest one."""

    attribute: str
    amount: Expr | None
    to: Expr
    per_second: bool
    span: Span


@expression_class
class Play:
    """`clip` is played as long as the state lasts, on the joints of the transform group `on` ("": all). It runs at `speed` times
    its own speed and with the share `weight` (None: 1). Where `again` holds as an agent comes into the state, it restarts. `add`:
    it is added to other clips that play."""

    clip: str
    on: str
    speed: Expr | None
    weight: Expr | None
    span: Span
    again: Expr | None = None
    add: bool = False
    blend_clips: tuple[str, str, str, str] = ("", "", "", "")  # clips for who turns left or right, climbs, goes down


@expression_class
class Wear:
    """Agents in the state show the geometry layer `layer` of their body beside its own, if `when` holds for them (None: all)."""

    layer: str
    when: Expr | None
    span: Span


@expression_class
class Channel:
    """A channel of the body has this value for agents in the state, and overrides clips."""

    channel: str
    value: Expr
    span: Span


@expression_class
class Look:
    """A transform group turns towards a place, at most `within` (None: 60 deg) from straight ahead. `over` (None: 0.2 s) sets how
    fast."""

    group: str
    at: Expr
    within: Expr | None
    over: Expr | None
    span: Span


Statement = Steer | FaceLine | Assign | EffectRequest | Give | Play | Wear | Channel | Look


@expression_class
class Take:
    """`source` has type ITEM, or FIELD for the cell below the feet. `amount` None takes all. Without an `attribute`, the amount
    taken from a field disappears."""

    attribute: str | None
    amount: Expr | None
    source: Expr
    span: Span


FROM_ANY_KEY = "from any"  # in the keys of those changes: no state can have this name


@expression_class
class Transition:
    """`condition` None is always true. All conditions that are present must hold: `delay` (time in the state), and `condition`
    for `held`."""

    key: str  # forager.main.search->approach#1
    interrupt: bool
    condition: Expr | None
    delay: Expr | None
    held: Expr | None
    take: Take | None
    target: int | None  # state index; None with `choices` or for previous
    previous: bool
    choices: tuple[tuple[int, Expr], ...]
    actions: tuple[Statement, ...]
    span: Span
    over: Expr | None = None  # the time in which the clip of the state before gives way


@expression_class
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


@expression_class
class Machine:
    name: str  # `main` where the states stand straight in the species
    start: int
    states: tuple[State, ...]
    span: Span


@expression_class
class AttributeDecl:
    """`default` is evaluated once, at birth (params and draws allowed). `is_builtin` marks built-in attributes such as size and
    max_speed."""

    name: str
    type: ValueType
    default: Expr
    is_builtin: bool
    help: str
    span: Span
    relax_to: Expr | None = None
    relax_over: Expr | None = None
    each: str | None = None  # species, for a value per pair
    strongest: int = 0


@expression_class
class Param:
    """`name` is qualified with its species. Numbers in base units; `unit` as the author wrote it."""

    name: str
    type: ValueType
    default: Constant
    low: Constant | None
    high: Constant | None
    unit: str
    help: str
    span: Span


@expression_class
class Handler:
    """`event`: spawn, collision, or an emitted one. For a collision, `other` is bound to the other agent, of the species `of`."""

    event: str
    other: Binding | None
    actions: tuple[Statement, ...]
    span: Span
    of: str = ""


@expression_class
class Layer:
    """`push` None is the word `state`: what the states steer. `faces`: a `face` line; its `push` turns the body alone."""

    push: Expr | None
    condition: Expr | None
    text: str
    span: Span
    key: str = ""
    faces: bool = False


@expression_class
class LayerStack:
    mode: str  # budget, sum, first
    layers: tuple[Layer, ...]
    span: Span


@expression_class
class RestingPush:
    """How agents stand still that no state steers. `silent`: of each machine that steers in some state, by its name, the indices
    of those states that steer nothing. An agent in silent states of all these machines requests `push`."""

    silent: dict[str, tuple[int, ...]]
    push: Expr
    span: Span


@expression_class
class Species:
    name: str
    help: str
    attributes: tuple[AttributeDecl, ...]
    params: tuple[Param, ...]
    lets: tuple[Binding, ...]
    latches: tuple[Binding, ...]
    handlers: tuple[Handler, ...]
    machines: tuple[Machine, ...]
    layers: LayerStack
    span: Span
    rest: RestingPush | None = None  # None: every state steers, or none does

    @property
    def own_types(self) -> Mapping[str, ValueType]:
        """Return the types of the named values of each agent: attributes, lets and latches."""
        lines: tuple[AttributeDecl | Binding, ...] = (*self.attributes, *self.lets, *self.latches)
        return {each.name: each.type for each in reversed(lines)}


@expression_class
class ItemAttribute:
    name: str
    type: ValueType
    default: Constant
    help: str
    span: Span


@expression_class
class WorldThing:
    """`kind`: the word of its row in `program/tables/things.py`."""

    name: str
    kind: str
    attributes: tuple[ItemAttribute, ...]
    help: str
    span: Span


@expression_class
class Field:
    """Settings absent are None. `keeps` is a factor per step; `combine` is add or max, `stencil` 4 or 8 and
    `deposits` last or first."""

    name: str
    surfaces: tuple[str, ...]
    cell: Expr
    half_life: Expr | None
    evaporate: Expr | None
    keeps: Expr | None
    diffuse: Expr | None
    combine: str
    limit: Expr | None
    stencil: int
    deposits: str
    span: Span


@expression_class
class Program:
    """All files together. A species of one file may be met by one of another."""

    species: dict[str, Species]
    world: dict[str, WorldThing]
    fields: dict[str, Field]
    params: dict[str, Param]
    events: tuple[str, ...]
    specs: tuple[Spec, ...]
    sources: tuple[nodes.File, ...] = field(default=())
    bindings: NameBindings = field(default=NameBindings())

    def of_kind(self, kind: str) -> list[str]:
        """Return the names of the things of the world of a kind."""
        return [name for name, thing in self.world.items() if thing.kind == kind]
