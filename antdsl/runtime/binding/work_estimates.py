"""Estimates of the memory that binding a scene needs, from extents and areas, before anything is allocated."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import NamedTuple

import numpy as np

from antdsl import limits
from antdsl.fields.face_points import Floats, LatticeTooFineError, choose_edge_pieces, count_slots
from antdsl.scene.geometry.mesh_files import compute_mesh_area
from antdsl.scene.setting import MeshData, PaintedValues, WorldSetting

_BYTES_PER_FACE = 200  # bytes of a face with its vertices, links, normals and tree
_BYTES_PER_VOXEL = 8  # bytes of a voxel: distance and state
_BYTES_PER_CELL = 48  # bytes of a field cell: two float32, position, neighbours
_BYTES_PER_FLOW_POINT = 64  # bytes of a flow point: position and vector in float64, cost
# Measured with wandering agents far from each other: the peak memory of a process with 20,000 and with 120,000 agents.
_BYTES_PER_AGENT = 600  # bytes of an agent of any species: footing, walk results, grids, frame row
_BYTES_PER_LEG = 550  # bytes of a walking leg


class WorkEstimate(NamedTuple):
    """The memory that a thing of the world needs: the number of its parts, the plural name of the parts, and approximate
    bytes."""

    subject: str
    part_count: int
    unit_name: str
    bytes: int


def estimate_world_work(
    setting: WorldSetting, fields: Mapping[str, tuple[tuple[str, ...], float]], agent_bytes: Mapping[str, int]
) -> list[WorkEstimate]:
    """Return an estimate for each thing of a setting. Pairs of neighbours and contacts are not included.

    `fields`: for each field, its surfaces and the edge length (mm) of its cells. `agent_bytes`: for each species, the size of one
    agent's registers; a step needs two copies."""
    return [
        *_estimate_meshes(setting),
        *_estimate_fields(setting, fields),
        *_estimate_flows(setting),
        *_estimate_agents(setting, agent_bytes),
    ]


def _clamp_count(count: float) -> int:
    """Return an estimated number as an integer, limited to a maximum, because it may be infinite."""
    return int(min(count, 2.0**62)) if count > 0 else 0


def _make_estimate(thing: str, count: float, parts: str, factor: int) -> WorkEstimate:
    return WorkEstimate(thing, _clamp_count(count), parts, _clamp_count(count * factor))


def _estimate_meshes(setting: WorldSetting) -> Iterator[WorkEstimate]:
    for kind, meshes in (("surface", setting.surfaces), ("obstacle", setting.obstacles)):
        for name, mesh in meshes.items():
            yield _make_estimate(f"{kind} {name}", len(mesh.faces), "faces", _BYTES_PER_FACE)
    for name, solid in setting.solids.items():
        across = np.ptp(solid.mesh.vertices, axis=0) / solid.voxel + 1 if len(solid.mesh.vertices) else np.zeros(3)
        yield _make_estimate(f"solid {name}", float(np.prod(across)), "voxels at most", _BYTES_PER_VOXEL)


def _estimate_fields(setting: WorldSetting, fields: Mapping[str, tuple[tuple[str, ...], float]]) -> Iterator[WorkEstimate]:
    for name, (surfaces, edge) in fields.items():
        area = sum(compute_mesh_area(setting.surfaces[each]) for each in surfaces if each in setting.surfaces)
        yield _make_estimate(f"field {name}", area / edge / edge, "cells at least", _BYTES_PER_CELL)


def _estimate_flows(setting: WorldSetting) -> Iterator[WorkEstimate]:
    longest = {name: _measure_longest_edges(mesh) for name, mesh in setting.surfaces.items()} if setting.flows else {}
    extent = _measure_surface_extent(setting)
    for name, flow in setting.flows.items():
        if isinstance(flow, PaintedValues) or not longest:
            continue
        edges = np.concatenate(
            [each if not flow.surfaces or of in flow.surfaces else np.zeros_like(each) for of, each in longest.items()]
        )
        try:
            count = count_slots(choose_edge_pieces(flow, edges, extent))
        except LatticeTooFineError:  # binding reports this error
            count = limits.MAX_FLOW_POINTS
        yield _make_estimate(f"flow {name}", count, "points at most", _BYTES_PER_FLOW_POINT)


def _measure_surface_extent(setting: WorldSetting) -> float:
    """Return the longest side (mm) of the bounding box of all surfaces."""
    boxes = [[mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)] for mesh in setting.surfaces.values() if len(mesh.vertices)]
    corners = np.concatenate(boxes) if boxes else np.zeros((1, 3))
    return float(np.ptp(corners, axis=0).max())


def _measure_longest_edges(mesh: MeshData) -> Floats:
    """Return the length of the longest edge (mm) of each face."""
    corners = mesh.vertices[mesh.faces]
    edges = corners[:, [1, 2, 0]] - corners
    longest: Floats = np.sqrt((edges * edges).sum(axis=2)).max(axis=1) if len(corners) else np.zeros(0)
    return longest


def _estimate_agents(setting: WorldSetting, agent_bytes: Mapping[str, int]) -> Iterator[WorkEstimate]:
    counts: dict[str, int] = {}
    for crowd in setting.crowds:
        counts[crowd.species] = counts.get(crowd.species, 0) + crowd.count
    for name, count in counts.items():
        legs = len(setting.legs[name].length) if name in setting.legs else 0
        yield _make_estimate(
            f"species {name}", count, "agents", 2 * agent_bytes.get(name, 0) + _BYTES_PER_AGENT + _BYTES_PER_LEG * legs
        )
