"""Lowers a program and records which nodes belong to each part of its text: conditions and their parts, layers, choices,
steering.

The plan is the same as without notes, because notes refer to existing nodes and add no statements."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field

from antdsl.diagnostics import Report
from antdsl.plan.builder import PlanBuilder, PlanError
from antdsl.plan.ir import PlanNode
from antdsl.plan.lowering import values
from antdsl.plan.lowering.expressions import lower_condition, lower_expression, lower_presence, lower_scalar
from antdsl.plan.lowering.machines import count_steps, has_state_lasted
from antdsl.plan.lowering.writer import LoweringRules, PlanWriter
from antdsl.program import model
from antdsl.program.tables.units import choose_default_unit, find_unit_measure
from antdsl.source import Span
from antdsl.syntax.words import NUMBER_REGEX, UNITS_REGEX

_JOINING_OPERATIONS = frozenset(("and", "or", "not", "is_some", "is_none", "lt", "le", "gt", "ge", "eq", "ne"))
_NUMBER_WITH_UNIT = re.compile(rf"(?<![\w.]){NUMBER_REGEX}[ \t]*({UNITS_REGEX})")
_MAX_NOTED_DEPTH = 6  # maximum depth of recorded nested parts
_BOOL_TYPE = model.ValueType(model.TypeKind.BOOL)
_NUMBER_TYPE = model.ValueType(model.TypeKind.NUMBER)


@dataclass(frozen=True, slots=True, eq=False)
class ExpressionNote:
    """A part of an expression in the source, with the nodes that compute it.

    - `nodes`: one node, or three for a vector.
    - `unit`: the unit for display. It is from the text of the same expression, or a default unit.
    - `role`: `draw` for the random number of a `chance`, and `bar` for the limit with which this number is compared. `joined`
      for an operation such as `and` or `<` that only joins its parts. "" for other parts."""

    text: str
    type: model.ValueType
    unit: str
    nodes: tuple[PlanNode, ...]
    parts: tuple[ExpressionNote, ...] = ()
    role: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class TimerNote:
    """A waiting time of a transition.

    `timer_kind`: held, after or at least. `elapsed`, `required`: the nodes of the elapsed and the required time, in steps for
    `held`, otherwise in seconds. `is_over`: the node that is true when the required time has elapsed."""

    timer_kind: str
    elapsed: PlanNode
    required: PlanNode
    is_over: PlanNode


@dataclass(frozen=True, slots=True, eq=False)
class ChangeNote:
    """A transition of a state. `number`: its number in the machine, from 1. `is_taken`: the node that is true if the transition
    happens.

    `condition`: a note about the condition and its parts. `condition_value`: the node of the condition's value. Both are None if
    the transition has no condition."""

    machine: str
    number: int
    state: model.State
    transition: model.Transition
    is_taken: PlanNode
    condition: ExpressionNote | None
    condition_value: PlanNode | None
    timers: tuple[TimerNote, ...]
    take_note: ExpressionNote | None


@dataclass(frozen=True, slots=True, eq=False)
class ChoiceNote:
    """The choice of a transition among several states: the random draw, and for each state its index and weight."""

    key: str
    draw: PlanNode
    weights: tuple[tuple[int, PlanNode], ...]


@dataclass(frozen=True, slots=True, eq=False)
class LayerNote:
    """A layer in the source. `budget_left`: the node of the strength that earlier layers have left for it. `has_budget`: the
    node that is true if this strength is above 0."""

    layer: model.Layer
    budget_left: PlanNode
    has_budget: PlanNode
    condition: ExpressionNote | None
    condition_value: PlanNode
    push: tuple[PlanNode, PlanNode, PlanNode]


RESTING_TEXT = "no line of this state steers, so the agent stands still, as with halt()"


def make_resting_site(species: str) -> str:
    """Return the key that stands for the push of agents in states that do not steer, in place of a line's key."""
    return f"{species}.rest#1"


@dataclass(frozen=True, slots=True, eq=False)
class SteerNote:
    """A `steer` or `face` line. `site`: its key, such as `SPECIES.MACHINE.STATE#1` or `SPECIES.layers.face#1`, or the result of
    `make_resting_site`."""

    site: str
    text: str
    push: tuple[PlanNode, PlanNode, PlanNode]
    condition_value: PlanNode | None = None  # whether the condition of a layer holds


@dataclass(slots=True, eq=False)
class SourceNotes:
    """The nodes that belong to parts of the source text of one species: transitions, choices by key, layers, and `steer` and
    `face` lines."""

    changes: list[ChangeNote] = field(default_factory=list)
    choices: dict[str, ChoiceNote] = field(default_factory=dict)
    layers: list[LayerNote] = field(default_factory=list)
    steers: list[SteerNote] = field(default_factory=list)


class NotingWriter(PlanWriter):
    """Writer that writes the same plan as PlanWriter and also records notes."""

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

    def note_transition(
        self, machine: str, number: int, state: model.State, transition: model.Transition, is_taken: PlanNode
    ) -> None:
        statement_count = len(self.statements)
        condition = (
            None
            if transition.condition is None
            else self._make_part_note(transition.condition, _find_written_units(transition.span))
        )
        holds = None if transition.condition is None else lower_condition(self, transition.condition)
        take = (
            None
            if transition.take_action is None or transition.take_action.source.type.kind is model.TypeKind.FIELD
            else self._make_part_note(transition.take_action.source, [])
        )
        timers = tuple(self._make_timer_notes(machine, state, transition))
        if len(self.statements) != statement_count:
            raise PlanError(f"the statement comes from a note, not from the program: {transition.span.text!r}")
        self.notes.changes.append(ChangeNote(machine, number, state, transition, is_taken, condition, holds, timers, take))

    def _make_timer_notes(self, machine: str, state: model.State, t: model.Transition) -> Iterator[TimerNote]:
        if t.hold_time is not None:
            held_time, needs = self.read_previous(f"{t.key}.held"), count_steps(self, lower_scalar(self, t.hold_time))
            yield TimerNote("held", held_time, needs, self.b("ge", held_time, needs))
        time_in_state = self.read_at_step_start(f"{machine}.time_in_state")
        if t.delay is not None:
            yield TimerNote("after", time_in_state, lower_scalar(self, t.delay), has_state_lasted(self, machine, t.delay))
        if state.min_duration is not None and not t.is_interrupt:
            yield TimerNote(
                "at least",
                time_in_state,
                lower_scalar(self, state.min_duration),
                has_state_lasted(self, machine, state.min_duration),
            )

    def note_state_choice(self, key: str, draw: PlanNode, weights: list[tuple[int, PlanNode]]) -> None:
        self.notes.choices[key] = ChoiceNote(key, draw, tuple(weights))

    def note_layer(
        self, layer: model.Layer, budget_left: PlanNode, has_budget: PlanNode, condition_value: PlanNode, push: values.VectorNodes
    ) -> None:
        statement_count = len(self.statements)
        condition = (
            None if layer.condition is None else self._make_part_note(layer.condition, _find_written_units(layer.condition.span))
        )
        if len(self.statements) != statement_count:
            raise PlanError(f"the statement comes from a note, not from the program: {layer.text!r}")
        self.notes.layers.append(LayerNote(layer, budget_left, has_budget, condition, condition_value, (push.x, push.y, push.z)))

    def note_steering(
        self,
        s: model.Steer | model.FaceLine | model.Layer,
        site: str,
        push: values.VectorNodes,
        condition_value: PlanNode | None = None,
    ) -> None:
        self.notes.steers.append(SteerNote(site, _join_lines(s.span.text), (push.x, push.y, push.z), condition_value))

    def note_resting_push(self, rest: model.RestingPush, push: values.VectorNodes) -> None:
        self.notes.steers.append(SteerNote(make_resting_site(self.species.name), RESTING_TEXT, (push.x, push.y, push.z)))

    # --- parts -------------------------------------------------------------------------------------------------------

    def _make_part_note(self, e: model.Expr, units: list[str], depth: int = 0) -> ExpressionNote | None:
        """Return a note about an expression and the parts on which it depends. Return None for an expression that has no value,
        such as a species or a field."""
        value = lower_expression(self, e)
        text, type = _join_lines(e.span.text), e.type
        parts: tuple[ExpressionNote, ...] = ()
        if isinstance(value, values.NamedThing | values.OwnPosition | values.SetElement):
            return None
        if isinstance(value, values.VectorNodes):
            return ExpressionNote(text, type, _choose_display_unit(e, units, self.program), tuple(value))
        if isinstance(value, values.EntityRef):
            return ExpressionNote(text, model.ValueType(value.kind, referent=value.owner), "", (value.node,))
        if isinstance(value, values.RayHit):
            nearness = ExpressionNote(
                "distance", model.ValueType(model.TypeKind.NUMBER, model.Dimension(length=1)), "mm", (value.distance,)
            )
            return ExpressionNote(text, _BOOL_TYPE, "", (value.hit,), (nearness,))
        if not isinstance(value, PlanNode):
            return ExpressionNote(text, _BOOL_TYPE, "", (lower_presence(self, value, e),))
        if depth < _MAX_NOTED_DEPTH:
            parts = tuple(self._make_inner_notes(e, value, units, depth + 1))
        joined = isinstance(e, model.OperationExpr) and e.name in _JOINING_OPERATIONS and bool(parts)
        return ExpressionNote(
            text, type, _choose_display_unit(e, units, self.program), (value,), parts, "joined" if joined else ""
        )

    def _make_inner_notes(self, e: model.Expr, node: PlanNode, units: list[str], depth: int) -> Iterator[ExpressionNote]:
        if isinstance(e, model.OperationExpr) and e.name == "chance" and node.op == "lt":
            yield ExpressionNote("draw", _NUMBER_TYPE, "", node.args[:1], role="draw")
            yield ExpressionNote("bar", _NUMBER_TYPE, "", node.args[1:], role="bar")
        named: set[str] = set()
        for inner, written in _iterate_inner_parts(e, units):
            outer = self.is_snapshot
            self.is_snapshot = outer or (isinstance(e, model.BindingRef) and e.binding.is_snapshot and not self.is_birth)
            try:
                part = self._make_part_note(inner, written, depth)
            finally:
                self.is_snapshot = outer
            if part is not None and part.text not in named:
                named.add(part.text)
                yield part


def _iterate_inner_parts(e: model.Expr, units: list[str]) -> Iterator[tuple[model.Expr, list[str]]]:
    """Yield the parts of an expression that are worth displaying, each with the units in its text.

    These parts are the sides of a comparison, names in a sum, and the values of `let`s."""
    if isinstance(e, model.BindingRef) and e.binding.role == "let" and e.binding.value is not None:
        if isinstance(e.binding.value, model.OperationExpr):
            yield from _iterate_inner_parts(e.binding.value, _find_written_units(e.binding.value.span))
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
            yield from _iterate_inner_parts(arg, units)


def _join_lines(text: str) -> str:
    return " ".join(text.split())


def _find_written_units(span: Span) -> list[str]:
    """Return the units that follow numbers in the text of a span."""
    return _NUMBER_WITH_UNIT.findall(span.text)


def _choose_display_unit(e: model.Expr, units: list[str], program: model.Program) -> str:
    """Return the unit in which to display a number. A param has its own unit. Otherwise, it is the first unit in the text that
    fits, or else a default unit."""
    if e.type.kind not in (model.TypeKind.NUMBER, model.TypeKind.VECTOR):
        return ""
    if isinstance(e, model.ParamRef) and e.name in program.params:
        units = [program.params[e.name].unit, *units]
    for unit in units:
        known = find_unit_measure(unit) if unit else None
        if known is not None and known.dim == e.type.dimension:
            return unit
    return choose_default_unit(e.type.dimension)
