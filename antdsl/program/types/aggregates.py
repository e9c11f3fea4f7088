"""Determines the types of expressions that only specs can use, such as `total(food.load)`, `share(state == carry)` or
`initial_count`."""

from __future__ import annotations

from collections.abc import Callable, Container
from dataclasses import replace
from typing import cast

from antdsl.program.expectations import (
    GEOMETRY_MEASURES,
    MOTION_MEASURES,
    AggregateExpr,
    BodyMeasure,
    CellValue,
    MeasureValue,
    MotionMeasure,
    ReferenceRunValue,
    StartValue,
    TimeOf,
)
from antdsl.program.kinds import BOOL_TYPE, NUMBER_TYPE, TIME_TYPE
from antdsl.program.model import ChangeRate, Dimension, Expr, TypeKind, ValueType
from antdsl.program.names.scope import (
    Declarations,
    NameScope,
    find_attributes,
    list_names,
    make_bad_expression,
    parse_type_words,
    suggest_name,
)
from antdsl.program.tables.set_senses import SET_RESULT_OPERATIONS
from antdsl.program.tables.things import KIND_BY_WORD
from antdsl.program.traverse import iterate_nodes
from antdsl.program.typed import ParamRef, ReduceExpr, ThingRef
from antdsl.program.types import calls, expressions, operators
from antdsl.program.types.aggregate_subjects import find_cell_field, find_subject, find_thing_kind, make_element_scope
from antdsl.program.types.arguments import type_arguments
from antdsl.program.types.descriptions import describe_type, quote_source
from antdsl.program.types.expressions import TypedArgument
from antdsl.program.types.operators import type_condition, type_value
from antdsl.program.types.sets import type_reduction_body
from antdsl.source import Span
from antdsl.syntax import nodes

AGGREGATE_WORDS = ("total", "share", "sum", "mean", "min", "max", "count", "any", "every")
_CELL_AGGREGATES = ("total", "sum", "mean", "min", "max")
_TRUTH_AGGREGATES = ("share", "count", "any", "every")
_VECTOR_AGGREGATES = ("total", "mean")
_COMPARISON_SIGNS = ("<", "<=", ">", ">=", "==", "!=")
_VOLUME_TYPE = ValueType(TypeKind.NUMBER, Dimension(length=3))


class SpecRules:
    """The typing rules of specs. They override the language's rules while a condition of a spec is checked."""

    def __init__(self, declarations: Declarations, has_reference_run: bool = False) -> None:
        self.language_rules = declarations.rules
        self.comparison_rules: dict[str, Callable[..., Expr]] = {"at_start": self._type_start_value}
        if has_reference_run:
            self.comparison_rules["other"] = self._type_reference_run_value
        self.is_in_aggregate = False  # whether the checker is inside an aggregate such as `total(…)`
        self.cells = ""  # the field with the cells that an aggregate reads
        self.other_side: Expr | None = None  # the other side of a comparison with `initial_count` or `other`
        own: dict[type, Callable[..., Expr]] = {
            nodes.Call: self._type_call, nodes.NameRef: self._type_name, nodes.Member: self._type_member,
            nodes.Binary: self._type_binary,
        }  # fmt: skip
        self.declarations = replace(declarations, rules={**declarations.rules, **own})

    # --- names -------------------------------------------------------------------------------------------------------

    def _type_name(self, scope: NameScope, node: nodes.NameRef, expected_type: ValueType | None) -> Expr:
        name = node.name.text
        if name in self.comparison_rules:
            if self.other_side is not None:
                return self.comparison_rules[name](scope, self.other_side, node.span)
            when = "at the start" if name == "at_start" else "in the reference run"
            message = f"`{name}` needs a comparison: it stands for the value of the other side {when}"
            advice = f"write `total(food.load) == {name}`, or `{name}(total(food.load))`"
            return scope.report_error("at-start-alone", message, node.span, advice)
        species = scope.species
        own_names: set[str] = set() if species is None else {*species.attributes, *species.params, *species.bindings}
        if name in scope.declarations.measures and name not in own_names and name not in scope.local_names:
            return self._type_measure(scope, node)
        if species is not None and name in GEOMETRY_MEASURES and name not in own_names:
            return BodyMeasure(parse_type_words(GEOMETRY_MEASURES[name]) or NUMBER_TYPE, ChangeRate.AGENT, node.span, name)
        return expressions.type_name(scope, node, expected_type)

    def _type_measure(self, scope: NameScope, node: nodes.NameRef) -> Expr:
        """Return the value of a declared measure. Errors in the measure are reported at its declaration."""
        name = node.name.text
        scope.record_name_use(node.span, "measure", name)
        value = scope.declarations.measure_values.get(name)
        if value is None or self._is_nested_aggregate(scope, node.span):
            return make_bad_expression(node.span)
        return MeasureValue(value.type, value.rate, node.span, name, value)

    def _type_time_of(self, scope: NameScope, node: nodes.Call, operand: nodes.Expr) -> Expr:
        if self._is_nested_aggregate(scope, node.span):
            return make_bad_expression(node.span)
        condition = type_condition(scope, operand, "`time_of`")
        if condition.type.kind is TypeKind.BAD:
            return make_bad_expression(node.span)
        if condition.rate > ChangeRate.STEP:
            message = f"{quote_source(operand.span)} differs from agent to agent, so it has no single time"
            return scope.report_error("wrong-rate", message, operand.span, "write a `share`, `count`, `any` or `every` of all")
        return TimeOf(TIME_TYPE, ChangeRate.STEP, node.span, condition)

    def _type_start_value(self, scope: NameScope, expr: Expr, span: Span) -> Expr:
        if self.is_in_aggregate:
            message = "`at_start` cannot be inside an expression that is computed for each agent"
            return scope.report_error("set-in-set", message, span, "write `at_start(total(food.load))`")
        if expr.type.kind is TypeKind.BAD:
            return make_bad_expression(span)
        if expr.type.kind is not TypeKind.NUMBER:
            words = f"`at_start` needs a number, but this is {describe_type(expr.type)}"
            return scope.report_error("wrong-kind", words, span, "compare numbers")
        return StartValue(expr.type, expr.rate, span, expr)

    def _type_reference_run_value(self, scope: NameScope, expr: Expr, span: Span) -> Expr:
        """Return the value of the number `expr` in the reference run. The number must be about the complete run."""
        if expr.type.kind is TypeKind.BAD:
            return make_bad_expression(span)
        names_agent = self.is_in_aggregate or scope.species is not None
        if names_agent or expr.type.kind is not TypeKind.NUMBER or expr.rate > ChangeRate.STEP:
            message = "`other` is a value of the complete reference run, not of one agent"
            advice = "write it in a line of the spec itself: `always: total(nest.load) >= other`"
            return scope.report_error("wrong-rate", message, span, advice)
        return ReferenceRunValue(expr.type, ChangeRate.STEP, span, expr)

    def _type_member(self, scope: NameScope, node: nodes.Member, expected_type: ValueType | None) -> Expr:
        owner, name = node.owner, node.name.text
        if isinstance(owner, nodes.NameRef):
            if owner.name.text in scope.declarations.fields and name == "value":
                return self._type_cell(scope, node, owner.name.text)
            if owner.name.text == "motion" and "motion" not in scope.local_names:
                return self._type_motion(scope, node)
            self_there = scope.local_names.get(owner.name.text)
            species = scope.declarations.species.get(owner.name.text)
            is_own = isinstance(self_there, ThingRef)
            if is_own and species is not None and name in species.params and name not in species.attributes:
                scope.mark_used("param", f"{species.name}.{name}")
                scope.record_name_use(owner.span, "species", species.name)
                scope.record_name_use(node.name.span, "own", species.name, name)
                return ParamRef(species.params[name], ChangeRate.RUN, node.span, f"{species.name}.{name}")
            bodily = species is not None and name in GEOMETRY_MEASURES and name not in {*species.attributes, *species.params}
            if bodily and isinstance(self_there, ThingRef):
                scope.record_name_use(owner.span, "species", owner.name.text)
                return BodyMeasure(parse_type_words(GEOMETRY_MEASURES[name]) or NUMBER_TYPE, ChangeRate.AGENT, node.span, name)
            if self._is_value_of_unnamed_agent(scope, owner.name.text, node):
                return make_bad_expression(node.span)
        return expressions.type_member(scope, node, expected_type)

    @staticmethod
    def _report_vectors(scope: NameScope, node: nodes.Expr, field: str) -> Expr:
        message = f"{quote_source(node.span)} needs numbers, but the cells of `{field}` hold vectors"
        advice = f"use the vectors at agents: `mean(a in walker: length({field}))`"
        return scope.report_error("wrong-kind", message, node.span, advice)

    def _type_cell(self, scope: NameScope, node: nodes.Member, field: str) -> Expr:
        scope.mark_used("field", field)
        scope.record_name_use(node.owner.span, "field", field)
        if scope.declarations.fields[field].has_vectors:
            return self._report_vectors(scope, node, field)
        if self.cells == field:
            return CellValue(NUMBER_TYPE, ChangeRate.ELEMENT, node.span, field)
        return scope.report_error(
            "wrong-rate", f"`{field}.value` needs a cell", node.span,
            f"use a value of all cells: `max({field}.value)`, `share({field}.value > 0)`; "
            f"at an agent's position, write `{field}` alone",
        )  # fmt: skip

    def _is_value_of_unnamed_agent(self, scope: NameScope, owner: str, node: nodes.Member) -> bool:
        """Return whether a text such as `forager.load` names a value of an agent or item without saying which one. If so, report
        it."""
        kind, name = find_thing_kind(scope.declarations, owner), node.name.text
        type = ValueType(TypeKind.AGENT if kind is TypeKind.SPECIES else TypeKind.ITEM, referent=owner)
        params = scope.declarations.species[owner].params if kind is TypeKind.SPECIES else {}
        known = kind is not None and name in {
            *find_attributes(scope.declarations, type),
            *(GEOMETRY_MEASURES if kind is TypeKind.SPECIES else ()),
        }
        if not known or owner in scope.local_names or name in params:
            return False
        if isinstance(node.owner, nodes.NameRef):
            scope.record_thing_use(node.owner.name)
        scope.record_value_use(node.name.span, type, name)
        who = "agent" if kind is TypeKind.SPECIES else "item"
        also = f", or test each agent: `each {owner} {{ always: {name} … }}`" if kind is TypeKind.SPECIES else ""
        advice = f"use a value of all: `total({owner}.{name})`, `share({owner}.{name} …)`{also}"
        scope.report.error("wrong-rate", f"`{name}` is a value of one {who}, but `{owner}` is all of them", node.span, advice)
        return True

    def _type_motion(self, scope: NameScope, node: nodes.Member) -> Expr:
        words = MOTION_MEASURES.get(node.name.text)
        if words is None:
            help = suggest_name(node.name.text, MOTION_MEASURES, f"there is {list_names(MOTION_MEASURES)}")
            scope.report.error("unknown-name", f"`motion` has no `{node.name.text}`", node.name.span, help)
            return make_bad_expression(node.span)
        return MotionMeasure(parse_type_words(words) or NUMBER_TYPE, ChangeRate.STEP, node.span, node.name.text)

    # --- the other side of a comparison ------------------------------------------------------------------------------

    def _type_binary(self, scope: NameScope, node: nodes.Binary, expected_type: ValueType | None) -> Expr:
        sides = [_uses_word(side, self.comparison_rules) for side in (node.left, node.right)]
        if node.op not in _COMPARISON_SIGNS or sides[0] == sides[1]:
            return operators.type_binary(scope, node, expected_type)
        other = node.right if sides[0] else node.left
        expr = type_value(scope, other)
        known = cast(nodes.Expr, TypedArgument(expr, other.span))
        left, right = (node.left, known) if sides[0] else (known, node.right)
        outer, self.other_side = self.other_side, expr
        try:
            return operators.type_binary(scope, nodes.Binary(node.op, left, right, node.op_span, node.span), expected_type)
        finally:
            self.other_side = outer

    def _type_call(self, scope: NameScope, node: nodes.Call, expected_type: ValueType | None) -> Expr:
        name = node.function.name.text if isinstance(node.function, nodes.NameRef) else ""
        first = node.arguments[0] if len(node.arguments) == 1 else None
        if name in self.comparison_rules:
            if not isinstance(first, nodes.Argument) or first.name is not None:
                return self._report_argument_count(scope, node, name)
            return self.comparison_rules[name](scope, type_value(scope, first.value), node.span)
        only = first.value if isinstance(first, nodes.Argument) and first.name is None else None
        if name == "time_of":
            return self._report_argument_count(scope, node, name) if only is None else self._type_time_of(scope, node, only)
        if name in AGGREGATE_WORDS and only is not None and not _is_set(scope, only):
            return self._type_aggregate(scope, node, name, only)
        if name in ("total", "share"):
            return self._report_argument_count(scope, node, name)
        expr = calls.type_call(scope, node, expected_type)
        if isinstance(expr, ReduceExpr) and scope.species is None and not scope.set_elements:
            return self._type_set_aggregate(scope, expr)
        return expr

    @staticmethod
    def _report_argument_count(scope: NameScope, node: nodes.Call, name: str) -> Expr:
        call_sample = f"{name}(total(food.load))" if name in ("at_start", "other") else f"{name}(food.load)"
        sample = {"share": "share(state == carry)", "time_of": "time_of(total(food.load) == 0)"}.get(name, call_sample)
        scope.report.error("wrong-argument", f"`{name}` needs exactly one argument", node.span, f"write `{sample}`")
        type_arguments(scope, node)
        return make_bad_expression(node.span)

    def _is_nested_aggregate(self, scope: NameScope, span: Span) -> bool:
        """Return whether an aggregate is inside another aggregate. If so, report an error."""
        if self.is_in_aggregate:
            message = f"{quote_source(span)} is inside an expression for each agent"
            scope.report.error("set-in-set", message, span, "write the two next to each other")
        return self.is_in_aggregate

    def _type_aggregate(self, scope: NameScope, node: nodes.Call, name: str, operand: nodes.Expr) -> Expr:
        if self._is_nested_aggregate(scope, node.span):
            return make_bad_expression(node.span)
        bare = operand.name.text if isinstance(operand, nodes.NameRef) else ""
        how = "total" if name == "sum" else name
        field = find_cell_field(scope.declarations, operand)
        if field:
            if name not in _TRUTH_AGGREGATES and not (isinstance(operand, nodes.Member) and operand.name.text == "value"):
                return self._report_no_sum(scope, node, field)
            bare = bare if name in _TRUTH_AGGREGATES else field
        if bare in scope.declarations.fields and name in (*_CELL_AGGREGATES, "count"):
            scope.mark_used("field", bare)
            if scope.declarations.fields[bare].has_vectors:
                return self._report_vectors(scope, node, bare)
            scope.record_name_use(operand.owner.span if isinstance(operand, nodes.Member) else operand.span, "field", bare)
            field_type = ValueType(TypeKind.FIELD, referent=bare)
            return AggregateExpr(NUMBER_TYPE, ChangeRate.STEP, node.span, how, field_type, (), None, None)
        thing = scope.declarations.things.get(bare)
        if thing is not None and KIND_BY_WORD[thing.kind].is_dug and name == "total":
            scope.mark_used("thing", bare)
            scope.record_name_use(operand.span, "thing", bare)
            dug = ValueType(TypeKind(thing.kind), referent=bare)
            return AggregateExpr(_VOLUME_TYPE, ChangeRate.STEP, node.span, how, dug, (), None, None)
        over = ValueType(TypeKind.FIELD, referent=field) if field else find_subject(scope, node, operand)
        if over is None:
            return make_bad_expression(node.span)
        inner, elements = (scope.with_changes(species=None), ()) if field else make_element_scope(scope, over, node.span)
        if isinstance(operand, nodes.NameRef) and bare == over.referent:
            scope.record_thing_use(operand.name)
        self.cells = field
        body: Expr | None = None
        if not (name in ("count", "any") and bare == over.referent):
            if bare == over.referent:
                return self._report_no_value(scope, node, bare)
            self.is_in_aggregate = True
            body = (
                type_condition(inner, operand, f"`{name}`")
                if name in _TRUTH_AGGREGATES
                else type_reduction_body(inner, name, operand)
            )
            self.is_in_aggregate, self.cells = False, ""
            if body.type.kind is TypeKind.BAD:
                return make_bad_expression(node.span)
            if body.type.kind is TypeKind.VECTOR and how not in _VECTOR_AGGREGATES:
                return self._report_vector(scope, node, operand)
        return AggregateExpr(_find_result_type(how, body), ChangeRate.STEP, node.span, how, over, elements, None, body)

    @staticmethod
    def _report_no_sum(scope: NameScope, node: nodes.Call, field: str) -> Expr:
        words = f"{quote_source(node.span)} computes a value for each cell of `{field}`"
        known = f"write `{node.function.span.text}({field}.value)`, or `count({field}.value > 0)` or similar"
        return scope.report_error("wrong-argument", words, node.span, known)

    @staticmethod
    def _report_no_value(scope: NameScope, node: nodes.Call, subject: str) -> Expr:
        value = f"{subject}.{'size' if subject in scope.declarations.species else 'radius'}"
        advice = f"name one, such as `{value}`, or write `count({subject})` for how many there are"
        return scope.report_error(
            "wrong-argument", f"{quote_source(node.span)} does not name a value of `{subject}`", node.span, advice
        )

    @staticmethod
    def _report_vector(scope: NameScope, node: nodes.Call, operand: nodes.Expr) -> Expr:
        text = " ".join(operand.span.text.split())
        message = f"{quote_source(node.span)} would be a vector, but a spec compares numbers"
        scope.report.error("wrong-kind", message, operand.span, f"write `length({text})`")
        return make_bad_expression(node.span)

    def _type_set_aggregate(self, scope: NameScope, reduction: ReduceExpr) -> Expr:
        """Type an aggregate over a set, such as `count(n in forager: n.load > 0)`.

        The set must contain all agents, because a smaller set would need an agent as its owner."""
        over = reduction.elements
        if self._is_nested_aggregate(scope, reduction.span):
            return make_bad_expression(reduction.span)
        is_complete_set = over.source == "all" and all(arg is None for arg in over.args)
        is_vector = reduction.type.kind is TypeKind.VECTOR and reduction.reducer in ("sum", "mean")
        is_number = is_vector or reduction.type.kind in (TypeKind.NUMBER, TypeKind.BOOL)
        if not is_complete_set or reduction.reducer in ("best", "nearest") or not is_number:
            message = f"{quote_source(reduction.span)} needs an agent, but none is named"
            advice = "move it to `each SPECIES { … }`, or use a `total`, `share`, `mean`, `min`, `max` or `count` of all"
            return scope.report_error("wrong-rate", message, reduction.span, advice)
        kind = TypeKind.ITEMS if over.element.type.kind is TypeKind.ITEM else TypeKind.SPECIES
        counts_all = reduction.reducer == "count" and reduction.body is not None and reduction.body.rate <= ChangeRate.CONST
        body = None if counts_all else reduction.body
        how = "total" if reduction.reducer == "sum" else reduction.reducer
        subject, elements = ValueType(kind, referent=over.source_name), (reduction.element, over.element)
        return AggregateExpr(
            _find_result_type(how, body), ChangeRate.STEP, reduction.span, how, subject, elements, over.condition, body
        )


def _find_result_type(reducer: str, body: Expr | None) -> ValueType:
    if reducer in ("any", "every"):
        return BOOL_TYPE
    return NUMBER_TYPE if body is None or reducer in ("share", "count") else body.type


def _uses_word(root: nodes.Expr, words: Container[str]) -> bool:
    """Return whether an expression contains one of `words` as a bare name, such as `initial_count`. A call such as
    `initial_count(…)` does not count."""
    called = {id(part.function) for part, _ in iterate_nodes(root) if isinstance(part, nodes.Call)}
    return any(isinstance(p, nodes.NameRef) and p.name.text in words and id(p) not in called for p, _ in iterate_nodes(root))


def _is_set(scope: NameScope, node: nodes.Expr) -> bool:
    if isinstance(node, nodes.Call):
        return isinstance(node.function, nodes.NameRef) and node.function.name.text in SET_RESULT_OPERATIONS
    if not isinstance(node, nodes.NameRef) or scope.species is None:
        return False
    binding = scope.species.bindings.get(node.name.text)
    return binding is not None and binding.type.kind is TypeKind.SET
