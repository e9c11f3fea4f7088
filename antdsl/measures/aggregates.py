"""Aggregates: numbers over all agents of a species, all items or all cells of a field, and conditions on such numbers. Results
do not depend on the row order.

Totals and counts are stored in float64, correctly rounded (J. Shewchuk, Discrete & Computational Geometry 18, 1997:
`math.fsum`). Everything else is float32 as in the language. Sums, differences and comparisons of totals and integers use
float64, so that even a tiny loss is visible among many agents."""

from __future__ import annotations

from math import fsum
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.numerics.elementwise import FUNCTION_BY_NAME
from antdsl.plan import ir
from antdsl.plan.lowering.spec_plans import AggregatePlan
from antdsl.plan.traverse import collect_required_nodes
from antdsl.runtime.sensing.world_senses import compute_uniform_leaf
from antdsl.runtime.world import Population, World

_EXACT_OPERATIONS = frozenset(("add", "sub", "neg", "abs", "min", "max", "mul", "lt", "le", "gt", "ge", "eq", "ne", "where"))


def sum_exactly(values: NDArray[Any]) -> np.float64:
    """Return the sum of all values, rounded only once. The result is not finite if a value is not."""
    wide = np.asarray(values, np.float64)
    return np.float64(fsum(wide.tolist())) if np.isfinite(wide).all() else np.float64(wide.sum())


def evaluate_aggregate(world: World, populations: dict[str, Population], plan: AggregatePlan) -> Any:
    """Return the number that an aggregate computes: float64 for totals and counts, float32 for all others.

    If there are no agents, return the aggregate of the empty set."""
    if plan.kind == "field" and plan.body_register is None:
        values = world.fields[plan.subject].amounts
        if plan.reducer == "count":
            return np.float64(len(values))
        return _aggregate_values(plan.reducer, values, len(values))
    if plan.subject in world.solids:
        return np.float64(world.solids[plan.subject].measure_volume())
    population = populations[plan.subject]
    chosen = None if plan.where_register is None else population.now[plan.where_register]
    count = len(population) if chosen is None else int(np.count_nonzero(chosen))
    if plan.body_register is None:
        return np.float64(count) if plan.reducer in ("count", "total") else np.float32(count > 0)
    values = population.now[plan.body_register] if plan.amount is None else world.items[plan.subject].amounts[plan.amount]
    if chosen is not None:
        values = values[chosen]
    if values.dtype == np.bool_:
        return _aggregate_truths(plan.reducer, int(np.count_nonzero(values)), count)
    return _aggregate_values(plan.reducer, values, count)


def _aggregate_truths(operation: str, true_count: int, count: int) -> Any:
    if operation == "count":
        return np.float64(true_count)
    if operation == "share":
        return np.float32(true_count / count if count else 0.0)
    return np.float32(true_count == count if operation == "every" else true_count > 0)


def _aggregate_values(operation: str, values: NDArray[Any], count: int) -> Any:
    if operation == "total":
        return sum_exactly(values)
    if operation == "mean":
        return np.float32(sum_exactly(values) / count if count else 0.0)
    if operation == "min":
        return np.float32(values.min()) if count else np.float32(np.inf)
    return np.float32(values.max()) if count else np.float32(-np.inf)


def evaluate_uniform_node(world: World, node: ir.PlanNode, spec_values: dict[str, Any]) -> Any:
    """Return the value of a node that has one value for all agents, computed by the backends' elementwise operations."""
    values: dict[ir.PlanNode, Any] = {}
    with np.errstate(all="ignore"):
        for each in collect_required_nodes((node,)):
            f = FUNCTION_BY_NAME.get(each.op)
            if f is None:
                values[each] = spec_values[each.attrs[0]] if each.op == "told" else compute_uniform_leaf(world, each)
                continue
            args = [values[a] for a in each.args]
            if each.op not in _EXACT_OPERATIONS or not all(map(_is_exact, each.args, args)):
                args = [np.float32(a) if isinstance(a, np.float64) else a for a in args]
            values[each] = f(*args)
    return values[node]


def _is_exact(node: ir.PlanNode, value: Any) -> bool:
    """Return whether the value of a node is exact, that is, computed only from totals, booleans and whole constants."""
    if isinstance(value, np.float32):
        return node.op == "const" and float(value).is_integer()
    return True
