"""The classes of the syntax tree of a `.ant` file. It matches the source: names are not resolved and units are not interpreted.

Every node has a `span`. A name is a `Name(text, span)`, never a bare string. Nodes are immutable and compare by identity."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TypeVar, dataclass_transform

from antdsl.source import Source, Span
from antdsl.syntax.editions import EDITIONS, NEWEST_EDITION
from antdsl.syntax.words import FIELD_VALUE_WORDS

NodeType = TypeVar("NodeType")


@dataclass_transform(frozen_default=True, eq_default=False)
def make_node_class(cls: type[NodeType]) -> type[NodeType]:
    """Make a class of nodes an immutable dataclass with slots. Its objects compare by identity."""
    return dataclass(frozen=True, slots=True, eq=False, repr=False)(cls)


@make_node_class
class Name:
    text: str
    span: Span


@make_node_class
class Text:
    """A string in quotes. `text`: the string without quotes."""

    text: str
    span: Span


@make_node_class
class Comment:
    """A comment from `#` to the end of its line. Its text includes the `#`."""

    text: str
    span: Span


# --- expressions -----------------------------------------------------------------------------------------------------


@make_node_class
class Number:
    value: float
    span: Span


@make_node_class
class Quantity:
    """A number with a unit. For example, `30 mm/s` has the value 30 and the unit `mm/s`. `unit_span`: the location of only the
    unit."""

    value: float
    unit: str
    unit_span: Span
    span: Span


@make_node_class
class NameRef:
    """A bare name that is used as a value, such as a variable, `state`, `self`, `up` or `previous`."""

    name: Name
    span: Span


@make_node_class
class Member:
    """A name after a dot, such as `load` in `food.load` or `wander` in `mine.wander`."""

    owner: Expr
    name: Name
    span: Span


@make_node_class
class Index:
    """A value in square brackets, such as `likes[other]`."""

    owner: Expr
    index: Expr
    span: Span


@make_node_class
class IndexAll:
    """All values of a pair value about the members of the set `over`, as in `likes[n in SET]`. Only allowed on the left of an
    assignment."""

    owner: Expr
    variable: Name
    over: Expr
    span: Span


@make_node_class
class Argument:
    """One argument of a call. `name`: the name, if the argument has the form `reach: 3`. The value may be a `RangeExpr`."""

    name: Name | None
    value: Expr
    span: Span


@make_node_class
class Comprehension:
    """The single argument of a call such as `sum(n in SET: EXPR)`. `over`: the set. `body`: the expression."""

    variable: Name
    over: Expr
    body: Expr
    span: Span


@make_node_class
class Call:
    """A call, as in `function(arguments)`. `function`: a NameRef or a Member."""

    function: Expr
    arguments: tuple[Argument | Comprehension, ...]
    span: Span


@make_node_class
class Unary:
    """An operation on one operand: `-x`, `not x`, `no x` (x is none, or an empty set) or `chance x`. `op`: the word or sign."""

    op: str
    operand: Expr
    op_span: Span
    span: Span


@make_node_class
class Binary:
    """An operation on two operands. `op`: one of `+ - * / ^ < <= > >= == != and or`."""

    op: str
    left: Expr
    right: Expr
    op_span: Span
    span: Span


@make_node_class
class IsNone:
    """A test for none: `x is none` or `x is not none`."""

    operand: Expr
    is_negated: bool
    span: Span


@make_node_class
class ClipTest:
    """A test of the clip that the agent's state plays: `clip done` (`name` is `done`), or `clip at MARK` with `at` true."""

    name: Name
    at: bool
    span: Span


@make_node_class
class IfElse:
    condition: Expr
    then: Expr
    otherwise: Expr
    span: Span


@make_node_class
class RangeExpr:
    """A range such as `0 mm .. 200 mm`. It is only allowed as an argument, after `in`, or in `seeds`."""

    low: Expr
    high: Expr
    span: Span


@make_node_class
class PairOf:
    """The expression `friend to foe`, which is reserved."""

    left: Expr
    right: Expr
    span: Span


@make_node_class
class NoneOf:
    """The value `none`, or `none of food`."""

    of: Name | None
    span: Span


@make_node_class
class BadExpr:
    """A placeholder for an expression that could not be read. The error is already reported."""

    span: Span


Expr = (
    Number
    | Quantity
    | NameRef
    | Member
    | Index
    | Call
    | Unary
    | Binary
    | IsNone
    | ClipTest
    | IfElse
    | RangeExpr
    | PairOf
    | NoneOf
    | BadExpr
)


# --- types as written ------------------------------------------------------------------------------------------------


@make_node_class
class TypeName:
    """The name of a type, such as `length`, `push`, or `item of food` (with `of`). `field to …` is reserved."""

    name: Name
    of: Name | None
    span: Span


# --- statements ------------------------------------------------------------------------------------------------------


@make_node_class
class Steer:
    push: Expr
    span: Span


@make_node_class
class Face:
    """A line `face e`, which turns the body towards `e`."""

    push: Expr
    span: Span


@make_node_class
class Assign:
    """An assignment: `x = e`, `x += e` or `x -= e`. `target`: a NameRef, Member, Index or IndexAll."""

    target: Expr | IndexAll
    op: str
    value: Expr
    span: Span


@make_node_class
class VerbLine:
    """A line that begins with a verb of `antdsl.syntax.verbs`.
    - `arguments`: as in `spawn worker` or `carve hill(radius: 2 mm)`. `die` has none.
    - `amount`: as in `deposit trail 2 /s` or `channel jaw = load`.
    - `to`: as in `emit hit to other`. `when`: as in `wear load when load > 0`."""

    verb: str
    name: Name | None
    amount: Expr | None
    arguments: tuple[Argument | Comprehension, ...]
    to: Expr | None
    span: Span
    when: Expr | None = None


@make_node_class
class Give:
    """A line that gives an amount to an item, such as `give 1 load to nest` or `give all load to nest`. `amount`: None to give
    all."""

    amount: Expr | None
    attribute: Name
    to: Expr
    span: Span


Action = Assign | VerbLine | Give


@make_node_class
class Take:
    """A line that takes an amount from an item or a field. `amount`: None to take all. Without an `attribute`, the item is
    removed."""

    amount: Expr | None
    attribute: Name | None
    source: Expr
    span: Span


@make_node_class
class Weight:
    """A line of `choose { … }`: a state and its weight in the random choice."""

    target: Name
    weight: Expr
    span: Span


@make_node_class
class Target:
    """The target of a transition: a named state, `previous`, or one of the `choices` of `choose { … }`."""

    name: Name | None
    is_previous: bool
    choices: tuple[Weight, ...]
    span: Span


@make_node_class
class Change:
    """A transition from one state to another.

    - `interrupt`: whether the line begins with `interrupt`.
    - `delay`: the time of `when after 0.5 s`, which has no `condition`.
    - `held`: how long the condition must have held.
    - `over`: the time in which the previous clip fades out.
    - `any_except`: for a `from any` transition, the states after `except`, as in `from any except a, b when …`. None for a
      transition inside a state."""

    interrupt: bool
    condition: Expr | None
    delay: Expr | None
    held: Expr | None
    take: Take | None
    target: Target
    over: Expr | None
    actions: tuple[Action, ...]
    any_except: tuple[Name, ...] | None
    span: Span


@make_node_class
class Let:
    name: Name
    value: Expr
    help: Text | None
    span: Span


@make_node_class
class Measure(Let):
    """A number or a condition about the complete run, which each run reports."""


@make_node_class
class State:
    """A state, as in `state NAME "label" colour { … }`. `at_least`: the shortest time that an agent stays in the state."""

    name: Name
    label: Text | None
    colour: Name | None
    at_least: Expr | None
    body: tuple[Steer | Face | Action | Change | Let, ...]  # in text order
    enter: tuple[Action, ...]
    exit: tuple[Action, ...]
    span: Span


# --- members of a species --------------------------------------------------------------------------------------------


@make_node_class
class Relax:
    """The clause `relax to V over T` in the declaration of an attribute."""

    to: Expr
    over: Expr
    span: Span


@make_node_class
class ForEach:
    """The clause `for each S, strongest N`, which declares a pair value about at most N agents of the species S."""

    species: Name
    strongest: Expr | None
    span: Span


@make_node_class
class Declaration:
    """A declaration of an attribute, a param or an item's attribute. The full form is `NAME: TYPE = V in LOW .. HIGH relax to V
    over T for each S, strongest N "help"`."""

    name: Name
    type: TypeName | None
    value: Expr
    range: RangeExpr | None
    relax: Relax | None
    each: ForEach | None
    help: Text | None
    span: Span


@make_node_class
class ParamDecl:
    declaration: Declaration
    span: Span


@make_node_class
class AnimalProperty:
    """A property of an agent that is set without `=`, such as `size 4 mm`."""

    name: Name
    value: Expr
    help: Text | None
    span: Span


@make_node_class
class Latch:
    """A bool with memory: `latch NAME = ON until UNTIL` turns on when `ON` holds, and off when `UNTIL` holds."""

    name: Name
    on: Expr
    until: Expr
    span: Span
    help: Text | None = None


@make_node_class
class Rule:
    condition: Expr
    value: Expr
    span: Span


@make_node_class
class Fuzzy:
    name: Name
    rules: tuple[Rule, ...]
    span: Span
    help: Text | None = None


@make_node_class
class Start:
    state: Name
    span: Span


@make_node_class
class On:
    """A handler: `on EVENT { … }`, `on collision(other) { … }` or `on collision(other: SPECIES) { … }`."""

    event: Name
    variable: Name | None
    species: Name | None
    actions: tuple[Action, ...]
    span: Span


@make_node_class
class Layer:
    """A line of `layers`. `is_face_line`: whether it begins with `face`; such a line only turns the body."""

    push: Expr
    condition: Expr | None
    span: Span
    is_face_line: bool = False  # `face e`


@make_node_class
class Layers:
    """The block `layers { … }`. `mode`: the word that says how the layers are combined; None for the default."""

    mode: Name | None  # `sum`, `first`; None is the budget
    layers: tuple[Layer, ...]
    span: Span


@make_node_class
class Machine:
    name: Name
    members: tuple[State | Start | Change | Let | Latch, ...]
    span: Span
    help: Text | None = None


SpeciesMember = ParamDecl | Declaration | AnimalProperty | Let | Latch | Fuzzy | Start | On | Layers | Machine | State | Change


# --- the top of a file -----------------------------------------------------------------------------------------------


@make_node_class
class Use:
    """A `use` line: `use steering` (`library`) or `use "./mine.ant" as mine` (`path`, `alias`)."""

    library: Name | None
    path: Text | None
    alias: Name | None
    span: Span


@make_node_class
class WorldItem:
    """The declaration of a thing in `world`, such as `surface ground "help"` or `items food { load = 0 }`. `kind`: the first
    word."""

    kind: Name
    name: Name
    attributes: tuple[Declaration, ...]
    help: Text | None
    span: Span


@make_node_class
class World:
    items: tuple[WorldItem, ...]
    span: Span


@make_node_class
class Setting:
    """A line with a setting of a field, such as `cell 4 mm`."""

    name: Name
    value: Expr
    span: Span


@make_node_class
class FieldDecl:
    """The declaration of a field, such as `field way: push on floor { … }`. `value_type`: the type of its cells; None for
    numbers."""

    name: Name
    surfaces: tuple[Name, ...]
    settings: tuple[Setting, ...]
    span: Span
    help: Text | None = None
    value_type: TypeName | None = None

    @property
    def has_vectors(self) -> bool:
        """Return whether the cells hold vectors. Unknown types count as vectors, because they are reported elsewhere."""
        return self.value_type is not None and self.value_type.name.text != FIELD_VALUE_WORDS[0]


@make_node_class
class Species:
    name: Name
    members: tuple[SpeciesMember, ...]
    help: Text | None
    span: Span


@make_node_class
class BehaviourArgument:
    name: Name
    type: TypeName
    default: Expr | None
    span: Span


@make_node_class
class Keep:
    """A memory: `keep x: T = FIRST then NEXT`."""

    name: Name
    type: TypeName | None
    first: Expr
    then: Expr
    span: Span


@make_node_class
class Behaviour:
    name: Name
    arguments: tuple[BehaviourArgument, ...]
    returns: TypeName
    help: Text | None
    body: tuple[Keep | Let, ...]
    result: Expr
    span: Span


@make_node_class
class SpecLine:
    """A line of a spec.

    - `kind`: the word `for`, `seeds`, `pass`, `set`, `against`, `always`, `never`, `eventually`, `finally`, `sooner`, `within`,
      `goal`, `until` or `each`.
    - `target`: the name that `set` changes, the species of `each` (a NameRef), or the scene of `against` (a Text).
    - `time`: the time of `for` and `within`, or the tolerance of `goal`. A `for` without a condition sets the length of the run.
    - `condition`: the condition of an expectation, or the value of `seeds` (a number or a range), `pass` or `set`.
    - `lines`: the lines inside `each` or `against`. `held`: how long the condition must have held.
    - `since`: the condition of `when`. The time starts when it becomes true."""

    kind: str
    target: Expr | Text | None
    time: Expr | None
    condition: Expr | None
    lines: tuple[SpecLine, ...]
    span: Span
    held: Expr | None = None
    since: Expr | None = None


@make_node_class
class Spec:
    name: Text
    scene: Text | None
    lines: tuple[SpecLine, ...]
    span: Span


TopItem = Use | World | FieldDecl | Species | Behaviour | Spec | Measure


@make_node_class
class File:
    """One parsed file.

    - `items`: the items that could be read, in text order, even if other parts of the file have errors.
    - `skipped_spans`: the locations of lines that were skipped or repaired. The report of parsing has an error for each.
    - `has_errors`: whether the report of parsing has an error.
    - `parts`: the separately parsed parts of the file, with their offsets in the file."""

    source: Source
    edition: Number | None
    help: Text | None
    items: tuple[TopItem, ...]
    comments: tuple[Comment, ...] = field(default=())
    skipped_spans: tuple[Span, ...] = field(default=())
    has_errors: bool = field(default=False)
    parts: Mapping[Source, int] = field(default_factory=dict)

    @property
    def edition_number(self) -> int:
        """Return the edition that the file names. If it names no edition or an unknown one, return the newest edition."""
        exists = self.edition is not None and self.edition.value in EDITIONS
        return int(self.edition.value) if self.edition is not None and exists else NEWEST_EDITION

    def file_span(self, span: Span) -> Span:
        """Return a span in one of the file's `parts`, converted to a span in the complete file."""
        base = self.parts.get(span.source)
        return span if base is None else Span(self.source, base + span.start, base + span.end)
