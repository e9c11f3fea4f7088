"""The checked program: all names are resolved, all expressions have a type and a rate, and all behaviour calls are expanded.

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
    - `per_second`: whether the added value is a rate, which is multiplied by dt. In the body of a state, it is.
    - `pair_agent`: for a pair value of one other agent, this agent. `other_agents`, `element`: for the pair values of a set of
      other agents, this set, and the name for one of its agents."""

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
    """A request to the thing `target`. `op`: the row of `antdsl.program.tables.effects` that defines the request.
    - `args`: the values of the row's `numbers`, in order; None if absent.
    - `result_attribute`: the agent's attribute to which the result is added.
    - `per_second`: whether the first of `args` is a rate, which is multiplied by dt.
    - `draw_key`: the key of its random numbers."""

    op: str
    target: str
    args: tuple[Expr | None, ...]
    span: Span
    result_attribute: str | None = None
    per_second: bool = False
    draw_key: str = ""


@expression_class
class Give:
    """A line that gives an amount to an item. `amount`: None to give all. `receiver`: an expression of type ITEM, or of type
    ITEMS for the nearest item."""

    attribute: str
    amount: Expr | None
    receiver: Expr
    per_second: bool
    span: Span


@expression_class
class Play:
    """A line that plays a clip as long as the agent is in the state.
    - `group`: the transform group that the clip moves; "" for all joints.
    - `speed`: the factor on the clip's own speed (None: 1). `weight`: the weight of the clip in the pose, 0 to 1 (None: 1).
    - `restart_condition`: the clip restarts if this holds when an agent enters the state.
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
    """A line that shows a layer of the body's geometry, in addition to other geometry, while the agent is in the state.

    `condition`: only agents that fulfil it show the layer (None: all)."""

    layer: str
    condition: Expr | None
    span: Span


@expression_class
class Channel:
    """A line that sets a channel of the body while the agent is in the state. The channel's value overrides the clips."""

    channel: str
    value: Expr
    span: Span


@expression_class
class Look:
    """A line that turns a transform group towards the point `at`.
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
    """A `take` in a transition: takes an amount from `source`. The source has type ITEM, or type FIELD for the cell below the
    agent's feet.
    - `amount`: None to take all.
    - `attribute`: the agent's attribute that receives the amount. If None, an amount from a field disappears."""

    attribute: str | None
    amount: Expr | None
    source: Expr
    span: Span


FROM_ANY_KEY = "from any"  # in the keys of these transitions; not a valid state name


@expression_class
class Transition:
    """A transition. It happens in a step if all of the following conditions hold.
    - `condition`: None: always true.
    - `delay`: the shortest time in the state before it can happen; None: no limit.
    - `hold_time`: how long `condition` must have been true; None: one step is enough."""

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
    - `min_duration`: the shortest time that an agent stays in the state; None for no limit.
    - `enter`, `exit`: the actions when an agent enters or leaves the state. `body`: the statements that run in each step."""

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
    - `is_builtin`: whether it is a built-in attribute, such as size or max_speed.
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
    """A param. `name`: qualified with the species. Numbers are in base units; `unit` is the unit in the source."""

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
    """A handler: the actions that run when an event arrives.

    - `event`: spawn, collision, or the name of an emitted event.
    - `other`: in a collision, the binding of the other agent. `other_species`: the species of that agent."""

    event: str
    other: Binding | None
    actions: tuple[Statement, ...]
    span: Span
    other_species: str = ""


@expression_class
class Layer:
    """One line of the layers.

    - `push`: the push of the line; None for the word `state`, which stands for the pushes of the current states.
    - `text`: the text of the line without its condition. `key`: the stable name of the layer, such as `separate#2`.
    - `is_face_line`: whether it is a `face` line, in which case `push` only turns the body."""

    push: Expr | None
    condition: Expr | None
    text: str
    span: Span
    key: str = ""
    is_face_line: bool = False


@expression_class
class LayerStack:
    """The layers of a species in the order of the source, and the method that combines them."""

    mode: str  # budget, sum, first
    layers: tuple[Layer, ...]
    span: Span


@expression_class
class RestingPush:
    """The push of agents that stand still, because none of their current states steers.

    `resting_states`: by machine name, the indices of the states that do not steer. Machines that never steer are not included.
    An agent requests `push` if the current state in each of these machines is one that does not steer."""

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
        """Return the types of the agent's attributes, lets and latches, by name."""
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
    """A field with its settings. A setting that is absent in the text is None.

    - `cell`: the cell size. `keeps`: the factor per step. `limit`: the largest value of a cell.
    - `combine`: how a deposit changes the value of a cell: "add" or "max".
    - `stencil`: how many neighbours of a cell diffusion uses, 4 or 8.
    - `deposits`: "first" if deposits are added before diffusion and evaporation, "last" if after.
    - `has_vectors`: whether the cells hold vectors. In this case, `limit` is their largest length."""

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
    """The program that consists of all files. Agents may interact with agents of a species that another file declares."""

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
