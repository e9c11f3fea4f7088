"""A checked spec: what is expected and when, and the expressions that only specs can have."""

from __future__ import annotations

from antdsl.program.model import Binding, Expr, ValueType, expression_class
from antdsl.source import Span
from antdsl.syntax import nodes


@expression_class
class AggregateExpr(Expr):
    """A number or bool about a whole population. `how`: total mean min max share count any every. `over`: a SPECIES, ITEMS, FIELD
    or SOLID (its total is the volume).

    `where` and `body` are expressions about one agent or item. `elements` are the names bound to it."""

    how: str
    over: ValueType
    elements: tuple[Binding, ...]
    where: Expr | None
    body: Expr | None


@expression_class
class AtStart(Expr):
    """The value of a number at the first frame of the spec, or in the first frame of each agent."""

    value: Expr


@expression_class
class OtherRun(Expr):
    """The value of a number about the whole in the spec's reference run, at the same frame."""

    value: Expr


@expression_class
class BodyMeasure(Expr):
    """The pose of an agent's body, by its name in GEOMETRY: values that agents themselves do not sense."""

    name: str


@expression_class
class CellValue(Expr):
    """The amount of a field in a cell, where cells are evaluated one by one."""

    field: str


@expression_class
class MotionMeasure(Expr):
    """A measure of motion over the whole run, by its name in a run's summary."""

    name: str


@expression_class
class ExpectationReading:
    """A part of a condition with a value that is reported if it fails; `unit` is one that the author wrote there, or a usual
    one."""

    expr: Expr
    unit: str


@expression_class
class Expectation:
    """One expectation. `kind`: always never eventually finally sooner within for until. `species`: judged for each of its agents;
    None: for the whole. `held`: the condition counts once it has held for that time. `since`: the time starts whenever this
    condition becomes true."""

    kind: str
    block: int  # 0 is the spec itself, then the `each` blocks in their order
    species: str | None
    condition: Expr
    time: Expr | None
    readings: tuple[ExpectationReading, ...]
    at_end: bool  # it asks for the motion, which is known when the run is over
    span: Span
    held: Expr | None = None
    since: Expr | None = None


@expression_class
class SpecChange:
    """`set NAME = V`: a param by its qualified name, or a setting of a field (`trail.half_life`)."""

    name: str
    value: Expr
    span: Span


@expression_class
class ComparisonRun:
    """The run that a spec compares with: another scene, or the same, with changes in addition to the spec's own."""

    scene: nodes.Text | None
    changes: tuple[SpecChange, ...]
    span: Span


@expression_class
class Spec:
    """`share`: of the seeds that must pass."""

    name: str
    scene: nodes.Text | None
    duration: Expr | None
    seeds: tuple[int, ...]
    changes: tuple[SpecChange, ...]
    expectations: tuple[Expectation, ...]
    span: Span
    share: float = 1.0
    against: ComparisonRun | None = None


GEOMETRY_MEASURES = {"overlap": "number", "penetration": "length", "off_surface": "length"}
MOTION_MEASURES = {
    "turn_p99": "angle",
    "tilt_p99": "angle",
    "tilt_max": "angle",
    "step_max": "number",
    "circling": "number",
    "standing": "number",
    "heads_inside": "number",
    "overlap_start": "number",
    "overlap_p99": "number",
    "deep_max": "number",
    "straightness": "number",
}
