"""Writes an agent definition: as files in antdsl's own form, or as a glTF 2.0 file.

antdsl's own form consists of a definition file, one glTF file with the geometry of all shapes, and files for other parts. Rig,
layers, groups, clips and metadata are in the forms of Houdini's documentation. In a glTF 2.0 file, joints are nodes, drawn layers
are meshes and skins, blend shapes are morph targets, and clips are animations. Coordinates are converted to metres, with +y up
and +z ahead."""

from __future__ import annotations

import re
from dataclasses import asdict, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl import __version__
from antdsl.bodies.agents.definition import Binding, Clip, Definition, Layer, SkinShape
from antdsl.bodies.agents.other_axes import convert_definition_axes
from antdsl.bodies.agents.transforms import compose_matrix, decompose_matrix
from antdsl.bodies.files.clip_document import collect_clip_channels, shorten_samples, write_clip
from antdsl.bodies.files.document_values import format_axis, parse_unit_mm
from antdsl.bodies.files.documents import format_json, write_group, write_layer, write_metadata, write_rig
from antdsl.bodies.files.gltf.gltf_clips import build_settings_extras
from antdsl.bodies.files.gltf.gltf_settings import CAPSULE_KEYS, build_body_extras
from antdsl.bodies.files.gltf.gltf_textures import COLOUR_ATTRIBUTE
from antdsl.bodies.files.gltf.gltf_writer import GltfShapeWriter, GltfWriter, JsonEntry
from antdsl.bodies.files.houdini_clip import write_clip_text
from antdsl.scene.scene_model import UNIT_MM

SHAPES_FILE_NAME = "shapes.glb"
WRITTEN_FRONT_AXIS, WRITTEN_UP_AXIS, MM_PER_METRE = (0.0, 0.0, 1.0), (0.0, 1.0, 0.0), 1000.0
_DEFAULT_COLOUR = (0.3, 0.3, 0.3)  # for materials with the colour of an agent's state, because a file contains no agents
_IDENTITY_TRANSFORM: dict[str, tuple[float, ...]] = {"translation": (0, 0, 0), "rotation": (0, 0, 0, 1), "scale": (1, 1, 1)}


# ---- our own files


def build_definition_files(body: Definition, name: str, *, has_houdini_clips: bool = False) -> dict[str, bytes]:
    """Return the bytes of a definition's files by path: `NAME.json`, and the files that it refers to, in the folder `NAME`.

    `has_houdini_clips`: write clips as Houdini's text clips. Settings that these cannot store are written to `NAME.json`."""
    unit = next((word for word, mm in UNIT_MM.items() if mm == body.unit), f"{body.unit:.15g} mm")
    if parse_unit_mm(unit) != body.unit:
        unit, body = "mm", convert_definition_axes(body, body.front, body.up, 1.0)
    files: dict[str, bytes] = {}

    def add_part_file(path: str, text: str, ending: str = "json") -> dict[str, Any]:
        own = path
        count = 2
        while f"{name}/{own}.{ending}" in files:
            own, count = f"{path}_{count}", count + 1
        files[f"{name}/{own}.{ending}"] = text.encode()
        return {"file": f"{name}/{own}.{ending}"}

    def add_houdini_clip(clip: Clip) -> dict[str, Any]:
        channels = {channel: shorten_samples(column) for channel, column in collect_clip_channels(clip).items()}
        reference = add_part_file(f"clips/{_to_file_name(clip.name)}", write_clip_text(channels, clip.rate), "clip")
        settings = {"loop": clip.loop, "stride": clip.stride, "marks": dict(clip.marks), "feet": clip.feet}
        return {**reference, "name": clip.name, **settings}

    document: dict[str, Any] = {
        "antdsl_body": 1, "name": body.name, "front": format_axis(body.front), "up": format_axis(body.up), "units": unit,
        "length": body.length, "rig": add_part_file("rig", write_rig(body.rig)),
    }  # fmt: skip
    if body.materials:
        document["materials"] = {material: list(colour) for material, colour in body.materials.items()}
    if body.shapes:
        files[f"{name}/{SHAPES_FILE_NAME}"] = _build_shapes_gltf(body)
        document["shapes"] = [_build_shape_reference(body, shape, f"{name}/{SHAPES_FILE_NAME}") for shape in body.shapes.values()]
    clips = [_add_explicit_shear(body, each) for each in body.clips.values()]
    for key, texts in (
        ("layers", [(each.name, write_layer(each)) for each in body.layers.values()]),
        ("clips", [(each.name, write_clip(each)) for each in clips if not has_houdini_clips]),
        ("groups", [(each.name, write_group(each)) for each in body.groups.values()]),
    ):
        if texts:
            document[key] = [add_part_file(f"{key}/{_to_file_name(each)}", text) for each, text in texts]
    if clips and has_houdini_clips:
        document["clips"] = [add_houdini_clip(each) for each in clips]
    if body.legs:
        document["legs"] = [leg.to_entry() for leg in body.legs]
    if body.gaits:
        document["gaits"] = [asdict(gait) for gait in body.gaits]
    if body.capsule is not None:
        document["capsule"] = dict(zip(CAPSULE_KEYS, body.capsule, strict=True))
    if body.idle:
        document["idle"] = body.idle
    if body.variation:
        document["variation"] = {"scale": dict(body.variation.scales), "materials": dict(body.variation.materials)}
    if body.metadata:
        document["metadata"] = add_part_file("metadata", write_metadata(body.metadata))
    return {f"{name}.json": format_json(document).encode()} | files


def _build_shapes_gltf(body: Definition) -> bytes:
    """Return the bytes of a glTF file with one mesh for each shape, in the units and axes of the definition.

    Shapes that follow joints have a skin."""
    writer = GltfWriter(f"antdsl {__version__}")
    materials = {}
    for name in {m: None for shape in body.shapes.values() for m in shape.materials if m and not _has_lone_material(body, shape)}:
        colour = body.materials.get(name, (1.0, 1.0, 1.0))
        materials[name] = writer.add_part(
            "materials", {"name": name, "pbrMetallicRoughness": {"baseColorFactor": [*colour, 1.0]}}
        )
    nodes = {name: writer.add_part("nodes", {"name": name}) for name in body.rig.names}
    roots = []
    for number, name in enumerate(body.rig.names):
        above = int(body.rig.parents[number])
        if above < 0:
            roots.append(nodes[name])
        else:
            writer.get_part("nodes", nodes[body.rig.names[above]]).setdefault("children", []).append(nodes[name])
    for shape in body.shapes.values():
        plain = SkinShape(
            shape.name, shape.points, shape.faces, shape.normals, shape.uvs, shape.materials, shape.material,
            {key: values for key, values in shape.attributes.items() if np.ndim(values) == 1 or key == COLOUR_ATTRIBUTE},
            shape.capture,
        )  # fmt: skip
        parts = GltfShapeWriter(writer, body, plain, shape.normals)
        entry: dict[str, Any] = {"name": shape.name, "mesh": parts.add_mesh(shape.name, materials)}
        if shape.capture is not None:
            entry["skin"] = parts.add_skin(nodes, roots[0])
        roots.append(writer.add_part("nodes", entry))
    return writer.to_bytes(False, scene=0, scenes=[{"nodes": roots}])


def _build_shape_reference(body: Definition, shape: SkinShape, path: str) -> dict[str, Any]:
    """Return the entry of a definition file that refers to a shape, including its blend-shape attributes."""
    reference: dict[str, Any] = {"file": path, "shape": shape.name}
    if _has_lone_material(body, shape):
        reference["material"] = shape.materials[0]
    if shape.blend is not None:
        blend = shape.blend
        reference |= {
            "blendshape_shapenames": list(blend.shapes), "blendshape_channels": list(blend.channels),
            "blendshape_attribs": " ".join(blend.attributes), "blendshape_ptidattr": blend.point_id,
            "blendshape_primidattr": blend.primitive_id,
        }  # fmt: skip
    if shape.in_betweens is not None:
        reference |= {
            "blendshape_shapenames": list(shape.in_betweens.shapes),
            "blendshape_inbetweenweights": list(shape.in_betweens.weights),
        }  # fmt: skip
    if shape.dual_quaternion_blend:
        reference["deformDualQuaternionBlendAttrib"] = shape.dual_quaternion_blend
    return reference


def _has_lone_material(body: Definition, shape: SkinShape) -> bool:
    """Return whether a shape has exactly one material and this material has no colour.

    In a glTF file, such a material would get a colour. Therefore the reference to the shape names the material instead."""
    return len(shape.materials) == 1 and shape.materials[0] not in body.materials


def _add_explicit_shear(body: Definition, clip: Clip) -> Clip:
    """Return the clip. If the rest pose has shear and the clip has none, add explicit shear to the clip. Otherwise a reader
    would use the shear of the rest pose."""
    if clip.shear is not None or np.abs(decompose_matrix(body.rig.rest_matrices)[3]).max(initial=0.0) < 1e-9:
        return clip
    return replace(clip, shear=np.zeros_like(clip.translation))


def _to_file_name(name: str) -> str:
    """Return a name with only characters that are safe in file names."""
    return re.sub(r"[^A-Za-z0-9_-]", "_", name)[:60] or "part"


# ---- glTF


def write_gltf(body: Definition, layer: Layer, *, text: bool) -> tuple[bytes, list[str]]:
    """Return a glTF file with the shapes of one layer, as bytes. Also return sentences about the parts that glTF cannot store.

    `text`: whether to write the text form .gltf instead of .glb."""
    placed = convert_definition_axes(body, WRITTEN_FRONT_AXIS, WRITTEN_UP_AXIS, MM_PER_METRE)
    document = _GltfParts(placed, layer)
    data = document.writer.to_bytes(text, scene=0, scenes=[{"nodes": document.roots}], extras=build_body_extras(placed))
    return data, [*document.omissions, *_list_omissions(body, layer)]


def _list_omissions(body: Definition, layer: Layer) -> list[str]:
    """Return sentences about the parts of a definition that glTF cannot store."""
    drawn = {binding.shape for binding in (*layer.static, *layer.deforming)}
    inputs = {s for shape in body.shapes.values() for s in (shape.blend.shapes if shape.blend else ())}
    others = [name for name in body.shapes if name not in drawn | inputs]
    notes = [f"the layer `{name}` is left out: glTF stores only one layer" for name in body.layers if name != layer.name]
    notes += [f"the shape `{name}` is left out: no exported layer uses it" for name in others[:4]]
    if body.groups:
        notes.append("transform groups are left out: glTF cannot store groups")
    if body.metadata:
        notes.append("the metadata of the body is left out")
    if any("dualquat" in binding.deformer for binding in layer.deforming):
        notes.append("dual quaternion skinning becomes linear: glTF has only linear skinning")
    if any(shape.in_betweens for shape in body.shapes.values()):
        notes.append("in-betweens become separate morph targets, with their weight at each sample")
    return notes


class _GltfParts:
    """Writer of a body to a glTF file. Its parts are created in the order of their dependencies."""

    def __init__(self, body: Definition, layer: Layer) -> None:
        self.body, self.writer, self.omissions = body, GltfWriter(f"antdsl {__version__}"), list[str]()
        self.nodes: dict[str, int] = {}
        self.roots: list[int] = []
        self._morph_shapes: list[tuple[int, GltfShapeWriter]] = []
        self._add_joints()
        self._materials = {name: self._add_material(name, colour) for name, colour in body.materials.items()}
        self._shape_parts: dict[str, GltfShapeWriter] = {}
        for binding in (*layer.static, *layer.deforming):
            self._add_binding(binding)
        for clip in body.clips.values():
            self._add_clip(clip)

    def _add_joints(self) -> None:
        """Add one node per joint, with its rest pose."""
        rig = self.body.rig
        moved = {joint for clip in self.body.clips.values() for joint in clip.joints}
        parts = decompose_matrix(rig.rest_matrices)
        again = compose_matrix(parts[0], parts[1], parts[2])
        for number, name in enumerate(rig.names):
            entry: JsonEntry = {"name": name}
            if np.abs(again[number] - rig.rest_matrices[number]).max() > 1e-6 and name not in moved:
                entry["matrix"] = rig.rest_matrices[number].T.ravel().tolist()
            else:
                for (path, still), part in zip(_IDENTITY_TRANSFORM.items(), parts, strict=False):
                    if np.abs(part[number] - np.array(still)).max() > 1e-12:
                        entry[path] = part[number].tolist()
            self.nodes[name] = self.writer.add_part("nodes", entry)
            if rig.parents[number] < 0:
                self.roots.append(self.nodes[name])
            else:
                above = self.writer.get_part("nodes", self.nodes[rig.names[rig.parents[number]]])
                above.setdefault("children", []).append(self.nodes[name])

    def _add_material(self, name: str, colour: tuple[float, float, float]) -> int:
        """Add a material with a base colour and return its number."""
        pbr = {"baseColorFactor": [*colour, 1.0], "metallicFactor": 0.0, "roughnessFactor": 0.55}
        return self.writer.add_part("materials", {"name": name, "pbrMetallicRoughness": pbr})

    def _add_binding(self, binding: Binding) -> None:
        """Add the shape of a binding as a mesh. A skinned mesh becomes a node next to the joints.

        Any other mesh is attached to its joint's node. If this node already has a mesh, it is attached to a new child node."""
        shape = self.body.shapes[binding.shape]
        if binding.shape not in self._shape_parts:
            self._shape_parts[binding.shape] = GltfShapeWriter(self.writer, self.body, shape, shape.normals)
            for name in shape.materials:
                if name and name not in self._materials:
                    self._materials[name] = self._add_material(name, _DEFAULT_COLOUR)
        parts = self._shape_parts[binding.shape]
        mesh = parts.add_mesh(shape.name, self._materials)
        if "skinning" in binding.deformer and shape.capture is not None:
            node = self.writer.add_part(
                "nodes", {"name": shape.name, "mesh": mesh, "skin": parts.add_skin(self.nodes, self.roots[0])}
            )
            self.roots.append(node)
        else:
            node = self.nodes.get(binding.transform, self.roots[0])
            if "mesh" in self.writer.get_part("nodes", node):
                below = self.writer.add_part("nodes", {"name": f"{binding.transform}.{shape.name}"})
                self.writer.get_part("nodes", node).setdefault("children", []).append(below)
                node = below
            self.writer.get_part("nodes", node)["mesh"] = mesh
        if parts.targets is not None:
            rest = parts.targets.compute_weights(self.body.rig.channel_defaults[None])[0].tolist()
            self.writer.get_part("meshes", mesh)["weights"] = rest
            self._morph_shapes.append((node, parts))

    def _add_clip(self, clip: Clip) -> None:
        """Add a clip as an animation, with channels for its joints and for morph weights."""
        times = self.writer.add_accessor(np.arange(clip.sample_count) / clip.rate, bounds=True)
        samplers: list[JsonEntry] = []
        channels: list[JsonEntry] = []

        def add_sampler(node: int, path: str, values: NDArray[np.float32]) -> None:
            channels.append({"sampler": len(samplers), "target": {"node": node, "path": path}})
            samplers.append({"input": times, "output": self.writer.add_accessor(values), "interpolation": "LINEAR"})

        for number, joint in enumerate(clip.joints):
            if joint in self.nodes:
                for path, part in (("translation", clip.translation), ("rotation", clip.rotation), ("scale", clip.scale)):
                    add_sampler(self.nodes[joint], path, part[:, number])
        if clip.shear is not None and np.abs(clip.shear).max() > 1e-6:
            self.omissions.append(f"the shear of the clip `{clip.name}` is left out: glTF cannot store shear")
        values = np.tile(self.body.rig.channel_defaults, (clip.sample_count, 1))
        known = [each.name for each in self.body.rig.channels]
        for number, channel in enumerate(clip.channels):
            if channel in known:
                values[:, known.index(channel)] = clip.values[:, number]
        used = {channel for shape in self.body.shapes.values() if shape.blend for channel in shape.blend.channels}
        if set(clip.channels) - used:
            self.omissions.append(f"channels of the clip `{clip.name}` that drive no morph target are left out")
        for node, parts in self._morph_shapes:
            assert parts.targets is not None and parts.shape.blend is not None
            if set(parts.shape.blend.channels) & set(clip.channels):
                add_sampler(node, "weights", parts.targets.compute_weights(values).reshape(-1))
        if channels:
            self.writer.add_part(
                "animations",
                {"name": clip.name, "samplers": samplers, "channels": channels, "extras": build_settings_extras(clip)},
            )
