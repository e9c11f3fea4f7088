"""A cache as one glTF 2.0 file. Each agent is a node with animated joints. Agents with equal definitions share meshes.

Source: Khronos Group, glTF 2.0 Specification, 2021. A node `World` converts the scene to glTF's axes and metres, and moves it by
its origin. Meshes with a skin are not below this node, because glTF ignores the transforms of their nodes."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.atomic_write import write_atomically
from antdsl.bodies.agents.definition import STATE_MATERIAL, Binding
from antdsl.bodies.agents.transforms import align_signs, decompose_matrix
from antdsl.bodies.body import compute_vertex_normals
from antdsl.bodies.files.gltf.gltf_writer import GltfShapeWriter, GltfWriter
from antdsl.bodies.posed_body import PosedBody
from antdsl.outputs.exports.gltf_keys import PATHS, AgentRows, NodeTracks, plan_keys
from antdsl.outputs.exports.gltf_lights import add_lights
from antdsl.outputs.exports.gltf_stage import GltfStage
from antdsl.outputs.exports.gltf_states import StateChanges
from antdsl.outputs.exports.poses_export import FEWER_AGENTS_ADVICE, NO_AGENTS_MESSAGE, list_crowds_by_body, make_pose_arrays
from antdsl.outputs.gallery import Gallery
from antdsl.outputs.numbered_files import ExportUnavailable
from antdsl.outputs.pictures.light import decode_srgb
from antdsl.outputs.pictures.model import Crowd

_MAX_FILE_AGENTS, _MAX_FILE_BYTES = 1000, 1 << 28  # limits of one file
_MAX_IGNORED_SHEAR = 1e-4
_WEIGHT_TOLERANCE = 1e-5  # of morph targets
_SpeciesBody = tuple[str, str]  # a species, and the key of one of its bodies


@dataclass(frozen=True, slots=True, kw_only=True)
class GltfOptions:
    """Options of an export to glTF.

    `tolerance`: the greatest permitted error in the position of a joint or mesh point, as a fraction of the body length. With 0,
    all keys that differ are written."""

    tolerance: float = 0.005


_DEFAULT_OPTIONS = GltfOptions()


def export_gltf(gallery: Gallery, frames: Iterable[int], path: Path, options: GltfOptions = _DEFAULT_OPTIONS) -> list[str]:
    """Write agents with joints, meshes, items and the camera, animated over these frames. Return messages about features that
    glTF does not support.

    Raises ExportUnavailable if the limits of a glTF file are exceeded, CacheError for a damaged frame, OSError if writing
    fails."""
    frames = list(frames)
    crowd = _BodyCollector.gather(gallery, frames)
    states = StateChanges.gather(gallery, frames)
    stage = GltfStage(gallery, frames)
    for (species, _), body in crowd.bodies.items():
        _AgentWriter(stage, body, species, states, options).write_agents()
    for frame in frames:
        picture = gallery.make_picture(frame)
        stage.add_picture(picture)
        if frame == frames[0]:
            add_lights(stage, picture)
    stage.write_motion()
    extras = {"first_frame": frames[0], "last_frame": frames[-1], "fps": 1 / gallery.dt, "tolerance": options.tolerance}
    write_atomically(path, stage.writer.to_bytes(path.suffix.lower() == ".gltf", scene=0, scenes=[stage.scene], extras=extras))
    return [*crowd.make_notes(), *stage.notes]


@dataclass(slots=True, eq=False)
class _BodyRecord:
    """The animation of all agents with one body.

    `outfits`: the body with each set of layers that agents wear.
    `arrays`: by name, the arrays of each frame, with one row per agent:
    - `id` int64, `frame` (counted from 0), `outfit` (index of `outfits`): the agent, frame and layers of the row
    - `translation` float32[J + 1, 3], `rotation` float32[J + 1, 4], `scale` float32[J + 1, 3]: of the agent's node, and of joints
    - `channels` float32[C]: channel values

    `shear`: the largest shear.
    `colour_by_agent`: by agent id, the display colour in the agent's first frame."""

    outfits: list[PosedBody] = field(default_factory=list)
    arrays: dict[str, list[NDArray[Any]]] = field(default_factory=dict)
    colour_by_agent: dict[int, tuple[float, ...]] = field(default_factory=dict)
    shear: float = 0.0

    def add_rows(self, crowd: Crowd, frame: int) -> None:
        """Append the rows of a crowd in a frame."""
        if crowd.body not in self.outfits:
            self.outfits.append(crowd.body)
        poses = make_pose_arrays(crowd)
        count = len(poses["id"])
        matrices = np.concatenate([poses["place"][:, None], poses["local"].astype(np.float64)], axis=1)
        *transforms, shear = decompose_matrix(matrices)
        self.shear = max(self.shear, float(np.abs(shear[:, 1:]).max(initial=0.0)))
        rows = {
            "id": poses["id"], "frame": np.full(count, frame), "outfit": np.full(count, self.outfits.index(crowd.body)),
            "channels": poses["channels"],
            **{path: values.astype(np.float32) for path, values in zip(PATHS, transforms, strict=True)},
        }  # fmt: skip
        for name, values in rows.items():
            self.arrays.setdefault(name, []).append(values)

    def take_sorted_arrays(self) -> dict[str, NDArray[Any]]:
        """Return the rows of all frames, sorted by agent and frame. The collected arrays are released."""
        keys = [np.concatenate(self.arrays[name]) for name in ("frame", "id")]
        order = np.lexsort(keys)
        return {name: np.concatenate(self.arrays.pop(name))[order] for name in list(self.arrays)}


@dataclass(slots=True, eq=False)
class _BodyCollector:
    """Collects the agents of a cache, by species and body."""

    bodies: dict[_SpeciesBody, _BodyRecord]
    recoloured_species: set[str] = field(default_factory=set)  # species with colour changes

    @staticmethod
    def gather(gallery: Gallery, frames: list[int]) -> _BodyCollector:
        """Return the agents of `frames`. Raises ExportUnavailable if there are too many agents or bytes."""
        bodies: dict[_SpeciesBody, _BodyRecord] = {}
        output = _BodyCollector(bodies)
        size = 0
        for number, frame in enumerate(frames):
            for (species, key, _), crowd, worn in list_crowds_by_body(gallery.make_picture(frame)):
                body = bodies.setdefault((species, key), _BodyRecord())
                size += len(crowd.position) * (40 * len(worn.definition.rig.names) + 64)
                output._add_crowd(species, body, crowd, number)
            agents = sum(len(body.colour_by_agent) for body in bodies.values())
            if agents > _MAX_FILE_AGENTS or size > _MAX_FILE_BYTES:
                many = (
                    f"{agents:,} agents with joints"
                    if agents > _MAX_FILE_AGENTS
                    else f"more than {_MAX_FILE_BYTES >> 20} MiB of keys"
                )
                raise ExportUnavailable(
                    f"glTF is for small crowds, but this crowd has {many}", f"{FEWER_AGENTS_ADVICE}, or write USD: `.usdc`"
                )
        return output

    def _add_crowd(self, species: str, body: _BodyRecord, crowd: Crowd, number: int) -> None:
        """Append the rows of a crowd in the frame `number` to the record of its body."""
        assert crowd.ids is not None
        body.add_rows(crowd, number)
        for one, colour in zip(np.asarray(crowd.ids).tolist(), np.asarray(crowd.colour).tolist(), strict=True):
            if body.colour_by_agent.setdefault(one, tuple(colour)) != tuple(colour):
                self.recoloured_species.add(species)

    def make_notes(self) -> list[str]:
        """Return messages about features of the agents that glTF does not support."""
        messages = [] if self.bodies else [NO_AGENTS_MESSAGE]
        messages += [
            f"agents of `{species}` keep the colour of their first state: glTF has no colours over time"
            for species in sorted(self.recoloured_species)
        ]  # fmt: skip
        deformers = {
            binding.deformer for body in self.bodies.values() for worn in body.outfits for binding in worn.bindings
        }  # fmt: skip
        if any("dualquat" in name for name in deformers):
            messages.append("dual quaternion skinning becomes linear: glTF has only linear skinning")
        return messages


@dataclass(slots=True, eq=False)
class _WornShape:
    """A shape that agents wear.

    `outfits`: the numbers of the outfits that contain the shape. `body`: the body with one of these outfits. `meshes`: the
    numbers of its meshes, by colour."""

    binding: Binding
    body: PosedBody
    parts: GltfShapeWriter
    outfits: list[int]
    meshes: dict[tuple[float, ...], int] = field(default_factory=dict)  # by the agent's colour

    @property
    def is_skinned(self) -> bool:
        """Return whether the points of the shape follow several joints."""
        return "skinning" in self.binding.deformer

    @property
    def has_targets(self) -> bool:
        """Return whether the shape has morph targets."""
        return self.parts.targets is not None and "blendshape" in self.binding.deformer


class _AgentWriter:
    """Writer of the nodes, skins and animation of all agents with one body."""

    def __init__(self, stage: GltfStage, body: _BodyRecord, species: str, states: StateChanges, options: GltfOptions) -> None:
        self._stage, self._species, self._states, self._colours = stage, species, states, body.colour_by_agent
        self._definition = body.outfits[0].definition
        if body.shear > _MAX_IGNORED_SHEAR:
            stage.add_note("a shear of joints is left out: glTF has none")
        self._arrays = body.take_sorted_arrays()
        self._ids, starts = np.unique(self._arrays["id"], return_index=True)
        frames = np.array(stage.frames, np.int64)[self._arrays["frame"]]
        self._rows = AgentRows(frames, np.append(starts, len(frames)).astype(np.int64))
        self._shapes = list(_list_shapes(stage.writer, body.outfits))
        for node in range(self._arrays["rotation"].shape[1]):
            self._arrays["rotation"][:, node] = align_signs(self._arrays["rotation"][:, node].astype(np.float64))
        self._plan = plan_keys(self._rows, self._measure_tracks(), options.tolerance)

    def _measure_tracks(self) -> NodeTracks:
        """Return the tracks of an agent's node and of its joints, in body lengths."""
        rig, length = self._definition.rig, self._definition.length
        radii = np.zeros(1 + len(rig.names))
        for each in self._shapes:
            if each.is_skinned:
                radii[1:] = np.maximum(radii[1:], each.parts.measure_radii(rig.names))
            else:
                node = 1 + rig.find_joint(each.binding.transform) if each.binding.transform in rig.names else 0
                radii[node] = max(radii[node], each.parts.measure_radius())
        move, turn, size = (self._arrays[path] for path in PATHS)
        unit = np.repeat(size[self._rows.starts[:-1], 0, :1], self._rows.counts, axis=0)  # of the body's space, in the scene
        top = move[:, 0] / (unit * length), turn[:, 0], size[:, 0] / unit
        joints = [(move[:, k] / length, turn[:, k], size[:, k]) for k in range(1, len(radii))]
        return NodeTracks([-1, *(rig.parents + 1).tolist()], [top, *joints], radii / length)

    def write_agents(self) -> None:
        """Write the nodes, the shapes and the animation keys of all agents."""
        weights = {
            k: each.parts.targets.compute_weights(self._arrays["channels"])
            for k, each in enumerate(self._shapes) if each.parts.targets is not None and each.has_targets
        }  # fmt: skip
        steps = {k: self._rows.choose_steps(values, np.full(len(self._ids), _WEIGHT_TOLERANCE)) for k, values in weights.items()}
        for agent, one in enumerate(self._ids.tolist()):
            nodes = self._write_joints(agent, one)
            for k, each in enumerate(self._shapes):
                node = self._write_shape(each, agent, one, nodes)
                if node is not None and k in weights:
                    rows = self._rows.list_keys(agent, max(int(steps[k][agent]), 1))
                    self._stage.write_weights(node, self._arrays["frame"][rows], weights[k][rows])

    def _write_joints(self, agent: int, agent_id: int) -> list[int]:
        """Write the nodes of an agent and of its joints, with their keys. Return the numbers of these nodes."""
        stage, name = self._stage, f"{self._species}_{agent_id}"
        nodes = [
            stage.add_agent(
                name, {"id": agent_id, "species": self._species, **self._states.describe_agent(self._species, agent_id)}
            )
        ]
        rig = self._definition.rig
        for joint, parent in zip(rig.names, rig.parents.tolist(), strict=True):
            nodes.append(stage.add_joint(nodes[parent + 1], joint))
        first, end = self._rows.starts[agent : agent + 2].tolist()
        is_partial = end - first < len(stage.frames)
        for k, node in enumerate(nodes):
            for path, step in zip(PATHS, self._plan.steps[k, :, agent].tolist(), strict=True):
                values = self._arrays[path][:, k]
                if path == "scale" and k == 0 and is_partial:
                    stage.write_presence(node, self._arrays["frame"][first:end], values[first:end])
                elif step:
                    rows, is_short = self._rows.list_keys(agent, step), path == "rotation" and self._plan.has_short_rotations
                    stage.write_keys(node, path, self._arrays["frame"][rows], values[rows], is_short=is_short)
                else:
                    stage.write_value(node, path, values[first])
        return nodes

    def _write_shape(self, worn_shape: _WornShape, agent: int, agent_id: int, nodes: list[int]) -> int | None:
        """Write the accessors of a body's shape, and return them."""
        stage, binding, rig = self._stage, worn_shape.binding, self._definition.rig
        rows = np.arange(*self._rows.starts[agent : agent + 2].tolist())
        frames = self._arrays["frame"][rows[np.isin(self._arrays["outfit"][rows], worn_shape.outfits)]]
        if not len(frames):
            return None
        colour = self._colours[agent_id]
        if colour not in worn_shape.meshes:
            worn_shape.meshes[colour] = worn_shape.parts.add_mesh(
                binding.shape, _write_materials(stage, worn_shape.body, binding.shape, colour)
            )
        name, followed = f"{self._species}_{agent_id}_{binding.shape}", dict(zip(rig.names, nodes[1:], strict=True))
        is_always_worn = len(frames) == len(rows)
        if not worn_shape.is_skinned:
            node = stage.add_body(followed.get(binding.transform, nodes[0]), name, worn_shape.meshes[colour], None)
            if not is_always_worn:
                stage.write_presence(node, frames)
            return node
        if not is_always_worn:  # points follow nodes at the joints: their scale hides the shape
            for joint in worn_shape.parts.capsule_joints:
                followed[joint] = stage.add_joint(followed[joint], f"{joint}_{binding.shape}")
                stage.write_presence(followed[joint], frames)
        return stage.add_body(None, name, worn_shape.meshes[colour], worn_shape.parts.add_skin(followed, nodes[0]))


def _list_shapes(writer: GltfWriter, outfits: list[PosedBody]) -> Iterable[_WornShape]:
    """Return all shapes in the given outfits, each only once."""
    shapes: dict[Binding, _WornShape] = {}
    for number, body in enumerate(outfits):
        for binding in body.bindings:
            if binding not in shapes:
                shapes[binding] = _WornShape(binding, body, _write_shape(writer, body, binding.shape), [])
            shapes[binding].outfits.append(number)
    return shapes.values()


def _write_shape(writer: GltfWriter, body: PosedBody, name: str) -> GltfShapeWriter:
    shape = body.definition.shapes[name]
    normals = shape.normals if shape.normals is not None else compute_vertex_normals(shape.points.astype(np.float64), shape.faces)
    return GltfShapeWriter(writer, body.definition, shape, normals)


def _write_materials(stage: GltfStage, body: PosedBody, shape: str, colour: tuple[float, ...]) -> dict[str, int]:
    """Write the materials of a shape, and return their numbers by name. Triangles without a material have the colour of the
    agent's state."""
    state = tuple(float(part) for part in decode_srgb(np.array(colour)))
    own: dict[str, Any] = dict(body.definition.materials)
    return {
        name: stage.find_or_add_material(name or STATE_MATERIAL, own[name] if name in own and name != STATE_MATERIAL else state)
        for name in body.definition.shapes[shape].materials or ("",)
    }
