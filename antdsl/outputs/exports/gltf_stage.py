"""The scene of a glTF file under construction: animated nodes, meshes of the world, items and the camera."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl import __version__
from antdsl.bodies.agents.transforms import align_signs, matrix_to_quaternion
from antdsl.bodies.body import compute_vertex_normals
from antdsl.bodies.files.gltf_writer import INDEX_BUFFER_TARGET, VERTEX_BUFFER_TARGET, GltfWriter
from antdsl.bodies.shapes import build_item_mesh
from antdsl.numerics.vector_rows import normalise_or_fallback
from antdsl.outputs.gallery import Gallery
from antdsl.outputs.pictures.light import decode_srgb
from antdsl.outputs.pictures.model import Item, Picture, Solid
from antdsl.scene.scene_model import UNIT_MM

_SENSOR_WIDTH_MM, _DEFAULT_ASPECT = 36.0, 16 / 9
_SQRT_HALF = float(np.sqrt(0.5))
_RIGID_TOLERANCE = 1e-4  # share of the mesh's size; a motion with smaller deviations counts as rigid

Floats = NDArray[np.float64]


@dataclass(slots=True, eq=False)
class _MovingNode:
    """The node of a mesh or an item, and its animation."""

    node: int
    frames: list[int] = field(default_factory=list)
    translations: list[Floats] = field(default_factory=list)
    rotations: list[Floats] = field(default_factory=list)
    scales: list[Floats] = field(default_factory=list)


class GltfStage:
    """The scene of a glTF file. Its methods count frames from 0 in the order of `frames`.

    A frame missing in `frames` still takes its time in the animation."""

    def __init__(self, gallery: Gallery, frames: list[int]) -> None:
        self.gallery, self.frames = gallery, frames
        self.writer = GltfWriter(f"antdsl {__version__}")
        self.notes: list[str] = []
        self._samplers: list[dict[str, Any]] = []
        self._channels: list[dict[str, Any]] = []
        self._time_accessors: dict[bytes, int] = {}
        self._materials: dict[Any, int] = {}
        self._solids: dict[str, tuple[_MovingNode, Floats]] = {}
        self._items: dict[int, _MovingNode] = {}
        self._dug_solids: dict[str, Solid] = {}
        scale = UNIT_MM[gallery.manifest.units] / 1000
        world: dict[str, Any] = {"name": "World", "children": [], "scale": [scale] * 3}
        if gallery.manifest.up == "z":
            world["rotation"] = [-_SQRT_HALF, 0.0, 0.0, _SQRT_HALF]
        if gallery.origin.any():
            x, y, z = (gallery.origin * scale).tolist()
            world["translation"] = [x, z, -y] if gallery.manifest.up == "z" else [x, y, z]  # JSON has double precision
        self._world_node = self.writer.add_part("nodes", world)
        self.scene: dict[str, Any] = {"nodes": [self._world_node]}
        self._write_camera()

    def add_note(self, sentence: str) -> None:
        """Add a message about an omission, unless it was added before."""
        if sentence not in self.notes:
            self.notes.append(sentence)

    # ---- nodes

    def _add_node(self, parent: int | None, entry: dict[str, Any]) -> int:
        number = self.writer.add_part("nodes", entry)
        if parent is None:
            self.scene["nodes"].append(number)
        else:
            self.writer.get_part("nodes", parent).setdefault("children", []).append(number)
        return number

    def add_agent(self, name: str, frames: NDArray[np.int64], translations: Floats, rotations: Floats, sizes: Floats) -> int:
        """Add the node of an agent, with its transforms in some frames, and return its number. In other frames its scale is 0."""
        node = self._add_node(self._world_node, {"name": name})
        self._write_keys(node, frames, translations, rotations, None)
        is_present = np.zeros(len(self.frames), np.bool_)
        is_present[frames] = True
        if is_present.all():
            self._write_keys(node, frames, None, None, sizes)
            return node
        edges = np.flatnonzero(np.diff(is_present, prepend=not is_present[0]) != 0)
        scales = np.where(is_present[edges, None], sizes[0], 0.0)
        self._write_channel(node, "scale", edges, scales, "STEP")
        return node

    def add_joint(
        self, parent: int, name: str, frames: NDArray[np.int64], translations: Floats, rotations: Floats, scales: Floats
    ) -> int:
        """Add the node of a joint, with keys for the components that change, and return its number."""
        node = self._add_node(parent, {"name": name})
        self._write_keys(node, frames, translations, rotations, scales)
        return node

    def add_body(self, parent: int | None, name: str, mesh: int, skin: int | None) -> int:
        """Add a node with a mesh and return its number. `parent`: the parent, None for a root. Nodes with a skin must be
        roots."""
        return self._add_node(parent, {"name": name, "mesh": mesh} | ({} if skin is None else {"skin": skin}))

    def write_weights(self, node: int, frames: NDArray[np.int64], values: NDArray[np.float32]) -> None:
        """Write the weights (n, targets) of a node's morph targets over frames."""
        mesh = self.writer.get_part("nodes", node)["mesh"]
        self.writer.get_part("meshes", mesh).setdefault("weights", [0.0] * values.shape[1])
        self.writer.get_part("nodes", node)["weights"] = values[0].tolist()
        if (values != values[0]).any():
            self._write_channel(node, "weights", frames, values, "LINEAR")

    def _write_keys(
        self, node: int, frames: NDArray[np.int64], translations: Floats | None, rotations: Floats | None, scales: Floats | None
    ) -> None:
        """Write translation, rotation and scale of a node. Constant components become values of the node, others become keys."""
        entry = self.writer.get_part("nodes", node)
        rotations = None if rotations is None else align_signs(rotations)
        for path, values, still in (
            ("translation", translations, (0, 0, 0)), ("rotation", rotations, (0, 0, 0, 1)), ("scale", scales, (1, 1, 1)),
        ):  # fmt: skip
            if values is None:
                continue
            samples = values.astype(np.float32)
            if (samples[0] != np.array(still, np.float32)).any():
                entry[path] = samples[0].tolist()
            if (samples != samples[0]).any():
                self._write_channel(node, path, frames, samples, "LINEAR")

    def _write_channel(self, node: int, path: str, frames: NDArray[np.int64], values: NDArray[Any], kind: str) -> None:
        """Write keys for one property (`path`) of a node. Keys between equal neighbours are left out."""
        is_key = np.ones(len(frames), np.bool_)
        if kind == "LINEAR" and len(frames) > 2:
            same = (values[1:] == values[:-1]).all(axis=1)
            is_key[1:-1] = ~(same[1:] & same[:-1])
        key = frames[is_key].tobytes()
        if key not in self._time_accessors:
            since = np.array(self.frames)[frames[is_key]] - self.frames[0]
            self._time_accessors[key] = self.writer.add_accessor(since * self.gallery.dt, bounds=True)
        output = values[is_key].reshape(-1) if path == "weights" else values[is_key]
        sampler = {"input": self._time_accessors[key], "output": self.writer.add_accessor(output), "interpolation": kind}
        self._channels.append({"sampler": len(self._samplers), "target": {"node": node, "path": path}})
        self._samplers.append(sampler)

    def find_or_add_material(self, name: str, colour: tuple[float, ...], *, has_vertex_colours: bool = False) -> int:
        """Return the number of the material with this name and base colour (linear). It is added at its first use."""
        key = (name, tuple(round(part, 6) for part in colour))
        if key not in self._materials:
            pbr = {
                "baseColorFactor": [*key[1], 1.0],
                "metallicFactor": 0.0,
                "roughnessFactor": 0.55 if not has_vertex_colours else 0.9,
            }
            self._materials[key] = self.writer.add_part(
                "materials", {"name": name, "pbrMetallicRoughness": pbr, "doubleSided": True}
            )
        return self._materials[key]

    # ---- the world

    def add_picture(self, picture: Picture) -> None:
        """Add the meshes and items of a frame, everything except agents."""
        frame = self.frames.index(picture.frame) if picture.frame is not None else 0
        dug = {mesh.name for mesh in self.gallery.manifest.meshes if mesh.row.is_dug}
        for solid in picture.solids:
            if solid.name in dug:
                self._dug_solids[solid.name] = solid
            else:
                self._add_solid(frame, solid)
        for number, item in enumerate(picture.items):
            self._add_item(frame, number, item)

    def _add_solid(self, frame: int, solid: Solid) -> None:
        vertices = np.asarray(solid.vertices, np.float64)
        if solid.name not in self._solids:
            node = self.add_body(self._world_node, solid.name, self._write_mesh(solid.name, vertices, solid.faces, None), None)
            self._solids[solid.name] = _MovingNode(node), vertices
        moving, first = self._solids[solid.name]
        turn, move, off = _fit_rigid(first, vertices)
        if off > _RIGID_TOLERANCE * max(float(np.ptp(first, axis=0).max()), 1e-12):
            self.add_note(f"`{solid.name}` changes its shape; only its shape in frame {self.frames[0]} is written")
            return
        moving.frames.append(frame)
        moving.translations.append(move)
        moving.rotations.append(turn)

    def _add_item(self, frame: int, number: int, item: Item) -> None:
        if item.shape == "none" or item.radius <= 0:
            return
        if number not in self._items:
            points, faces, colours = build_item_mesh(item.shape)
            if self.gallery.manifest.up == "z":
                points = np.stack([points[:, 0], -points[:, 2], points[:, 1]], axis=1)
            node = self.add_body(
                self._world_node, item.name, self._write_mesh(item.name, points, faces, decode_srgb(colours)), None
            )
            self._items[number] = _MovingNode(node)
        moving = self._items[number]
        moving.frames.append(frame)
        moving.translations.append(np.asarray(item.position, np.float64))
        moving.scales.append(np.full(3, item.radius * max(min(item.remaining_share, 1.0), 0.0) ** (1 / 3)))

    def _write_mesh(self, name: str, points: Floats, faces: NDArray[Any], colours: NDArray[Any] | None) -> int:
        attributes = {
            "POSITION": self.writer.add_accessor(points, "f4", VERTEX_BUFFER_TARGET, bounds=True),
            "NORMAL": self.writer.add_accessor(_normalise(compute_vertex_normals(points, faces)), "f4", VERTEX_BUFFER_TARGET),
        }
        if colours is not None:
            attributes["COLOR_0"] = self.writer.add_accessor(colours, "f4", VERTEX_BUFFER_TARGET)
        indices = self.writer.add_accessor(np.ravel(faces), "u4", INDEX_BUFFER_TARGET)
        tone = (1.0, 1.0, 1.0) if colours is not None else (0.36, 0.31, 0.25)
        material = self.find_or_add_material("painted" if colours is not None else "ground", tone, has_vertex_colours=True)
        return self.writer.add_part(
            "meshes", {"name": name, "primitives": [{"attributes": attributes, "indices": indices, "material": material}]}
        )

    def write_motion(self) -> None:
        """Write the collected motion of meshes and items, dug solids, and the animation."""
        for moving, _ in self._solids.values():
            if moving.frames:
                self._write_keys(
                    moving.node, np.array(moving.frames), np.array(moving.translations), np.array(moving.rotations), None
                )
        for moving in self._items.values():
            self._write_keys(moving.node, np.array(moving.frames), np.array(moving.translations), None, np.array(moving.scales))
        for name, solid in self._dug_solids.items():
            self.add_body(self._world_node, name, self._write_mesh(name, solid.vertices, solid.faces, None), None)
            self.add_note(f"`{name}` is written as in frame {self.frames[-1]}")
        if self.gallery.manifest.fields:
            self.add_note("fields are left out")
        if self._channels:
            self.writer.add_part("animations", {"name": "shot", "samplers": self._samplers, "channels": self._channels})

    def _write_camera(self) -> None:
        first = self.gallery.make_camera(self.frames[0])
        if first is None:
            return
        angle = 2 * np.arctan(_SENSOR_WIDTH_MM / _DEFAULT_ASPECT / 2 / first.focal)
        away = float(np.linalg.norm(np.subtract(first.at, first.look_at))) * UNIT_MM[self.gallery.manifest.units] / 1000
        reach = max(away, 1e-6)  # metres; the scale of a node does not affect its camera
        lens = {"yfov": float(angle), "aspectRatio": _DEFAULT_ASPECT, "znear": reach * 1e-3, "zfar": reach * 1e3}
        number = self.writer.add_part("cameras", {"type": "perspective", "perspective": lens})
        node = self._add_node(self._world_node, {"name": "camera", "camera": number})
        moves, turns, camera_frames = [], [], self.frames if self.gallery.has_moving_camera else self.frames[:1]
        for frame in camera_frames:
            camera = self.gallery.make_camera(frame)
            assert camera is not None
            eye, aim = np.asarray(camera.at, np.float64), np.asarray(camera.look_at, np.float64)
            upward = (0.0, 1.0, 0.0) if self.gallery.manifest.up == "y" else (0.0, 0.0, 1.0)
            back = normalise_or_fallback(eye - aim, np.array([0.0, 0.0, 1.0]))
            up = np.asarray(camera.up or upward, np.float64)
            if np.linalg.norm(np.cross(up, back)) < 1e-6:
                up = np.roll(up, 1)
            side = normalise_or_fallback(np.cross(up, back), np.array([1.0, 0.0, 0.0]))
            moves.append(eye)
            turns.append(matrix_to_quaternion(np.stack([side, np.cross(back, side), back], axis=1)))
            if camera.focal != first.focal:
                self.add_note("the camera's focal length is that of the first frame")
        self._write_keys(node, np.arange(len(camera_frames)), np.array(moves), np.array(turns), None)


def _fit_rigid(first: Floats, later: Floats) -> tuple[Floats, Floats, float]:
    """Return the rotation (x y z w) and the translation that best map the points `first` to `later`, and the largest error
    (Kabsch, 1976)."""
    if np.array_equal(first, later):
        return np.array([0.0, 0.0, 0.0, 1.0]), np.zeros(3), 0.0
    a, b = first.mean(axis=0), later.mean(axis=0)
    u, _, vt = np.linalg.svd((first - a).T @ (later - b))
    flip = np.diag([1.0, 1.0, np.sign(np.linalg.det(vt.T @ u.T))])
    turn = vt.T @ flip @ u.T
    move = b - turn @ a
    return matrix_to_quaternion(turn), move, float(np.abs(first @ turn.T + move - later).max(initial=0.0))


def _normalise(normals: NDArray[np.float32]) -> Floats:
    wide = normals.astype(np.float64)
    unit_normals: Floats = wide / np.maximum(np.linalg.norm(wide, axis=1, keepdims=True), 1e-12)
    return unit_normals
