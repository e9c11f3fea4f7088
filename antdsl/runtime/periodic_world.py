"""Periodic worlds: images of the ground around the box of the scene, and agents that cross the border of the box.

During a step, agents walk on over the images of the ground. So a step needs no special case for the seam. After the step,
agents outside the box are moved into it by whole widths. An extended mesh begins with the faces of the original mesh."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from antdsl.ground.plane import PlaneGround
from antdsl.numerics.periodic_box import PeriodicBox
from antdsl.runtime.world import AXES, UNWRAPPED_REGISTERS, Population, World
from antdsl.scene.setting import MeshData, WorldSetting
from antdsl.senses.overlaps import measure_worst_overlaps

Floats = NDArray[np.float64]
Rows = NDArray[np.intp]
MARGIN_SHARE = 0.5  # of the width: how far images of the world reach beyond the box


@dataclass(frozen=True, slots=True, eq=False)
class FaceImages:
    """The source of each face of an extended mesh. `source` int32[m]: the face of the original mesh. `counts` int64[m, 3]: the
    offset of the image from that face, in widths."""

    source: NDArray[np.int32]
    counts: NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class PeriodicWorld:
    """The box of a periodic world, relative to the world's origin. `faces`: the images of faces, by surface number.
    `obstacle_faces`: the images of faces of obstacles, by name."""

    box: PeriodicBox
    faces: tuple[FaceImages, ...]
    obstacle_faces: Mapping[str, FaceImages]


def extend_mesh(mesh: MeshData, box: PeriodicBox) -> tuple[MeshData, FaceImages]:
    """Return a mesh together with its images up to half a width beyond the box, and the source of each face."""
    widths = np.array(box.widths)
    low = np.where(widths > 0, np.array(box.low) - MARGIN_SHARE * widths, -np.inf)
    high = np.where(widths > 0, np.array(box.low) + (1 + MARGIN_SHARE) * widths, np.inf)
    corners = mesh.vertices[mesh.faces]
    least, most = (corners.min(axis=1), corners.max(axis=1)) if len(corners) else (np.zeros((0, 3)), np.zeros((0, 3)))
    vertices, faces = [mesh.vertices], [mesh.faces]
    sources, counts = [np.arange(len(mesh.faces), dtype=np.int32)], [np.zeros((len(mesh.faces), 3), np.int64)]
    first = len(mesh.vertices)
    for count in box.list_images()[1:]:
        displacement = count * widths
        own = np.flatnonzero(((most + displacement >= low) & (least + displacement <= high)).all(axis=1))
        used, numbers = np.unique(mesh.faces[own], return_inverse=True)
        vertices.append(mesh.vertices[used] + displacement)
        faces.append((first + numbers.reshape(-1, 3)).astype(np.int32))
        sources.append(own.astype(np.int32))
        counts.append(np.tile(count, (len(own), 1)))
        first += len(used)
    extended = MeshData(np.concatenate(vertices), np.concatenate(faces))
    return extended, FaceImages(np.concatenate(sources), np.concatenate(counts))


def wrap_world(world: World) -> None:
    """Move the agents that have left the box of a periodic world back into it, and update their unwrapped positions."""
    if world.periodic is None:
        return
    for population in world.populations.values():
        _wrap_agents(world, population)
        _update_unwrapped(population, world.periodic.box)


def _wrap_agents(world: World, population: Population) -> None:
    """Move the agents of one species that are outside the box into it."""
    assert world.periodic is not None
    counts = _count_widths(world, population)
    rows = np.flatnonzero(counts.any(axis=1))
    if not len(rows):
        return
    box, footing = world.periodic.box, population.footing
    population.position = population.position.copy()  # arrays of the step may still refer to the old one
    if isinstance(world.ground, PlaneGround):
        population.position[rows] = box.move_points(population.position[rows], -counts[rows])
        footing.columns["point"] = population.position.copy()
    else:
        standing = footing.select_rows(rows)
        for number, images in enumerate(world.periodic.faces):
            own = np.flatnonzero((standing.mesh == number) & (standing.face >= 0))
            standing.face[own] = images.source[standing.face[own]]
        footing.write_rows(rows, standing)
        population.position[rows] = world.ground.position(standing)
    for k, axis in enumerate(AXES):
        population.now[f"position.{axis}"][rows] = population.position[rows, k]
    window = world.motion.windows.get(population.name)
    if window is not None and len(window.ids) == len(population):
        window.start[rows] -= counts[rows] * np.array(box.widths)


def measure_overlaps(
    world: World, x: NDArray[np.float32], y: NDArray[np.float32], z: NDArray[np.float32], radius: NDArray[np.float32]
) -> NDArray[np.float32]:
    """Return the result of `measure_worst_overlaps`. In a periodic world, overlaps across the seam are included."""
    if world.periodic is None:
        return measure_worst_overlaps(x, y, z, radius)
    reach = 2 * float(np.max(radius, initial=0.0, where=np.isfinite(radius)))
    rows, (x_all, y_all, z_all) = world.periodic.box.find_image_rows((x, y, z), reach)
    return measure_worst_overlaps(x_all, y_all, z_all, radius.take(rows))[: len(x)]


def _count_widths(world: World, population: Population) -> NDArray[np.int64]:
    """Return by how many whole widths each agent is outside the box, int64[n, 3]."""
    assert world.periodic is not None
    if isinstance(world.ground, PlaneGround):
        return world.periodic.box.count_widths(population.position)
    counts, footing = np.zeros((len(population), 3), np.int64), population.footing
    for number, images in enumerate(world.periodic.faces):
        own = np.flatnonzero((footing.mesh == number) & (footing.face >= 0))
        counts[own] = images.counts[footing.face[own]]
    return counts


def _update_unwrapped(population: Population, box: PeriodicBox) -> None:
    """Add the last step to the unwrapped positions. These follow the wrapped positions, but do not jump at the seam."""
    for k, axis in enumerate(AXES):
        register = population.now[UNWRAPPED_REGISTERS[k]]
        place, width = population.now[f"position.{axis}"], box.widths[k]
        if not width:
            register[:] = place
            continue
        turns = np.rint((register.astype(np.float64) - place) / width)
        register[:] = place + turns * width


def make_periodic_world(
    setting: WorldSetting, meshes: dict[str, MeshData], origin: Floats
) -> tuple[PeriodicWorld | None, dict[str, MeshData]]:
    """Return the periodic world of a setting (None if it is not periodic), and its meshes together with their images around
    the box. `meshes`: with vertices relative to `origin` (3,) mm."""
    if setting.period is None:
        return None, meshes
    box = setting.period.shift(origin)
    extended = {name: extend_mesh(mesh, box) for name, mesh in meshes.items()}
    surfaces = tuple(extended[name][1] for name in setting.surfaces)
    obstacles = {name: extended[name][1] for name in setting.obstacles}
    return PeriodicWorld(box, surfaces, obstacles), {name: mesh for name, (mesh, _) in extended.items()}
