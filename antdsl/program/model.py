"""The checked program: every name resolved, every expression with its type and rate, every behaviour call expanded.

Only `check` makes these values. They are immutable, compare by identity, and have a Span."""

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
    from antdsl.program.expectations import Measure, Spec


# --- statements ------------------------------------------------------------------------------------------------------


@expression_class
class Steer:
    """A `steer` line: adds a push to the steering of the agent."""

    push: Expr
    span: Span


@expression_class
class FaceLine:
    """A line that turns the body towards `direction`. The length of the vector has no effect."""

    direction: Expr
    span: Span


@expression_class
class Assign:
    """An assignment. `op` is `=`, `+=` or `-=`.
    - `per_second`: whether the added value is a rate, to be multiplied by dt. This is so in the body of a state.
    - `pair_agent`, `other_agents`, `element`: for a pair value, the other agent, or the set of others and the name bound to
      each."""

    attribute: str
    op: str
    value: Expr
    per_second: bool
    span: Span
    pair_agent: Expr | None = None  # `likes[other]`: the other agent
    other_agents: SetExpr | None = None  # `likes[n in SET]`: the set
    element: Binding | None = None


@expression_class
class EffectRequest:
    """A request to `target`, as the row `op` of `antdsl.program.tables.effects` defines.
    - `args`: the row's `numbers` in order; None if absent.
    - `result_attribute`: the agent's attribute to which the result is added.
    - `per_second`: whether the first of `args` is a rate, to be multiplied by dt.
    - `draw_key`: the site of its random numbers."""

    op: str
    target: str
    args: tuple[Expr | None, ...]
    span: Span
    result_attribute: str | None = None
    per_second: bool = False
    draw_key: str = ""


@expression_class
class Give:
    """Gives an amount to an item. `amount` None gives all. `receiver` has type ITEM, or ITEMS for the nearest item."""

    attribute: str
    amount: Expr | None
    receiver: Expr
    per_second: bool
    span: Span


@expression_class
class Play:
    """Plays a clip as long as the state lasts.
    - `group`: the transform group that the clip moves; "" for all joints.
    - `speed`: the factor on the clip's own speed (None: 1). `weight`: the weight of the clip in the pose, 0 to 1 (None: 1).
    - `restart_condition`: if this holds as an agent enters the state, the clip restarts.
    - `is_additive`: whether the clip is added to the other clips that play.
    - `blend_clips`: the clips for turning left, turning right, going up and going down; "" if absent."""

    clip: str
    group: str
    speed: Expr | None
    weight: Expr | None
    span: Span
    restart_condition: Expr | None = None
    is_additive: bool = False
    blend_clips: tuple[str, str, str, str] = ("", "", "", "")  # turning left, turning right, going up, going down


@expression_class
class Wear:
    """A line that shows the geometry layer `layer` of the body, in addition to other geometry, on agents in the state.

    `condition`: only on agents for which it holds (None: all)."""

    layer: str
    condition: Expr | None
    span: Span


@expression_class
class Channel:
    """Sets a channel of the body for agents in the state. It overrides the clips."""

    channel: str
    value: Expr
    span: Span


@expression_class
class Look:
    """Turns a transform group towards the point `at`.
    - `max_angle`: the largest angle from straight ahead (None: 60 deg).
    - `time_constant`: the time constant of the turn (None: 0.2 s)."""

    group: str
    at: Expr
    max_angle: Expr | None
    time_constant: Expr | None
    span: Span


Statement = Steer | FaceLine | Assign | EffectRequest | Give | Play | Wear | Channel | Look


@expression_class
class Take:
    """Takes an amount from an item or a field. `source` has type ITEM, or FIELD for the cell below the agent's feet.
    - `amount`: None takes all.
    - `attribute`: the attribute that receives the amount. If None, an amount from a field disappears."""

    attribute: str | None
    amount: Expr | None
    source: Expr
    span: Span


FROM_ANY_KEY = "from any"  # in the keys of these transitions; not a valid state name


@expression_class
class Transition:
    """A transition. It happens if all conditions that are present hold.
    - `condition`: None is always true.
    - `delay`: the least time in the state.
    - `hold_time`: the time for which `condition` must have held."""

    key: str  # forager.main.search->approach#1
    is_interrupt: bool
    condition: Expr | None
    delay: Expr | None
    hold_time: Expr | None
    take_action: Take | None
    target: int | None  # state index; None with `choices` or for previous
    targets_previous: bool
    choices: tuple[tuple[int, Expr], ...]
    actions: tuple[Statement, ...]
    span: Span
    fade_time: Expr | None = None  # duration of the cross-fade from the clip of the previous state


@expression_class
class State:
    """A state of a machine.

    - `label`: the display name. `colour`: the display colour, RGB from 0 to 1.
    - `min_duration`: the shortest time for which an agent stays; None for no limit.
    - `enter`, `exit`: the actions as an agent enters or leaves the state. `body`: the statements of each step."""

    name: str
    index: int
    label: str
    colour: tuple[float, float, float]
    min_duration: Expr | None
    transitions: tuple[Transition, ...]  # in order of evaluation: interrupts, `from any`, the others
    enter: tuple[Statement, ...]
    exit: tuple[Statement, ...]
    body: tuple[Statement, ...]
    span: Span


@expression_class
class Machine:
    """A state machine. `start`: the index of its start state."""

    name: str  # `main` for states directly in the species
    start: int
    states: tuple[State, ...]
    span: Span


@expression_class
class AttributeDecl:
    """A declared attribute. `default` is evaluated once, at birth; it may use params and draws.
    - `is_builtin`: a built-in attribute, such as size or max_speed.
    - `pair_species`: for a pair value, the species of the other agents. `slot_count`: its number of slots."""

    name: str
    type: ValueType
    default: Expr
    is_builtin: bool
    help: str
    span: Span
    relax_to: Expr | None = None
    relax_time: Expr | None = None
    pair_species: str | None = None  # species of the other agents of a pair value
    slot_count: int = 0


@expression_class
class Param:
    """A param. `name` is qualified with its species. Numbers are in base units; `unit` is as in the source."""

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
    """The actions for an event.

    - `event`: spawn, collision, or the name of an emitted event.
    - `other`: in a collision, the binding of the other agent. `other_species`: the species of that agent."""

    event: str
    other: Binding | None
    actions: tuple[Statement, ...]
    span: Span
    other_species: str = ""


@expression_class
class Layer:
    """A line of the layers.

    - `push`: the push of the line; None for the word `state`, which stands for the pushes of the current states.
    - `text`: the text of the line without its condition. `key`: the stable name of the layer, such as `separate#2`.
    - `is_face_line`: whether it is a `face` line, in which `push` only turns the body."""

    push: Expr | None
    condition: Expr | None
    text: str
    span: Span
    key: str = ""
    is_face_line: bool = False


@expression_class
class LayerStack:
    """The layers of a species in the order of the source, and how they are combined."""

    mode: str  # budget, sum, first
    layers: tuple[Layer, ...]
    span: Span


@expression_class
class RestingPush:
    """The push of agents that stand still because no state steers them.

    `resting_states`: for each machine that steers in at least one state, by name, the indices of its states that do not steer. An
    agent requests `push` if it is in such a state in all of these machines."""

    resting_states: dict[str, tuple[int, ...]]
    push: Expr
    span: Span


@expression_class
class Species:
    """A checked species with all of its members."""

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
    edition: int = 1  # of the file that declares it
    has_body_clearance: bool = False  # whether the body, not only the feet, stays outside the ground and obstacles
    has_whole_body: bool = False  # whether head, abdomen and load take room in contacts

    @property
    def own_types(self) -> Mapping[str, ValueType]:
        """Return the types of the attributes, lets and latches of each agent, by name."""
        lines: tuple[AttributeDecl | Binding, ...] = (*self.attributes, *self.lets, *self.latches)
        return {each.name: each.type for each in reversed(lines)}


@expression_class
class ItemAttribute:
    """An attribute of items, with its default value."""

    name: str
    type: ValueType
    default: Constant
    help: str
    span: Span


@expression_class
class WorldThing:
    """A thing of the world. `kind`: the word of its row in `program/tables/things.py`."""

    name: str
    kind: str
    attributes: tuple[ItemAttribute, ...]
    help: str
    span: Span


@expression_class
class Field:
    """A field. Absent settings are None.

    - `cell`: the cell size. `keeps`: the factor per step. `limit`: the largest value of a cell.
    - `combine`: how deposits combine with the value of a cell, add or max.
    - `stencil`: the number of neighbour cells that diffusion uses, 4 or 8.
    - `deposits`: whether deposits are added first or last, relative to diffusion and evaporation.
    - `has_vectors`: whether the cells hold vectors. Then `limit` is the largest length."""

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
    has_vectors: bool = False


@expression_class
class Program:
    """The program that all files form together. Agents may interact with agents of a species that another file declares."""

    species: dict[str, Species]
    world: dict[str, WorldThing]
    fields: dict[str, Field]
    params: dict[str, Param]
    events: tuple[str, ...]
    specs: tuple[Spec, ...]
    sources: tuple[nodes.File, ...] = field(default=())
    bindings: NameBindings = field(default=NameBindings())
    measures: tuple[Measure, ...] = field(default=())

    def list_things_of_kind(self, kind: str) -> list[str]:
        """Return the names of the things of one kind."""
        return [name for name, thing in self.world.items() if thing.kind == kind]
