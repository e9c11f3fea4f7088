"""Lowers a spec, or the measures of a program, to a plan. The plan has blocks for each agent and item, aggregates over complete
populations, and conditions on these aggregates.

The blocks of a judged species store only into separate registers and change nothing else. `decide` computes the values that are
aggregated over a population. `act` judges each agent. `blend` computes the values for the message of a failure."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

from antdsl.diagnostics import Report
from antdsl.plan import ir
from antdsl.plan.builder import PlanBuilder
from antdsl.plan.ir import OPERATION_BY_NAME, Block, PlanNode, Register, SpeciesPlan, Store, UpdateRate, ValueKind
from antdsl.plan.lowering.actions import report_unsupported
from antdsl.plan.lowering.expressions import lower_condition, lower_expression, lower_scalar, lower_vector
from antdsl.plan.lowering.lower import MAX_RECURSION_FRAMES
from antdsl.plan.lowering.rules import LOWERING_RULES
from antdsl.plan.lowering.spec_plans import (
    AggregatePlan,
    FirstTimePlan,
    GoalPlan,
    JudgementPlan,
    MeasuresPlan,
    ReadingPlan,
    ReferenceValuePlan,
    SpecPlan,
    StartValuePlan,
)  # fmt: skip
from antdsl.plan.lowering.values import EntityRef, LoweredValue, OwnPosition, VectorNodes, compute_length
from antdsl.plan.lowering.writer import PlanWriter, UnsupportedConstruct
from antdsl.plan.traverse import collect_required_nodes, find_shared_senses
from antdsl.program import expectations, model
from antdsl.program.traverse import iterate_parts
from antdsl.source import Span

_TRUTH_AGGREGATES = ("share", "count", "any", "every")
_ITEM_VALUES_HELP = "use the position or the radius of the item, or one of its declared values"


class _SpecWriter(PlanWriter):
    """A PlanWriter that also lowers expressions that only specs can use."""

    def __init__(self, lowering: _SpecLowering, species: model.Species, registers: dict[str, Register]) -> None:
        super().__init__(lowering.b, lowering.program, species, lowering.report, LOWERING_RULES)
        self.lowering, self.period = lowering, lowering.program_plan.period
        self.registers = dict(registers)
        self.blocks: dict[str, list[Store]] = {"decide": [], "act": [], "blend": []}

    def _read_register(self, name: str, snapshot: bool) -> PlanNode:
        if name not in self.registers:
            raise UnsupportedConstruct(
                "reading a sense of an item in a spec", self.b.span or self.species.span, _ITEM_VALUES_HELP
            )
        return super()._read_register(name, snapshot)

    def lower_spec_expression(self, e: model.Expr) -> LoweredValue:
        if isinstance(e, expectations.AggregateExpr):
            return self.lowering.lower_aggregate(e)
        if isinstance(e, expectations.MotionMeasure):
            return self.b("told", attrs=(f"motion.{e.name}",))
        if isinstance(e, expectations.ReferenceRunValue):
            return self.lowering.lower_reference_run_value(e)
        if isinstance(e, expectations.BodyMeasure):
            return self.read_body_register(e)
        if isinstance(e, expectations.CellValue):
            return self.b("snap", attrs=("value",), kind=ValueKind.F32)
        if isinstance(e, expectations.TimeOf):
            return self.lowering.lower_time_of(e)
        if isinstance(e, expectations.MeasureValue):
            return self.lowering.lower_measure(e.value)
        assert isinstance(e, expectations.StartValue)
        return self.lowering.lower_start_value(self, e)

    def read_body_register(self, e: expectations.BodyMeasure) -> PlanNode:
        """Return the node that reads a body measure from its register. The judge fills this register before the evaluation."""
        name = f"geometry.{e.name}"
        self.registers[name] = Register(name, ValueKind.F32, "attribute")
        self.lowering.body_measures.setdefault(self.species.name, set()).add(e.name)
        return self.b("snap", attrs=(name,), kind=ValueKind.F32)

    def store_result(self, block: str, name: str, node: PlanNode, span: Span) -> str:
        """Add a register that the spec's block `block` fills with the value of `node`. Return the register's name."""
        self.registers[name] = Register(name, node.kind, "memory")
        self.blocks[block].append(Store(name, node, span, allows_infinity=True))
        return name

    def make_species_plan(self) -> SpeciesPlan:
        """Return the plan of the species with the registers and stores that the spec adds."""
        decide, act, blend = (Block(tuple(self.blocks[name])) for name in ("decide", "act", "blend"))
        lazy_senses = find_shared_senses(decide, act, blend)
        return SpeciesPlan(self.species.name, self.registers, (), Block(()), decide, act, blend, (), (), lazy_senses)


class _SpecLowering:
    """The state of the lowering of one spec."""

    def __init__(self, program: model.Program, plan: ir.Plan, report: Report) -> None:
        self.program, self.program_plan, self.report = program, plan, report
        self.b = PlanBuilder()
        self.aggregates: list[AggregatePlan] = []
        self.stored_values: list[StartValuePlan | FirstTimePlan] = []
        self.reference_values: list[ReferenceValuePlan] = []
        self.body_measures: dict[str, set[str]] = {}
        self.known: dict[model.Expr, LoweredValue] = {}
        self.writers: dict[str, _SpecWriter] = {}
        empty_layers = model.LayerStack("budget", (), next(iter(program.species.values())).span)
        self._empty_layers = empty_layers
        self.run_writer = _SpecWriter(self, self._make_empty_species(""), {})

    def _make_empty_species(self, name: str) -> model.Species:
        return model.Species(name, "", (), (), (), (), (), (), self._empty_layers, self._empty_layers.span)

    def get_agent_writer(self, species: str, span: Span | None = None) -> _SpecWriter:
        """Return the writer for a species. Raise UnsupportedConstruct if the scene does not contain this species."""
        if species not in self.program_plan.species:
            assert span is not None
            words = f"a spec about `{species}`, which is not in the scene,"
            raise UnsupportedConstruct(words, span, f"add `{species}` to the scene's `crowd`")
        if species not in self.writers:
            self.writers[species] = _SpecWriter(self, self.program.species[species], self.program_plan.species[species].registers)
        return self.writers[species]

    def get_item_writer(self, items: str) -> _SpecWriter:
        """Return the writer for a group of items, which has the items' values as registers."""
        if items not in self.writers:
            names = ("position.x", "position.y", "position.z", "radius", *self.program_plan.items[items].attributes)
            self.writers[items] = _SpecWriter(
                self, self._make_empty_species(items), {n: Register(n, ValueKind.F32, "attribute") for n in names}
            )
        return self.writers[items]

    def get_cell_writer(self, field: str) -> _SpecWriter:
        """Return the writer for the cells of a field. The register `value` of this writer stands for the value of a cell."""
        if field not in self.writers:
            self.writers[field] = _SpecWriter(
                self, self._make_empty_species(field), {"value": Register("value", ValueKind.F32, "attribute")}
            )
        return self.writers[field]

    # --- wholes and starts -------------------------------------------------------------------------------------------

    def _lower_once(self, e: model.Expr, lower: Callable[[], LoweredValue]) -> Any:
        """Return the lowered value of an expression. An expression that occurs several times is lowered only once."""
        if e not in self.known:
            self.known[e] = lower()
        return self.known[e]

    def lower_measure(self, value: model.Expr) -> PlanNode:
        """Return the node of a measure, which is a number or a condition."""
        lower = lower_condition if value.type.kind is model.TypeKind.BOOL else lower_scalar
        node: PlanNode = self._lower_once(value, lambda: lower(self.run_writer, value))
        return node

    def lower_time_of(self, e: expectations.TimeOf) -> PlanNode:
        """Return the node of the time at which a condition first holds."""

        def lower() -> PlanNode:
            condition = lower_condition(self.run_writer, e.condition)
            self.stored_values.append(FirstTimePlan(f"time#{len(self.stored_values) + 1}", condition))
            return self.b("told", attrs=(self.stored_values[-1].name,))

        node: PlanNode = self._lower_once(e, lower)
        return node

    def lower_aggregate(self, e: expectations.AggregateExpr) -> LoweredValue:
        """Return the value of an aggregate: the node of a number or bool, or the three nodes of a vector."""
        value: LoweredValue = self._lower_once(e, lambda: self._lower_new_aggregate(e))
        return value

    def _lower_new_aggregate(self, e: expectations.AggregateExpr) -> LoweredValue:
        name, of = f"whole#{len(self.aggregates) + 1}", e.population.referent or ""
        kind = e.population.kind.value
        where = body = amount = None
        if kind in ("species", "items") or e.body is not None:
            writers = {"field": self.get_cell_writer, "items": self.get_item_writer}
            w = writers[kind](of) if kind in writers else self.get_agent_writer(of, e.span)
            for element in e.elements:
                w.environment[element] = OwnPosition()
            if e.where is not None:
                where = w.store_result(
                    "decide", f"{name}.where", self._check_pure(w, lower_condition(w, e.where), e.where), e.where.span
                )
            if e.body is not None and e.type.kind is model.TypeKind.VECTOR:
                nodes = lower_vector(w, e.body)
                axes = ((axis, self._check_pure(w, getattr(nodes, axis), e.body)) for axis in "xyz")
                bodies = [w.store_result("decide", f"{name}.body.{axis}", node, e.body.span) for axis, node in axes]
                parts = [AggregatePlan(f"{name}.{body[-1]}", e.reducer, kind, of, where, body) for body in bodies]
                self.aggregates += parts
                return VectorNodes(*(self.b("told", attrs=(part.name,)) for part in parts))
            if e.body is not None:
                node = lower_condition(w, e.body) if e.reducer in _TRUTH_AGGREGATES else lower_scalar(w, e.body)
                body = w.store_result("decide", f"{name}.body", self._check_pure(w, node, e.body), e.body.span)
                if kind == "items" and node.op == "snap" and node.attrs[0] in self.program_plan.items[of].attributes:
                    amount = node.attrs[0]
        self.aggregates.append(AggregatePlan(name, e.reducer, kind, of, where, body, amount))
        result = self.b("told", attrs=(name,))
        return self.b("ne", result, self.b.add_number(0)) if e.type.kind is model.TypeKind.BOOL else result

    def lower_start_value(self, w: _SpecWriter, e: expectations.StartValue) -> PlanNode:
        """Return the node of the value that a number has at the start of the run. For a number of agents, it is the value at the
        start of each agent's life."""
        node: PlanNode = self._lower_once(e, lambda: self._lower_new_start_value(w, e))
        return node

    def _lower_new_start_value(self, w: _SpecWriter, e: expectations.StartValue) -> PlanNode:
        node = lower_scalar(w, e.value)
        name = f"start#{len(self.stored_values) + 1}"
        if node.rate <= UpdateRate.STEP:
            self.stored_values.append(StartValuePlan(name, value=node))
            return self.b("told", attrs=(name,))
        source_register = w.store_result("decide", f"{name}.asked", self._check_pure(w, node, e), e.span)
        w.registers[name] = Register(name, ValueKind.F32, "attribute")
        self.stored_values.append(StartValuePlan(name, species=w.species.name, source_register=source_register))
        return self.b("snap", attrs=(name,), kind=ValueKind.F32)

    def lower_reference_run_value(self, e: expectations.ReferenceRunValue) -> PlanNode:
        """Return the node of the value that a number has in the reference run."""

        def lower() -> PlanNode:
            value = lower_scalar(self.run_writer, e.value)
            self.reference_values.append(ReferenceValuePlan(f"other#{len(self.reference_values) + 1}", value))
            return self.b("told", attrs=(self.reference_values[-1].name,))

        node: PlanNode = self._lower_once(e, lower)
        return node

    def _check_pure(self, w: _SpecWriter, node: PlanNode, e: model.Expr) -> PlanNode:
        """Return the node unchanged. Raise UnsupportedConstruct if it has side effects, or reads a value that items or cells do
        not have."""
        if w.statements:
            w.statements.clear()
            words = "a value that remembers earlier steps, inside a spec,"
            raise UnsupportedConstruct(words, e.span, "test something that the value changes: an attribute, a state or a speed")
        name = w.species.name
        if name in (*self.program_plan.items, *self.program.fields) and any(
            _is_agent_only(n) for n in collect_required_nodes([node])
        ):
            if name in self.program_plan.items:
                raise UnsupportedConstruct("reading a sense of an item in a spec", e.span, _ITEM_VALUES_HELP)
            raise UnsupportedConstruct(
                "reading a sense of a cell in a spec", e.span, "use the `value` of the cell: a cell of a field has nothing else"
            )
        return node

    def collect_queries(self) -> dict[str, Any]:
        """Return the arguments with which to create a QueryPlan, by field name."""
        species = {name: self.get_agent_writer(name).make_species_plan() for name in self.program_plan.species}
        species |= {name: w.make_species_plan() for name, w in self.writers.items() if name not in species}
        return {
            "plan": replace(self.program_plan, species=species, nodes=tuple(self.b.nodes)),
            "aggregates": tuple(self.aggregates),
            "stored_values": tuple(self.stored_values),
            "reference_values": tuple(self.reference_values),
            "body_measures": {name: frozenset(names) for name, names in self.body_measures.items()},
        }

    # --- lines -------------------------------------------------------------------------------------------------------

    def lower_expectation(self, e: expectations.Expectation, number: int) -> JudgementPlan | None:
        try:
            w = self.run_writer if e.species is None else self.get_agent_writer(e.species, e.span)
            node = self._check_pure(w, lower_condition(w, e.condition), e.condition)
            condition = node if e.species is None else w.store_result("act", f"line#{number}", node, e.span)
            time, held = (None if each is None else lower_scalar(self.run_writer, each) for each in (e.time, e.hold_time))
            since: PlanNode | str | None = None
            if e.start_condition is not None:
                since_node = self._check_pure(w, lower_condition(w, e.start_condition), e.start_condition)
                since = since_node if e.species is None else w.store_result("act", f"line#{number}.since", since_node, e.span)
            goal = None if e.goal is None else self._lower_goal(e.goal)
            readings = [self._lower_reading(w, r, f"line#{number}.{k}") for k, r in enumerate(e.readings)]
        except UnsupportedConstruct as missing:
            report_unsupported(w, missing)
            return None
        return JudgementPlan(
            e.kind, e.block_number, e.species, condition, time, tuple(readings), e.is_at_end, e.span, held, since, goal
        )

    def _lower_goal(self, goal: expectations.Goal) -> GoalPlan:
        value, target = (lower_scalar(self.run_writer, each) for each in (goal.value, goal.target))
        return GoalPlan(value, target, goal.tolerance)

    def _lower_reading(self, w: _SpecWriter, reading: expectations.ExpectationReading, name: str) -> ReadingPlan:
        e, value = reading.expr, lower_expression(w, reading.expr)
        type = e.type
        if isinstance(value, EntityRef):
            value = value.node
        elif isinstance(value, VectorNodes):
            value, type = compute_length(w.b, value), model.ValueType(model.TypeKind.NUMBER, type.dimension)
        elif not isinstance(value, PlanNode):
            value, type = lower_condition(w, e), model.ValueType(model.TypeKind.BOOL)
        if value.rate <= UpdateRate.STEP:
            return ReadingPlan(e.span, type, reading.unit, node=value)
        return ReadingPlan(e.span, type, reading.unit, register=w.store_result("blend", name, value, e.span))


def _is_agent_only(node: PlanNode) -> bool:
    """Return whether only agents have a value for a node, for example for a sense or the age. Items only have registers."""
    return node.op != "snap" and (OPERATION_BY_NAME[node.op].rate is UpdateRate.AGENT or node.kind is ValueKind.SET)


def lower_spec(spec: expectations.Spec, program: model.Program, plan: ir.Plan) -> tuple[SpecPlan | None, Report]:
    """Return the plan that evaluates a spec, and a report. The plan is None if an expression cannot be evaluated yet. `plan`:
    the lowered program that the spec judges."""
    work = _SpecLowering(program, plan, Report())
    with _allow_deep_recursion():
        duration = None if spec.duration is None else lower_scalar(work.run_writer, spec.duration)
        judgements = [work.lower_expectation(e, n) for n, e in enumerate(spec.expectations, 1)]
    if not work.report.ok:
        return None, work.report
    valid_judgements = tuple(j for j in judgements if j is not None)
    return SpecPlan(spec=spec, duration=duration, judgements=valid_judgements, **work.collect_queries()), work.report


def lower_measures(program: model.Program, plan: ir.Plan) -> tuple[MeasuresPlan | None, Report]:
    """Return the plan that evaluates the measures of a program, and a report. The plan is None if the report has errors. `plan`:
    the lowered program.

    Measures of species that are not in the scene are omitted, because they have no value there."""
    work, nodes = _SpecLowering(program, plan, Report()), {}
    with _allow_deep_recursion():
        for measure in program.measures:
            absent = [name for name in program.species if name not in plan.species]
            if any(_refers_to_other_species(part, absent) for part in iterate_parts(measure.value)):
                continue
            try:
                nodes[measure.name] = work.lower_measure(measure.value)
            except UnsupportedConstruct as missing:
                report_unsupported(work.run_writer, missing)
    return MeasuresPlan(nodes=nodes, **work.collect_queries()) if work.report.ok else None, work.report


def _refers_to_other_species(part: object, species: Sequence[str]) -> bool:
    """Return whether an expression is an aggregate over one of the species `species`."""
    return isinstance(part, expectations.AggregateExpr) and part.population.referent in species


@contextmanager
def _allow_deep_recursion() -> Iterator[None]:
    """Raise Python's recursion limit within the context, so that deeply nested expressions can be lowered."""
    previous_limit = sys.getrecursionlimit()
    sys.setrecursionlimit(max(previous_limit, MAX_RECURSION_FRAMES))
    try:
        yield
    finally:
        sys.setrecursionlimit(previous_limit)
