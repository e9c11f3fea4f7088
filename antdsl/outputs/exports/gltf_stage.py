"""The scene of a glTF file while it is built: animated nodes, meshes of the world, items and the camera."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl import __version__
from antdsl.bodies.agents.transforms import align_signs, matrix_to_quaternion
from antdsl.bodies.body import compute_vertex_normals
from antdsl.bodies.files.gltf.gltf_writer import INDEX_BUFFER_TARGET, VERTEX_BUFFER_TARGET, GltfWriter
from antdsl.bodies.shapes import build_item_mesh
from antdsl.outputs.gallery import Gallery
from antdsl.outputs.pictures.light import decode_srgb
from antdsl.outputs.pictures.model import Item, Picture, Solid
from antdsl.outputs.scene_cameras import SceneCameras, find_camera_axes
from antdsl.scene.looks import KIND_BY_LOOK, SURFACE_KINDS
from antdsl.scene.scene_model import UNIT_MM
from antdsl.scene.setting import SENSOR_WIDTH_MM

_DEFAULT_ASPECT = 16 / 9
_SQRT_HALF = float(np.sqrt(0.5))
_DEFAULT_BY_PATH = {"translation": (0, 0, 0), "rotation": (0, 0, 0, 1), "scale": (1, 1, 1)}
_RIGID_TOLERANCE = 1e-4  # share of the mesh's size; a motion with smaller deviations counts as rigid

_BODY_ROUGHNESS, _ITEM_ROUGHNESS = 0.55, 0.9

Floats = NDArray[np.float64]


@dataclass(slots=True, eq=False)
class _MovingNode:
    """The node of a mesh or an item, and its transforms in all frames."""

    node: int
    frames: list[int] = field(default_factory=list)
    translations: list[Floats] = field(default_factory=list)
    rotations: list[Floats] = field(default_factory=list)
    scales: list[Floats] = field(default_factory=list)


class GltfStage:
    """The scene of a glTF file. Its methods count frames from 0 in the order of `frames`.

    If `frames` omits a frame number, the animation still has time for it."""

    def __init__(self, gallery: Gallery, frames: list[int]) -> None:
        self.gallery, self.frames = gallery, frames
        self.writer = GltfWriter(f"antdsl {__version__}")
        self.notes: list[str] = []
        self._samplers: list[dict[str, Any]] = []
        self._channels: list[dict[str, Any]] = []
        self._sampler_numbers: dict[tuple[int, int, str], int] = {}  # by the accessors of times and values, and their kind
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
        self._write_cameras()

    def add_note(self, sentence: str) -> None:
        """Add a message about an omission, unless it has already been added."""
        if sentence not in self.notes:
            self.notes.append(sentence)

    # ---- nodes

    def _add_node(self, parent: int | None, entry: dict[str, Any]) -> int:
        """Add a node. Return its number. `parent`: the number of its parent node; None for a root."""
        number = self.writer.add_part("nodes", entry)
        if parent is None:
            self.scene["nodes"].append(number)
        else:
            self.writer.get_part("nodes", parent).setdefault("children", []).append(number)
        return number

    def add_agent(self, name: str, extras: dict[str, Any]) -> int:
        """Add the node of an agent with its `extras`. Return its number."""
        return self._add_node(self._world_node, {"name": name, "extras": extras})

    def add_joint(self, parent: int, name: str) -> int:
        """Add the node of a joint. Return its number."""
        return self._add_node(parent, {"name": name})

    def add_body(self, parent: int | None, name: str, mesh: int, skin: int | None) -> int:
        """Add a node that has a mesh. Return its number.

        `parent`: the number of its parent node; None for a root. Nodes with a skin must be roots."""
        return self._add_node(parent, {"name": name, "mesh": mesh} | ({} if skin is None else {"skin": skin}))

    def add_child(self, item: int | None, name: str, move: NDArray[Any] | None = None, turn: NDArray[Any] | None = None) -> int:
        """Add a node. Return its number. Its parent is the node of the drawn item `item`, or the world if `item` is None.

        `move` (3,): its position relative to the item, in radii. `turn`: its rotation, a quaternion (x y z w)."""
        entry: dict[str, Any] = {"name": name}
        entry |= {} if move is None else {"translation": [float(part) for part in move]}
        entry |= {} if turn is None else {"rotation": [float(part) for part in turn]}
        return self._add_node(self._world_node if item is None else self._items[item].node, entry)

    def write_presence(self, node: int, frames: NDArray[np.int64], scales: Floats | None = None) -> None:
        """Write keys for the scale of a node that exists only in `frames`. In all other frames, its scale is 0.

        `scales` (n, 3): the scales in `frames`, 1 by default."""
        track = np.zeros((len(self.frames), 3))
        track[frames] = 1.0 if scales is None else scales
        keys = np.flatnonzero(np.append(True, (track[1:] != track[:-1]).any(axis=1)))
        self.write_keys(node, "scale", keys, track[keys], "STEP")

    def write_weights(self, node: int, frames: NDArray[np.int64], values: NDArray[np.float32]) -> None:
        """Write the weights (n, targets) of a node's morph targets in `frames`."""
        mesh = self.writer.get_part("nodes", node)["mesh"]
        self.writer.get_part("meshes", mesh).setdefault("weights", [0.0] * values.shape[1])
        self.write_keys(node, "weights", frames, values)

    def write_value(self, node: int, path: str, value: NDArray[Any]) -> None:
        """Write a constant value for a node's property `path`. The default value of the format is omitted."""
        single = np.asarray(value, np.float32)
        if path == "weights" or (single != np.array(_DEFAULT_BY_PATH[path], np.float32)).any():
            digits = 7 if path == "rotation" else 9  # components of rotations are at most 1, so these are float32 too
            self.writer.get_part("nodes", node)[path] = [float(f"{part:.{digits}g}") for part in single.tolist()]

    def write_keys(
        self, node: int, path: str, frames: NDArray[np.int64], values: NDArray[Any], interpolation: str = "LINEAR",
        is_short: bool = False,
    ) -> None:  # fmt: skip
        """Write keys (n, k) for a node's property `path`. The first key is also the static value of the node.

        `is_short`: whether to write int16, for values up to 1."""
        values = align_signs(values) if path == "rotation" else values
        self.write_value(node, path, values[0])
        keys = np.rint(values * 32767).astype(np.int16) if is_short else np.asarray(values, np.float32)
        if (keys == keys[0]).all():
            return
        seconds = (np.array(self.frames)[frames] - self.frames[0]) * self.gallery.dt
        accessors = (
            self.writer.add_accessor(seconds, bounds=True, is_packed=True),
            self.writer.add_accessor(keys.reshape(-1) if path == "weights" else keys, "i2" if is_short else "f4", is_packed=True),
        )
        key = *accessors, interpolation
        if key not in self._sampler_numbers:
            self._sampler_numbers[key] = len(self._samplers)
            self._samplers.append({"input": accessors[0], "output": accessors[1], "interpolation": interpolation})
        self._channels.append({"sampler": self._sampler_numbers[key], "target": {"node": node, "path": path}})

    def find_or_add_material(
        self, name: str, colour: tuple[float, ...], roughness: float = _BODY_ROUGHNESS, metalness: float = 0.0
    ) -> int:
        """Return the number of the material with this name and base colour (linear). Add it if it does not exist."""
        key = (name, tuple(round(part, 6) for part in colour))
        if key not in self._materials:
            pbr = {"baseColorFactor": [*key[1], 1.0], "metallicFactor": metalness, "roughnessFactor": roughness}
            self._materials[key] = self.writer.add_part(
                "materials", {"name": name, "pbrMetallicRoughness": pbr, "doubleSided": True}
            )
        return self._materials[key]

    # ---- the world

    def add_picture(self, picture: Picture) -> None:
        """Add the meshes and items of a frame, but no agents."""
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
        """Add the node of a mesh in its first frame. In later frames, record its motion."""
        vertices = np.asarray(solid.vertices, np.float64)
        if solid.name not in self._solids:
            node = self.add_body(
                self._world_node, solid.name, self._write_mesh(solid.name, vertices, solid.faces, solid.kind), None
            )
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
        """Add the node of an item in its first frame. In later frames, record its motion."""
        if item.shape == "none" or item.radius <= 0:
            return
        if number not in self._items:
            points, faces, colours = build_item_mesh(item.shape)
            if self.gallery.manifest.up == "z":
                points = np.stack([points[:, 0], -points[:, 2], points[:, 1]], axis=1)
            node = self.add_body(
                self._world_node,
                item.name,
                self._write_mesh(item.name, points, faces, KIND_BY_LOOK.get(item.look or ""), decode_srgb(colours)),
                None,
            )
            self._items[number] = _MovingNode(node)
        moving = self._items[number]
        moving.frames.append(frame)
        moving.translations.append(np.asarray(item.position, np.float64))
        moving.scales.append(np.full(3, item.drawn_radius))

    def _write_mesh(
        self, name: str, points: Floats, faces: NDArray[Any], kind: str | None, colours: NDArray[Any] | None = None
    ) -> int:
        """Write a mesh. Return its number.

        `kind`: the kind of surface that selects its material; None for a mesh with colours per point."""
        attributes = {
            "POSITION": self.writer.add_accessor(points, "f4", VERTEX_BUFFER_TARGET, bounds=True),
            "NORMAL": self.writer.add_accessor(
                _normalise_normals(compute_vertex_normals(points, faces)), "f4", VERTEX_BUFFER_TARGET
            ),
        }
        if colours is not None and kind is None:
            attributes["COLOR_0"] = self.writer.add_accessor(colours, "f4", VERTEX_BUFFER_TARGET)
        indices = self.writer.add_accessor(np.ravel(faces), "u4", INDEX_BUFFER_TARGET)
        if kind is None:
            material = self.find_or_add_material("painted", (1.0, 1.0, 1.0), _ITEM_ROUGHNESS)
        else:
            row = SURFACE_KINDS[kind]
            material = self.find_or_add_material(kind, tuple(decode_srgb(row.colour).tolist()), row.roughness, row.metalness)
        return self.writer.add_part(
            "meshes", {"name": name, "primitives": [{"attributes": attributes, "indices": indices, "material": material}]}
        )

    def write_motion(self) -> None:
        """Write the collected motion of meshes and items, dug solids, and the animation."""
        for moving in [*(solid for solid, _ in self._solids.values()), *self._items.values()]:
            frames = np.array(moving.frames, np.int64)
            for path, values in (
                ("translation", moving.translations), ("rotation", moving.rotations), ("scale", moving.scales),
            ):  # fmt: skip
                if values:
                    self.write_keys(moving.node, path, frames, np.array(values))
        for name, solid in self._dug_solids.items():
            self.add_body(self._world_node, name, self._write_mesh(name, solid.vertices, solid.faces, solid.kind), None)
            self.add_note(f"`{name}` is written as in frame {self.frames[-1]}")
        if self.gallery.manifest.fields:
            self.add_note("fields are left out")
        if self._channels:
            self.writer.add_part("animations", {"name": "shot", "samplers": self._samplers, "channels": self._channels})

    def _write_cameras(self) -> None:
        """Write the cameras of the scene."""
        cameras = SceneCameras(self.gallery)
        for name, written_name in cameras.list_exported(self.frames[0]).items():
            self._write_camera(cameras, name, written_name)

    def _write_camera(self, cameras: SceneCameras, name: str, written_name: str) -> None:
        """Write the scene's camera `name`, with its motion. `written_name`: its name in the file."""
        first = cameras.make_camera(self.frames[0], name)
        assert first is not None
        angle = 2 * np.arctan(SENSOR_WIDTH_MM / _DEFAULT_ASPECT / 2 / first.focal)
        away = float(np.linalg.norm(np.subtract(first.at, first.look_at))) * UNIT_MM[self.gallery.manifest.units] / 1000
        reach = max(away, 1e-6)  # metres; the scale of a node does not affect its camera
        lens = {"yfov": float(angle), "aspectRatio": _DEFAULT_ASPECT, "znear": reach * 1e-3, "zfar": reach * 1e3}
        number = self.writer.add_part("cameras", {"type": "perspective", "perspective": lens})
        node = self._add_node(self._world_node, {"name": written_name, "camera": number})
        moves, turns, camera_frames = [], [], self.frames if cameras.is_moving(name) else self.frames[:1]
        for frame in camera_frames:
            camera = cameras.make_camera(frame, name)
            assert camera is not None
            eye, axes = find_camera_axes(camera, self.gallery.manifest.up)
            moves.append(eye)
            turns.append(matrix_to_quaternion(axes.T))
            if camera.focal != first.focal:
                self.add_note(f"the focal length of the camera `{name}` is that of the first frame")
        self.write_keys(node, "translation", np.arange(len(camera_frames)), np.array(moves))
        self.write_keys(node, "rotation", np.arange(len(camera_frames)), np.array(turns))


def _fit_rigid(first: Floats, second: Floats) -> tuple[Floats, Floats, float]:
    """Return the rotation (x y z w) and the translation that map points `first` to `second` best, and the greatest error (Kabsch,
    1976)."""
    if np.array_equal(first, second):
        return np.array([0.0, 0.0, 0.0, 1.0]), np.zeros(3), 0.0
    a, b = first.mean(axis=0), second.mean(axis=0)
    u, _, vt = np.linalg.svd((first - a).T @ (second - b))
    flip = np.diag([1.0, 1.0, np.sign(np.linalg.det(vt.T @ u.T))])
    turn = vt.T @ flip @ u.T
    move = b - turn @ a
    return matrix_to_quaternion(turn), move, float(np.abs(first @ turn.T + move - second).max(initial=0.0))


def _normalise_normals(normals: NDArray[np.float32]) -> Floats:
    wide = normals.astype(np.float64)
    unit_normals: Floats = wide / np.maximum(np.linalg.norm(wide, axis=1, keepdims=True), 1e-12)
    return unit_normals
