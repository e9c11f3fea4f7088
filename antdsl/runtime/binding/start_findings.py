"""Warnings about the start, after binding: too little space for all agents, no path to the target of a flow, or starting values
of fields outside the ground."""

from __future__ import annotations

import math

import numpy as np

from antdsl.diagnostics import Report
from antdsl.fields.path_flow import PathFlow
from antdsl.plan.ir import SpeciesPlan
from antdsl.plan.traverse import collect_required_nodes, iterate_statements, list_blocks, list_operands
from antdsl.runtime.notes.target_findings import find_far_targets
from antdsl.runtime.world import World
from antdsl.scene import Scene
from antdsl.scene.setting import SolvedFlowData
from antdsl.scene.staging.item_placement import is_away_from_surfaces

_GAP_HELP = "open a path, move the target or the crowd, or handle the case: `when not reachable({flow}) -> …`"
_REACHABLE_OPERATION = "flow.reachable"
_UNREACHABLE_HELP = (
    "open a path, or move the target or the crowd; if this is intended: `# antdsl: ignore[unreachable-target] WHY`"
)


def find_start_warnings(scene: Scene, world: World) -> Report:
    """Return warnings about the crowd and the fields of a world, each located in the scene."""
    report = find_crowding_warnings(scene, world)
    report.extend(find_far_targets(scene, world))
    for name, number in world.unreached_field_starts:
        help = "write a larger `radius` or `extent`, move it, or check the `units` of the mesh"
        words = f"no cell of `{name}` is there, so this starting value has no effect"
        report.warning("off-surface", words, scene.find_span("fields", name, number), help)
    for name, flow in world.setting.flows.items():
        if not isinstance(flow, SolvedFlowData) or name not in world.flows:
            continue
        gap = _measure_excessive_gap(world, name)
        if gap:
            words = f"the target of `{name}` is {gap:.4g} mm away from the ground, so paths end at the nearest ground point"
            help = "move the target onto the ground, or give it a radius that reaches the ground"
            report.warning("unreachable-target", words, scene.find_span("world", name, key=True), help)
        for species, plan in world.plan.species.items():
            count = len(world.populations[species])
            uses = _find_flow_operations(plan).get(name, set())
            cut_off = count - count_agents_with_path(world, species, name) if count and uses - {_REACHABLE_OPERATION} else 0
            if cut_off:
                words = f"{cut_off:,} of {count:,} `{species}` have no path to the target of `{name}`"
                help = _UNREACHABLE_HELP if _REACHABLE_OPERATION in uses else _GAP_HELP.format(flow=name)
                report.warning("unreachable-target", words, scene.find_span("world", name, "solved"), help)
    return report


def _measure_excessive_gap(world: World, name: str) -> float:
    """Return the distance (mm) of a flow's target from the ground, or 0 if it is at most a tenth of the ground's extent.

    Smaller distances are normal, for example for a target slightly above the ground."""
    flow = world.flows[name]
    if not isinstance(flow, PathFlow) or flow.crossable_ground is None:
        return 0.0
    points = flow.crossable_ground.surface.points
    return flow.target_gap if len(points) and flow.target_gap > 0.1 * float(np.ptp(points, axis=0).max()) else 0.0


def count_agents_with_path(world: World, species: str, flow: str) -> int:
    """Return how many agents of a species have a path to the target of a flow."""
    population = world.populations[species]
    place, up = population.position.astype(np.float64), population.normal.astype(np.float64)
    return int(np.count_nonzero(world.flows[flow].has_flow_at(world.ground.meshes, population.footing, place, up)))


def _find_flow_operations(species: SpeciesPlan) -> dict[str, set[str]]:
    """Return, by flow name, the operations by which a species reads the flow."""
    uses: dict[str, set[str]] = {}
    operand_nodes = [
        node for _, block in list_blocks(species) for _, each in iterate_statements(block) for node in list_operands(each)
    ]
    for node in collect_required_nodes([*operand_nodes, *species.memoised_senses]):
        if node.op.startswith("flow."):
            uses.setdefault(str(node.attrs[0]), set()).add(node.op)
    return uses


def find_crowding_warnings(scene: Scene, world: World) -> Report:
    """Return a warning for each crowd line without space for all its agents, located at the place of the line.

    Lines with a place that is off all surfaces are skipped, because another check reports them."""
    report, setting = Report(), world.setting
    for line in world.overcrowded_lines:
        if is_away_from_surfaces(setting.crowds[line.crowd_index].place, setting, scene.model.up):
            continue
        low, high = (f"{radius:.3g}" for radius in line.radius)
        wide = f"{low} mm" if low == high else f"{low} to {high} mm"
        cover = (
            f"{line.covered_area:,.0f} mm²"
            if line.available_area is None
            else f"{line.covered_area:,.0f} of {line.available_area:,.0f} mm²"
        )
        words = f"only {line.fitting_count:,} of {line.count:,} `{line.species}` have space at the start"
        place = scene.model.crowd[line.crowd_index].place
        words += (
            f": with a radius of {wide} {'or half of `apart` ' if place.apart is not None else ''}all of them would cover {cover}"
        )
        help = "write a smaller `count`, or a smaller `radius` in the program"
        if place.apart is not None:
            help = "write a smaller `count`, a larger place, or a smaller `apart`"
        elif line.sufficient_radius is not None:
            larger = f"`radius: {_round_up(line.sufficient_radius / scene.model.unit_mm)} {scene.model.units}`"
            help = f"write {larger}, a smaller `count`, or a smaller `radius` in the program"
        elif line.fits_available_area:
            help = "use all sides with `by: area`, or write a smaller `count`"
        elif place.inside is not None or place.density is not None:
            help = "write a larger place, a smaller `count`, or a smaller `radius` in the program"
        report.warning("no-room", words, scene.find_span("crowd", line.crowd_index, "place"), help)
    return report


def _round_up(value: float) -> str:
    """Return a number as text, rounded up to two significant digits."""
    step = 10.0 ** (math.floor(math.log10(value)) - 1)
    return f"{math.ceil(value / step) * step:g}"
