"""The plan, the intermediate form of a program: statements, registers, and scalar nodes with operations from a closed table.

A `PlanNode` is pure and interned by its builder: nodes with the same operation and operands are one object. A vector is three
nodes. A statement acts on the agents of its region: the agents of the species that fulfil all enclosing `If` conditions. Base
units: mm, s, g, rad. Positions are float32, relative to the origin of the scene."""

# One line per row and one letter per kind keep the table readable.

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum, IntEnum
from typing import Any

from antdsl.program.tables import senses
from antdsl.program.tables.rows import SenseRow
from antdsl.program.tables.things import BLOCKING_KINDS
from antdsl.source import Span


class ValueKind(Enum):
    """The type of a node's value."""

    F32 = "f32"
    BOOL = "bool"
    I32 = "i32"  # a state's index, an item's row (-1 is none)
    I64 = "i64"  # an agent's id (-1 is none)
    TUPLE = "tuple"  # several results; taken apart by `get`
    SET = "set"

    __hash__ = object.__hash__  # Enum's own hash is slow, and a reload calls it tens of thousands of times


class UpdateRate(IntEnum):
    """How often a node is computed. A higher rate means more often."""

    CONST = 0
    RUN = 1
    STEP = 2
    AGENT = 3
    PAIR = 4  # inside a set: per (agent, other agent) or (agent, item)


@dataclass(frozen=True, slots=True, eq=False)
class PlanNode:
    """A node of a plan: an operation on other nodes. `attrs`: names and constants (not nodes), as in OPERATION_BY_NAME."""

    op: str
    args: tuple[PlanNode, ...]
    attrs: tuple[Any, ...]
    kind: ValueKind
    rate: UpdateRate
    span: Span | None
    number: int  # position in the builder's list: operands have smaller numbers

    def __repr__(self) -> str:
        inner = ", ".join([f"%{a.number}" for a in self.args] + [repr(a) for a in self.attrs])
        return f"%{self.number} = {self.op}({inner})"


@dataclass(frozen=True, slots=True)
class Operation:
    """A row of the table of operations. `args`: one letter for the kind of each operand (f F32, b BOOL, i I32, l I64, t TUPLE, s
    SET, x any scalar); * repeats the last letter. `kind`: the kind of the result. `rate`: the lowest rate of the result."""

    args: str
    attrs: tuple[str, ...]
    kind: ValueKind
    rate: UpdateRate
    meaning: str


F, BOOL, INDEX = ValueKind.F32, ValueKind.BOOL, ValueKind.I32
ID, T, SET = ValueKind.I64, ValueKind.TUPLE, ValueKind.SET
_CONST, _RUN, _STEP = UpdateRate.CONST, UpdateRate.RUN, UpdateRate.STEP
_AGENT, _PAIR = UpdateRate.AGENT, UpdateRate.PAIR

KIND_BY_LETTER = {"f": F, "b": BOOL, "i": INDEX, "l": ID, "t": T, "s": SET}


def _build_sense_operation(row: SenseRow) -> Operation:
    attrs = (row.thing_kind, *row.attrs) if row.thing_kind else row.attrs
    return Operation(row.operands, attrs, KIND_BY_LETTER[row.kinds] if len(row.kinds) == 1 else T, _AGENT, row.results_text)


OPERATION_BY_NAME: dict[str, Operation] = {
    # constants and values of the run
    "const": Operation("", ("value",), F, _CONST, "a float32"),
    "const.bool": Operation("", ("value",), BOOL, _CONST, "true or false"),
    "const.i32": Operation("", ("value",), INDEX, _CONST, "a state's index or an item's row"),
    "const.i64": Operation("", ("value",), ID, _CONST, "an agent's id; -1 is none"),
    "param": Operation("", ("name",), F, _RUN, "a param's value in base units"),
    "run": Operation("", ("name",), F, _RUN, "dt (s), u (mm per scene unit), up_x, up_y, up_z (the scene's up)"),
    "step": Operation("", ("name",), F, _STEP, "time (s), frame"),
    "told": Operation("", ("name",), F, _STEP, "a measure of the complete run, which a spec computed for this frame"),
    # elementwise; float32, IEEE, in exactly this order of operations
    "add": Operation("ff", (), F, _CONST, "a + b"),
    "sub": Operation("ff", (), F, _CONST, "a - b"),
    "mul": Operation("ff", (), F, _CONST, "a * b"),
    "div": Operation("ff", (), F, _CONST, "a / b"),
    "neg": Operation("f", (), F, _CONST, "-a"),
    "abs": Operation("f", (), F, _CONST, "|a|"),
    "min": Operation("ff", (), F, _CONST, "the smaller number; if one is NaN, the other"),
    "max": Operation("ff", (), F, _CONST, "the larger number; if one is NaN, the other"),
    "floor": Operation("f", (), F, _CONST, "the largest whole number up to a"),
    "sqrt": Operation("f", (), F, _CONST, "square root; NaN below 0"),
    "sin": Operation("f", (), F, _CONST, "own kernel"),
    "cos": Operation("f", (), F, _CONST, "own kernel"),
    "exp": Operation("f", (), F, _CONST, "own kernel"),
    "log": Operation("f", (), F, _CONST, "own kernel, natural"),
    "pow": Operation("ff", (), F, _CONST, "exp(b log a); whole-number powers of negative a have the right sign"),
    "atan2": Operation("ff", (), F, _CONST, "own kernel"),
    "lt": Operation("xx", (), BOOL, _CONST, "a < b, of the same kind"),
    "le": Operation("xx", (), BOOL, _CONST, "a <= b, of the same kind"),
    "gt": Operation("ff", (), BOOL, _CONST, "a > b"),
    "ge": Operation("ff", (), BOOL, _CONST, "a >= b"),
    "eq": Operation("xx", (), BOOL, _CONST, "a == b, of the same kind"),
    "ne": Operation("xx", (), BOOL, _CONST, "a != b, of the same kind"),
    "and": Operation("bb", (), BOOL, _CONST, "both"),
    "or": Operation("bb", (), BOOL, _CONST, "either"),
    "not": Operation("b", (), BOOL, _CONST, "not"),
    "where": Operation("bxx", (), F, _CONST, "b if a is true, else c; of the kind of b and c"),
    "number": Operation("x", (), F, _CONST, "bool, state or row as float32"),
    "finite": Operation("f", (), F, _CONST, "a, or 0 where it is not finite"),
    "get": Operation("t", ("index",), F, _CONST, "one element of a tuple, of that element's kind"),
    # the agent
    "snap": Operation("", ("register",), F, _AGENT, "a register's value at the start of the step"),
    "load": Operation("", ("register", "version"), F, _AGENT, "a register's value now; `version`: the number of earlier stores"),
    "id": Operation("", (), ID, _AGENT, "the agent's own id"),
    "age": Operation("", (), F, _AGENT, "seconds since birth"),
    "draw": Operation("", ("site", "index"), F, _AGENT, "uniform in [0, 1): a function of seed, frame, species, id, site, index"),
    "draw.agent": Operation("", ("site", "species"), ID, _AGENT, "id of a random living agent of the species; -1 for none"),
    "event": Operation("", ("name",), BOOL, _AGENT, "whether the event reached the agent in the previous step"),
    "surface.touching": Operation("", ("name",), BOOL, _AGENT, "whether the agent is on the surface"),
    # references to other agents and to items
    "agent.get": Operation(
        "l", ("species", "register"), F, _AGENT, "another agent's register at the start of the step; 0 for none"
    ),
    "agent.age": Operation("l", ("species",), F, _AGENT, "another agent's seconds since birth; 0 for none"),
    "agent.alive": Operation("l", ("species",), BOOL, _AGENT, "whether the agent exists"),
    "item.get": Operation("i", ("items", "attribute"), F, _AGENT, "x y z radius or a declared attribute of an item; 0 for none"),
    "item.alive": Operation("i", ("items",), BOOL, _AGENT, "whether the item exists"),
    # senses of the place; the agent's own position at the start of the step
    **{row.op: _build_sense_operation(row) for row in senses.SENSE_BY_OPERATION.values()},
    # sets
    "set.agents": Operation(
        "ff", ("species", "all_round"), SET, _AGENT, "other agents within a radius and an angle (its cosine) of the heading"
    ),
    "set.every": Operation("", ("species",), SET, _AGENT, "all other agents of a species"),
    "set.items": Operation("f", ("items",), SET, _AGENT, "items with their centre within a distance (inf: all)"),
    "other": Operation("", ("register",), F, _PAIR, "the other agent's register at the step's start, or an item's attribute"),
    "other.id": Operation("", (), ID, _PAIR, "the other agent's id"),
    "other.row": Operation("", (), INDEX, _PAIR, "the item's row"),
    "pair.x": Operation("", (), F, _PAIR, "other's x - own x"),
    "pair.y": Operation("", (), F, _PAIR, "other's y - own y"),
    "pair.z": Operation("", (), F, _PAIR, "other's z - own z"),
    "pair.distance": Operation("", (), F, _PAIR, "sqrt((x*x + y*y) + z*z)"),
    # reductions: set, condition (BOOL) and, for some, body. Sums are exact: decision 23 of the language reference
    "reduce.sum": Operation("sbf", ("quantum",), F, _AGENT, "exact sum of terms rounded to multiples of 2**quantum; 0 for none"),
    "reduce.min": Operation("sbf", (), F, _AGENT, "inf for none"),
    "reduce.max": Operation("sbf", (), F, _AGENT, "-inf for none"),
    "reduce.count": Operation("sb", (), F, _AGENT, "how many"),
    "reduce.any": Operation("sb", (), BOOL, _AGENT, "at least one"),
    "reduce.agent": Operation("sbf", (), ID, _AGENT, "id of the agent with the smallest body, then the least id; -1 for none"),
    "reduce.nth_agent": Operation(
        "sbff", (), ID, _AGENT, "id of the agent with the n-th smallest body, n rounded down; -1 for none"
    ),
    "reduce.nth_item": Operation("sbff", (), INDEX, _AGENT, "row of the item with the n-th smallest body, likewise"),
    "reduce.item": Operation("sbf", (), INDEX, _AGENT, "row of the item with the smallest body, then the least row; -1 for none"),
}

TUPLE_KINDS_BY_OPERATION: dict[str, tuple[ValueKind, ...]] = {
    row.op: tuple(KIND_BY_LETTER[letter] for letter in row.kinds)
    for row in senses.SENSE_BY_OPERATION.values()
    if len(row.kinds) > 1
}

# Senses with results that are stored for the step, and computed only for agents that need them.
_REDUCE_OPERATIONS = tuple(name for name in OPERATION_BY_NAME if name.startswith("reduce."))
SENSE_OPERATIONS = frozenset((*senses.SENSE_BY_OPERATION, *_REDUCE_OPERATIONS, "draw.agent"))


@dataclass(frozen=True, slots=True, eq=False)
class Block:
    """Statements that run one after another, for the same agents."""

    statements: tuple[PlanStatement, ...]


@dataclass(frozen=True, slots=True, eq=False)
class If:
    """A region: statements that run only for agents that fulfil `condition`. If the condition is NaN, they do not run."""

    condition: PlanNode
    body: Block
    span: Span | None


@dataclass(frozen=True, slots=True, eq=False)
class Store:
    """Assignment of a value to a register. NaN and infinite values are faults. If `allows_infinity` is true, +inf is allowed
    (decision 24 of the language reference)."""

    register: str
    value: PlanNode
    span: Span | None
    allows_infinity: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class Claim:
    """Claim of an amount from an item's attribute or, if `item` is None, from the cell of the field `target` at the agent.
    `amount`: None claims all that remains. After `decide`, claims are granted in random order (ties by id) as long as enough
    remains. `won_register`: the BOOL register that is true for agents with a granted claim. `register`: the agent's register to
    which the amount is added; None if the amount is not stored."""

    target: str
    attribute: str
    item: PlanNode | None
    amount: PlanNode | None
    won_register: str
    register: str | None
    site: str
    span: Span | None


@dataclass(frozen=True, slots=True, eq=False)
class Give:
    """Transfer of an amount from the agent's register `register` to an item's attribute, which receives it in the next step.
    `amount`: None transfers all. A larger amount than the register's value is reduced to this value."""

    items: str
    attribute: str
    item: PlanNode
    amount: PlanNode | None
    register: str
    span: Span | None


@dataclass(frozen=True, slots=True, eq=False)
class Request:
    """A request for a change in the world, such as a deposit.

    `op`: the name of a row in `program.tables.effects`. `target`: the name of the thing or event. `args`: the operands in the
    order of that row; None if absent. `register`: the agent's register to which the result is added after the step.
    `target_species`: the species of the agent that receives the request; its id is an I64 operand."""

    op: str
    target: str
    args: tuple[PlanNode | None, ...]
    span: Span | None
    register: str | None = None
    site: str = ""
    target_species: str | None = None


PlanStatement = If | Store | Claim | Give | Request


@dataclass(frozen=True, slots=True, eq=False)
class Register:
    """A named value of each agent. `role`: attribute, memory (of a keep, latch, held or machine), temp, or pair (a slot of a
    pair value). A temp lasts one step, and starts each step at `initial_value`. Registers with other roles persist between
    steps and are hashed. `language_type`: the type in the language; () if it has none. A reload retains the value only if the
    edited program declares the same name with the same type."""

    name: str
    kind: ValueKind
    role: str
    initial_value: float | int | bool = 0
    referenced_species: str | None = None  # species of the ids in an I64 register: references to the dead become -1 in it
    language_type: tuple[Any, ...] = ()  # kind, exponents of its dimension, and its species or thing


def format_birth_register_name(attribute: str) -> str:
    """Return the name of the temp with the value that the scene sets for an attribute at birth (infinite if it sets none)."""
    return f"~born.{attribute}"


@dataclass(frozen=True, slots=True, eq=False)
class MachinePlan:
    """A machine. Its registers are NAME.state, NAME.previous, NAME.next (I32) and NAME.time_in_state (F32, seconds).
    `state_labels`, `colours`: the display name and colour (RGB, 0 to 1) of each state. `start`: the index of the start state."""

    name: str
    states: tuple[str, ...]
    state_labels: tuple[str, ...]
    colours: tuple[tuple[float, float, float], ...]
    start: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class LayerPlan:
    """A layer of a species. `text`: its line in the source."""

    text: str
    span: Span


@dataclass(frozen=True, slots=True)
class ClipPlan:
    """A clip of the body. `on`: the transform group that it moves; "" for all joints. `is_additive`: whether the clip's
    differences from the rest pose are added to the other clips. `left_turn_clip`, `right_turn_clip`, `climbing_clip`,
    `descending_clip`: the clips that replace it while the agent turns, climbs or descends; "" if absent."""

    name: str
    on: str = ""
    is_additive: bool = False
    left_turn_clip: str = ""
    right_turn_clip: str = ""
    climbing_clip: str = ""
    descending_clip: str = ""

    @property
    def has_lean_clips(self) -> bool:
        return any((self.left_turn_clip, self.right_turn_clip, self.climbing_clip, self.descending_clip))


@dataclass(frozen=True, slots=True, eq=False)
class SpeciesPlan:
    """The plan of one species. The block `born` fills the registers at birth and runs `on spawn`. Before it runs, position and
    velocity are set. Each step runs `decide`, `act` and `blend` in this order. Claims are resolved between `decide` and
    `act`. A vector NAME consists of three registers: NAME.x, NAME.y and NAME.z. Every species has these registers: position,
    velocity, heading and up (vectors), push (vector, temp), size, mass, radius, clearance, max_speed, max_force, max_turn,
    response and group. An infinite max_turn means no limit. If `response` is 0 or `kinematic`, the push changes the velocity
    at once. All species have `moved` if the program reads how far contacts pushed an agent. A species with a minimum speed
    has min_speed. A species with `face` lines has ~face (vector, temp), zero for agents that face their direction of motion."""

    name: str
    registers: dict[str, Register]
    machines: tuple[MachinePlan, ...]
    born: Block
    decide: Block
    act: Block
    blend: Block
    event_names: tuple[str, ...]
    layers: tuple[LayerPlan, ...]
    memoised_senses: tuple[PlanNode, ...] = ()  # senses with results that are stored for the rest of the step
    pair_rest_values: Mapping[str, PlanNode] = field(default_factory=dict)  # initial and rest value of each pair value; rate RUN
    clips: tuple[ClipPlan, ...] = ()  # clips that its states play; clip registers hold their index
    worn_layers: tuple[str, ...] = ()  # layers of the body that states show: registers `wear#LAYER`
    channels: tuple[str, ...] = ()  # channels that states set: the value `channel#NAME`, and `.said`, whether a state sets it
    look_groups: tuple[str, ...] = ()  # transform groups that states turn towards a point: `look#GROUP.x`, `.y`, `.z`
    has_body_clearance: bool = False  # whether the body, not only the feet, stays outside the ground and obstacles
    has_whole_body: bool = False  # whether head, abdomen and load take room in contacts
    settings: tuple[str, ...] = ()  # the registers among height, upright, max_slope and crouch that move its agents


@dataclass(frozen=True, slots=True, eq=False)
class FieldPlan:
    """The plan of a field. Its nodes have the rate RUN. `cell`: the edge length of a cell (mm). `retained_share`: the factor for
    evaporation per step. `deposits`: whether deposits are added "first" (before diffusion and evaporation) or "last".
    `stencil`: the number of neighbours to which a cell diffuses, 4 or 8."""

    name: str
    surfaces: tuple[str, ...]
    cell: PlanNode
    retained_share: PlanNode | None
    diffuse: PlanNode | None  # mm^2/s
    combine: str
    limit: PlanNode | None
    span: Span
    stencil: int = 4
    deposits: str = "last"
    vector_field: str = ""  # the field of vectors of which this is one component


@dataclass(frozen=True, slots=True, eq=False)
class ItemsPlan:
    name: str
    attributes: dict[str, float]  # declared attributes and their defaults, base units


@dataclass(frozen=True, slots=True, eq=False)
class ParamPlan:
    name: str
    default: PlanNode  # rate RUN at most


@dataclass(frozen=True, slots=True, eq=False, weakref_slot=True)
class Plan:
    """The plan of a complete program: declarations by name, and all nodes. Operands precede the operations that use them."""

    species: dict[str, SpeciesPlan]
    fields: dict[str, FieldPlan]
    items: dict[str, ItemsPlan]
    params: dict[str, ParamPlan]
    thing_names_by_kind: Mapping[str, tuple[str, ...]]  # names of the other things of the world, by their kind
    nodes: tuple[PlanNode, ...] = field(default=())
    period: tuple[float, float, float] | None = None  # widths (mm) of its periodic world, 0 along axes that do not wrap

    def list_things_of_kind(self, *kinds: str) -> tuple[str, ...]:
        """Return the names of all things of one of the kinds `kinds`."""
        return tuple(name for kind in kinds for name in self.thing_names_by_kind.get(kind, ()))

    @property
    def obstacles(self) -> tuple[str, ...]:
        """Return the names of the things that block agents."""
        return self.list_things_of_kind(*BLOCKING_KINDS)
