"""Lowers a program and records the nodes of parts of its text: conditions and their parts, layers, choices, steering.

The plan is unchanged: a note refers to existing nodes and writes no statement."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field

from antdsl.diagnostics import Report
from antdsl.plan.builder import PlanBuilder, PlanError
from antdsl.plan.ir import PlanNode
from antdsl.plan.lowering import values
from antdsl.plan.lowering.expressions import lower, presence, scalar, truth
from antdsl.plan.lowering.machines import has_passed, steps
from antdsl.plan.lowering.writer import LoweringRules, PlanWriter
from antdsl.program import model
from antdsl.program.tables.units import default_unit, measure
from antdsl.source import Span
from antdsl.syntax.words import NUMBER_REGEX, UNITS_REGEX

_JOINING_OPERATIONS = frozenset(("and", "or", "not", "is_some", "is_none", "lt", "le", "gt", "ge", "eq", "ne"))
_NUMBER_WITH_UNIT = re.compile(rf"(?<![\w.]){NUMBER_REGEX}[ \t]*({UNITS_REGEX})")
_MAX_NOTED_DEPTH = 6  # levels of nested parts that are noted
_BOOL_TYPE = model.ValueType(model.TypeKind.BOOL)
_NUMBER_TYPE = model.ValueType(model.TypeKind.NUMBER)


@dataclass(frozen=True, slots=True, eq=False)
class PartNote:
    """A part of an expression.

    - `nodes`: one node, or three for a vector.
    - `unit`: a unit that the author wrote in the same expression, or a default one.
    - `role`: `draw`: the random number of a `chance`. `bar`: the limit that it is compared with. `joined`: an operation such as
      `and` or `<` that only joins its parts. "" otherwise."""

    text: str
    type: model.ValueType
    unit: str
    nodes: tuple[PlanNode, ...]
    parts: tuple[PartNote, ...] = ()
    role: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class TimerNote:
    """A waiting time. `what`: held, after or at least. `has`, `needs`: the elapsed and the required time, in steps for held, in
    seconds otherwise."""

    what: str
    has: PlanNode
    needs: PlanNode
    holds: PlanNode


@dataclass(frozen=True, slots=True, eq=False)
class ChangeNote:
    """A transition of a state. `number`: its number in the machine, from 1. `condition`: None is always true. `fires`: whether it
    happens."""

    machine: str
    number: int
    state: model.State
    transition: model.Transition
    fires: PlanNode
    condition: PartNote | None
    holds: PlanNode | None
    timers: tuple[TimerNote, ...]
    take: PartNote | None


@dataclass(frozen=True, slots=True, eq=False)
class ChoiceNote:
    """The choice of a transition to one of several states: the random draw, and the weight of each state by its index."""

    key: str
    draw: PlanNode
    weights: tuple[tuple[int, PlanNode], ...]


@dataclass(frozen=True, slots=True, eq=False)
class LayerNote:
    """A layer. `left`: the budget that earlier layers have left. `looked`: whether `left` is above 0."""

    layer: model.Layer
    left: PlanNode
    looked: PlanNode
    condition: PartNote | None
    holds: PlanNode
    push: tuple[PlanNode, PlanNode, PlanNode]


RESTING_TEXT = "no line steers, so the agent does not move: halt()"


def resting_site(species: str) -> str:
    """Return the key of the push of agents in states that do not steer."""
    return f"{species}.rest#1"


@dataclass(frozen=True, slots=True, eq=False)
class SteerNote:
    """A `steer` or `face` line. `site`: its key, `SPECIES.MACHINE.STATE#1`, `SPECIES.layers.face#1`, or the result of
    `resting_site`."""

    site: str
    text: str
    push: tuple[PlanNode, PlanNode, PlanNode]
    holds: PlanNode | None = None  # whether the condition of a layer holds


@dataclass(slots=True, eq=False)
class SourceNotes:
    """The notes about one species."""

    changes: list[ChangeNote] = field(default_factory=list)
    choices: dict[str, ChoiceNote] = field(default_factory=dict)
    layers: list[LayerNote] = field(default_factory=list)
    steers: list[SteerNote] = field(default_factory=list)


class NotingWriter(PlanWriter):
    """Writes the same plan as PlanWriter, and records notes."""

    def __init__(
        self,
        builder: PlanBuilder,
        program: model.Program,
        species: model.Species,
        report: Report,
        rules: LoweringRules,
        notes: SourceNotes,
    ) -> None:
        super().__init__(builder, program, species, report, rules)
        self.notes = notes

    def note_transition(self, machine: str, number: int, state: model.State, t: model.Transition, fires: PlanNode) -> None:
        statement_count = len(self.statements)
        condition = None if t.condition is None else self._part_note(t.condition, _written_units(t.span))
        holds = None if t.condition is None else truth(self, t.condition)
        take = None if t.take is None or t.take.source.type.kind is model.TypeKind.FIELD else self._part_note(t.take.source, [])
        timers = tuple(self._timer_notes(machine, state, t))
        if len(self.statements) != statement_count:
            raise PlanError(f"a note wrote a statement: {t.span.text!r}")
        self.notes.changes.append(ChangeNote(machine, number, state, t, fires, condition, holds, timers, take))

    def _timer_notes(self, machine: str, state: model.State, t: model.Transition) -> Iterator[TimerNote]:
        if t.held is not None:
            held_time, needs = self.read_previous(f"{t.key}.held"), steps(self, scalar(self, t.held))
            yield TimerNote("held", held_time, needs, self.b("ge", held_time, needs))
        time_in_state = self.read(f"{machine}.time_in_state")
        if t.delay is not None:
            yield TimerNote("after", time_in_state, scalar(self, t.delay), has_passed(self, machine, t.delay))
        if state.at_least is not None and not t.interrupt:
            yield TimerNote("at least", time_in_state, scalar(self, state.at_least), has_passed(self, machine, state.at_least))

    def note_choice(self, key: str, draw: PlanNode, weights: list[tuple[int, PlanNode]]) -> None:
        self.notes.choices[key] = ChoiceNote(key, draw, tuple(weights))

    def note_layer(self, layer: model.Layer, left: PlanNode, looked: PlanNode, holds: PlanNode, push: values.VectorNodes) -> None:
        statement_count = len(self.statements)
        condition = None if layer.condition is None else self._part_note(layer.condition, _written_units(layer.condition.span))
        if len(self.statements) != statement_count:
            raise PlanError(f"a note wrote a statement: {layer.text!r}")
        self.notes.layers.append(LayerNote(layer, left, looked, condition, holds, (push.x, push.y, push.z)))

    def note_steering(
        self, s: model.Steer | model.FaceLine | model.Layer, site: str, push: values.VectorNodes, holds: PlanNode | None = None
    ) -> None:
        self.notes.steers.append(SteerNote(site, _single_line(s.span.text), (push.x, push.y, push.z), holds))

    def note_rest(self, rest: model.RestingPush, push: values.VectorNodes) -> None:
        self.notes.steers.append(SteerNote(resting_site(self.species.name), RESTING_TEXT, (push.x, push.y, push.z)))

    # --- parts -------------------------------------------------------------------------------------------------------

    def _part_note(self, e: model.Expr, units: list[str], depth: int = 0) -> PartNote | None:
        """Return an expression with the parts that determine it; None for expressions without a value (a species, a field)."""
        value = lower(self, e)
        text, type = _single_line(e.span.text), e.type
        parts: tuple[PartNote, ...] = ()
        if isinstance(value, values.NamedThing | values.OwnPlace | values.SetElement):
            return None
        if isinstance(value, values.VectorNodes):
            return PartNote(text, type, _display_unit(e, units, self.program), tuple(value))
        if isinstance(value, values.EntityRef):
            return PartNote(text, model.ValueType(value.what, of=value.of), "", (value.node,))
        if isinstance(value, values.RayHit):
            nearness = PartNote(
                "distance", model.ValueType(model.TypeKind.NUMBER, model.Dimension(length=1)), "mm", (value.distance,)
            )
            return PartNote(text, _BOOL_TYPE, "", (value.hit,), (nearness,))
        if not isinstance(value, PlanNode):
            return PartNote(text, _BOOL_TYPE, "", (presence(self, value, e),))
        if depth < _MAX_NOTED_DEPTH:
            parts = tuple(self._inner_notes(e, value, units, depth + 1))
        joined = isinstance(e, model.OperationExpr) and e.name in _JOINING_OPERATIONS and bool(parts)
        return PartNote(text, type, _display_unit(e, units, self.program), (value,), parts, "joined" if joined else "")

    def _inner_notes(self, e: model.Expr, node: PlanNode, units: list[str], depth: int) -> Iterator[PartNote]:
        if isinstance(e, model.OperationExpr) and e.name == "chance" and node.op == "lt":
            yield PartNote("draw", _NUMBER_TYPE, "", node.args[:1], role="draw")
            yield PartNote("bar", _NUMBER_TYPE, "", node.args[1:], role="bar")
        named: set[str] = set()
        for inner, written in _inner_parts(e, units):
            outer = self.snapshot
            self.snapshot = outer or (isinstance(e, model.BindingRef) and e.binding.snapshot and not self.born)
            try:
                part = self._part_note(inner, written, depth)
            finally:
                self.snapshot = outer
            if part is not None and part.text not in named:
                named.add(part.text)
                yield part


def _inner_parts(e: model.Expr, units: list[str]) -> Iterator[tuple[model.Expr, list[str]]]:
    """Yield the parts of an expression that are worth displaying, each with its units: sides of a comparison, names in a sum, the
    values of `let`s."""
    if isinstance(e, model.BindingRef) and e.binding.role == "let" and e.binding.value is not None:
        if isinstance(e.binding.value, model.OperationExpr):
            yield from _inner_parts(e.binding.value, _written_units(e.binding.value.span))
        return
    if not isinstance(e, model.OperationExpr):
        return
    for arg in e.args:
        if (
            arg is None
            or arg.rate is model.ChangeRate.ELEMENT
            or isinstance(arg, model.Constant | model.StateConstant | model.NoneRef)
        ):
            continue
        if e.name in _JOINING_OPERATIONS or isinstance(
            arg, model.BindingRef | model.AttributeRef | model.ParamRef | model.ReduceExpr
        ):
            yield arg, units
        else:
            yield from _inner_parts(arg, units)


def _single_line(text: str) -> str:
    return " ".join(text.split())


def _written_units(span: Span) -> list[str]:
    """Return the units after numbers in the text of a span."""
    return _NUMBER_WITH_UNIT.findall(span.text)


def _display_unit(e: model.Expr, units: list[str], program: model.Program) -> str:
    """Return a unit for a number: the unit of the param itself, the first unit of its dimension in the text, or a default one."""
    if e.type.kind not in (model.TypeKind.NUMBER, model.TypeKind.VECTOR):
        return ""
    if isinstance(e, model.ParamRef) and e.name in program.params:
        units = [program.params[e.name].unit, *units]
    for unit in units:
        known = measure(unit) if unit else None
        if known is not None and known.dim == e.type.dim:
            return unit
    return default_unit(e.type.dim)
