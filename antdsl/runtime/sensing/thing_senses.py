"""The senses for curves, flows, maps and cameras, at the positions of the agents. Also functions that all senses use for rows."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.plan import ir
from antdsl.runtime.sensing.sensed_camera import SensedCamera
from antdsl.runtime.world import AXES, Population, World

SenseValue = Any
Rows = slice | NDArray[np.intp]


def count_rows(rows: Rows) -> int:
    return rows.stop - rows.start if isinstance(rows, slice) else len(rows)


def expand_to_rows(value: SenseValue, rows: Rows) -> NDArray[Any]:
    """Return `value` as an array with one entry per row."""
    return np.full(count_rows(rows), value) if np.ndim(value) == 0 else value


def read_positions(world: World, population: Population, rows: Rows) -> tuple[NDArray[np.float32], ...]:
    return tuple(population.start[f"position.{axis}"][rows] for axis in AXES)


def read_exact_positions(world: World, population: Population, rows: Rows) -> NDArray[np.float64]:
    """Return the float64 positions (n, 3; mm) of the agents `rows` at the start of the step."""
    return np.stack(read_positions(world, population, rows), axis=1).astype(np.float64)


def _sense_curve_closest(world: World, population: Population, node: ir.PlanNode, rows: Rows) -> SenseValue:
    nearest = world.curves[node.attrs[0]].find_closest(*read_positions(world, population, rows))
    return nearest.distance, nearest.px, nearest.py, nearest.pz, nearest.tx, nearest.ty, nearest.tz


def _sense_flow_value(world: World, population: Population, node: ir.PlanNode, rows: Rows) -> SenseValue:
    place = read_exact_positions(world, population, rows)
    up = population.normal[rows].astype(np.float64)
    return world.flows[node.attrs[0]].sample(world.ground.meshes, population.footing.select_rows(rows), place, up)


def _sense_flow_reachable(world: World, population: Population, node: ir.PlanNode, rows: Rows) -> SenseValue:
    place = read_exact_positions(world, population, rows)
    up = population.normal[rows].astype(np.float64)
    return world.flows[node.attrs[0]].has_flow_at(world.ground.meshes, population.footing.select_rows(rows), place, up)


def _sense_map_value(world: World, population: Population, node: ir.PlanNode, rows: Rows) -> SenseValue:
    meshes = world.ground.meshes
    assert meshes is not None  # maps are painted on them
    return world.maps[node.attrs[0]].sample(meshes, population.footing.select_rows(rows))


def _find_camera(world: World, node: ir.PlanNode) -> SensedCamera:
    return SensedCamera(world.setting.cameras[node.attrs[0]], world.origin)


def _sense_camera_position(world: World, population: Population, node: ir.PlanNode, rows: Rows) -> SenseValue:
    place = _find_camera(world, node).find_position(world.frame).astype(np.float32)
    return tuple(np.full(count_rows(rows), part) for part in place)


def _sense_camera_view(world: World, population: Population, node: ir.PlanNode, rows: Rows, margin: SenseValue) -> SenseValue:
    place = read_exact_positions(world, population, rows)
    return _find_camera(world, node).find_positions_in_view(world.frame, place, np.float64(1) * expand_to_rows(margin, rows))


PLACED_THING_SENSES: Mapping[str, Callable[..., SenseValue]] = {
    "curve.closest": _sense_curve_closest,
    "flow.value": _sense_flow_value,
    "flow.reachable": _sense_flow_reachable,
    "map.value": _sense_map_value,
    "camera.position": _sense_camera_position,
    "camera.in_view": _sense_camera_view,
}
