"""Shapes of a definition's library: references to mesh files, the documented attributes of blend shapes with them, and included
libraries."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from antdsl import limits
from antdsl.bodies.agents.definition import Blend, InBetweens, Shape
from antdsl.bodies.files.checked_values import Values
from antdsl.bodies.files.json_text import Node
from antdsl.bodies.files.named_files import GLTF, MESHES, USD, BodyFiles, file_ending
from antdsl.scene.geometry.mesh_text import MeshError
from antdsl.scene.geometry.meshes import read_mesh
from antdsl.scene.model import UNIT_MM
from antdsl.scene.paths import PathRefused
from antdsl.source import Span

_BLEND = (
    "blendshape_shapenames", "blendshape_channels", "blendshape_inbetweenweights", "blendshape_attribs", "blendshape_ptidattr",
    "blendshape_primidattr", "deformDualQuaternionBlendAttrib",
)  # fmt: skip
_KNOWN = ("file", "shape", "name", "units", "material", "prim", *_BLEND)


def read_shapes(
    values: Values,
    node: Node,
    files: BodyFiles,
    unit: float,
    shapes: dict[str, Shape],
    materials: dict[str, tuple[float, float, float]],
) -> None:
    """Add the shapes of a list of references to `shapes`, and the colours of their materials. A reference without a file changes
    an existing shape. `unit`: millimetres in one of the definition's units."""
    first: dict[str, Span] = {}
    for each in values.items(node, 'references such as `{"file": "sword.obj", "name": "sword"}`'):
        entries = values.object(each, "a shape", _KNOWN)
        if entries is None:
            continue
        new_shapes = _read_reference(values, each, entries, files, shapes, materials)
        name = values.text(entries.get("name"), "the name of a shape")
        factor = _read_factor(values, entries.get("units"), unit)
        if name is not None and len(new_shapes) != 1:
            if new_shapes:
                words = f"a name is given, and the file has {len(new_shapes)} shapes"
                values.report.error("wrong-value", words, values.span(entries["name"]), f'add `"shape": "{new_shapes[0].name}"`')
            continue
        for shape in new_shapes:
            shape = scale_shape(shape, factor) if factor != 1.0 else shape
            if "file" not in entries:
                shapes.pop(shape.name, None)
            shape = replace(shape, name=name or shape.name)
            if "material" in entries and (material := values.text(entries["material"], "the name of a material")) is not None:
                shape = replace(shape, materials=(material,), material=np.zeros(len(shape.faces), np.int32))
            if any(key in entries for key in _BLEND):
                shape = _with_blend(values, each, entries, shape)
            if shape.name in shapes:
                place = entries["name"] if "name" in entries else entries.get("file", each)
                labelled = first.get(shape.name, values.start_span(node))
                values.report_repeated(place, f"there are two shapes `{shape.name}`", labelled)
                continue
            shapes[shape.name] = shape
            first[shape.name] = values.span(entries["name"]) if "name" in entries else values.start_span(each)


def _read_reference(
    values: Values, node: Node, entries: Mapping[str, Node], files: BodyFiles, shapes: Mapping[str, Shape],
    materials: dict[str, tuple[float, float, float]],
) -> list[Shape]:  # fmt: skip
    """The shapes that a reference means."""
    shape_name = values.text(entries.get("shape"), "the name of a shape in the file")
    if "file" not in entries:
        if shape_name is None:
            values.report.error("missing-key", "a shape has no `file`", values.start_span(node), 'add `"file": "sword.obj"`')
        elif shape_name not in shapes:
            values.report_unknown(values.span(entries["shape"]), "shape", shape_name, shapes)
        return [shapes[shape_name]] if shape_name is not None and shape_name in shapes else []
    path = values.text(entries["file"], "the path of a file")
    if path is None:
        return []
    new_shapes = shapes_of(files, path, values.span(entries["file"]), materials, _stem(values, entries, path))
    if shape_name is None or not new_shapes:
        return list(new_shapes.values())
    if shape_name not in new_shapes:
        values.report_unknown(values.span(entries["shape"]), f"shape in `{path[-60:]}`", shape_name, new_shapes)
        return []
    return [new_shapes[shape_name]]


def _stem(values: Values, entries: Mapping[str, Node], path: str) -> str:
    name = entries.get("name")
    if name is not None and isinstance(name.value, str) and name.value:
        return name.value
    return path.rpartition("/")[2].rpartition(":")[2].rpartition(".")[0] or "shape"


def shapes_of(
    files: BodyFiles, path: str, place: Span, materials: dict[str, tuple[float, float, float]], name: str
) -> dict[str, Shape]:
    """Return the shapes of a file by name: all of a glTF or USD file; one called `name` of a mesh file."""
    kind = file_ending(path)
    if files.is_closed_format(path, place):
        return {}
    if kind in GLTF or kind in USD:
        body = files.body(path, place)
        if body is None:
            return {}
        for material, colour in body.materials.items():
            materials.setdefault(material, colour)
        return dict(body.shapes)
    if kind not in MESHES:
        kinds = ", ".join(f".{each}" for each in (*GLTF, *USD, *MESHES))
        files.report.error("wrong-kind", f"`{path[-80:]}` is not a file of shapes", place, f"one of {kinds} is read")
        return {}
    try:
        mesh = read_mesh(files.bytes_of(files.full(path), limits.MESH_BYTES), path)
    except PathRefused as why:
        files.report_refusal(why, place)
        return {}
    except MeshError as why:
        files.report.error("bad-mesh", f"the mesh `{path[-80:]}` {why}", place, why.help)
        return {}
    if len(mesh.vertices) > limits.BODY_POINTS:
        words = f"`{path[-80:]}` has more than {limits.BODY_POINTS:,} points"
        files.report.error("too-large", words, place, "use a lighter mesh")
        return {}
    ids = {"id": mesh.own_vertices.astype(np.int64)}
    return {name: Shape(name, mesh.vertices.astype(np.float32), mesh.faces.astype(np.int32), attributes=dict(ids))}


def read_includes(
    values: Values, node: Node, files: BodyFiles, shapes: dict[str, Shape], materials: dict[str, tuple[float, float, float]]
) -> None:
    """Add the shapes of included libraries, each named by a condensed and an absolute path."""
    for pair in values.items(node, "pairs of a condensed and an absolute path"):
        texts = [values.text(each, "a path", empty=True) for each in values.items(pair, "paths")]
        if len(texts) != 2 or None in texts:
            if None not in texts:
                words = f"a library needs two paths, but this list has {len(texts)}"
                values.report.error("wrong-value", words, values.span(pair), 'write `["$HIP/lib.glb", "/…/lib.glb"]`')
            continue
        condensed, absolute = str(texts[0]), str(texts[1])
        if files.is_closed_format(condensed or absolute, values.span(pair)):
            continue
        try:
            path = files.resolve_library(condensed, absolute)
        except PathRefused as why:
            files.report_refusal(why, values.span(pair))
            continue
        for name, shape in shapes_of(files, path, values.span(pair), materials, _stem(values, {}, path)).items():
            if name in shapes:
                values.report.error("duplicate-name", f"there are two shapes `{name}`", values.span(pair), None)
            else:
                shapes[name] = shape


def _read_factor(values: Values, node: Node | None, unit: float) -> float:
    if node is None:
        return 1.0
    if not isinstance(node.value, str) or node.value not in UNIT_MM:
        values.report.error("wrong-value", "expected a unit of length here", values.span(node), 'write `"mm"`')
        return 1.0
    return UNIT_MM[node.value] / unit


def scale_shape(shape: Shape, factor: float) -> Shape:
    """Return a shape in other units: its points, and the joint positions at capture."""
    capture = shape.capture
    if capture is not None:
        inverse = capture.inverse.copy()
        inverse[:, :3, 3] *= factor
        capture = replace(capture, inverse=inverse)
    return replace(shape, points=(shape.points * np.float32(factor)).astype(np.float32), capture=capture)


def _with_blend(values: Values, node: Node, entries: Mapping[str, Node], shape: Shape) -> Shape:
    """Return a shape with the documented blend attributes: of a base shape (names and channels), or of an input with in-between
    shapes (names and weights)."""
    if "deformDualQuaternionBlendAttrib" in entries:
        name = values.text(entries["deformDualQuaternionBlendAttrib"], "the name of an attribute", empty=True)
        shape = replace(shape, dual_quaternion_blend=name or "")
    if not any(key in entries for key in _BLEND[:-1]):
        return shape
    names = _texts(values, entries.get("blendshape_shapenames"), "names of shapes")
    if "blendshape_shapenames" not in entries:
        words = "a blend shape does not say which shapes it blends"
        values.report.error("missing-key", words, values.start_span(node), 'add `"blendshape_shapenames": ["…"]`')
        return shape
    if "blendshape_inbetweenweights" in entries:
        weights = values.numbers(entries["blendshape_inbetweenweights"], "weights of in-between shapes", len(names))
        if weights is None:
            return shape
        for number in np.flatnonzero((weights == 0) | (weights == 1)):
            words = f"the in-between shape `{names[number]}` has the weight {weights[number]:g}, "
            words += "which is reserved for complete shapes"
            values.report.error("out-of-range", words, values.span(entries["blendshape_inbetweenweights"]), "write `0.5`")
        return replace(shape, between=InBetweens(names, tuple(map(float, weights))))
    channels = _texts(values, entries.get("blendshape_channels"), "names of channels")
    if len(channels) != len(names):
        words = f"there are {len(names)} shapes to blend, but {len(channels)} channels"
        place = values.span(entries.get("blendshape_channels", entries["blendshape_shapenames"]))
        values.report.error("wrong-value", words, place, "name a channel for each shape")
        return shape
    attributes = values.text(entries.get("blendshape_attribs"), "names of attributes") or "P N"
    point, primitive = (
        values.text(entries.get(key), "the name of an attribute") or "id"
        for key in ("blendshape_ptidattr", "blendshape_primidattr")
    )
    return replace(shape, blend=Blend(names, channels, tuple(attributes.split()), point, primitive))


def _texts(values: Values, node: Node | None, what: str) -> tuple[str, ...]:
    texts = [values.text(each, f"one of the {what}") for each in values.items(node, what)] if node is not None else []
    return tuple(each for each in texts if each is not None)
