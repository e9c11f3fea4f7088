"""Posed meshes of agents as a sequence in which every frame has the same points. For cloth simulation, and for programs without
joints."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

from antdsl.atomic_write import atomic_path
from antdsl.bodies.body import rotate_vectors
from antdsl.numerics.records import select_record_rows
from antdsl.outputs.exports.mesh_files import MeshPart, write_mesh
from antdsl.outputs.exports.poses_export import FEWER_AGENTS_ADVICE, NO_AGENTS_MESSAGE, BodyKey, list_crowds_by_body
from antdsl.outputs.gallery import Gallery
from antdsl.outputs.numbered_files import ExportUnavailable, make_numbered_path
from antdsl.outputs.pictures.light import decode_srgb, encode_srgb
from antdsl.outputs.pictures.model import Crowd
from antdsl.outputs.usd.values import (
    ROOT_PATH,
    StageOutput,
    ValueSamples,
    add_mesh,
    add_root,
    compute_box,
    raise_disk_errors,
    to_identifier,
    to_vector_array,
)
from antdsl.scene.geometry.usd import import_pxr_module
from antdsl.scene.scene_model import UNIT_MM

_MAX_FRAME_POINTS = 20_000_000  # maximum number of points in a frame
_AGENTS_PER_BATCH = 64  # agents that are posed at once


def export_meshes(gallery: Gallery, frames: Iterable[int], path: Path) -> list[str]:
    """Write the posed bodies of agents as one mesh per frame, in scene units. Return messages about agents that are omitted.

    Agents are sorted by species and id. The n-th point is the same point of the same agent in each frame. Agents that do not
    exist in all frames are omitted.

    Raises ExportUnavailable if no agent is in all frames, or if there are too many points. Raises CacheError for a damaged frame,
    OSError if writing fails."""
    frames = list(frames)
    common_ids, notes = _find_common_agents(gallery, frames)
    for frame in frames:
        write_mesh(make_numbered_path(path, frame), list(_pose_meshes(gallery, frame, common_ids)), gallery.origin)
    return notes


def export_usd_meshes(gallery: Gallery, frames: Iterable[int], path: Path) -> list[str]:
    """Write the posed bodies of agents as USD, one mesh per agent, with points and normals over time.

    Returns the messages of `export_meshes`. The meshes are `/World/SPECIES/agent_ID`. Raises UsdError without usd-core."""
    frames = list(frames)
    common_ids, notes = _find_common_agents(gallery, frames)
    usd, geom = import_pxr_module("Usd"), import_pxr_module("UsdGeom")
    with raise_disk_errors(path), atomic_path(path, path.suffix) as part:
        stage = usd.Stage.CreateNew(str(part))
        geom.SetStageMetersPerUnit(stage, UNIT_MM[gallery.manifest.units] / 1000)
        geom.SetStageUpAxis(stage, gallery.manifest.up.upper())
        stage.SetTimeCodesPerSecond(1 / gallery.dt)
        stage.SetFramesPerSecond(1 / gallery.dt)
        stage.SetStartTimeCode(frames[0])
        stage.SetEndTimeCode(frames[-1])
        stage.SetDefaultPrim(add_root(stage, gallery.origin).GetPrim())
        out, samples = StageOutput(stage), dict[str, tuple[ValueSamples, ...]]()
        for frame in frames:
            for each in _pose_meshes(gallery, frame, common_ids):
                if each.name not in samples:
                    samples[each.name] = _add_usd_mesh(out, each)
                points, extent, normals = samples[each.name]
                points.set(frame, each.points)
                extent.set(frame, compute_box(each.points))
                normals.set(frame, each.normals)
        stage.Save()
        del samples, out, stage
    return notes


def _add_usd_mesh(stage_output: StageOutput, part: MeshPart) -> tuple[ValueSamples, ...]:
    """Add the mesh of an agent. Return its values over time: points, extent and normals."""
    species, _, number = part.name.rpartition("_")
    import_pxr_module("UsdGeom").Xform.Define(stage_output.stage, f"{ROOT_PATH}/{to_identifier(species)}")
    usd_mesh = add_mesh(
        stage_output.stage, f"{ROOT_PATH}/{to_identifier(species)}/agent_{number}", part.points, part.faces, part.normals
    )
    assert part.colours is not None
    usd_mesh.CreateDisplayColorPrimvar("vertex").Set(to_vector_array(decode_srgb(part.colours)))
    attributes = (usd_mesh.GetPointsAttr(), usd_mesh.GetExtentAttr(), usd_mesh.GetNormalsAttr())
    for attribute in attributes:
        attribute.Clear()
    return tuple(stage_output.add_samples(attribute, to_vector_array, np.float32) for attribute in attributes)


def _find_common_agents(gallery: Gallery, frames: list[int]) -> tuple[dict[BodyKey, set[int]], list[str]]:
    """Return the ids of the agents that exist in all frames with the same layers, and messages about all other agents.

    The ids are given by species and layers."""
    common_ids: dict[BodyKey, set[int]] = {}
    all_ids: dict[BodyKey, set[int]] = {}
    for k, frame in enumerate(frames):
        frame_ids: dict[BodyKey, set[int]] = {}
        for key, crowd, _ in list_crowds_by_body(gallery.make_picture(frame)):
            frame_ids.setdefault(key, set()).update(np.asarray(crowd.ids).tolist())
        common_ids = frame_ids if not k else {name: ids & frame_ids.get(name, set()) for name, ids in common_ids.items()}
        for name, ids in frame_ids.items():
            all_ids.setdefault(name, set()).update(ids)
    if not all_ids:
        return {}, [NO_AGENTS_MESSAGE]
    if not any(common_ids.values()):
        raise ExportUnavailable("no agent with a body exists in all of these frames", "choose others with `--ids` or `--frames`")
    left = sum(len(ids - common_ids.get(key, set())) for key, ids in all_ids.items())
    return common_ids, [f"{left} agents do not exist in all of these frames, and are omitted"] if left else []


def _pose_meshes(gallery: Gallery, frame: int, common_ids: dict[BodyKey, set[int]]) -> Iterator[MeshPart]:
    """Yield the posed mesh of each agent in `common_ids`, by species and id."""
    parts: list[tuple[str, int, MeshPart]] = []
    total = 0
    for key, crowd, worn in list_crowds_by_body(gallery.make_picture(frame)):
        rows = np.flatnonzero(np.isin(np.asarray(crowd.ids), sorted(common_ids.get(key, ()))))
        total += len(rows) * len(worn.material_colours)
        if total > _MAX_FRAME_POINTS:
            raise ExportUnavailable(
                f"the meshes of these agents have more than {_MAX_FRAME_POINTS:,} points a frame", FEWER_AGENTS_ADVICE
            )
        for a in range(0, len(rows), _AGENTS_PER_BATCH):
            parts += _pose_batch(key[0], crowd, rows[a : a + _AGENTS_PER_BATCH])
    return (part for _, _, part in sorted(parts, key=lambda part: part[:2]))


def _pose_batch(species: str, crowd: Crowd, rows: np.ndarray[Any, Any]) -> list[tuple[str, int, MeshPart]]:
    """Return the posed meshes of the agents in `rows`, as (species, id, mesh)."""
    worn = crowd.body
    assert crowd.ids is not None
    points, normals = crowd.pose_vertices(worn, rows)
    orient = np.asarray(crowd.orient, np.float64)[rows]
    placed = rotate_vectors(orient, points.astype(np.float64)) * crowd.scale[rows, None, None] + crowd.position[rows, None]
    across = rotate_vectors(orient, normals.astype(np.float64))
    own, tint = encode_srgb(worn.compute_colours(select_record_rows(crowd.driven_pose, rows))) / 255.0, worn.tint_weights[:, None]
    parts = []
    for k, row in enumerate(rows.tolist()):
        number, colours = int(crowd.ids[row]), own[k % len(own)] * (1 - tint) + tint * crowd.colour[row]
        parts.append((species, number, MeshPart(f"{species}_{number}", placed[k], worn.faces, across[k], colours)))
    return parts
