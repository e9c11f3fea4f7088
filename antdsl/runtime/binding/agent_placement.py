"""Places agents at the start: on the ground or inside things, outside obstacles, without overlaps.

The position of an agent depends on the seed, its species, its id, and the agents that were placed before it. So adding agents
does not move the others."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from antdsl.numerics import elementary, randomness
from antdsl.numerics import vectors as vec
from antdsl.numerics.vectors import VectorArrays
from antdsl.plan import ir
from antdsl.plan.traverse import iterate_with_positions
from antdsl.program.tables.effects import list_effects_of_phase
from antdsl.runtime.binding.initial_attributes import write_initial_values
from antdsl.runtime.binding.overcrowding import OvercrowdedCrowd
from antdsl.runtime.binding.spacing import (
    RELEASE_TRIES_PER_ROUND,
    OccupiedDiscs,
    StartPositionCandidates,
    has_extent,
    spread_agents,
)
from antdsl.runtime.binding.start_positions import MAX_RANDOM_COVERED_SHARE, PLACEMENT_FRAME, StartPositionSampler
from antdsl.runtime.binding.start_shapes import FULL_TURN, compute_facing
from antdsl.runtime.faults import FaultLog
from antdsl.runtime.lifecycle import apply_deaths_and_births, initialise_cells_of_newborn, initialise_newborn
from antdsl.runtime.line_tables import find_created_ids
from antdsl.runtime.moving import scripted_walks
from antdsl.runtime.moving.clearance.clear_steps import settle_bodies_outside_ground
from antdsl.runtime.moving.tilting import tilt_new_bodies
from antdsl.runtime.world import AXES, Population, World, add_rows, make_empty_population, retain_rows
from antdsl.scene.setting import CrowdData, PlacementData

_MIN_NORMAL_SINE = 1e-3  # if the sine of a direction's angle to the normal is smaller, the direction leads off the ground


def place_crowds(world: World) -> None:
    """Add all crowds to the world. Ids follow the order of the scene's crowd lines."""
    for line in world.crowd_lines:
        world.populations[line.species].next_id += len(line)
    lines = zip(world.setting.crowds, world.crowd_lines, strict=True)
    place_new_agents(world, [(crowd, find_created_ids(crowd, line, None, world.frame)) for crowd, line in lines])
    joined: dict[str, NDArray[np.intp]] = {}
    for name, population in world.populations.items():
        if len(population):
            _shuffle_rows(world, population)
            joined[name] = np.arange(len(population))
    initialise_agents(world, joined)
    world.motion.begin_measuring(world)


def place_new_agents(world: World, new_crowds: Sequence[tuple[CrowdData, NDArray[np.int64]]]) -> dict[str, NDArray[np.intp]]:
    """Add agents of crowd lines. Return their rows, by species. Only their positions are set.

    The new agents overlap neither each other nor existing agents. Positions that the scene gives as points come first, and are
    not changed. Each line avoids the agents of the lines before it. Lines without space for all their agents are added to
    `world.overcrowded_lines`."""
    new_crowds = [(crowd, ids) for crowd, ids in new_crowds if len(ids)]
    if not new_crowds:
        return {}
    starts = [StartPositionSampler(world, crowd) for crowd, _ in new_crowds]
    radius = _compute_spacing_radii(world, new_crowds, starts, _compute_birth_radii(world, new_crowds, starts))
    occupancy = OccupiedDiscs(_compute_position_precision(world))
    rounds = RELEASE_TRIES_PER_ROUND if world.is_stepping else None
    box = None if rounds is None else _find_box_of_start_positions(new_crowds, starts, radius, sum(rounds))
    for population in world.populations.values():
        own_radius = population.now["radius"].astype(np.float64)
        near = slice(None) if box is None else _find_rows_in_reach(population.position, own_radius, box)
        occupancy.add_fixed_discs(population.position[near], own_radius[near])
    draws: dict[int, StartPositionCandidates] = {}
    for k, (_, ids) in enumerate(new_crowds):
        if starts[k].has_points:
            draws[k] = starts[k].draw_candidates(ids, range(1))
            occupancy.add_fixed_discs(draws[k].position, radius[k])
    first = 0
    for k, (crowd, ids) in enumerate(new_crowds):
        if k not in draws:
            draws[k], fits = spread_agents(occupancy, starts[k].draw_candidates, ids, radius[k], first, rounds)
            first += len(ids)
            if not fits.all() and not world.is_stepping:  # at a rate, agents stand in the way only until they walk on
                wide = radius[k][has_extent(radius[k])]
                ends = (float(wide.min(initial=np.inf)), float(wide.max(initial=0.0)))
                cover = float(np.pi * (wide * wide).sum())
                fit, start = int(np.count_nonzero(fits)), starts[k]
                room_for = (start.estimate_area(), start.find_sufficient_radius(cover), start.fits_unlimited_surface(cover))
                world.overcrowded_lines.append(
                    OvercrowdedCrowd(crowd.line_index, crowd.species, len(ids), fit, ends, cover, *room_for)
                )
    first_rows = {crowd.species: len(world.populations[crowd.species]) for crowd, _ in new_crowds}
    for k, (crowd, ids) in enumerate(new_crowds):
        _add_agents_of_line(world, crowd, ids, draws[k])
    if world.notes is not None:
        world.notes.remove_absent_agents(world, first_rows, is_start=not world.is_stepping)
    return {name: np.arange(row, len(world.populations[name])) for name, row in first_rows.items()}


def _find_box_of_start_positions(
    new_crowds: Sequence[tuple[CrowdData, NDArray[np.int64]]],
    start_samplers: Sequence[StartPositionSampler],
    radius: Sequence[NDArray[np.float64]],
    tries: int,
) -> NDArray[np.float64]:
    """Return the corners (2, 3) of a box that contains the bodies of new agents at all positions they may try."""
    drawn = [
        start.draw_candidates(ids, range(tries)).position for (_, ids), start in zip(new_crowds, start_samplers, strict=True)
    ]
    widest = max(float(own[has_extent(own)].max(initial=0.0)) for own in radius)
    points = np.concatenate(drawn)
    return np.stack([points.min(axis=0) - 1.01 * widest, points.max(axis=0) + 1.01 * widest])


def _find_rows_in_reach(
    position: NDArray[np.float64], radius: NDArray[np.float64], box: NDArray[np.float64]
) -> NDArray[np.bool_]:
    """Return a mask of the agents with bodies that extend into a box with corners (2, 3). `position` (n, 3), `radius` (n): mm."""
    reach = 1.01 * np.where(has_extent(radius), radius, 0.0)[:, None]
    is_near: NDArray[np.bool_] = ((position >= box[0] - reach) & (position <= box[1] + reach)).all(axis=1)
    return is_near


def _add_agents_of_line(
    world: World, crowd: CrowdData, ids: NDArray[np.int64], draws: StartPositionCandidates
) -> NDArray[np.intp]:
    """Add the agents of one crowd line at their drawn positions. Return their rows."""
    population = world.populations[crowd.species]
    rows = add_rows(population, ids, world.display_frame, draws.position, draws.footing)
    for k, axis in enumerate(AXES):
        population.now[f"up.{axis}"][rows] = draws.up[:, k]
    population.now["group"][rows] = crowd.line_index
    write_initial_values(world, population, np.arange(rows.start, rows.stop), crowd)
    return np.arange(rows.start, rows.stop)


def _compute_birth_radii(
    world: World, new_crowds: Sequence[tuple[CrowdData, NDArray[np.int64]]], starts: Sequence[StartPositionSampler]
) -> list[NDArray[np.float64]]:
    """Return the radii (mm) at birth of each line's agents, for the positions of the first try.

    A radius may depend on any value that is available at birth, so it is computed in a temporary world."""
    trial = replace(
        world,
        populations={name: make_empty_population(p.plan, world.ground) for name, p in world.populations.items()},
        faults=FaultLog(),
        grids={},
        trees={},
        clearances={},
        transitions={},
        detail_levels=None,
    )
    rows: dict[str, list[NDArray[np.intp]]] = {}
    lines = []
    for (crowd, ids), start in zip(new_crowds, starts, strict=True):
        lines.append(_add_agents_of_line(trial, crowd, ids, start.draw_candidates(ids, range(1))))
        rows.setdefault(crowd.species, []).append(lines[-1])
    joined = {name: np.concatenate(parts) for name, parts in rows.items()}
    for name, chosen in joined.items():
        trial.populations[name].next_id = world.populations[name].next_id
        _orient_agents(trial, trial.populations[name], chosen)
    initialise_newborn(trial, joined)
    radius = {name: trial.populations[name].now["radius"].astype(np.float64) for name in joined}
    return [radius[crowd.species][own] for (crowd, _), own in zip(new_crowds, lines, strict=True)]


def _compute_spacing_radii(
    world: World,
    new_crowds: Sequence[tuple[CrowdData, NDArray[np.int64]]],
    starts: Sequence[StartPositionSampler],
    radius: list[NDArray[np.float64]],
) -> list[NDArray[np.float64]]:
    """Return the radii (mm) of the discs that the agents of each line occupy at the start.

    A radius is at least that of the agent, `radius`, and at least half the distance that the line declares between agents. For an
    even crowd, discs are as large as random placement permits. Lines with the same place are treated together for this."""
    radii = []
    for (crowd, _), start, own in zip(new_crowds, starts, radius, strict=True):
        half = crowd.place.spacing / 2
        if np.isinf(half):
            count = sum(c.count for c in world.setting.crowds if _make_placement_key(c.place) == _make_placement_key(crowd.place))
            half = np.sqrt(MAX_RANDOM_COVERED_SHARE * (start.estimate_area() or 0.0) / (np.pi * max(count, 1)))
        radii.append(np.maximum(own, half) if half > 0 else own)
    return radii


def _make_placement_key(place: PlacementData) -> tuple[object, ...]:
    """Return a key that is equal for lines that distribute their agents evenly in the same place."""
    return place.surfaces, place.disc_centre, place.radius, place.density, place.is_by_area, place.spacing


def _compute_position_precision(world: World) -> float:
    """Return the precision (mm) of positions, which are stored as float32 relative to the world's origin."""
    meshes = world.ground.meshes
    far = 0.0 if meshes is None else float(np.abs([meshes.low, meshes.high]).max(initial=0.0))
    return far * float(np.finfo(np.float32).eps)


def initialise_agents(world: World, new_rows: Mapping[str, NDArray[np.intp]]) -> None:
    """Set the orientation, the registers and the start velocity of new agents. `new_rows`: their rows, by species.

    Events that they emit at birth are sensed in the first step, or in the next one for agents created within a step."""
    for name, rows in new_rows.items():
        _orient_agents(world, world.populations[name], rows)
    initialise_newborn(world, new_rows)
    for name, rows in new_rows.items():
        _set_start_velocity(world, world.populations[name], rows)
        scripted_walks.start_scripted_walks(world, world.populations[name], rows)
        if not settle_bodies_outside_ground(world, world.populations[name], rows):
            tilt_new_bodies(world, world.populations[name], rows)
    initialise_cells_of_newborn(world)  # before deaths: requests of an agent that dies at birth count
    births = set(list_effects_of_phase("births"))
    if any(births & p.effects.requests.keys() for p in world.populations.values()):
        apply_deaths_and_births(world)
        initialise_cells_of_newborn(world)
    for population in () if world.is_stepping else world.populations.values():
        for name in population.events:
            population.events[name] |= population.raised_events[name]
            population.raised_events[name].fill(False)


def _draw_uniform_numbers(world: World, species: str, index: int, ids: NDArray[np.int64]) -> NDArray[np.float32]:
    return randomness.draw_uniform(world.setting.seed, PLACEMENT_FRAME, species, "heading", index, ids)


def _shuffle_rows(world: World, population: Population) -> None:
    if world.options.shuffle_rows is not None:
        retain_rows(population, np.random.default_rng(world.options.shuffle_rows).permutation(len(population)))


def _choose_headings(
    world: World, population: Population, rows: NDArray[np.intp], up: VectorArrays, drawn_headings: VectorArrays
) -> VectorArrays:
    """Return headings along the ground: the heading that the scene defines for the start point, else the drawn heading."""
    heading = drawn_headings
    for crowd in world.setting.crowds:
        if crowd.species != population.name or (crowd.place.headings is None and crowd.place.facing is None):
            continue
        own = np.flatnonzero(population.now["group"][rows] == crowd.line_index)
        directions = compute_facing(world, crowd, population.position[rows[own]])
        if directions is None and crowd.place.headings is not None:
            directions = crowd.place.headings[population.ids[rows[own]] % len(crowd.place.headings)]
        assert directions is not None
        ahead = vec.split_columns(directions, np.float32)
        heading = vec.copy(heading)
        for component, value in zip(
            heading,
            vec.normalise_or_fallback(
                vec.project_to_plane(ahead, vec.take_rows(up, own)), vec.take_rows(drawn_headings, own), _MIN_NORMAL_SINE
            ),
            strict=True,
        ):
            component[own] = value
    return heading


def _orient_agents(world: World, population: Population, rows: NDArray[np.intp]) -> None:
    """Set up direction, heading and velocity (0) of agents. Up is the ground's normal; the heading is set in the scene or
    random."""
    target_up = np.stack([population.now[f"up.{axis}"] for axis in AXES], axis=1).astype(np.float64)
    up = vec.split_columns(world.ground.compute_upright_normals(population.footing, target_up)[rows], np.float32)
    angle = _draw_uniform_numbers(world, population.name, 0, population.ids[rows]) * FULL_TURN
    side = vec.find_perpendicular(up)
    ahead = vec.cross(up, side)
    heading = vec.add(vec.scale(side, elementary.cos(angle)), vec.scale(ahead, elementary.sin(angle)))
    heading = _choose_headings(world, population, rows, up, heading)
    for k, axis in enumerate(AXES):
        population.normal[rows, k] = up[k]
        for name, value in (("position", population.position[rows, k]), ("up", up[k]), ("heading", heading[k])):
            population.now[f"{name}.{axis}"][rows] = value
            population.start[f"{name}.{axis}"][rows] = value


def _set_start_velocity(world: World, population: Population, rows: NDArray[np.intp]) -> None:
    """Set the velocity along the heading, at a random fraction of top speed (T02). Skip species that set their motion at
    birth."""
    if any(
        isinstance(s, ir.Store) and s.register.startswith("velocity.") for _, s in iterate_with_positions(population.plan.born)
    ):
        return
    speed = population.now["max_speed"][rows] * _draw_uniform_numbers(world, population.name, 1, population.ids[rows])
    if "min_speed" in population.now:
        least = np.minimum(population.now["min_speed"][rows], population.now["max_speed"][rows])
        speed = np.maximum(speed, least)
    for axis in AXES:
        velocity = population.now[f"heading.{axis}"][rows] * speed
        population.now[f"velocity.{axis}"][rows] = velocity
        population.start[f"velocity.{axis}"][rows] = velocity
