"""What a spec says once it is checked: what is expected and when, and the expressions that only a spec can have."""

from __future__ import annotations

from antdsl.program.model import Binding, Expr, Type, value
from antdsl.source import Span
from antdsl.syntax import nodes


@value
class Whole(Expr):
    """A number or truth about all there are. `how`: total mean min max share count any every; `over`: a SPECIES, ITEMS, FIELD
    or SOLID (its total is the volume).

    `where` and `body` are expressions of one of them: an agent itself, or an item. `elements` are the names that stand for it."""

    how: str
    over: Type
    elements: tuple[Binding, ...]
    where: Expr | None
    body: Expr | None


@value
class AtStart(Expr):
    """What a number was at the first frame of the spec, or in the first frame of each agent."""

    value: Expr


@value
class Measured(Expr):
    """A measure of motion over the whole run, by its name in a run's summary."""

    name: str


@value
class Reading:
    """A part of a condition whose value is told where it fails; `unit` is one that the author wrote there, or a usual one."""

    expr: Expr
    unit: str


@value
class Expectation:
    """`kind`: always never eventually within until. `species`: judged of each agent of it; None: of the whole."""

    kind: str
    block: int  # 0 is the spec itself, then the `each` blocks in their order
    species: str | None
    condition: Expr
    time: Expr | None
    readings: tuple[Reading, ...]
    at_end: bool  # it asks for the motion, which is known when the run is over
    span: Span


@value
class Changed:
    """`set NAME = V`: a param by its qualified name, or a setting of a field (`trail.half_life`)."""

    name: str
    value: Expr
    span: Span


@value
class Spec:
    name: str
    scene: nodes.Text | None
    duration: Expr | None
    seeds: tuple[int, ...]
    changes: tuple[Changed, ...]
    expectations: tuple[Expectation, ...]
    span: Span


MOTION = {"turn_p99": "angle", "circling": "number", "standing": "number", "overlap_p99": "number", "straightness": "number"}
