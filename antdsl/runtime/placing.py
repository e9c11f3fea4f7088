"""Where agents start: on the ground or inside things, outside of obstacles. A place is a function of (seed, species, id):
more move nobody."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.plan import ir
from antdsl.runtime import kernels, randomness
from antdsl.runtime import vectors as vec
from antdsl.runtime.births import come_alive, deaths_and_births, settle_newborn
from antdsl.runtime.reading import walk
from antdsl.runtime.world import AXES, Population, World, add_rows, select_rows
from antdsl.scene.setting import CrowdData, MeshData, PlaceData

_TRIES = 12  # a place beside the ground or in an obstacle is drawn again
_FRAME = 0  # placement belongs to no frame
_TURN = np.float32(2 * np.pi)


def populate(world: World) -> None:
    """Put all crowds into the world; ids in the order of the scene's lines."""
    counted: dict[str, int] = {}
    joined: dict[str, NDArray[np.intp]] = {}
    for crowd in world.setting.crowds:
        population = world.populations[crowd.species]
        ids = np.arange(counted.get(crowd.species, 0), counted.get(crowd.species, 0) + crowd.count)
        counted[crowd.species] = population.next_id = int(crowd.count + (ids[0] if len(ids) else population.next_id))
        if not len(ids):
            continue
        put(world, crowd, ids)
    for name, population in world.populations.items():
        if len(population):
            _shuffle(world, population)
            joined[name] = np.arange(len(population))
    begin(world, joined)


def put(world: World, crowd: CrowdData, ids: NDArray[np.int64]) -> NDArray[np.intp]:
    """Rows for agents of a crowd where the scene places them; gives the rows, of which nothing else is filled yet."""
    population = world.populations[crowd.species]
    if crowd.place.inside is not None and world.ground.meshes is not None:
        footing, up = _seen_from(world, crowd.species, crowd.place, crowd.place.inside, ids)
    else:
        footing, up = _footing(world, crowd.species, crowd.place, ids), np.broadcast_to(world.up, (len(ids), 3))
    rows = add_rows(population, ids, world.frame, world.ground.position(footing), footing)
    for k, axis in enumerate(AXES):
        population.now[f"up.{axis}"][rows] = up[:, k]
    population.now["group"][rows] = crowd.group
    return np.arange(rows.start, rows.stop)


def begin(world: World, joined: Mapping[str, NDArray[np.intp]]) -> None:
    """Let those who were put into the world stand, be born and set out, by species their rows; what they raise at birth is
    seen in the first step."""
    for name, rows in joined.items():
        _stand(world, world.populations[name], rows)
    come_alive(world, joined)
    for name, rows in joined.items():
        _set_out(world, world.populations[name], rows)
    if any(p.effects.spawns or p.effects.deaths for p in world.populations.values()):
        deaths_and_births(world)
    settle_newborn(world)
    for population in world.populations.values():
        for name in population.events:
            population.events[name] |= population.raised[name]
            population.raised[name].fill(False)


def _draw(world: World, species: str, index: int, ids: NDArray[np.int64], site: str = "place") -> NDArray[np.float32]:
    return randomness.uniform(world.setting.seed, _FRAME, species, site, index, ids)


def _footing(world: World, species: str, place: PlaceData, ids: NDArray[np.int64]) -> Any:
    """Footings for new agents, drawn until they are on the ground and in no obstacle."""
    on = place.on or None
    points = _points(world, species, place, ids, 0)
    footing, found = world.ground.place(points, world.up, on)
    for attempt in range(1, _TRIES):
        poor = np.flatnonzero(~found | inside_obstacle(world, world.ground.position(footing)))
        if place.points is not None or not len(poor):
            break
        again, good = world.ground.place(_points(world, species, place, ids[poor], attempt), world.up, on)
        for name in type(footing).__dataclass_fields__:
            getattr(footing, name)[poor] = getattr(again, name)
        found = found.copy()
        found[poor] = good
    return footing


def _seen_from(
    world: World, species: str, place: PlaceData, eye: tuple[float, float, float], ids: NDArray[np.int64]
) -> tuple[Any, NDArray[np.float64]]:
    """Footings where lines from a place in drawn directions first meet a mesh, and ups (n, 3) towards it. Who has drawn nothing
    but lines that meet none, or others than those in `on`, begins at the nearest surface."""
    meshes, start = world.ground.meshes, np.asarray(eye, np.float64) - world.origin
    begin = np.broadcast_to(start, (len(ids), 3))
    far = meshes.extent * 1.8 + float(np.abs(start - (meshes.low + meshes.high) / 2).max())
    place_at, towards, left = begin.copy(), np.array(np.broadcast_to(world.up, begin.shape)), np.arange(len(ids))
    wanted = [meshes.names.index(name) for name in (place.on or meshes.names) if name in meshes.names]
    for attempt in range(_TRIES):
        if not len(left):
            break
        u, v = (_draw(world, species, 2 * attempt + k, ids[left], "inside") for k in range(2))
        height = 1.0 - 2.0 * u.astype(np.float64)  # even over a ball, by a theorem of Archimedes
        flat, angle = np.sqrt(np.maximum(1.0 - height * height, 0.0)), v * _TURN
        way = np.stack([flat * kernels.cos(angle), height, flat * kernels.sin(angle)], axis=1)
        found, part, footing = meshes.met(begin[left], way * far)
        at = begin[left] + way * (far * part)[:, None]
        good = found & np.isin(footing.mesh, wanted) & ~inside_obstacle(world, at)
        place_at[left[good]], towards[left[good]] = at[good], -way[good]
        left = left[~good]
    return world.ground.nearest(place_at)[0], towards


def _points(world: World, species: str, place: PlaceData, ids: NDArray[np.int64], attempt: int) -> NDArray[np.float64]:
    """Wanted places (n, 3), to be dropped onto the ground."""
    if place.points is not None and len(place.points):
        return np.asarray(place.points, np.float64)[ids % len(place.points)] - world.origin
    u, v, w = (_draw(world, species, 4 * attempt + k, ids) for k in range(3))
    grounds = {**world.setting.surfaces, **{name: solid.mesh for name, solid in world.setting.solids.items()}}
    if place.around is not None or not grounds:
        middle = np.zeros(3) if place.around is None else np.asarray(place.around, np.float64) - world.origin
        radius = 100.0 if place.radius is None else place.radius
        away, angle = np.sqrt(u).astype(np.float64) * radius, v * _TURN
        up = vec.columns(np.broadcast_to(world.up, (len(ids), 3)), np.float64)
        side = vec.across(up)
        ahead = vec.cross(up, side)
        disc = vec.add(vec.scale(side, away * kernels.cos(angle)), vec.scale(ahead, away * kernels.sin(angle)))
        return middle + vec.rows(disc)
    if place.density is not None:
        return _by_density(world, place, u, np.sort([v, w, _draw(world, species, 4 * attempt + 3, ids)], axis=0))
    meshes = [grounds[name] for name in (place.on or tuple(world.setting.surfaces) or tuple(grounds))]
    return _on_faces(meshes, u, v, w) - world.origin


def _on_faces(
    meshes: list[MeshData], u: NDArray[np.float32], v: NDArray[np.float32], w: NDArray[np.float32]
) -> NDArray[np.float64]:
    """Points spread evenly over the area of some meshes."""
    corners = np.concatenate([m.vertices[m.faces] for m in meshes])
    edge, other = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    normal = vec.cross(vec.columns(edge, np.float64), vec.columns(other, np.float64))
    area = np.cumsum(vec.length(normal))
    face = np.minimum(np.searchsorted(area, u.astype(np.float64) * area[-1], side="right"), len(area) - 1)
    fold = v + w > 1
    a, b = np.where(fold, 1 - v, v), np.where(fold, 1 - w, w)
    points: NDArray[np.float64] = corners[face, 0] + a[:, None] * edge[face] + b[:, None] * other[face]
    return points


def _by_density(world: World, place: PlaceData, u: NDArray[np.float32], cuts: NDArray[np.float32]) -> NDArray[np.float64]:
    """Points as dense as a map says, from one draw and three ascending ones each.

    A density that is linear in a triangle is a mixture of three that are each proportional to one corner's weight, and so are
    gaps between ascending draws, two of them joined (L. Devroye, Non-Uniform Random Variate Generation, 1986, V.2, XI.4)."""
    _, _, mesh, table = world.ground.meshes.triangles
    wanted = np.isin(mesh, [world.surface_index[name] for name in (place.on or tuple(world.surface_index))])
    area = vec.length(vec.cross(vec.columns(table.edge1.T, np.float64), vec.columns(table.edge2.T, np.float64)))
    share = np.maximum(world.maps[place.density or ""].corners, 0.0) * np.where(wanted & table.live, area, 0.0)
    total = np.cumsum(share.T.ravel())
    pick = np.minimum(np.searchsorted(total, u.astype(np.float64) * total[-1], side="right"), len(total) - 1)
    face, corner = pick // 3, pick % 3
    _, two, three = cuts.astype(np.float64)
    much, rest, last = two, three - two, 1 - three
    b1 = np.where(corner == 1, much, rest)
    b2 = np.where(corner == 2, much, last)
    points: NDArray[np.float64] = table.corner.take(face, axis=1) + b1 * table.edge1.take(face, axis=1)
    return np.ascontiguousarray((points + b2 * table.edge2.take(face, axis=1)).T)


def inside_obstacle(world: World, points: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Whether points lie in an obstacle: the first face above them shows its back."""
    found = np.zeros(len(points), np.bool_)
    up = np.broadcast_to(world.up, points.shape)
    for name in world.plan.obstacles:
        mesh = world.setting.obstacles.get(name)
        if mesh is None or not len(mesh.faces):
            continue
        hits = world.obstacles[name].cast(points, up)
        corners = mesh.vertices[mesh.faces[np.maximum(hits.face, 0)]]
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])  # edges: the origin does not matter
        found |= hits.hit & ((normal * up).sum(axis=1) > 0)
    return found


def _shuffle(world: World, population: Population) -> None:
    if world.options.shuffle_rows is not None:
        select_rows(population, np.random.default_rng(world.options.shuffle_rows).permutation(len(population)))


def _stand(world: World, population: Population, rows: NDArray[np.intp]) -> None:
    """Up from the ground, and a heading drawn around it; at rest."""
    wanted = np.stack([population.now[f"up.{axis}"] for axis in AXES], axis=1).astype(np.float64)
    up = vec.columns(world.ground.upright(population.footing, wanted)[rows], np.float32)
    angle = _draw(world, population.name, 0, population.ids[rows], "heading") * _TURN
    side = vec.across(up)
    ahead = vec.cross(up, side)
    heading = vec.add(vec.scale(side, kernels.cos(angle)), vec.scale(ahead, kernels.sin(angle)))
    for k, axis in enumerate(AXES):
        population.normal[rows, k] = up[k]
        for name, value in (("position", population.position[rows, k]), ("up", up[k]), ("heading", heading[k])):
            population.now[f"{name}.{axis}"][rows] = value
            population.start[f"{name}.{axis}"][rows] = value


def _set_out(world: World, population: Population, rows: NDArray[np.intp]) -> None:
    """A drawn share of full speed along the heading (T02), unless the species says at birth how it moves."""
    if any(isinstance(s, ir.Store) and s.register.startswith("velocity.") for _, s in walk(population.plan.born)):
        return
    speed = population.now["max_speed"][rows] * _draw(world, population.name, 1, population.ids[rows], "heading")
    for axis in AXES:
        velocity = population.now[f"heading.{axis}"][rows] * speed
        population.now[f"velocity.{axis}"][rows] = velocity
        population.start[f"velocity.{axis}"][rows] = velocity
