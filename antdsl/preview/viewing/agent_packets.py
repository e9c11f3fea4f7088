"""The packet of each frame: agents ordered by id, items with their amounts, and the feelers of followed agents."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.outputs.edits.edited_cache import EditedCache
from antdsl.outputs.feelers import compute_feeler_rays, list_feelers
from antdsl.plan.ir import Plan
from antdsl.preview.agent_columns import CURRENT_COLUMNS, make_packet_arrays, make_reduced_frame
from antdsl.preview.binary_packets import pack_arrays
from antdsl.preview.viewing.action_arrays import collect_actions, make_action_arrays, read_stored_poses, store_poses
from antdsl.preview.viewing.edited_packets import make_edited_arrays
from antdsl.preview.viewing.page_units import choose_unit, find_unit_size
from antdsl.preview.viewing.view_state import PageInterest, SlotPackets, ViewState
from antdsl.program.model import Program
from antdsl.runtime import Population, World

_MISSING_STATE = 255
Arrays = dict[str, NDArray[Any]]


class AgentPackets:
    """A maker of the packets for the slot `frame`. Directions are unit vectors times 127, speeds are in mm/s, and columns are in
    units that the scene message gives."""

    def __init__(self) -> None:
        self._last_key: tuple[World | None, int, int | None, PageInterest, EditedCache | None] = (
            None,
            0,
            None,
            PageInterest(),
            None,
        )

    def make_packets(self, view_state: ViewState) -> SlotPackets:
        """Yield the packet of the current frame if the frame, the world, the edits or the displayed columns have changed."""
        world, stored_frame, view = view_state.world, view_state.stored_frame, view_state.edited.find_view()
        frame = world.frame if stored_frame is None else stored_frame
        key = world, frame, stored_frame, view_state.interest, view
        if key[0] is self._last_key[0] and key[1:] == self._last_key[1:]:
            return
        self._last_key = key
        if stored_frame is not None:  # also while the session is simulating towards that frame
            reduced_frame = view_state.session.read_reduced_frame(stored_frame)
            if reduced_frame is not None:
                arrays = _add_edits(_make_stored_arrays(view_state, stored_frame, reduced_frame), view_state, frame)
                yield "frame", pack_arrays("frame", arrays, frame=frame, light=True)
            return
        arrays = _add_edits(_make_world_arrays(view_state), view_state, frame) | _make_item_arrays(world, view_state.shot.program)
        feelers, feeler_owners = _make_followed_feelers(world, view_state.shot.program, view_state.interest)
        yield "frame", pack_arrays("frame", arrays | feelers, frame=frame, light=False, felt=feeler_owners)


def _make_stored_arrays(view_state: ViewState, frame: int, reduced_frame: Mapping[str, Arrays]) -> Arrays:
    """Return the arrays of agents for a stored frame. `reduced_frame`: the stored arrays, by species."""
    plan = view_state.session.timeline.find_stretch(frame).shot.plan
    arrays = _renumber_states(_join_stored_arrays(reduced_frame), plan, view_state.shot.plan)
    for pose_arrays in read_stored_poses(view_state.session, frame).values():
        arrays |= pose_arrays
    return arrays


def _make_world_arrays(view_state: ViewState) -> Arrays:
    """Return the arrays of agents for the session's current frame."""
    world, arrays = view_state.world, Arrays()
    factors = _find_column_factors(world, view_state.shot.program, view_state.interest)
    store_poses(view_state.session)
    reduced_frame = view_state.session.read_reduced_frame(world.frame) or {}  # this also stores the reduced frame
    poses = read_stored_poses(view_state.session, world.frame)
    for name, population in world.populations.items():
        then = reduced_frame[name] if name in reduced_frame else make_reduced_frame(population)
        arrays |= _join_stored_arrays({name: then}) | _make_current_arrays(population, factors)
        if name in poses:
            arrays |= poses[name]
        else:
            arrays |= make_action_arrays(collect_actions(world, view_state.shot, population, then))
    return arrays


def _add_edits(arrays: Arrays, view_state: ViewState, frame: int) -> Arrays:
    """Return the arrays of agents after applying the edits that users added. `arrays`: the arrays without edits."""
    edited = view_state.edited.read_frame(frame)
    return arrays if edited is None else make_edited_arrays(*edited, view_state.world, view_state.shot, arrays)


def _make_current_arrays(population: Population, factors: Mapping[tuple[str, str], float]) -> Arrays:
    """Return the arrays that reduced frames do not contain. `factors`: by species and column, the factor to the displayed
    unit."""
    name, now, rows = population.name, population.now, population.get_rows_by_id()
    arrays: Arrays = {f"{name}/{column}": array for column, array in make_packet_arrays(population, CURRENT_COLUMNS).items()}
    for (species, column), factor in factors.items():
        if species == name:
            arrays[f"{name}/column/{column}"] = now[column][rows].astype(np.float32) * np.float32(factor)
    return arrays


def _find_column_factors(world: World, program: Program, interest: PageInterest) -> dict[tuple[str, str], float]:
    """Return the unit conversion factors of the requested columns, by species and column. Unknown columns are omitted."""
    factors = {}
    for species, name in sorted(interest.columns):
        declared = {each.name: each for each in program.species[species].attributes} if species in program.species else {}
        if name in declared and species in world.populations and name in world.populations[species].now:
            factors[species, name] = 1 / find_unit_size(choose_unit(declared[name]), world.setting.unit_mm, world.dt)
    return factors


def _make_followed_feelers(world: World, program: Program, interest: PageInterest) -> tuple[Arrays, list[tuple[str, int, int]]]:
    """Return the feelers of all followed agents, concatenated, and a list of these agents.

    An entry of the list is the species, the id, and the number of the agent's feelers."""
    feelers = [(who, make_feeler_arrays(world, program, who.species, who.agent)) for who in interest.followed_agents]
    feelers = [(who, arrays) for who, arrays in feelers if arrays]
    owners = [(who.species, who.agent, len(arrays["feelers"])) for who, arrays in feelers]
    return {name: np.concatenate([arrays[name] for _, arrays in feelers]) for name in (feelers[0][1] if feelers else ())}, owners


def _make_item_arrays(world: World, program: Program) -> Arrays:
    arrays: Arrays = {}
    for name, items in world.items.items():
        arrays[f"item/{name}/position"] = items.position.astype(np.float32)
        arrays[f"item/{name}/size"] = items.visible_values["radius"]
        for declared in program.world[name].attributes:
            if declared.name in items.amounts:
                one = find_unit_size(choose_unit(declared), world.setting.unit_mm, world.dt)
                arrays[f"item/{name}/amount/{declared.name}"] = (items.amounts[declared.name] / one).astype(np.float32)
    return arrays


def _renumber_states(arrays: Arrays, stored_plan: Plan, page_plan: Plan) -> Arrays:
    """Return the arrays with states renumbered from `stored_plan` to `page_plan`. States that `page_plan` lacks become 255."""
    for name, species in stored_plan.species.items() if stored_plan is not page_plan else ():
        known = (
            {machine.name: machine.states for machine in page_plan.species[name].machines} if name in page_plan.species else {}
        )
        for machine in species.machines:
            states = known.get(machine.name, ())
            table = np.array([states.index(each) if each in states else _MISSING_STATE for each in machine.states], np.uint8)
            arrays[f"{name}/state/{machine.name}"] = table[arrays[f"{name}/state/{machine.name}"]]
    return arrays


def _join_stored_arrays(reduced_frame: Mapping[str, Arrays]) -> Arrays:
    """Return the arrays of a reduced frame in one dictionary, under the names `SPECIES/NAME`."""
    return {f"{species}/{name}": array for species, light in reduced_frame.items() for name, array in light.items()}


def make_feeler_arrays(world: World, program: Program, species: str, agent: int) -> dict[str, NDArray[Any]]:
    """Return the segments of an agent's k feelers and whether each has hit a surface; {} if the agent does not exist. `feelers`
    float32 (k, 2, 3): from the agent to the end or the first hit of the feeler. `feelers/hit` uint8 (k)."""
    population = world.populations.get(species)
    row = int(population.find_rows(np.array([agent]))[0]) if population is not None else -1
    if population is None or row < 0:
        return {}
    scale = 1 / world.setting.unit_mm
    position = population.position[row : row + 1] * scale
    ahead, up = (population.read_vector(name)[row : row + 1] for name in ("heading", "up"))
    size = population.now["size"][row : row + 1].astype(np.float64) * scale
    feelers = list_feelers(program, species, world.params, world.setting.unit_mm, world.dt)
    if not feelers:
        return {}
    lines = np.concatenate([compute_feeler_rays(entry, position, ahead, up, size) for entry in feelers]) / scale
    displacement = lines[:, 1] - lines[:, 0]
    reach = np.sqrt((displacement * displacement).sum(axis=1))
    unit = (displacement / np.maximum(reach, 1e-12)[:, None]).astype(np.float32)
    start = lines[:, 0].astype(np.float32)
    nearest = np.full(len(lines), np.inf, np.float32)
    for name in (*world.plan.obstacles, *world.solids):
        hits = world.obstacles[name].cast_feelers(start.T, unit.T, reach.astype(np.float32))
        nearest = np.minimum(nearest, np.where(hits.hit, hits.t, np.inf))
    hit = np.isfinite(nearest)
    lines[hit, 1] = start[hit] + unit[hit] * nearest[hit, None]
    return {"feelers": lines.astype(np.float32), "feelers/hit": hit.astype(np.uint8)}
