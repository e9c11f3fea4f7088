"""Estimates of what binding a scene has to allocate: counts and bytes from extents and areas, before anything is made."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import NamedTuple

import numpy as np

from antdsl import limits
from antdsl.fields.face_points import cuts_for, slots_of
from antdsl.scene.setting import FlowData, MeshData, Painted, Setting, SolvedFlow, SpreadFlow

_FACE = 200  # bytes of a face with its vertices, links, normals and tree
_VOXEL = 8  # of a distance, and of what a voxel is
_CELL = 48  # of a field: two float32, its place, its neighbours
_POINT = 64  # of a flow: a place and a vector in float64, its cost
_ACROSS, _PIECES = 64, 8  # parts of the extent, of a radius or of a border, where a flow names no cell


class Work(NamedTuple):
    """What a thing of the world needs: `number` of `parts`, and about so many bytes."""

    thing: str
    number: int
    parts: str
    bytes: int


def world_work(
    setting: Setting, fields: Mapping[str, tuple[tuple[str, ...], float]], agent_bytes: Mapping[str, int]
) -> list[Work]:
    """The work for each thing of a setting. `fields`: by name their surfaces and the edge (mm) of their cells; `agent_bytes`: of
    one agent of each species."""
    return [*_meshes(setting), *_fields(setting, fields), *_flows(setting), *_agents(setting, agent_bytes)]


def _saturated(count: float) -> int:
    """A whole number, however large or endless the estimate is."""
    return int(min(count, 2.0**62)) if count > 0 else 0


def _work(thing: str, count: float, parts: str, each: int) -> Work:
    return Work(thing, _saturated(count), parts, _saturated(count * each))


def _meshes(setting: Setting) -> Iterator[Work]:
    for kind, meshes in (("surface", setting.surfaces), ("obstacle", setting.obstacles)):
        for name, mesh in meshes.items():
            yield _work(f"{kind} {name}", len(mesh.faces), "faces", _FACE)
    for name, solid in setting.solids.items():
        across = np.ptp(solid.mesh.vertices, axis=0) / solid.voxel + 1 if len(solid.mesh.vertices) else np.zeros(3)
        yield _work(f"solid {name}", float(np.prod(across)), "voxels at most", _VOXEL)


def _fields(setting: Setting, fields: Mapping[str, tuple[tuple[str, ...], float]]) -> Iterator[Work]:
    for name, (surfaces, edge) in fields.items():
        area = sum(_area(setting.surfaces[each]) for each in surfaces if each in setting.surfaces)
        yield _work(f"field {name}", area / (edge * edge), "cells at least", _CELL)


def _area(mesh: MeshData) -> float:
    a, b, c = (mesh.vertices[mesh.faces[:, corner]] for corner in range(3))
    across = np.cross(b - a, c - a)
    return float(np.sqrt((across * across).sum(axis=1)).sum() / 2)


def _flows(setting: Setting) -> Iterator[Work]:
    for name, flow in setting.flows.items():
        if isinstance(flow, Painted):
            continue
        meshes = [setting.surfaces[each] for each in (flow.on or setting.surfaces) if each in setting.surfaces]
        count = sum(slots_of(cuts_for(_longest(mesh), _cell(flow, mesh))) for mesh in meshes if len(mesh.faces))
        yield _work(f"flow {name}", min(count, limits.FLOW_POINTS), "points at most", _POINT)


def _cell(flow: FlowData, mesh: MeshData) -> float:
    if isinstance(flow, Painted):
        return np.inf
    if flow.cell is not None:
        return flow.cell
    if isinstance(flow, SpreadFlow) and flow.radius is not None:
        return flow.radius / _PIECES
    if isinstance(flow, SpreadFlow | SolvedFlow):
        return float(np.ptp(mesh.vertices, axis=0).max()) / _ACROSS
    return flow.within / _PIECES


def _longest(mesh: MeshData) -> np.ndarray[tuple[int, ...], np.dtype[np.float64]]:
    corners = mesh.vertices[mesh.faces]
    edges = corners[:, [1, 2, 0]] - corners
    longest: np.ndarray[tuple[int, ...], np.dtype[np.float64]] = np.sqrt((edges * edges).sum(axis=2)).max(axis=1)
    return longest


def _agents(setting: Setting, agent_bytes: Mapping[str, int]) -> Iterator[Work]:
    counts: dict[str, int] = {}
    for crowd in setting.crowds:
        counts[crowd.species] = counts.get(crowd.species, 0) + crowd.count
    for name, count in counts.items():
        yield _work(f"species {name}", count, "agents", agent_bytes.get(name, 0))
