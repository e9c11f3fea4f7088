"""Builds the inputs for a step of bodies that stay outside their ground: capsules, registers and stances."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from antdsl.ground.mesh.walk_events import CrowdWalk
from antdsl.ground.protocol import Footing
from antdsl.numerics import parallel
from antdsl.numerics import vectors as vec
from antdsl.numerics.vectors import VectorArrays
from antdsl.runtime.body_rows import find_body_numbers
from antdsl.runtime.moving.body_records import (
    BodyLimits,
    BodyPoses,
    BodyRegisters,
    BodyStances,
    ContactFaces,
    FaceBuffers,
    FaceSearch,
)
from antdsl.runtime.moving.clearance.body_paths import BodyShape
from antdsl.runtime.moving.clearance.obstacle_clearance import find_obstacle_faces
from antdsl.runtime.moving.contacts.capsules import find_capsule
from antdsl.runtime.world import Population, World

ROWS_PER_THREAD = 32  # fewer rows are not worth another thread
_F = np.float32
_MARGIN_BODY_LENGTHS = 0.04  # body lengths that are added at both ends of the capsule

Rows = NDArray[np.int64]
SurfaceStances = tuple[Footing, NDArray[np.float64], NDArray[np.float32]]  # footings, positions and normals


def make_face_search(walk: CrowdWalk, count: int, threads: int) -> FaceSearch:
    """Return the tables for a search of the faces near the paths of `count` agents."""
    several = parallel.count_parts(count, threads, ROWS_PER_THREAD)
    table, boxes = walk.walk_tables.table, walk.boxes
    buffers = FaceBuffers(np.empty(several * boxes.triangle_order.size, np.int64), several, count)
    several, near = table.piece_count > 1 or bool(table.cuts.cut_starts[-1]), walk.build_tables()[1]
    return FaceSearch(several, near, table.piece, table.cuts.cut_starts, boxes.to_box_tree(), buffers)


def make_contact_faces(world: World, walk: CrowdWalk, count: int, threads: int) -> tuple[ContactFaces, ContactFaces]:
    """Return the faces of the ground and those of all obstacles, with buffers for `count` rows."""
    several, table = parallel.count_parts(count, threads, ROWS_PER_THREAD), walk.walk_tables.table
    sets = ((walk.build_tables()[0].face_table, table.piece, walk.boxes.to_box_tree()), find_obstacle_faces(world))
    ground, things = (
        ContactFaces(faces, pieces, boxes, FaceBuffers(np.empty(several * boxes.triangle_order.size, np.int64), several, count))
        for faces, pieces, boxes in sets
    )
    return ground, things


def compute_unit_shapes(
    world: World, population: Population, margin: float = _MARGIN_BODY_LENGTHS
) -> tuple[NDArray[np.float64], NDArray[np.uint8]]:
    """Return the capsules (k, 4) of the k bodies of a species, and the index of each agent's body, uint8[n].

    Each capsule has the fields of a `BodyShape` for a body size of 1 mm. It is extended by `margin` at both ends."""
    capsules = [find_capsule(world, key) for key in world.setting.list_body_keys(population.name)]
    shapes = [
        BodyShape(max(each.length - each.width, 0.0) / 2 + margin, each.width / 2, each.height, each.forward_offset)
        for each in capsules
    ]
    return np.array(shapes, np.float64), find_body_numbers(population, world.setting)


def make_unlimited_bodies(world: World, population: Population) -> tuple[BodyStances, BodyLimits]:
    """Return the stances of all bodies of a species, and their capsules without margins as limits that allow any shift."""
    now, zero = population.now, np.zeros(len(population), _F)
    poses = BodyPoses(vec.get_vector_registers(now, "up"), vec.get_vector_registers(now, "heading"))
    limits = BodyLimits(zero, zero, _F(1), now["size"], zero, *compute_unit_shapes(world, population, 0.0), np.inf, np.inf)
    return BodyStances(population.position, population.normal, poses), limits


def select_stances(stances: SurfaceStances, selection: NDArray[np.int64] | NDArray[np.bool_]) -> SurfaceStances:
    """Return the footings, positions and normals at the rows `selection`."""
    selection = np.flatnonzero(selection) if selection.dtype == np.bool_ else selection
    return stances[0].select_rows(selection), stances[1][selection], stances[2][selection]


def compute_row_dots(columns: Sequence[NDArray[np.float32]], vectors: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return the dot products (k) of two sets of vectors. `columns` are three arrays (k); `vectors` is an array (k, 3)."""
    result: NDArray[np.float32] = (columns[0] * vectors[:, 0] + columns[1] * vectors[:, 1]) + columns[2] * vectors[:, 2]
    return result


def read_lifts(population: Population, rows: Rows) -> VectorArrays:
    return vec.take_rows(vec.get_vector_registers(population.now, "~lift"), rows)


def update_idle_times(
    population: Population, rows: Rows, start_positions: NDArray[np.float64], dt: np.float32
) -> NDArray[np.float32]:
    """Update for how long the feet of the agents at `rows` have not moved although they should. Called after a step of `dt`
    seconds.

    Return these times (s). `start_positions` (n, 3) mm: the positions of all agents before the step."""
    now, position = population.now, population.position
    walks = vec.length(vec.take_rows(vec.get_vector_registers(now, "velocity"), rows)) != 0
    walks &= (position[rows] == start_positions[rows]).all(axis=1)
    now["~idle"][rows] = idle = np.where(walks, now["~idle"][rows] + dt, _F(0))
    return idle


def read_body_registers(population: Population) -> BodyRegisters:
    now = population.now
    lift, out = vec.get_vector_registers(now, "~lift"), vec.get_vector_registers(now, "~out")
    return BodyRegisters(lift, now["~wait"], now["~depth"], out, now["~idle"])
