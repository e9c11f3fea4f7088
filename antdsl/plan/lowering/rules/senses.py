"""Rules for senses, for values of the run such as the time, and for the push towards a velocity."""

from __future__ import annotations

from collections.abc import Callable

from antdsl.plan.builder import PlanError
from antdsl.plan.field_components import name_field_components
from antdsl.plan.ir import PlanNode
from antdsl.plan.lowering import values
from antdsl.plan.lowering.expressions import lower_expression, lower_scalar, lower_vector
from antdsl.plan.lowering.sets import cast_ray
from antdsl.plan.lowering.values import LoweredValue, NamedThing, VectorNodes
from antdsl.plan.lowering.writer import PlanWriter, UnsupportedConstruct
from antdsl.plan.simplify import get_constant_value
from antdsl.program import model
from antdsl.program.tables.rows import BuiltinRow, SenseRow
from antdsl.program.tables.senses import SENSE_BY_OPERATION


def _get_thing_name(w: PlanWriter, e: model.OperationExpr, index: int = 0) -> str:
    expr = e.args[index]
    assert expr is not None
    thing = lower_expression(w, expr)
    if not isinstance(thing, NamedThing):
        raise PlanError(f"expected a thing of the world, not a {type(thing).__name__}: {e.span.text!r}")
    return thing.name


def _make_sense_rule(sense: SenseRow, word: BuiltinRow) -> Callable[[PlanWriter, model.OperationExpr], LoweredValue]:
    """Return the rule of a word that has the same arguments as its sense: the named thing first, then the operands."""
    first, size = sense.find_result_index(word.part)

    def lower_sense(w: PlanWriter, e: model.OperationExpr) -> LoweredValue:
        rest = e.args[1:] if sense.thing_kind else e.args
        operands = [node for arg in rest if arg is not None for node in _list_operands(lower_expression(w, arg), arg)]
        sense_node = w.b(sense.op, *operands, attrs=(_get_thing_name(w, e),) if sense.thing_kind else ())
        if len(sense.kinds) == 1:
            return sense_node
        components = [w.b("get", sense_node, attrs=(first + i,)) for i in range(size)]
        return VectorNodes(*components) if size == 3 else components[0]

    return lower_sense


def _list_operands(value: LoweredValue, e: model.Expr) -> tuple[PlanNode, ...]:
    """Return a value as operands: one for a number, three for a vector."""
    if isinstance(value, PlanNode):
        return (value,)
    if isinstance(value, VectorNodes):
        return (value.x, value.y, value.z)
    raise PlanError(f"expected a number or a vector, not a {type(value).__name__}: {e.span.text!r}")


def _lower_nearest_cells(w: PlanWriter, e: model.OperationExpr) -> list[PlanNode]:
    count_expr = e.args[1]
    assert count_expr is not None
    count = get_constant_value(lower_scalar(w, count_expr))
    if count is None:
        raise UnsupportedConstruct("a computed number of cells", e.span, "write the number itself: `nearest: 16`")
    cells = w.b("field.strongest", attrs=(_get_thing_name(w, e), max(1, min(27, int(count)))))
    return [w.b("get", cells, attrs=(i,)) for i in range(4)]


def _lower_field_max(w: PlanWriter, e: model.OperationExpr) -> LoweredValue:
    return _lower_nearest_cells(w, e)[0]


def _lower_strongest(w: PlanWriter, e: model.OperationExpr) -> LoweredValue:
    return VectorNodes(*_lower_nearest_cells(w, e)[1:])


def _lower_ray(w: PlanWriter, e: model.OperationExpr) -> LoweredValue:
    direction, reach = e.args[0], e.args[1]
    assert direction is not None and reach is not None
    return cast_ray(w, values.normalise_vector(w.b, lower_vector(w, direction)), lower_scalar(w, reach), _get_thing_name(w, e, 2))


def _lower_slope(w: PlanWriter, e: model.OperationExpr) -> LoweredValue:
    return values.compute_angle_between(w.b, w.read_vector("up"), _read_world_up(w))


def _lower_uphill(w: PlanWriter, e: model.OperationExpr) -> LoweredValue:
    """Return the world's up direction, projected onto the plane perpendicular to the agent's up. Its length is the sine of the
    ground's slope."""
    up, sky = w.read_vector("up"), _read_world_up(w)
    return values.subtract_vectors(w.b, sky, values.scale_vector(w.b, up, values.compute_dot_product(w.b, up, sky)))


def _read_world_up(w: PlanWriter) -> VectorNodes:
    return VectorNodes(w.read_run_value("up_x"), w.read_run_value("up_y"), w.read_run_value("up_z"))


def _lower_flow_value(w: PlanWriter, e: model.OperationExpr) -> LoweredValue:
    """Return the vector of a flow at the agent. `e` may also name a field of vectors; its vector is projected onto the ground
    under the agent."""
    name = _get_thing_name(w, e)
    if not _is_vector_field(w, name):
        return _READ_FLOW(w, e)
    stored = VectorNodes(*(w.b("field.value", attrs=(each,)) for each in name_field_components(name)))
    up = w.read_vector("up")
    return values.subtract_vectors(w.b, stored, values.scale_vector(w.b, up, values.compute_dot_product(w.b, up, stored)))


def _lower_reachable(w: PlanWriter, e: model.OperationExpr) -> LoweredValue:
    """Return a node that is true if a flow leads from the agent's position to its target. If `e` names a field of vectors, it is
    true where the vector is not 0."""
    if not _is_vector_field(w, _get_thing_name(w, e)):
        return _TEST_REACHABLE(w, e)
    vector = _lower_flow_value(w, e)
    assert isinstance(vector, VectorNodes)
    return w.b("gt", values.compute_dot_product(w.b, vector, vector), w.b.add_number(0))


def _is_vector_field(w: PlanWriter, name: str) -> bool:
    return name in w.program.fields and w.program.fields[name].has_vectors


def _lower_run_value(w: PlanWriter, e: model.OperationExpr) -> LoweredValue:
    name = _get_thing_name(w, e)
    return w.read_run_value(name) if name == "dt" else w.b("step", attrs=(name,))


def _lower_event(w: PlanWriter, e: model.OperationExpr) -> LoweredValue:
    return w.b("event", attrs=(_get_thing_name(w, e),))


def _lower_match(w: PlanWriter, e: model.OperationExpr) -> LoweredValue:
    """Return the push that reaches a requested velocity within this step: (requested - own) mass / (max_force dt), with a length
    of at most 1 (Reynolds 1999, 6)."""
    assert e.args[0] is not None
    b = w.b
    change = values.subtract_vectors(b, lower_vector(w, e.args[0]), w.read_vector("velocity"))
    strength = b("mul", w.read_at_step_start("max_force"), w.read_run_value("dt"))
    return values.limit_length(
        b, values.scale_vector(b, change, b("div", w.read_at_step_start("mass"), strength)), b.add_number(1)
    )


_READ_FLOW, _TEST_REACHABLE = (
    _make_sense_rule(SENSE_BY_OPERATION[op], SENSE_BY_OPERATION[op].words[0]) for op in ("flow.value", "flow.reachable")
)
_COMPUTED_SENSES = {
    "field_max": _lower_field_max, "strongest": _lower_strongest, "ray": _lower_ray, "slope": _lower_slope,
    "uphill": _lower_uphill, "run": _lower_run_value, "event": _lower_event, "match": _lower_match,
    "flow_value": _lower_flow_value, "reachable": _lower_reachable,
}  # fmt: skip
SENSE_RULES = {
    word.op: _make_sense_rule(sense, word)
    for sense in SENSE_BY_OPERATION.values()
    for word in sense.words
    if word.op not in _COMPUTED_SENSES
} | _COMPUTED_SENSES
