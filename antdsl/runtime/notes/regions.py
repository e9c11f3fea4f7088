"""Regions of notes: the distance of agents from a region, and the direction that leads out of it."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from antdsl.numerics.easing import apply_smoothstep
from antdsl.numerics.vector_rows import dot, length
from antdsl.runtime.notes.active_notes import NotedAgents
from antdsl.runtime.notes.targets import NearestOnMesh, TargetPoints, find_ball_centres, find_target_mesh, make_note_line
from antdsl.runtime.notes.wishes import Floats
from antdsl.runtime.sensing.sensed_camera import SensedCamera
from antdsl.runtime.world import World
from antdsl.scene.notes.note_regions import Band, NoteRegion
from antdsl.scene.notes.notes_model import ConfineNote, PassingNote, RegionNote
from antdsl.scene.notes.selectors import AgentName, Box, View
from antdsl.scene.thing_models import convert_point


class RegionDistances(NamedTuple):
    """The distances of agents from a region. `signed_distances` (n,): distances (mm), negative inside. `outward_directions` (n,
    3): unit vectors that point out of the region or, for agents outside, away from it."""

    signed_distances: Floats
    outward_directions: Floats


def measure_distances_to_region(world: World, region: NoteRegion, agents: NotedAgents) -> RegionDistances:
    """Return the distances of agents from a region."""
    position = agents.population.position[agents.rows]
    if isinstance(region, Box):
        return _measure_distances_to_box(world, region, position)
    if isinstance(region, View):
        return _measure_distances_to_view(world, region, position)
    unit_mm = world.setting.unit_mm
    if isinstance(region, Band):
        curve = make_note_line(world, region.along)
        if curve is None:
            return RegionDistances(np.full(len(position), np.inf), np.zeros((len(position), 3)))
        closest = curve.find_closest(*position.T)
        nearest = np.stack([closest.px, closest.py, closest.pz], axis=1).astype(np.float64)
        return _measure_distances_to_tube(position - nearest, region.width.to_millimetres(unit_mm) / 2)
    mesh = find_target_mesh(world, region.around) if isinstance(region.around, AgentName) else None
    if mesh is not None:
        return _measure_distances_to_tube(
            -NearestOnMesh(world.obstacles[mesh]).find_nearest(position)[0], region.radius.to_millimetres(unit_mm)
        )
    centres = find_ball_centres(world, region.around)
    offset, distance = TargetPoints(centres.points, np.zeros(len(centres.points))).find_nearest(position)
    distances = _measure_distances_to_tube(-offset, region.radius.to_millimetres(unit_mm))
    is_centre = centres.is_centre.get(agents.population.name, np.zeros(len(agents.population), np.bool_))[agents.rows]
    return distances._replace(signed_distances=np.where(is_centre | np.isnan(distance), np.inf, distances.signed_distances))


def select_agents_inside(agents: NotedAgents) -> NotedAgents:
    """Return the agents that are inside the region of their note. If the note has no region, return all agents."""
    note = agents.active.note
    if not isinstance(note, PassingNote) or note.inside is None:
        return agents
    return agents.select_agents(measure_distances_to_region(agents.world, note.inside, agents).signed_distances <= 0)


def _measure_distances_to_tube(offset: Floats, radius: float) -> RegionDistances:
    """Return the distances from the region within `radius` mm of a line or point. `offset` (n, 3): the vector from the nearest
    point of the line to each position."""
    distance = length(offset)
    return RegionDistances(distance - radius, offset / np.where(distance > 1e-9, distance, np.inf)[:, None])


def _measure_distances_to_view(world: World, view: View, position: Floats) -> RegionDistances:
    """Return the distances from the pyramid that a camera sees in the new frame. Of its planes, the one that is farthest outside
    counts."""
    eye, ahead, sides = SensedCamera(world.setting.cameras[view.in_view], world.origin).find_view_pyramid(world.display_frame)
    bounds = [
        (axis, tangent * (2 * share - 1), sign)
        for (axis, tangent), shares in zip(sides, (view.across, view.up), strict=True)
        for share, sign in zip(shares, (-1, 1), strict=True)
    ]
    normals = [-ahead, *(sign * (axis - bound * ahead) / np.sqrt(1 + bound * bound) for axis, bound, sign in bounds)]
    offset = position - eye
    beyond = np.stack([dot(offset, np.broadcast_to(normal, offset.shape)) for normal in normals], axis=1)
    farthest = beyond.argmax(axis=1)
    return RegionDistances(beyond[np.arange(len(position)), farthest], np.array(normals)[farthest])


def _measure_distances_to_box(world: World, box: Box, position: Floats) -> RegionDistances:
    """Return the distances from a box. Inside it, directions are along the ground, never towards its top or bottom."""
    corners = np.array([convert_point(point, world.setting.unit_mm) for point in (box.corner, box.opposite)]) - world.origin
    middle, half = corners.mean(axis=0), np.abs(corners[1] - corners[0]) / 2
    offset = position - middle
    beyond = np.abs(offset) - half
    side = np.where(offset < 0, -1.0, 1.0)
    past = np.maximum(beyond, 0.0) * side
    outside = length(past)
    level = np.where(np.abs(world.up) > 0.5, -np.inf, beyond)  # of the axes along the ground
    axis = level.argmax(axis=1)
    rows = np.arange(len(position))
    inward = np.zeros_like(position)
    inward[rows, axis] = side[rows, axis]
    is_outside = outside > 0
    outward = np.where(is_outside[:, None], past / np.where(is_outside, outside, 1.0)[:, None], inward)
    return RegionDistances(np.where(is_outside, outside, level[rows, axis]), outward)


def compute_note_share_in_region(agents: NotedAgents, signed_distances: Floats | None) -> Floats:
    """Return the weight (k,) of a note for each agent: its strength, reduced by region, falloff and map.

    `signed_distances`: the distances from the region; None if the note has no region."""
    note, world = agents.active.note, agents.world
    assert isinstance(note, RegionNote)
    share = agents.weight * note.strength
    if signed_distances is not None:
        falloff = 0.0 if note.falloff is None else note.falloff.to_millimetres(world.setting.unit_mm)
        share *= apply_smoothstep(1.0 - signed_distances / falloff) if falloff else (signed_distances <= 0)
    if note.painted is not None and world.ground.meshes is not None:
        footing = agents.population.footing.select_rows(agents.rows)
        share *= np.clip(world.maps[note.painted].sample(world.ground.meshes, footing).astype(np.float64), 0.0, 1.0)
    return share


def measure_distances_to_note_region(agents: NotedAgents) -> RegionDistances | None:
    """Return the distances of agents from the region of their note. None if the note has no region."""
    note = agents.active.note
    assert isinstance(note, RegionNote)
    if note.region is None:
        return None
    distances = measure_distances_to_region(agents.world, note.region, agents)
    return compute_distances_to_complement(distances) if isinstance(note, ConfineNote) else distances


def compute_distances_to_complement(distances: RegionDistances) -> RegionDistances:
    """Return the distances from the complement of a region."""
    return RegionDistances(-distances.signed_distances, -distances.outward_directions)


def remove_inward_steps(agents: NotedAgents, distances: RegionDistances, step: Floats) -> Floats:
    """Return the steps (k, 3) mm of agents, cut off so that they end outside a region, or no deeper inside. Agents slide along
    its border. Steps of agents for which the note is just beginning or ending do not change."""
    normal = agents.population.normal[agents.rows].astype(np.float64)
    flat = distances.outward_directions - dot(distances.outward_directions, normal)[:, None] * normal
    size = length(flat)
    out = flat / np.where(size > 1e-6, size, np.inf)[:, None]
    reach = np.maximum(distances.signed_distances, 0.0) / np.maximum(size, 1e-6)
    excess = np.where(agents.weight == 1.0, np.maximum(-dot(step, out) - reach, 0.0), 0.0)
    cut: Floats = step + excess[:, None] * out
    return cut
