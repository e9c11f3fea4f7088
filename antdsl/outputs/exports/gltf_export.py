"""A cache as one glTF 2.0 file. Each agent is a node with animated joints. Agents with equal definitions share meshes.

Khronos Group, glTF 2.0 Specification, 2021. A node `World` converts the scene to glTF's axes and metres, and moves it by its
origin. Meshes with a skin are not below this node, since glTF ignores their own transform."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.atomic_write import write_atomically
from antdsl.bodies.agents.definition import STATE_MATERIAL
from antdsl.bodies.agents.transforms import decompose_matrix
from antdsl.bodies.body import compute_vertex_normals
from antdsl.bodies.files.gltf_writer import GltfWriter, ShapeParts
from antdsl.bodies.posed_body import PosedBody
from antdsl.outputs.exports.gltf_stage import GltfStage
from antdsl.outputs.exports.poses_export import (
    FEWER_AGENTS_ADVICE,
    NO_AGENTS_MESSAGE,
    BodyKey,
    list_crowds_by_body,
    make_pose_arrays,
)
from antdsl.outputs.gallery import Gallery
from antdsl.outputs.numbered_files import ExportUnavailable
from antdsl.outputs.pictures.light import decode_srgb
from antdsl.outputs.pictures.model import Crowd

_MAX_FILE_AGENTS, _MAX_FILE_BYTES = 1000, 1 << 28  # limits of one file
_MAX_IGNORED_SHEAR = 1e-4

Floats = NDArray[np.float64]


def export_gltf(gallery: Gallery, frames: Iterable[int], path: Path) -> list[str]:
    """Write agents with joints, meshes, items and the camera, animated over these frames.

    Return messages about features that glTF lacks.

    Raises ExportUnavailable beyond the limits of one glTF file, CacheError for a damaged frame, OSError if writing fails."""
    frames = list(frames)
    crowd = _BodyCollector.gather(gallery, frames)
    stage = GltfStage(gallery, frames)
    for key, body in crowd.bodies.items():
        _write_agents(stage, body, crowd.get_colours(key), key[0])
    for frame in frames:
        stage.add_picture(gallery.make_picture(frame))
    stage.write_motion()
    write_atomically(path, stage.writer.to_bytes(path.suffix.lower() == ".gltf", scene=0, scenes=[stage.scene]))
    return [*crowd.make_notes(), *stage.notes]


@dataclass(slots=True, eq=False)
class _BodyRecord:
    """The animation of all agents with one body.

    `arrays`: arrays by frame and name, with one row per agent.
    `id` int64, `frame` (numbers from 0): agent and frame of the row.
    `place` float64[4, 4]: from the body's space to the scene.
    `local` float32[J, 4, 4], `channels` float32[C]: joints and channels.
    `colour_by_agent`: by agent id, the display colour in its first frame."""

    body: PosedBody
    arrays: dict[str, list[NDArray[Any]]] = field(default_factory=dict)
    colour_by_agent: dict[int, tuple[float, ...]] = field(default_factory=dict)


@dataclass(slots=True, eq=False)
class _BodyCollector:
    """Collector of the agents of a cache, by species and body."""

    bodies: dict[BodyKey, _BodyRecord]
    recoloured_species: set[str] = field(default_factory=set)  # species with colour changes

    @staticmethod
    def gather(gallery: Gallery, frames: list[int]) -> _BodyCollector:
        """Return the agents of some frames. Raises ExportUnavailable beyond the limits of agents or bytes."""
        bodies: dict[BodyKey, _BodyRecord] = {}
        output = _BodyCollector(bodies)
        size = 0
        for number, frame in enumerate(frames):
            for key, crowd, worn in list_crowds_by_body(gallery.make_picture(frame)):
                body = bodies.setdefault(key, _BodyRecord(worn))
                size += len(crowd.position) * (40 * len(worn.definition.rig.names) + 64)
                output._add_crowd(key, body, crowd, number)
            agents = sum(len(body.colour_by_agent) for body in bodies.values())
            if agents > _MAX_FILE_AGENTS or size > _MAX_FILE_BYTES:
                many = (
                    f"{agents:,} agents with joints"
                    if agents > _MAX_FILE_AGENTS
                    else f"more than {_MAX_FILE_BYTES >> 20} MiB of keys"
                )
                raise ExportUnavailable(
                    f"glTF is for small crowds, but this one has {many}", f"{FEWER_AGENTS_ADVICE}, or write USD: `.usdc`"
                )
        return output

    def _add_crowd(self, key: BodyKey, body: _BodyRecord, crowd: Crowd, number: int) -> None:
        """Append one frame's rows of a crowd to its body."""
        rows = make_pose_arrays(crowd) | {"frame": np.full(len(crowd.position), number, np.int64)}
        for name in ("id", "frame", "place", "local", "channels"):
            body.arrays.setdefault(name, []).append(rows[name])
        for one, colour in zip(rows["id"].tolist(), np.asarray(crowd.colour).tolist(), strict=True):
            if body.colour_by_agent.setdefault(one, tuple(colour)) != tuple(colour):
                self.recoloured_species.add(key[0])

    def get_colours(self, key: BodyKey) -> dict[int, tuple[float, ...]]:
        """Return the display colours of the agents with a body, by id."""
        return self.bodies[key].colour_by_agent

    def make_notes(self) -> list[str]:
        """Return messages on features of the agents that glTF lacks."""
        messages = [] if self.bodies else [NO_AGENTS_MESSAGE]
        messages += [
            f"agents of `{species}` keep the colour of their first state: glTF has no colours over time"
            for species in sorted(self.recoloured_species)
        ]  # fmt: skip
        deformers = {b.deformer for body in self.bodies.values() for b in body.body.bindings if b.deformer}
        if any("dualquat" in name for name in deformers):
            messages.append("dual quaternion skinning is linear there: glTF has no other")
        return messages


def _write_agents(stage: GltfStage, body: _BodyRecord, colours: dict[int, tuple[float, ...]], species: str) -> None:
    """Write the nodes, skins and animation of all agents with one body."""
    worn = body.body
    rig, writer = worn.definition.rig, stage.writer
    ids, frame, place, local, channels = map(np.concatenate, body.arrays.values())
    move, turn, size, shear = decompose_matrix(local.astype(np.float64))
    if shear.size and np.abs(shear).max() > _MAX_IGNORED_SHEAR:
        stage.add_note("a shear of joints is left out: glTF has none")
    order = np.lexsort((frame, ids))
    shapes = [_write_shape(writer, worn, binding.shape) for binding in worn.bindings]
    meshes: dict[tuple[int, tuple[float, ...]], int] = {}
    starts = np.searchsorted(ids[order], sorted(colours))
    for one, start, end in zip(sorted(colours), starts, [*starts[1:], len(order)], strict=True):
        rows = order[start:end]
        top = stage.add_agent(f"{species}_{one}", frame[rows], *decompose_matrix(place[rows])[:3])
        nodes: dict[str, int] = {}
        for joint, name in enumerate(rig.names):
            above = nodes[rig.names[rig.parents[joint]]] if rig.parents[joint] >= 0 else top
            nodes[name] = stage.add_joint(above, name, frame[rows], move[rows, joint], turn[rows, joint], size[rows, joint])
        for k, (binding, parts) in enumerate(zip(worn.bindings, shapes, strict=True)):
            key = (k, colours[one])
            if key not in meshes:
                meshes[key] = parts.mesh(binding.shape, _write_materials(stage, worn, colours[one]))
            follows = "skinning" in binding.deformer
            at = None if follows else nodes.get(binding.transform, top)
            node = stage.add_body(
                at, f"{species}_{one}_{binding.shape}", meshes[key], parts.add_skin(nodes, top) if follows else None
            )
            if parts.targets is not None and "blendshape" in binding.deformer:
                stage.write_weights(node, frame[rows], parts.targets.weights(channels[rows]))


def _write_shape(writer: GltfWriter, body: PosedBody, name: str) -> ShapeParts:
    shape = body.definition.shapes[name]
    normals = shape.normals if shape.normals is not None else compute_vertex_normals(shape.points.astype(np.float64), shape.faces)
    return ShapeParts(writer, body.definition, shape, normals)


def _write_materials(stage: GltfStage, body: PosedBody, colour: tuple[float, ...]) -> dict[str, int]:
    """Return the numbers of a body's materials, by name. Triangles without a material get the agent's state colour."""
    state = tuple(float(part) for part in decode_srgb(np.array(colour)))
    own: dict[str, Any] = dict(body.definition.materials)
    used = (material for binding in body.bindings for material in body.definition.shapes[binding.shape].materials)
    return {
        name: stage.find_or_add_material(name or STATE_MATERIAL, own[name] if name in own and name != STATE_MATERIAL else state)
        for name in dict.fromkeys(("", STATE_MATERIAL, *own, *used))
    }
