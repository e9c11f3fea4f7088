"""An agent definition as our own files. A definition file names rig, layers, groups, clips and metadata in their documented forms
beside it; one glTF file has the geometry of all shapes."""

from __future__ import annotations

import re
from dataclasses import asdict, replace
from typing import Any

import numpy as np

from antdsl import __version__
from antdsl.bodies.agents.definition import Clip, Definition, Shape
from antdsl.bodies.agents.other_axes import convert_axes
from antdsl.bodies.agents.transforms import parts_of
from antdsl.bodies.files.clip_document import write_clip
from antdsl.bodies.files.document_model import axis_word, unit_mm
from antdsl.bodies.files.documents import json_text, write_group, write_layer, write_metadata, write_rig
from antdsl.bodies.files.gltf_writer import GltfWriter, ShapeParts
from antdsl.scene.model import UNIT_MM

SHAPES = "shapes.glb"


def definition_files(body: Definition, name: str) -> dict[str, bytes]:
    """The files of a definition by their paths: `NAME.json`, and the parts that it names in the folder `NAME`."""
    unit = next((word for word, mm in UNIT_MM.items() if mm == body.unit), f"{body.unit:.15g} mm")
    if unit_mm(unit) != body.unit:
        unit, body = "mm", convert_axes(body, body.front, body.up, 1.0)
    files: dict[str, bytes] = {}

    def part(path: str, text: str) -> dict[str, str]:
        own = path
        count = 2
        while f"{name}/{own}.json" in files:
            own, count = f"{path}_{count}", count + 1
        files[f"{name}/{own}.json"] = text.encode()
        return {"file": f"{name}/{own}.json"}

    document: dict[str, Any] = {
        "antdsl_body": 1, "name": body.name, "front": axis_word(body.front), "up": axis_word(body.up), "units": unit,
        "length": body.length, "rig": part("rig", write_rig(body.rig)),
    }  # fmt: skip
    if body.materials:
        document["materials"] = {material: list(colour) for material, colour in body.materials.items()}
    if body.shapes:
        files[f"{name}/{SHAPES}"] = _shapes_gltf(body)
        document["shapes"] = [_shape_reference(body, shape, f"{name}/{SHAPES}") for shape in body.shapes.values()]
    for key, texts in (
        ("layers", [(each.name, write_layer(each)) for each in body.layers.values()]),
        ("clips", [(each.name, write_clip(_with_shear(body, each))) for each in body.clips.values()]),
        ("groups", [(each.name, write_group(each)) for each in body.groups.values()]),
    ):
        if texts:
            document[key] = [part(f"{key}/{_file_name(each)}", text) for each, text in texts]
    if body.legs:
        document["legs"] = [asdict(leg) for leg in body.legs]
    if body.gaits:
        document["gaits"] = [asdict(gait) for gait in body.gaits]
    if body.idle:
        document["idle"] = body.idle
    if body.variation:
        document["variation"] = {"scale": dict(body.variation.scales), "materials": dict(body.variation.materials)}
    if body.metadata:
        document["metadata"] = part("metadata", write_metadata(body.metadata))
    return {f"{name}.json": json_text(document).encode()} | files


def _shapes_gltf(body: Definition) -> bytes:
    """Return a glTF file of all shapes unchanged, one mesh each; those that follow joints have a skin. Numbers are the
    definition's."""
    writer = GltfWriter(f"antdsl {__version__}")
    materials = {}
    for name in {m: None for shape in body.shapes.values() for m in shape.materials if m and not _has_lone_material(body, shape)}:
        colour = body.materials.get(name, (1.0, 1.0, 1.0))
        materials[name] = writer.add("materials", {"name": name, "pbrMetallicRoughness": {"baseColorFactor": [*colour, 1.0]}})
    nodes = {name: writer.add("nodes", {"name": name}) for name in body.rig.names}
    roots = []
    for number, name in enumerate(body.rig.names):
        above = int(body.rig.parents[number])
        if above < 0:
            roots.append(nodes[name])
        else:
            writer.entry("nodes", nodes[body.rig.names[above]]).setdefault("children", []).append(nodes[name])
    for shape in body.shapes.values():
        plain = Shape(
            shape.name, shape.points, shape.faces, shape.normals, shape.uvs, shape.materials, shape.material,
            {key: values for key, values in shape.attributes.items() if np.ndim(values) == 1}, shape.capture,
        )  # fmt: skip
        parts = ShapeParts(writer, body, plain, shape.normals)
        entry: dict[str, Any] = {"name": shape.name, "mesh": parts.mesh(shape.name, materials)}
        if shape.capture is not None:
            entry["skin"] = parts.add_skin(nodes, roots[0])
        roots.append(writer.add("nodes", entry))
    return writer.bytes(False, scene=0, scenes=[{"nodes": roots}])


def _shape_reference(body: Definition, shape: Shape, path: str) -> dict[str, Any]:
    """Return a definition's reference to a shape, with the documented attributes of blend shapes."""
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
    if shape.between is not None:
        reference |= {
            "blendshape_shapenames": list(shape.between.shapes), "blendshape_inbetweenweights": list(shape.between.weights),
        }  # fmt: skip
    if shape.dual_quaternion_blend:
        reference["deformDualQuaternionBlendAttrib"] = shape.dual_quaternion_blend
    return reference


def _has_lone_material(body: Definition, shape: Shape) -> bool:
    """Return whether a shape has exactly one material and that has no colour, such as `state`. glTF would give it a colour, so
    the reference names the material."""
    return len(shape.materials) == 1 and shape.materials[0] not in body.materials


def _with_shear(body: Definition, clip: Clip) -> Clip:
    """Return a clip with explicit shear where the rest pose has some: a clip text without shear takes it from the rest pose."""
    if clip.shear is not None or np.abs(parts_of(body.rig.rest)[3]).max(initial=0.0) < 1e-9:
        return clip
    return replace(clip, shear=np.zeros_like(clip.translation))


def _file_name(name: str) -> str:
    """A name as a file has it."""
    return re.sub(r"[^A-Za-z0-9_-]", "_", name)[:60] or "part"
