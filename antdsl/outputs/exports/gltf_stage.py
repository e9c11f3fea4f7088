"""The scene of a glTF file under construction: animated nodes, meshes of the world, items and the camera."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl import __version__
from antdsl.bodies.agents.transforms import align_signs, rotation_of
from antdsl.bodies.body import vertex_normals
from antdsl.bodies.files.gltf_writer import INDICES, VERTICES, GltfWriter
from antdsl.bodies.shapes import placed
from antdsl.numerics.vector_rows import unit_or
from antdsl.outputs.gallery import Gallery
from antdsl.outputs.pictures.light import decode_srgb
from antdsl.outputs.pictures.model import Item, Picture, Solid
from antdsl.scene.model import UNIT_MM

_SENSOR_WIDTH_MM, _DEFAULT_ASPECT = 36.0, 16 / 9
_SQRT_HALF = float(np.sqrt(0.5))
_RIGID_TOLERANCE = 1e-4  # largest deviation from a rigid motion, as a share of the mesh's size

Floats = NDArray[np.float64]


@dataclass(slots=True, eq=False)
class _MovingNode:
    """The node of a mesh or an item, and its animation."""

    node: int
    frames: list[int] = field(default_factory=list)
    moves: list[Floats] = field(default_factory=list)
    turns: list[Floats] = field(default_factory=list)
    sizes: list[Floats] = field(default_factory=list)


class GltfStage:
    """The scene of a glTF file. Its methods count frames from 0 in the order of `frames`.

    A frame missing in `frames` still takes its time in the animation."""

    def __init__(self, gallery: Gallery, frames: list[int]) -> None:
        self.gallery, self.frames = gallery, frames
        self.writer = GltfWriter(f"antdsl {__version__}")
        self.notes: list[str] = []
        self._samplers: list[dict[str, Any]] = []
        self._channels: list[dict[str, Any]] = []
        self._times: dict[bytes, int] = {}
        self._materials: dict[Any, int] = {}
        self._solids: dict[str, tuple[_MovingNode, Floats]] = {}
        self._items: dict[int, _MovingNode] = {}
        self._dug: dict[str, Solid] = {}
        scale = UNIT_MM[gallery.manifest.units] / 1000
        world: dict[str, Any] = {"name": "World", "children": [], "scale": [scale] * 3}
        if gallery.manifest.up == "z":
            world["rotation"] = [-_SQRT_HALF, 0.0, 0.0, _SQRT_HALF]
        if gallery.origin.any():
            x, y, z = (gallery.origin * scale).tolist()
            world["translation"] = [x, z, -y] if gallery.manifest.up == "z" else [x, y, z]  # JSON: double precision
        self._world = self.writer.add("nodes", world)
        self.scene: dict[str, Any] = {"nodes": [self._world]}
        self._camera()

    def add_note(self, sentence: str) -> None:
        """Add a message about an omission, unless it was added before."""
        if sentence not in self.notes:
            self.notes.append(sentence)

    # ---- nodes

    def _node(self, above: int | None, entry: dict[str, Any]) -> int:
        number = self.writer.add("nodes", entry)
        if above is None:
            self.scene["nodes"].append(number)
        else:
            self.writer.entry("nodes", above).setdefault("children", []).append(number)
        return number

    def agent(self, name: str, frames: NDArray[np.int64], move: Floats, turn: Floats, size: Floats) -> int:
        """Add the node of an agent, with its transforms in some frames, and return its number. In other frames its scale is 0."""
        node = self._node(self._world, {"name": name})
        self._keys(node, frames, move, turn, None)
        is_present = np.zeros(len(self.frames), np.bool_)
        is_present[frames] = True
        if is_present.all():
            self._keys(node, frames, None, None, size)
            return node
        edges = np.flatnonzero(np.diff(is_present, prepend=not is_present[0]) != 0)
        scales = np.where(is_present[edges, None], size[0], 0.0)
        self._channel(node, "scale", edges, scales, "STEP")
        return node

    def joint(self, above: int, name: str, frames: NDArray[np.int64], move: Floats, turn: Floats, size: Floats) -> int:
        """Add the node of a joint, with keys for the components that change, and return its number."""
        node = self._node(above, {"name": name})
        self._keys(node, frames, move, turn, size)
        return node

    def body(self, above: int | None, name: str, mesh: int, skin: int | None) -> int:
        """Add a node with a mesh and return its number. `above`: the parent, None for a root. Nodes with a skin must be roots."""
        return self._node(above, {"name": name, "mesh": mesh} | ({} if skin is None else {"skin": skin}))

    def weights(self, node: int, frames: NDArray[np.int64], values: NDArray[np.float32]) -> None:
        """Write the weights (n, targets) of a node's morph targets over frames."""
        mesh = self.writer.entry("nodes", node)["mesh"]
        self.writer.entry("meshes", mesh).setdefault("weights", [0.0] * values.shape[1])
        self.writer.entry("nodes", node)["weights"] = values[0].tolist()
        if (values != values[0]).any():
            self._channel(node, "weights", frames, values, "LINEAR")

    def _keys(self, node: int, frames: NDArray[np.int64], move: Floats | None, turn: Floats | None, size: Floats | None) -> None:
        """Write translation, rotation and scale of a node. Constant components become values of the node, others become keys."""
        entry = self.writer.entry("nodes", node)
        turn = None if turn is None else align_signs(turn)
        for path, values, still in (
            ("translation", move, (0, 0, 0)), ("rotation", turn, (0, 0, 0, 1)), ("scale", size, (1, 1, 1)),
        ):  # fmt: skip
            if values is None:
                continue
            samples = values.astype(np.float32)
            if (samples[0] != np.array(still, np.float32)).any():
                entry[path] = samples[0].tolist()
            if (samples != samples[0]).any():
                self._channel(node, path, frames, samples, "LINEAR")

    def _channel(self, node: int, path: str, frames: NDArray[np.int64], values: NDArray[Any], kind: str) -> None:
        """Write keys for one property (`path`) of a node. Keys between equal neighbours are left out."""
        is_key = np.ones(len(frames), np.bool_)
        if kind == "LINEAR" and len(frames) > 2:
            same = (values[1:] == values[:-1]).all(axis=1)
            is_key[1:-1] = ~(same[1:] & same[:-1])
        key = frames[is_key].tobytes()
        if key not in self._times:
            since = np.array(self.frames)[frames[is_key]] - self.frames[0]
            self._times[key] = self.writer.accessor(since * self.gallery.dt, bounds=True)
        output = values[is_key].reshape(-1) if path == "weights" else values[is_key]
        sampler = {"input": self._times[key], "output": self.writer.accessor(output), "interpolation": kind}
        self._channels.append({"sampler": len(self._samplers), "target": {"node": node, "path": path}})
        self._samplers.append(sampler)

    def material(self, name: str, colour: tuple[float, ...], *, vertex: bool = False) -> int:
        """Return the number of the material with this name and base colour (linear). It is added at its first use."""
        key = (name, tuple(round(part, 6) for part in colour))
        if key not in self._materials:
            pbr = {"baseColorFactor": [*key[1], 1.0], "metallicFactor": 0.0, "roughnessFactor": 0.55 if not vertex else 0.9}
            self._materials[key] = self.writer.add("materials", {"name": name, "pbrMetallicRoughness": pbr, "doubleSided": True})
        return self._materials[key]

    # ---- the world

    def add_picture(self, picture: Picture) -> None:
        """Add the meshes and items of a frame, everything except agents."""
        frame = self.frames.index(picture.frame) if picture.frame is not None else 0
        dug = {mesh.name for mesh in self.gallery.manifest.meshes if mesh.row.is_dug}
        for solid in picture.solids:
            if solid.name in dug:
                self._dug[solid.name] = solid
            else:
                self._solid(frame, solid)
        for number, item in enumerate(picture.items):
            self._item(frame, number, item)

    def _solid(self, frame: int, solid: Solid) -> None:
        vertices = np.asarray(solid.vertices, np.float64)
        if solid.name not in self._solids:
            node = self.body(self._world, solid.name, self._mesh(solid.name, vertices, solid.faces, None), None)
            self._solids[solid.name] = _MovingNode(node), vertices
        moving, first = self._solids[solid.name]
        turn, move, off = _fit_rigid(first, vertices)
        if off > _RIGID_TOLERANCE * max(float(np.ptp(first, axis=0).max()), 1e-12):
            self.add_note(f"`{solid.name}` changes its shape; only its shape in frame {self.frames[0]} is written")
            return
        moving.frames.append(frame)
        moving.moves.append(move)
        moving.turns.append(turn)

    def _item(self, frame: int, number: int, item: Item) -> None:
        if item.shape == "none" or item.radius <= 0:
            return
        if number not in self._items:
            points, faces, colours = placed(item.shape)
            if self.gallery.manifest.up == "z":
                points = np.stack([points[:, 0], -points[:, 2], points[:, 1]], axis=1)
            node = self.body(self._world, item.name, self._mesh(item.name, points, faces, decode_srgb(colours)), None)
            self._items[number] = _MovingNode(node)
        moving = self._items[number]
        moving.frames.append(frame)
        moving.moves.append(np.asarray(item.position, np.float64))
        moving.sizes.append(np.full(3, item.radius * max(min(item.left, 1.0), 0.0) ** (1 / 3)))

    def _mesh(self, name: str, points: Floats, faces: NDArray[Any], colours: NDArray[Any] | None) -> int:
        attributes = {
            "POSITION": self.writer.accessor(points, "f4", VERTICES, bounds=True),
            "NORMAL": self.writer.accessor(_unit(vertex_normals(points, faces)), "f4", VERTICES),
        }
        if colours is not None:
            attributes["COLOR_0"] = self.writer.accessor(colours, "f4", VERTICES)
        indices = self.writer.accessor(np.ravel(faces), "u4", INDICES)
        tone = (1.0, 1.0, 1.0) if colours is not None else (0.36, 0.31, 0.25)
        material = self.material("painted" if colours is not None else "ground", tone, vertex=True)
        return self.writer.add(
            "meshes", {"name": name, "primitives": [{"attributes": attributes, "indices": indices, "material": material}]}
        )

    def finish(self) -> None:
        """Write the collected motion of meshes and items, dug solids, and the animation."""
        for moving, _ in self._solids.values():
            if moving.frames:
                self._keys(moving.node, np.array(moving.frames), np.array(moving.moves), np.array(moving.turns), None)
        for moving in self._items.values():
            self._keys(moving.node, np.array(moving.frames), np.array(moving.moves), None, np.array(moving.sizes))
        for name, solid in self._dug.items():
            self.body(self._world, name, self._mesh(name, solid.vertices, solid.faces, None), None)
            self.add_note(f"`{name}` is written as in frame {self.frames[-1]}")
        if self.gallery.manifest.fields:
            self.add_note("fields are left out")
        if self._channels:
            self.writer.add("animations", {"name": "shot", "samplers": self._samplers, "channels": self._channels})

    def _camera(self) -> None:
        first = self.gallery.camera(self.frames[0])
        if first is None:
            return
        angle = 2 * np.arctan(_SENSOR_WIDTH_MM / _DEFAULT_ASPECT / 2 / first.focal)
        away = float(np.linalg.norm(np.subtract(first.at, first.look_at))) * UNIT_MM[self.gallery.manifest.units] / 1000
        reach = max(away, 1e-6)  # metres: the scale of a node does not count for its camera
        lens = {"yfov": float(angle), "aspectRatio": _DEFAULT_ASPECT, "znear": reach * 1e-3, "zfar": reach * 1e3}
        number = self.writer.add("cameras", {"type": "perspective", "perspective": lens})
        node = self._node(self._world, {"name": "camera", "camera": number})
        moves, turns, camera_frames = [], [], self.frames if self.gallery.camera_moves else self.frames[:1]
        for frame in camera_frames:
            camera = self.gallery.camera(frame)
            assert camera is not None
            eye, aim = np.asarray(camera.at, np.float64), np.asarray(camera.look_at, np.float64)
            upward = (0.0, 1.0, 0.0) if self.gallery.manifest.up == "y" else (0.0, 0.0, 1.0)
            back = unit_or(eye - aim, np.array([0.0, 0.0, 1.0]))
            up = np.asarray(camera.up or upward, np.float64)
            if np.linalg.norm(np.cross(up, back)) < 1e-6:
                up = np.roll(up, 1)
            side = unit_or(np.cross(up, back), np.array([1.0, 0.0, 0.0]))
            moves.append(eye)
            turns.append(rotation_of(np.stack([side, np.cross(back, side), back], axis=1)))
            if camera.focal != first.focal:
                self.add_note("the camera's focal length is that of the first frame")
        self._keys(node, np.arange(len(camera_frames)), np.array(moves), np.array(turns), None)


def _fit_rigid(first: Floats, then: Floats) -> tuple[Floats, Floats, float]:
    """Return the rotation (x y z w) and the translation that best map the points `first` to `then`, and the largest error
    (Kabsch, 1976)."""
    if np.array_equal(first, then):
        return np.array([0.0, 0.0, 0.0, 1.0]), np.zeros(3), 0.0
    a, b = first.mean(axis=0), then.mean(axis=0)
    u, _, vt = np.linalg.svd((first - a).T @ (then - b))
    flip = np.diag([1.0, 1.0, np.sign(np.linalg.det(vt.T @ u.T))])
    turn = vt.T @ flip @ u.T
    move = b - turn @ a
    return rotation_of(turn), move, float(np.abs(first @ turn.T + move - then).max(initial=0.0))


def _unit(normals: NDArray[np.float32]) -> Floats:
    wide = normals.astype(np.float64)
    unit_normals: Floats = wide / np.maximum(np.linalg.norm(wide, axis=1, keepdims=True), 1e-12)
    return unit_normals
