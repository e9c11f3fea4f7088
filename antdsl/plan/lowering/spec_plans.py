"""The plans of specs and measures: what an evaluator computes in each frame, and what a judge derives from these values."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from antdsl.plan import ir
from antdsl.plan.ir import PlanNode
from antdsl.program import expectations, model
from antdsl.source import Span


@dataclass(frozen=True, slots=True, eq=False)
class AggregatePlan:
    """A number about all agents of a species, all items of a group, the cells of a field, or a solid. Nodes read the number by
    `name`.

    - `kind`, `subject`: the kind and the name of this species, group, field or solid.
    - `where_register`, `body_register`: the registers in which `decide` stores the condition and the value of each member.
    - `amount`: the attribute of items that is aggregated without conversion to float32."""

    name: str
    reducer: str
    kind: str
    subject: str
    where_register: str | None = None
    body_register: str | None = None
    amount: str | None = None


@dataclass(frozen=True, slots=True, eq=False)
class StartValuePlan:
    """A number that a spec compares with its value at the start.

    For a number about the complete run, `value` is its node, and other nodes read the start value by `name`. For a number of
    each agent of `species`, the register `name` stores the value that `source_register` has in the agent's first frame."""

    name: str
    value: PlanNode | None = None
    species: str | None = None
    source_register: str | None = None


@dataclass(frozen=True, slots=True, eq=False)
class FirstTimePlan:
    """The time at which a condition about the complete run first holds. Other nodes read it by `name`."""

    name: str
    condition: PlanNode


@dataclass(frozen=True, slots=True, eq=False)
class ReferenceValuePlan:
    """A number that is computed in the reference run. `value`: the node that computes it there. `name`: the name by which nodes
    of the judged run read it."""

    name: str
    value: PlanNode


@dataclass(frozen=True, slots=True, eq=False)
class ReadingPlan:
    """A value that the message about a failure reports. It is a node, or a register that `blend` fills for each agent."""

    span: Span
    type: model.ValueType
    unit: str
    node: PlanNode | None = None
    register: str | None = None


@dataclass(frozen=True, slots=True, eq=False)
class GoalPlan:
    """A goal: the nodes of its value and target, and the tolerance as a fraction of the target."""

    value: PlanNode
    target: PlanNode
    tolerance: float


@dataclass(frozen=True, slots=True, eq=False)
class JudgementPlan:
    """One expectation of a spec.

    - `condition`, `start_condition` (of a `when`): if `species` is set, the names of registers that `act` fills for each agent.
      Otherwise, nodes about the complete run.
    - `time`, `hold_time`: nodes with one value for the run."""

    kind: str
    block_number: int
    species: str | None
    condition: PlanNode | str
    time: PlanNode | None
    readings: tuple[ReadingPlan, ...]
    is_at_end: bool
    span: Span
    hold_time: PlanNode | None = None
    start_condition: PlanNode | str | None = None
    goal: GoalPlan | None = None


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class QueryPlan:
    """Lowered expressions about complete runs.

    - `plan`: the plan with the judged species, and with each group of items as an additional species of the same name.
    - `stored_values`: values of earlier frames, each after the values that it uses.
    - `body_measures`: by species, the names in GEOMETRY_MEASURES that have registers. The evaluator fills these registers before
      the evaluation."""

    plan: ir.Plan
    aggregates: tuple[AggregatePlan, ...]
    stored_values: tuple[StartValuePlan | FirstTimePlan, ...]
    reference_values: tuple[ReferenceValuePlan, ...] = ()
    body_measures: Mapping[str, frozenset[str]] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class SpecPlan(QueryPlan):
    """A lowered spec."""

    spec: expectations.Spec
    duration: PlanNode | None
    judgements: tuple[JudgementPlan, ...]


@dataclass(frozen=True, slots=True, eq=False, kw_only=True)
class MeasuresPlan(QueryPlan):
    """The lowered measures of a program. `nodes`: the node of each measure by the measure's name, in text order."""

    nodes: Mapping[str, PlanNode]
