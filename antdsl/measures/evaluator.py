"""Evaluation of the expressions of specs and measures, in a copy of the world with separate registers.

The backend of the run evaluates them. The run itself does not change."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from copy import copy
from math import radians
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.casting.rays import RayScene
from antdsl.ground.protocol import Footing
from antdsl.measures.aggregates import evaluate_aggregate, evaluate_uniform_node
from antdsl.plan import ir
from antdsl.plan.lowering.spec_plans import QueryPlan, StartValuePlan
from antdsl.plan.traverse import collect_required_nodes, iterate_statements, list_operands
from antdsl.program.expectations import MOTION_MEASURES
from antdsl.runtime.backends import BACKENDS
from antdsl.runtime.lifecycle import update_agent_cells
from antdsl.runtime.periodic_world import measure_overlaps
from antdsl.runtime.requests import EffectRequests
from antdsl.runtime.world import AXES, DTYPE_BY_KIND, Items, Population, World, make_fixed_columns

FloatArray = NDArray[np.float32]
_UNKNOWN_VALUE = 1e300  # not representable as float32; marks agents that did not exist yet


class RunEvaluator:
    """Evaluates the expressions of a spec or of measures. Call `evaluate_frame` at each frame, from the first on.

    `values`: by name, the aggregates of the last evaluated frame, and stored values of earlier frames."""

    def __init__(self, plan: QueryPlan, world: World) -> None:
        self.plan, self.first = plan, world.frame
        self.backend: Any = BACKENDS[world.options.backend](plan.plan)
        self.values: dict[str, Any] = {}
        value_plans = (plan.aggregates, plan.stored_values, plan.reference_values)
        self.value_names = [each.name for plans in value_plans for each in plans]
        self.value_names += [f"motion.{name}" for name in MOTION_MEASURES]
        self.start_values: dict[str, NDArray[np.float64]] = {}  # by agent id
        self.field_reading_species = {name for name, species in plan.plan.species.items() if _has_field_requests(species)}

    def evaluate_node(self, world: World, node: ir.PlanNode) -> Any:
        """Return the value of a node that has one value for all agents."""
        return evaluate_uniform_node(world, node, self.values)

    def evaluate_frame(self, world: World, compared_values: Mapping[str, Any]) -> World:
        """Return a copy of the world, with the results of the expressions in its registers. `compared_values`: values of the
        reference run, by name."""
        self._store_motion_measures(world)
        self.values |= compared_values
        for items in world.items.values():
            items.publish_amounts()
        spec_world = copy(world)
        spec_world.plan, spec_world.backend, spec_world.grids, spec_world.clearances, spec_world.touching_agents = (
            self.plan.plan,
            self.backend,
            {},
            {},
            None,
        )
        spec_world.populations = {name: self._make_queried_population(spec_world, name) for name in self.plan.plan.species}
        spec_world.spec_values = dict.fromkeys(self.value_names, np.float32(0))  # no value is computed yet
        self.backend.begin_step(spec_world)
        self.run_block(spec_world, "decide")
        for each in self.plan.aggregates:
            self.values[each.name] = evaluate_aggregate(world, spec_world.populations, each)
        self._store_values(world, spec_world)
        spec_world.spec_values |= {name: np.float32(number) for name, number in self.values.items()}
        self.backend.begin_step(spec_world)
        self.run_block(spec_world, "act")
        return spec_world

    def _store_values(self, world: World, spec_world: World) -> None:
        """Store the values of this frame that are needed in later frames."""
        for each in self.plan.stored_values:
            if not isinstance(each, StartValuePlan):
                if not np.isfinite(self.values.setdefault(each.name, np.float32(np.inf))) and self.evaluate_node(
                    world, each.condition
                ):
                    self.values[each.name] = np.float32((world.frame - self.first) / float(world.setting.fps))
            elif each.value is not None:
                if each.name not in self.values:
                    self.values[each.name] = self.evaluate_node(world, each.value)
            elif each.species is not None and each.source_register is not None:
                self._record_first_values(spec_world.populations[each.species], each.name, each.source_register)

    def run_block(self, spec_world: World, block: str, species: str | None = None, rows: Any = None) -> None:
        """Run a block of the spec for all agents, or only for `rows` of one species. Results are written to registers of
        `spec_world`."""
        for name, population in spec_world.populations.items():
            if len(population) and getattr(population.plan, block).statements and species in (None, name):
                self.backend.run(spec_world, population, block, rows)

    def _store_motion_measures(self, world: World) -> None:
        """Store the motion measures of this frame. A measure without data is NaN."""
        for name, number in world.motion.summarise().items():
            unknown = world.motion.ways == 0 and name in ("circling", "straightness")
            value = radians(number) if MOTION_MEASURES[name] == "angle" else number
            self.values[f"motion.{name}"] = np.float32(np.nan if unknown else value)

    def _make_queried_population(self, spec_world: World, name: str) -> Population:
        """Return a population that stands for the agents of a species, the items of a name, or the cells of a field."""
        if name in spec_world.items:
            return self._make_item_population(spec_world.items[name])
        if name in spec_world.fields:
            return self._make_cell_population(spec_world, name)
        return self._make_agent_population(spec_world, spec_world.populations[name])

    def _make_cell_population(self, spec_world: World, name: str) -> Population:
        """Return a population that stands for the cells of a field, all at the origin."""
        plan, values = self.plan.plan.species[name], np.asarray(spec_world.fields[name].amounts)
        start, count = {"value": values.astype(np.float32)}, len(values)
        nowhere = np.broadcast_to(np.zeros(3), (count, 3))
        now = _make_result_arrays(plan.registers, start, count)
        return _make_population(plan, start, now, nowhere)

    def _make_agent_population(self, spec_world: World, population: Population) -> Population:
        """Return a population of the same agents with additional registers for results."""
        respondents = copy(population)
        respondents.columns = population.columns.copy()
        respondents.plan, respondents.effects, respondents.cells = self.plan.plan.species[population.name], EffectRequests(), {}
        count = len(population)
        registers = respondents.plan.registers
        respondents.now = _make_result_arrays(registers, population.start, count)
        for name in self.plan.body_measures.get(population.name, ()):
            respondents.now[f"geometry.{name}"] = measure_geometry(spec_world, population, name)
        respondents.start = {**population.start, **respondents.now}
        if population.name in self.field_reading_species:
            update_agent_cells(spec_world, respondents)
        return respondents

    def _make_item_population(self, items: Items) -> Population:
        """Return a population that stands for items, as if they were agents of a separate species."""
        plan, count = self.plan.plan.species[items.name], len(items)
        start = {f"position.{axis}": items.visible_values[axis] for axis in AXES}
        start |= {name: items.visible_values[name] for name in ("radius", *items.amounts)}
        now = _make_result_arrays(plan.registers, start, count)
        return _make_population(plan, start, now, items.position)

    def _record_first_values(self, judged: Population, name: str, register: str) -> None:
        """Copy the value that a number has in each agent's first frame to the register that conditions read."""
        ids, current_values = judged.ids, judged.now[register]
        values = self.start_values[name] = extend_table_for_ids(self.start_values.get(name, np.zeros(0)), ids, _UNKNOWN_VALUE)
        values[ids] = np.where(values[ids] == _UNKNOWN_VALUE, current_values, values[ids])
        judged.start[name] = values[ids].astype(np.float32)


def extend_table_for_ids(table: NDArray[Any], ids: NDArray[np.int64], fill_value: Any) -> NDArray[Any]:
    """Return the table with at least one row for each id in `ids`. New rows have the value `fill_value`."""
    missing_count = int(ids.max(initial=-1)) + 1 - len(table)
    return (
        table if missing_count <= 0 else np.concatenate([table, np.full(max(missing_count, len(table)), fill_value, table.dtype)])
    )


def _make_population(
    plan: ir.SpeciesPlan, start: dict[str, NDArray[Any]], registers: dict[str, NDArray[Any]], positions: NDArray[np.float64]
) -> Population:
    """Return a population of things that are not agents and have no ground. `positions`: (n, 3)."""
    n = len(positions)
    return Population(
        plan, make_fixed_columns(n, ids=np.arange(n), position=positions), start, registers, Footing.create_unplaced(n), {}, {}
    )


def _make_result_arrays(
    registers: Mapping[str, ir.Register], given_arrays: Mapping[str, Any], count: int
) -> dict[str, NDArray[Any]]:
    """Return one array for each register that is not in `given_arrays`. Numbers are NaN until a block computes them."""
    result_registers = [register for register in registers.values() if register.name not in given_arrays]
    return {r.name: np.full(count, np.nan if r.kind is ir.ValueKind.F32 else 0, DTYPE_BY_KIND[r.kind]) for r in result_registers}


def _has_field_requests(species: ir.SpeciesPlan) -> bool:
    """Return whether any block reads the field cell of the agent."""
    operand_nodes = (
        node
        for block in (species.decide, species.act, species.blend)
        for _, s in iterate_statements(block)
        for node in list_operands(s)
    )
    return any(node.op.startswith("field.") for node in collect_required_nodes(operand_nodes))


def measure_geometry(world: World, population: Population, name: str) -> FloatArray:
    """Return the measure `name` of GEOMETRY_MEASURES for each agent, float32[n]. Lengths are in mm."""
    return _MEASURE_FUNCTIONS[name](world, population)


def _measure_overlap(world: World, population: Population) -> FloatArray:
    """Return, for each agent, the worst overlap with any other agent: 0 if separate, 1 at the same position."""
    populations = list(world.populations.values())
    measured = [
        each for each in populations if "radius" in each.start and "position.x" in each.start and each.footing is not None
    ]
    x, y, z, radius = (
        np.concatenate([each.start[name] for each in measured]) for name in ("position.x", "position.y", "position.z", "radius")
    )
    own_index = next(k for k, each in enumerate(measured) if each.name == population.name)
    first = sum(len(each) for each in measured[:own_index])
    worst = measure_overlaps(world, x, y, z, radius)
    return worst[first : first + len(population)]


def _measure_penetration(world: World, population: Population) -> FloatArray:
    """Return how deep each agent's centre is inside a solid or a closed obstacle mesh; 0 if it is outside."""
    depth = np.zeros(len(population))
    for name in world.plan.obstacles:
        scene = world.obstacles.get(name)
        if isinstance(scene, RayScene):
            depth = np.maximum(depth, scene.measure_depth_inside(population.position))
    for volume in world.solids.values():
        depth = np.maximum(depth, -volume.sample_distances(population.position))
    return depth.astype(np.float32)


def _measure_surface_distance(world: World, population: Population) -> FloatArray:
    """Return the distance of each agent from its correct position: its clearance above its point on a triangle or solid."""
    distance: NDArray[np.float64] = np.linalg.norm(population.position - world.ground.position(population.footing), axis=1)
    for number, volume in enumerate(world.solids.values(), len(world.setting.surfaces)):
        rows = np.flatnonzero(population.footing.mesh == number)
        distance[rows] = np.maximum(distance[rows], np.abs(volume.sample_distances(population.position[rows])))
    clearance = population.start.get("clearance", np.zeros(len(population)))
    deviation: FloatArray = np.abs(distance - clearance).astype(np.float32)
    return deviation


_MEASURE_FUNCTIONS: Mapping[str, Callable[[World, Population], FloatArray]] = {
    "overlap": _measure_overlap,
    "penetration": _measure_penetration,
    "off_surface": _measure_surface_distance,
}
