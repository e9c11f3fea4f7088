"""Sets as lists of pairs, and reductions over these pairs. A pair consists of a requesting row and another agent or an item.

Pairs are sorted by the requesting row. Every reduction gives the same bits for any order of the pairs of a row."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl import limits
from antdsl.numerics import exact_sums
from antdsl.plan import ir
from antdsl.plan.traverse import collect_required_nodes, iterate_statements, list_blocks, list_operands
from antdsl.runtime.faults import Fault, LimitStop
from antdsl.runtime.sensing.image_pairs import can_use_image_grid, measure_offsets, measure_pairs_within
from antdsl.runtime.sensing.item_pairs import find_items_within
from antdsl.runtime.sensing.nearest_pairs import find_nearest_agents
from antdsl.runtime.sensing.neighbourhood import find_species_grid
from antdsl.runtime.world import AXES, Items, Population, World
from antdsl.senses.neighbours import TooManyNeighboursError, ViewConeColumns
from antdsl.source import Span

Floats = NDArray[np.float32]
Index = NDArray[np.integer[Any]]
NO_AGENT = np.int64(-1)
NO_ITEM = np.int32(-1)
_DISTANCE_SLACK_FACTOR = 1 + 1e-6  # exceeds the float32 rounding of a distance
MAX_PAIRS_PER_CHUNK = 1 << 22  # limit for a chunk that compares all agents with all


@dataclass(frozen=True, slots=True, eq=False)
class NeighbourPairRows:
    """The pairs of a set.

    `others`: the other agents or the items. `count`: the number of requesting rows. `agent_indices`: for each pair, the index of
    the requesting row, from 0. `other_indices`: the row in `others`. `dx`, `dy`, `dz`: the position of the other minus that of
    the requester, float32 mm. `distance`: the length of this vector."""

    others: Population | Items
    count: int  # requesting rows
    agent_indices: Index
    other_indices: Index
    dx: Floats
    dy: Floats
    dz: Floats
    distance: Floats

    def select_rows(self, rows: NDArray[np.intp]) -> NeighbourPairRows:
        """Return only the pairs of the given requesting rows, which are numbered from 0 again."""
        number = np.full(self.count, -1)
        number[rows] = np.arange(len(rows))
        i = number.take(self.agent_indices)
        keep = np.flatnonzero(i >= 0)
        rest: Any = (a.take(keep) for a in (self.other_indices, self.dx, self.dy, self.dz, self.distance))
        return NeighbourPairRows(self.others, len(rows), i.take(keep), *rest)


def find_pairs(
    world: World, population: Population, node: ir.PlanNode, rows: Any, args: tuple[Any, ...], threads: int = 1
) -> NeighbourPairRows:
    """Return the pairs of a set for the given rows (a slice or an array). `args`: the values of the set's operands."""
    own = tuple(np.ascontiguousarray(population.start[f"position.{axis}"][rows]) for axis in AXES)
    if node.op == "set.items":
        items = world.items[node.attrs[0]]
        if world.periodic is not None:
            return NeighbourPairRows(items, len(own[0]), *measure_pairs_within(world, items, own, None, args[0]))
        return NeighbourPairRows(items, len(own[0]), *find_items_within(items, own, args[0]))
    other = world.populations[node.attrs[0]]
    ids = population.ids[rows] if other is population else None
    if node.op == "set.every":
        plain = world.periodic is None and needs_only_nearest(world.plan.species[population.name], node)
        nearest = find_nearest_agents(world, other, own, ids) if plain else None
        return _make_all_pairs(world, other, own, ids) if nearest is None else NeighbourPairRows(other, len(own[0]), *nearest)
    radius, cosine = args
    view = None if node.attrs[1] else _read_view_cones(population, rows, cosine, len(own[0]))
    try:
        return _find_pairs_within(world, other, own, ids, radius, view, threads)
    except TooManyNeighboursError:
        pass
    species = world.plan.species[population.name]
    count = find_needed_nearest_count(species, node)
    try:
        if count is None:
            raise TooManyNeighboursError
        return _find_pairs_within(world, other, own, ids, _limit_radii_to_nearest(other, own, ids, radius, count), view, threads)
    except TooManyNeighboursError:
        span = _find_first_use_of_set(species, node)
        what = "neighbours" if span is None else " ".join(span.text.split())
        why = (
            f"has more than {limits.MAX_CANDIDATES_IN_RADIUS:,} neighbours in its radius, of which it uses only "
            f"the {limits.MAX_QUERY_NEIGHBOURS} nearest"
        )
        fault = Fault(world.frame, population.name, -1, what, span, (), f"{why}: {_format_radius_advice(other, radius)}")
        raise LimitStop(fault) from None


def _format_radius_advice(other: Population, radius: Any) -> str:
    """Return advice for messages about a radius that contains too many agents. If they cannot all fit without overlap, the advice
    is to separate them."""
    widest, body = float(np.max(radius)), float(np.median(other.start["radius"]))
    if 0 < widest < body * np.sqrt(limits.MAX_CANDIDATES_IN_RADIUS):
        return "the agents overlap: place them farther apart, or write a smaller radius"
    return "write a smaller radius"


def needs_only_nearest(species: ir.SpeciesPlan, node: ir.PlanNode) -> bool:
    """Return whether a set is a complete species of which only the nearest agent is used. If so, the set contains only this
    agent."""
    return node.op == "set.every" and find_needed_nearest_count(species, node) == 1


@lru_cache(256)
def find_needed_nearest_count(species: ir.SpeciesPlan, node: ir.PlanNode) -> int | None:
    """Return how many of the nearest agents suffice for all results that use a set. None if results need other agents too."""
    every = collect_required_nodes(
        n for _, block in list_blocks(species) for _, statement in iterate_statements(block) for n in list_operands(statement)
    )
    reductions = [each for each in every if each.op.startswith("reduce.") and each.args[0] is node]
    if not reductions or any(each.op != "reduce.agent" or each.args[2].op != "pair.distance" for each in reductions):
        return None
    all_round = node.op == "set.every" or node.attrs[1]
    plain = all_round and all(each.args[1].op == "const.bool" and each.args[1].attrs[0] for each in reductions)
    return 1 if plain else limits.MAX_QUERY_NEIGHBOURS


def _limit_radii_to_nearest(
    other: Population, own_positions: tuple[Floats, ...], ids: NDArray[np.int64] | None, radius: Any, count: int
) -> Floats:
    """Return the radii (mm), shortened so that they still contain the nearest `count` others."""
    from scipy.spatial import cKDTree

    theirs = np.stack([other.start[f"position.{axis}"] for axis in AXES], axis=1).astype(np.float64)
    mine = np.stack(own_positions, axis=1).astype(np.float64)
    known, is_finite = np.isfinite(theirs).all(axis=1), np.isfinite(mine).all(axis=1)
    away = np.full(len(mine), np.inf)
    away[is_finite] = cKDTree(theirs[known]).query(mine[is_finite], [count + (ids is not None)])[0][:, 0]
    shorter: Floats = np.minimum(radius, away * _DISTANCE_SLACK_FACTOR).astype(np.float32)
    return shorter


def _find_first_use_of_set(species: ir.SpeciesPlan, node: ir.PlanNode) -> Span | None:
    """Return the shortest text in the species' source file that uses a set. The set itself may be defined in a library."""
    if _is_in_program_text(node.span):
        return node.span
    for _, block in list_blocks(species):
        for _, statement in iterate_statements(block):
            below = collect_required_nodes(list_operands(statement))
            if node not in below or not _is_in_program_text(statement.span):
                continue
            using = {node.number}
            using.update(each.number for each in below if any(arg.number in using for arg in each.args))
            spans = [
                each.span for each in below if each.number in using and each.span is not None and _is_in_program_text(each.span)
            ]
            return min(spans, key=lambda span: span.end - span.start, default=statement.span)
    return node.span


def _is_in_program_text(span: Span | None) -> bool:
    return span is not None and not span.source.path.startswith("<")


def _read_view_cones(population: Population, rows: Any, cosine: Any, count: int) -> ViewConeColumns:
    """Return the heading of each requesting row, and `cosine`, the cosine of half its field of view, as columns."""
    hx, hy, hz = (population.start[f"heading.{axis}"][rows] for axis in AXES)
    return hx, hy, hz, np.full(count, cosine) if np.ndim(cosine) == 0 else cosine


def _find_pairs_within(
    world: World,
    other: Population,
    own_positions: tuple[Floats, ...],
    ids: NDArray[np.int64] | None,
    radius: Any,
    view: ViewConeColumns | None,
    threads: int,
) -> NeighbourPairRows:
    """Return the pairs within a radius (mm) and in view, found with a cell grid."""
    widest = float(np.max(radius, initial=0.0)) if np.size(radius) else 0.0
    if not can_use_image_grid(world, widest):
        return NeighbourPairRows(
            other, len(own_positions[0]), *measure_pairs_within(world, other, own_positions, ids, radius, view)
        )
    widest = widest if np.isfinite(widest) and widest > 0 else 1.0
    grid = find_species_grid(world, other, widest)
    p = grid.find_pairs(
        None,
        radius,
        qx=own_positions[0],
        qy=own_positions[1],
        qz=own_positions[2],
        qid=ids,
        view=view,
        threads=threads,
        limit=limits.MAX_CANDIDATES_IN_RADIUS,
    )
    return NeighbourPairRows(other, len(own_positions[0]), p.i, p.j, p.dx, p.dy, p.dz, p.distance)


def _make_all_pairs(
    world: World, other: Population, own_positions: tuple[Floats, ...], ids: NDArray[np.int64] | None
) -> NeighbourPairRows:
    """Return the pairs of each requesting row with all agents of a species, except with itself."""
    n, m = len(own_positions[0]), len(other)
    i, j = np.repeat(np.arange(n), m), np.tile(np.arange(m), n)
    if ids is not None:
        keep = np.flatnonzero(other.ids.take(j) != ids.take(i))
        i, j = i.take(keep), j.take(keep)
    theirs = [other.start[f"position.{axis}"].take(j) for axis in AXES]
    dx, dy, dz = measure_offsets(world, theirs, [own.take(i) for own in own_positions])
    return NeighbourPairRows(other, n, i, j, dx, dy, dz, np.sqrt((dx * dx + dy * dy) + dz * dz))


# --- reductions ------------------------------------------------------------------------------------------------------


def _select_rows_by_condition(pairs: NeighbourPairRows, condition: Any) -> tuple[Index, NDArray[np.intp] | None]:
    """Return the requesting rows of those pairs that satisfy a condition, and the indices of these pairs (None: all pairs)."""
    if np.ndim(condition) == 0:
        return (pairs.agent_indices, None) if condition else (pairs.agent_indices[:0], np.empty(0, np.intp))
    keep = np.flatnonzero(condition)
    return (pairs.agent_indices, None) if len(keep) == len(pairs.agent_indices) else (pairs.agent_indices.take(keep), keep)


def _get_body_values(pairs: NeighbourPairRows, body: Any, selected_rows: NDArray[np.intp] | None) -> Floats:
    """Return the values of a reduction's body for the selected pairs. `selected_rows`: the indices of these pairs; None for
    all."""
    values: Floats = np.full(len(pairs.agent_indices), body) if np.ndim(body) == 0 else body
    return values if selected_rows is None else values.take(selected_rows)


def _reduce_sum(pairs: NeighbourPairRows, node: ir.PlanNode, condition: Any, body: Any) -> Any:
    i, keep = _select_rows_by_condition(pairs, condition)
    return exact_sums.sum_by_index(i, _get_body_values(pairs, body, keep), int(node.attrs[0]), pairs.count)


def _reduce_count(pairs: NeighbourPairRows, node: ir.PlanNode, condition: Any) -> Any:
    return np.bincount(_select_rows_by_condition(pairs, condition)[0], minlength=pairs.count).astype(np.float32)


def _reduce_any(pairs: NeighbourPairRows, node: ir.PlanNode, condition: Any) -> Any:
    has_any = np.zeros(pairs.count, np.bool_)
    has_any[_select_rows_by_condition(pairs, condition)[0]] = True
    return has_any


def _find_row_starts(i: Index) -> NDArray[np.intp]:
    return np.flatnonzero(np.concatenate(([True], i[1:] != i[:-1])))


def _find_row_minima(i: Index, body: Floats, count: int) -> Floats:
    """Return the least `body` of each requesting row, ignoring NaN. It is inf for rows without pairs."""
    result = np.full(count, np.inf, np.float32)
    if len(i):
        starts = _find_row_starts(i)
        result[i[starts]] = np.minimum.reduceat(np.where(body == body, body, np.float32(np.inf)) + np.float32(0), starts)
    return result


def _reduce_min(pairs: NeighbourPairRows, node: ir.PlanNode, condition: Any, body: Any) -> Any:
    i, keep = _select_rows_by_condition(pairs, condition)
    return _find_row_minima(i, _get_body_values(pairs, body, keep), pairs.count)


def _reduce_max(pairs: NeighbourPairRows, node: ir.PlanNode, condition: Any, body: Any) -> Any:
    i, keep = _select_rows_by_condition(pairs, condition)
    return -_find_row_minima(i, -_get_body_values(pairs, body, keep), pairs.count) + np.float32(0)


def _find_best_label(pairs: NeighbourPairRows, condition: Any, body: Any, label: NDArray[Any], missing_label: Any) -> Any:
    """Return, for each requesting row, the label (id or number) of the pair with the least `body`; if several are equal, the
    least label.

    `missing_label`: the result for rows without pairs."""
    result = np.full(pairs.count, missing_label)
    i, keep = _select_rows_by_condition(pairs, condition)
    if not len(i):
        return result
    body = _get_body_values(pairs, body, keep)
    label = label if keep is None else label.take(keep)
    best = np.flatnonzero(body == _find_row_minima(i, body, pairs.count).take(i))
    if len(best):
        i, label = i.take(best), label.take(best)
        starts = _find_row_starts(i)
        result[i[starts]] = np.minimum.reduceat(label, starts)
    return result


def _find_best_agent(pairs: NeighbourPairRows, node: ir.PlanNode, condition: Any, body: Any) -> Any:
    assert isinstance(pairs.others, Population)
    return _find_best_label(pairs, condition, body, pairs.others.ids.take(pairs.other_indices), NO_AGENT)


def _find_best_item(pairs: NeighbourPairRows, node: ir.PlanNode, condition: Any, body: Any) -> Any:
    return _find_best_label(pairs, condition, body, pairs.other_indices.astype(np.int32), NO_ITEM)


def _find_nth_label(
    pairs: NeighbourPairRows, condition: Any, body: Any, number: Any, label: NDArray[Any], missing_label: Any
) -> Any:
    """Return, for each requesting row, the label (id or number) of the pair with the n-th least `body`. Equal pairs are sorted by
    label.

    `number`: n for each row. `missing_label`: the result for rows with fewer than n pairs."""
    result = np.full(pairs.count, missing_label)
    i, keep = _select_rows_by_condition(pairs, condition)
    body, number = _get_body_values(pairs, body, keep), np.floor(_get_body_values(pairs, number, keep))
    label = label if keep is None else label.take(keep)
    order = np.lexsort((label, body, i))
    order = order[body[order] == body[order]]
    if not len(order):
        return result
    i, starts = i.take(order), _find_row_starts(i.take(order))
    place = np.arange(len(i)) - np.repeat(starts, np.diff(np.append(starts, len(i))))
    those = np.flatnonzero(place == number.take(order) - 1)
    result[i.take(those)] = label.take(order.take(those))
    return result


def _find_nth_agent(pairs: NeighbourPairRows, node: ir.PlanNode, condition: Any, body: Any, number: Any) -> Any:
    assert isinstance(pairs.others, Population)
    return _find_nth_label(pairs, condition, body, number, pairs.others.ids.take(pairs.other_indices), NO_AGENT)


def _find_nth_item(pairs: NeighbourPairRows, node: ir.PlanNode, condition: Any, body: Any, number: Any) -> Any:
    return _find_nth_label(pairs, condition, body, number, pairs.other_indices.astype(np.int32), NO_ITEM)


REDUCTION_FUNCTIONS: Mapping[str, Callable[..., Any]] = {
    "reduce.sum": _reduce_sum,
    "reduce.count": _reduce_count,
    "reduce.any": _reduce_any,
    "reduce.min": _reduce_min,
    "reduce.max": _reduce_max,
    "reduce.agent": _find_best_agent,
    "reduce.item": _find_best_item,
    "reduce.nth_agent": _find_nth_agent,
    "reduce.nth_item": _find_nth_item,
}


def read_pair_value(pairs: NeighbourPairRows, node: ir.PlanNode) -> NDArray[Any]:
    """Return, for each pair, a value of the other agent, of the item, or of the pair itself."""
    match node.op:
        case "pair.x":
            return pairs.dx
        case "pair.y":
            return pairs.dy
        case "pair.z":
            return pairs.dz
        case "pair.distance":
            return pairs.distance
        case "other.row":
            return pairs.other_indices.astype(np.int32)
        case "other.id":
            assert isinstance(pairs.others, Population)
            return pairs.others.ids.take(pairs.other_indices)
        case "other":
            source = pairs.others.start if isinstance(pairs.others, Population) else pairs.others.visible_values
            return source[node.attrs[0]].take(pairs.other_indices)
    raise AssertionError(f"{node.op} is not of a pair")
