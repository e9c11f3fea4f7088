"""The senses of agents: one function per operation of the plan, for any number of rows at once.

All backends use these functions for draws, rays, fields, curves, items and other agents. Each backend computes sets and
reductions with its own method. Arguments are arrays with one entry per row, or single values. Results are arrays with one entry
per row."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.casting.nearby import FeelerQuery
from antdsl.casting.obstacle import Obstacle
from antdsl.casting.tolerances import MIN_VECTOR_LENGTH
from antdsl.casting.triangle_grid import Arrays
from antdsl.ground.protocol import Footing, GroundMove
from antdsl.numerics import elementary, noise, randomness
from antdsl.numerics import vectors as vec
from antdsl.plan import ir
from antdsl.runtime.clip_values import read_clip_value
from antdsl.runtime.collisions import find_new_contacts
from antdsl.runtime.moving import moving_geometry
from antdsl.runtime.moving.clearance.obstacle_clearance import get_obstacle_clearance, is_contact_possible
from antdsl.runtime.sensing.lamp_light import sense_light
from antdsl.runtime.sensing.neighbourhood import compute_clear_velocity, find_widest_gap
from antdsl.runtime.sensing.thing_senses import PLACED_THING_SENSES, Rows, SenseValue, count_rows, expand_to_rows, read_positions
from antdsl.runtime.world import AXES, Population, World

FLOAT32_MIN_VECTOR_LENGTH = np.float32(MIN_VECTOR_LENGTH)
NO_HIT = (np.False_, np.float32(np.inf), np.float32(0), np.float32(0), np.float32(0))  # result of a ray without a hit
_BORDER_INSET_SHARE = 1e-6  # share of the path from a border point to the middle of its face


def compute_constant(node: ir.PlanNode) -> SenseValue:
    """Return the value of a constant node as a NumPy scalar."""
    match node.op:
        case "const":
            return np.float32(node.attrs[0])
        case "const.bool":
            return np.bool_(node.attrs[0])
        case "const.i32":
            return np.int32(node.attrs[0])
        case "const.i64":
            return np.int64(node.attrs[0])
    raise AssertionError(f"{node.op} is not constant")


def compute_uniform_leaf(world: World, node: ir.PlanNode) -> SenseValue:
    """Return the value of a leaf node that is equal for all agents, as a scalar: a constant, a param, the time, or similar."""
    if node.rate is ir.UpdateRate.CONST:
        return compute_constant(node)
    match node.op:
        case "param":
            return world.params[node.attrs[0]]
        case "told":
            return world.spec_values[node.attrs[0]]
        case "step":
            return np.float32(world.display_frame * world.dt if node.attrs[0] == "time" else world.display_frame)
        case "run":
            name = node.attrs[0]
            if name.startswith("up_"):
                return np.float32(world.up[AXES.index(name[-1])])
            return np.float32(world.dt if name == "dt" else world.setting.unit_mm)
    raise AssertionError(f"{node.op} is not a value of the run")


def _sense_id(world: World, population: Population, node: ir.PlanNode, rows: Rows) -> SenseValue:
    return population.ids[rows]


def _sense_age(world: World, population: Population, node: ir.PlanNode, rows: Rows) -> SenseValue:
    return _compute_age(world, population.born[rows])


def _compute_age(world: World, birth_frames: NDArray[np.int64]) -> SenseValue:
    """Return the age (s) of agents, given the frames in which they were born."""
    steps = np.maximum(world.frame - birth_frames, 0)  # at birth, `born` is the next frame
    return (steps * world.dt).astype(np.float32)


def _sense_draw(world: World, population: Population, node: ir.PlanNode, rows: Rows) -> SenseValue:
    site, index = node.attrs
    return randomness.draw_uniform(world.setting.seed, world.frame, population.name, site, index, population.ids[rows])


def _sense_drawn_agent(world: World, population: Population, node: ir.PlanNode, rows: Rows) -> SenseValue:
    site, species = node.attrs
    word = randomness.draw_four_words(world.setting.seed, world.frame, population.name, site, 0, population.ids[rows])[0]
    return world.populations[species].draw_living_ids(word)


def _sense_event(world: World, population: Population, node: ir.PlanNode, rows: Rows) -> SenseValue:
    flags = population.events.get(node.attrs[0])
    return np.zeros(count_rows(rows), np.bool_) if flags is None else flags[rows]


def _sense_touched_surface(world: World, population: Population, node: ir.PlanNode, rows: Rows) -> SenseValue:
    return population.footing.mesh[rows] == world.surface_index.get(node.attrs[0], -1)


def _sense_agent_register(world: World, population: Population, node: ir.PlanNode, rows: Rows, ids: SenseValue) -> SenseValue:
    """Return a register of other agents at the start of the step. `ids`: the agents. It is 0 for dead agents and for the id
    -1."""
    species, register = node.attrs
    other = world.populations[species]
    at = other.find_rows(expand_to_rows(ids, rows))
    source = other.start[register]
    is_alive = at >= 0
    return (
        np.where(is_alive, source[np.where(is_alive, at, 0)], source.dtype.type(0))
        if len(source)
        else np.zeros(len(at), source.dtype)
    )


def _sense_agent_age(world: World, population: Population, node: ir.PlanNode, rows: Rows, ids: SenseValue) -> SenseValue:
    other = world.populations[node.attrs[0]]
    at = other.find_rows(expand_to_rows(ids, rows))
    if not len(other):
        return np.zeros(len(at), np.float32)
    return np.where(at >= 0, _compute_age(world, other.born[np.where(at >= 0, at, 0)]), np.float32(0))


def _sense_agent_alive(world: World, population: Population, node: ir.PlanNode, rows: Rows, ids: SenseValue) -> SenseValue:
    return world.populations[node.attrs[0]].find_rows(expand_to_rows(ids, rows)) >= 0


def _sense_item_amount(world: World, population: Population, node: ir.PlanNode, rows: Rows, item: SenseValue) -> SenseValue:
    items, attribute = node.attrs
    source = world.items[items].visible_values[attribute]
    item = expand_to_rows(item, rows)
    has_item = (item >= 0) & (item < len(source))
    return (
        np.where(has_item, source[np.where(has_item, item, 0)], np.float32(0)) if len(source) else np.zeros(len(item), np.float32)
    )


def _sense_item_alive(world: World, population: Population, node: ir.PlanNode, rows: Rows, item: SenseValue) -> SenseValue:
    item = expand_to_rows(item, rows)
    return (item >= 0) & (item < len(world.items[node.attrs[0]]))


def _sense_ray(
    world: World,
    population: Population,
    node: ir.PlanNode,
    rows: Rows,
    dx: SenseValue,
    dy: SenseValue,
    dz: SenseValue,
    reach: SenseValue,
) -> SenseValue:
    """Return the result of one feeler for each row, in the same form as `_sense_rays`."""
    n = count_rows(rows)
    rays = tuple(np.ascontiguousarray(expand_to_rows(v, rows), np.float32) for v in (dx, dy, dz, reach))
    hits = tuple(np.full(n, value) for value in NO_HIT)
    _sense_rays(world, population, node, rows, [(np.ones(n, np.bool_), rays, hits)])
    return hits


def _sense_rays(world: World, population: Population, node: ir.PlanNode, rows: Rows, queries: Sequence[FeelerQuery]) -> None:
    """Compute what the feelers of n agents hit, and write it to the results of `queries`.

    Operands: directions of any length (x y z) and the reach (mm), float32[n]. Results, initially `NO_HIT`: whether the feeler
    hits, the distance (mm) and the normal (x y z)."""
    name, start = node.attrs[0], population.start
    place = start["position.x"][rows], start["position.y"][rows], start["position.z"][rows]
    clear = get_obstacle_clearance(world, population, name)
    levels = None if world.detail_levels is None else world.detail_levels.find_levels(world, population, name)
    which = [(world.obstacles[name], clear[rows])]
    if levels is not None and world.detail_levels is not None:
        far = np.float32(np.inf)
        boxes = np.where(levels == 1, world.detail_levels.get_box_clearance(world, population, name), far)
        which = [
            (world.obstacles[name], np.where(levels == 0, clear, far)[rows]),
            (world.detail_levels.get_box_scene(name), boxes[rows]),
        ]
    for scene, near in which:
        left = scene.cast_feeler_batch((*place, near), queries, world.options.threads)
        if left:
            _cast_remaining_feelers(scene, (*place, near), left, queries, world.options.threads)


def _cast_remaining_feelers(
    scene: Obstacle,
    columns: Arrays,
    remaining_feelers: Sequence[tuple[int, NDArray[np.intp]]],
    queries: Sequence[FeelerQuery],
    threads: int,
) -> None:
    """Compute what the remaining feelers hit in one scene, with all rays together.

    `remaining_feelers`, `columns`: the feelers, in the form that `Obstacle.cast_feeler_batch` takes and returns."""
    *place, clear = columns
    row = np.concatenate([rows for _, rows in remaining_feelers])
    ask_numbers = np.repeat([each for each, _ in remaining_feelers], [len(rows) for _, rows in remaining_feelers])
    with np.errstate(all="ignore"):
        wx, wy, wz, far = (np.concatenate([queries[each][1][k].take(rows) for each, rows in remaining_feelers]) for k in range(4))
        size = np.sqrt((wx * wx + wy * wy) + wz * wz)
        near = (far > 0) & (far < np.inf) & is_contact_possible(clear.take(row), far)
        sound = np.flatnonzero(near & (size > FLOAT32_MIN_VECTOR_LENGTH) & (size < np.inf))
        if not len(sound):
            return
        row, ask_numbers, size, far = (v.take(sound) for v in (row, ask_numbers, size, far))
        positions, directions = [v.take(row) for v in place], [v.take(sound) / size for v in (wx, wy, wz)]
        hits = scene.cast_feelers(positions, directions, far, threads)
    for each, _ in remaining_feelers:
        own = (ask_numbers == each).nonzero()[0]
        for into, values in zip(queries[each][2], (hits.hit, hits.t, hits.nx, hits.ny, hits.nz), strict=True):
            into[row[own]] = values[own]


def _sense_obstacle_near(world: World, population: Population, node: ir.PlanNode, rows: Rows, reach: SenseValue) -> SenseValue:
    reach = expand_to_rows(reach, rows)
    x, y, z = read_positions(world, population, rows)
    hits = world.obstacles[node.attrs[0]].find_nearest_within(x, y, z, reach, threads=world.options.threads)
    return hits.hit, hits.t, hits.nx, hits.ny, hits.nz


def _sense_field_value(world: World, population: Population, node: ir.PlanNode, rows: Rows) -> SenseValue:
    return world.fields[node.attrs[0]].sample(population.cells[node.attrs[0]][rows])


def _sense_field_ahead(
    world: World, population: Population, node: ir.PlanNode, rows: Rows, ahead: SenseValue, turn: SenseValue
) -> SenseValue:
    """Return the value of a field at the distance `ahead` from agents, in the direction `turn` (radians, to the left of the
    heading).

    The heading is projected onto the ground below the feet; `up` is the normal of this ground."""
    up = vec.split_columns(population.normal[rows], np.float32)
    heading = vec.take_rows(vec.get_vector_registers(population.start, "heading"), rows)
    ahead, turn = (expand_to_rows(each, rows) for each in (ahead, turn))
    with np.errstate(all="ignore"):
        sound = np.isfinite(ahead) & np.isfinite(turn)
        ahead, turn = np.where(sound, ahead, np.float32(0)), np.where(sound, turn, np.float32(0))
        left = vec.cross(up, heading)
        displacement = vec.add(vec.scale(heading, elementary.cos(turn)), vec.scale(left, elementary.sin(turn)))
        displacement = vec.scale(displacement, ahead)
        moved = world.ground.move(
            population.footing.select_rows(rows),
            vec.stack_rows(displacement),
            vec.stack_rows(heading),
            vec.stack_rows(up),
            population.start["size"][rows].astype(np.float64),
            world.options.threads,
            stop_at_borders=True,
        )
    field = world.fields[node.attrs[0]]
    footing, position = _move_inside_border(world, moved)
    place = moving_geometry.compute_rest_positions(world, footing, position)
    cells = field.cells.find_cells_by_side(place, world.ground.find_sides(footing))
    return field.sample(np.where(moved.is_lost, -1, cells))


def _move_inside_border(world: World, move: GroundMove) -> tuple[Footing, NDArray[np.float64]]:
    """Return the footings and the positions at the ends of walks. An end at an open border is moved slightly into the face.

    A border may be on the boundary of two cells. A position exactly on it could read a cell outside the surface."""
    meshes = world.ground.meshes
    if meshes is None or not move.is_blocked.any():
        return move.footing, move.position
    rows = np.flatnonzero(move.is_blocked & meshes.get_face_numbers(move.footing)[1])
    footing, position = move.footing.copy(), move.position.copy()
    inner = footing.select_rows_on_meshes(rows)
    for weight in (inner.b1, inner.b2):
        weight += (1 / 3 - weight) * _BORDER_INSET_SHARE
    footing.write_rows(rows, inner)
    position[rows] = meshes.position(inner)
    return footing, position


def _sense_field_strongest(world: World, population: Population, node: ir.PlanNode, rows: Rows) -> SenseValue:
    field, count = node.attrs
    value, x, y, z = world.fields[field].sample_strongest(population.cells[field][rows], int(count))
    nothing = ~(value > 0)
    positions = moving_geometry.move_from_rest(world, population, rows, (x, y, z))
    return value, *(np.where(nothing, own, k) for own, k in zip(read_positions(world, population, rows), positions, strict=True))


def _sense_field_gradient(world: World, population: Population, node: ir.PlanNode, rows: Rows) -> SenseValue:
    slope = world.fields[node.attrs[0]].sample_gradient(population.cells[node.attrs[0]][rows])
    return moving_geometry.rotate_from_rest(world, population, rows, slope)


def _sense_noise(world: World, population: Population, node: ir.PlanNode, rows: Rows, *arguments: SenseValue) -> SenseValue:
    """Return the noise at the agents' positions in the axes of the scene, at the time of the step. `arguments`: scale, seed,
    period."""
    scale, seed, period = (np.float64(1) * expand_to_rows(each, rows) for each in arguments)
    place = np.stack(read_positions(world, population, rows)).astype(np.float64) + world.origin[:, None]
    step_time = np.full((1, count_rows(rows)), world.display_frame * world.dt)
    unit = np.stack((scale, scale, scale, period))
    cells = np.concatenate((place, step_time)) / np.where(unit > 0, unit, np.nan)
    which = np.floor(np.where(np.abs(seed) < noise.MAX_LATTICE_COORDINATE, seed, 0.0)).astype(np.int64)
    return noise.compute_noise(cells, which).astype(np.float32)


def _list_row_numbers(rows: Rows) -> NDArray[np.intp]:
    return np.arange(rows.start, rows.stop) if isinstance(rows, slice) else np.asarray(rows)


def _sense_clear_velocity(
    world: World, population: Population, node: ir.PlanNode, rows: Rows, *arguments: SenseValue
) -> SenseValue:
    """Return a velocity that avoids collisions. `arguments`: the wish x, y, z (mm/s), `within` (mm), `horizon` (s), and the
    largest number of neighbours."""
    which = _list_row_numbers(rows)
    wx, wy, wz = (expand_to_rows(each, rows) for each in arguments[:3])
    within, horizon, most = (expand_to_rows(np.float64(1) * each, rows) for each in arguments[3:])
    return compute_clear_velocity(world, population, which, (wx, wy, wz), within, horizon, most)


def _sense_widest_gap(
    world: World, population: Population, node: ir.PlanNode, rows: Rows, radius: SenseValue, max_count: SenseValue
) -> SenseValue:
    radius, max_count = (expand_to_rows(np.float64(1) * each, rows) for each in (radius, max_count))
    return find_widest_gap(world, population, _list_row_numbers(rows), radius, max_count)


def _sense_clip_value(world: World, population: Population, node: ir.PlanNode, rows: Rows, clip: SenseValue) -> SenseValue:
    return read_clip_value(world, population, node.attrs[0], clip, rows)


def _sense_contact(world: World, population: Population, node: ir.PlanNode, rows: Rows, *touched: SenseValue) -> SenseValue:
    """Return the contact that begins, and the ids of all agents now touched. `touched`: the ids of the agents touched before."""
    known = np.stack([np.asarray(expand_to_rows(each, rows), np.int64) for each in touched], axis=1)
    contact_ids, known = find_new_contacts(world, population, node.attrs[0], _list_row_numbers(rows), known)
    return contact_ids, *(np.ascontiguousarray(ids) for ids in known.T)


SENSE_FUNCTIONS: Mapping[str, Callable[..., SenseValue]] = {
    **PLACED_THING_SENSES,
    "id": _sense_id,
    "age": _sense_age,
    "draw": _sense_draw,
    "draw.agent": _sense_drawn_agent,
    "event": _sense_event,
    "surface.touching": _sense_touched_surface,
    "agent.get": _sense_agent_register,
    "agent.age": _sense_agent_age,
    "agent.alive": _sense_agent_alive,
    "item.get": _sense_item_amount,
    "item.alive": _sense_item_alive,
    "ray": _sense_ray,
    "obstacle.near": _sense_obstacle_near,
    "field.value": _sense_field_value,
    "field.ahead": _sense_field_ahead,
    "field.strongest": _sense_field_strongest,
    "field.gradient": _sense_field_gradient,
    "noise": _sense_noise,
    "clear.velocity": _sense_clear_velocity,
    "gap.widest": _sense_widest_gap,
    "lamp.light": sense_light,
    "contact": _sense_contact,
    "clip.value": _sense_clip_value,
}

# Senses with operands and results in the arrays of machine code, for several queries of n rows at once.
# Each entry has its function and its initial results.
BATCHED_SENSES: Mapping[
    str, tuple[Callable[[World, Population, ir.PlanNode, Rows, Sequence[FeelerQuery]], None], tuple[Any, ...]]
] = {"ray": (_sense_rays, NO_HIT)}
