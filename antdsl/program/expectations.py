"""The classes of checked specs and measures: expectations, their times, and the expressions that only specs and measures can
contain."""

from __future__ import annotations

from antdsl.program.model import Binding, Expr, ValueType, expression_class
from antdsl.source import Span
from antdsl.syntax import nodes


@expression_class
class AggregateExpr(Expr):
    """A number, vector or bool about a complete population.

    - `reducer`: total, mean, min, max, share, count, any or every. The total or mean of vectors is a vector.
    - `population`: a type of kind SPECIES, ITEMS, FIELD or SOLID. The total of a solid is its volume.
    - `elements`: the names that stand for the current agent or item.
    - `where`, `body`: the condition on an agent or item, and the value to aggregate."""

    reducer: str
    population: ValueType
    elements: tuple[Binding, ...]
    where: Expr | None
    body: Expr | None


@expression_class
class StartValue(Expr):
    """The value that a number had at its start. For a number of an agent, this is the agent's first frame, otherwise the first
    frame of the spec."""

    value: Expr


@expression_class
class ReferenceRunValue(Expr):
    """The value that a number has in the spec's reference run at the same frame. The number must be about the complete run."""

    value: Expr


@expression_class
class TimeOf(Expr):
    """The time from the first frame of the spec to the first frame in which a condition holds. It is infinite until then."""

    condition: Expr


@expression_class
class MeasureValue(Expr):
    """The value of a declared measure."""

    name: str
    value: Expr


@expression_class
class Measure:
    """A declared measure: a number or a condition about the complete run. `help`: its text in quotes, or ""."""

    name: str
    value: Expr
    help: str
    span: Span


@expression_class
class BodyMeasure(Expr):
    """A value that is measured from an agent's pose. `name`: its name in GEOMETRY_MEASURES. Agents themselves cannot sense it."""

    name: str


@expression_class
class CellValue(Expr):
    """The amount of a field in the current cell, for expressions that are evaluated for each cell."""

    field: str


@expression_class
class MotionMeasure(Expr):
    """A measure of motion over the complete run. `name`: its name in MOTION_MEASURES."""

    name: str


@expression_class
class ExpectationReading:
    """A value in a condition, which the message reports if the condition fails. `unit`: the unit in which the value is
    displayed."""

    expr: Expr
    unit: str


@expression_class
class Goal:
    """A number that a run should reach at its end. `tolerance`: the accepted difference, as a fraction of the target."""

    value: Expr
    target: Expr
    tolerance: float


@expression_class
class Expectation:
    """One expectation of a spec.

    - `kind`: always, never, eventually, finally, sooner, within, for or until.
    - `block_number`: the number of the `each` block that contains it, from 1; 0 outside of such blocks.
    - `species`: the species with agents that are judged one by one; None for the complete run.
    - `is_at_end`: whether the expectation uses a measure that is known only at the end of the run.
    - `hold_time`: how long the condition must have held before it counts.
    - `start_condition`: whenever this condition becomes true, the time starts again.
    - `goal`: the goal, if the expectation is from a `goal` line. Such a line is judged like a `finally` line."""

    kind: str
    block_number: int  # 0: the spec itself; from 1: the `each` blocks in order
    species: str | None
    condition: Expr
    time: Expr | None
    readings: tuple[ExpectationReading, ...]
    is_at_end: bool  # it uses a motion measure, which is only known after the run
    span: Span
    hold_time: Expr | None = None
    start_condition: Expr | None = None
    goal: Goal | None = None


@expression_class
class SpecChange:
    """A line `set NAME = V` of a spec. `name`: a param by its qualified name, or a setting of a field such as
    `trail.half_life`."""

    name: str
    value: Expr
    span: Span


@expression_class
class ComparisonRun:
    """The reference run with which a spec compares the judged run.

    `scene`: the scene of the reference run, if it differs from the spec's. `changes`: its `set` lines, which are added to those
    of the spec."""

    scene: nodes.Text | None
    changes: tuple[SpecChange, ...]
    span: Span


@expression_class
class Spec:
    """A checked spec. `pass_share`: the fraction of seeds that must pass, from 0 to 1. `reference_run`: None if the spec has no
    `against` block."""

    name: str
    scene: nodes.Text | None
    duration: Expr | None
    seeds: tuple[int, ...]
    changes: tuple[SpecChange, ...]
    expectations: tuple[Expectation, ...]
    span: Span
    pass_share: float = 1.0
    reference_run: ComparisonRun | None = None


GEOMETRY_MEASURES = {"overlap": "number", "penetration": "length", "off_surface": "length"}
MOTION_MEASURES = {
    "turn_p99": "angle",
    "tilt_p99": "angle",
    "tilt_max": "angle",
    "step_max": "number",
    "circling": "number",
    "standing": "number",
    "heads_inside": "number",
    "body_inside": "number",
    "overlap_start": "number",
    "overlap_p99": "number",
    "deep_max": "number",
    "straightness": "number",
}

# The expressions that only specs and measures can have
RUN_EXPRESSIONS = (AggregateExpr, StartValue, ReferenceRunValue, TimeOf, MeasureValue, BodyMeasure, CellValue, MotionMeasure)
