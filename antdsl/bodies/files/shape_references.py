"""Reads the shapes that a definition refers to: in mesh files, and in included shape libraries.

A reference may also set the blend-shape attributes of Houdini's documentation."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from antdsl import limits
from antdsl.bodies.agents.definition import BlendTargets, InBetweens, SkinShape
from antdsl.bodies.files.document_model import BodyForm, ShapeReference
from antdsl.bodies.files.json_text import JsonNode, find_node, find_span, report_unknown_name
from antdsl.bodies.files.named_files import GLTF_ENDINGS, HOUDINI_ENDINGS, MESH_ENDINGS, USD_ENDINGS, BodyFiles, get_file_ending
from antdsl.diagnostics import Label
from antdsl.scene.geometry.mesh_files import RawMesh, read_mesh, read_named_meshes
from antdsl.scene.geometry.mesh_text import MeshError
from antdsl.scene.paths import PathRefused
from antdsl.source import Span

Colours = dict[str, tuple[float, float, float]]


def read_shapes(
    form: BodyForm, root: JsonNode, files: BodyFiles, unit: float, shapes: dict[str, SkinShape], materials: Colours
) -> None:
    """Load the shapes that a definition names into `shapes`, and the colours of their materials into `materials`.

    A reference without a file changes an existing shape. `unit`: millimetres per unit of the definition."""
    first: dict[str, Span] = {}
    for number, reference in enumerate(form.shapes):
        node = find_node(root, ("shapes", number))
        new_shapes = _resolve_shape_reference(reference, node, files, shapes, materials)
        if reference.name is not None and len(new_shapes) != 1:
            if new_shapes:
                words = f"`name` can name only one shape, but the file has {len(new_shapes)} shapes"
                help = f'add `"shape": "{new_shapes[0].name}"`'
                files.report.error("wrong-value", words, find_span(node, ("name",)), help)
            continue
        for shape in new_shapes:
            if reference.units is not None and reference.units != unit:
                shape = scale_shape(shape, reference.units / unit)
            if reference.file is None:
                shapes.pop(shape.name, None)
            shape = replace(shape, name=reference.name or shape.name)
            if reference.material is not None:
                shape = replace(shape, materials=(reference.material,), material=np.zeros(len(shape.faces), np.int32))
            shape = _add_blend_attributes(reference, node, files, shape)
            if shape.name in shapes:
                words, label = f"there are two shapes `{shape.name}`", first.get(shape.name, find_span(root, ("shapes",)))
                place = find_span(node, ("name" if reference.name else "file",))
                files.report.error("duplicate-name", words, place, "keep one of them", labels=(Label(label, "here first"),))
                continue
            shapes[shape.name] = shape
            first[shape.name] = find_span(node, ("name",))


def _resolve_shape_reference(
    reference: ShapeReference, node: JsonNode, files: BodyFiles, shapes: Mapping[str, SkinShape], materials: Colours
) -> list[SkinShape]:
    """Return the shapes that a reference selects, from its file or, if it names no file, from `shapes`. Report shapes that do
    not exist."""
    if reference.file is None:
        if reference.shape is None:
            words = f"{f'the shape `{reference.name[:60]}`' if reference.name else 'a shape'} has neither `file` nor `shape`"
            help = 'add `"file": "sword.obj"`, or `"shape": "body"` for a shape of the file under `from`'
            files.report.error("missing-key", words, node.marked_span, help)
            return []
        what, known = "shape", shapes
    else:
        place, name = find_span(node, ("file",)), reference.name or _get_file_stem(reference.file)
        what, known = (
            f"shape in `{reference.file[-60:]}`",
            load_shapes(files, reference.file, place, materials, name, reference.prim),
        )
        if reference.shape is None or not known:
            return list(known.values())
    if reference.shape not in known:
        report_unknown_name(files.report, find_span(node, ("shape",)), what, reference.shape, known)
        return []
    return [known[reference.shape]]


def _get_file_stem(path: str) -> str:
    """Return the name of a file without folder, root and ending, or `shape` if nothing remains."""
    return path.rpartition("/")[2].rpartition(":")[2].rpartition(".")[0] or "shape"


def load_shapes(
    files: BodyFiles, path: str, place: Span, materials: Colours, name: str, prim: str | None = None
) -> Mapping[str, SkinShape]:
    """Return the shapes of a file by name.

    For glTF, the result has all shapes; for USD, the shapes at and below `prim`. A .geo or .bgeo file gives one shape for each
    value of the primitive attribute `name`. Without this attribute, and for other mesh files, there is one shape, called `name`.
    """
    kind = get_file_ending(path)
    if files.is_closed_format(path, place):
        return {}
    if kind in GLTF_ENDINGS or kind in USD_ENDINGS:
        body = files.read_body(path, place, prim or "")
        if body is None:
            return {}
        for material, colour in body.materials.items():
            materials.setdefault(material, colour)
        return dict(body.shapes)
    if kind not in MESH_ENDINGS:
        kinds = ", ".join(f".{each}" for each in (*GLTF_ENDINGS, *USD_ENDINGS, *MESH_ENDINGS))
        files.report.error(
            "wrong-kind", f"`{path[-80:]}` is not a file of shapes", place, f"use a file of one of these types: {kinds}"
        )
        return {}
    try:
        data = files.read_file(files.to_root_path(path), limits.MAX_MESH_BYTES)
        meshes = read_named_meshes(data, path) or {name: read_mesh(data, path)}
    except PathRefused as error:
        files.report_refusal(error, place)
        return {}
    except MeshError as error:
        files.report.error("bad-mesh", f"the mesh `{path[-80:]}` {error}", place, error.help)
        return {}
    if sum(len(mesh.vertices) for mesh in meshes.values()) > limits.MAX_BODY_POINTS:
        words = f"`{path[-80:]}` has more than {limits.MAX_BODY_POINTS:,} points"
        files.report.error("too-large", words, place, "use a mesh with fewer points")
        return {}
    if kind in HOUDINI_ENDINGS:
        for sentence in dict.fromkeys(each for mesh in meshes.values() for each in mesh.notes.describe_skipped()):
            files.report.warning("body-left-out", f"of `{files.display_path(path)}`: {sentence}", place)
    return {name: _make_shape(name, mesh) for name, mesh in meshes.items()}


def _make_shape(name: str, mesh: RawMesh) -> SkinShape:
    """Return the mesh of a file as a shape. The shape's point attribute `id` contains the index of each point in the file."""
    ids = {"id": mesh.file_vertex_indices.astype(np.int64)}
    return SkinShape(name, mesh.vertices.astype(np.float32), mesh.faces.astype(np.int32), attributes=dict(ids))


def read_includes(form: BodyForm, root: JsonNode, files: BodyFiles, shapes: dict[str, SkinShape], materials: Colours) -> None:
    """Add the shapes of included libraries to `shapes`, and the colours of their materials to `materials`.

    The document names each library by two paths: a condensed path with variables such as `$HIP`, and an absolute path."""
    for number, (condensed, absolute) in enumerate(form.shapelib_includes):
        place = find_node(root, ("shapelib_includes", number)).span
        if files.is_closed_format(condensed or absolute, place):
            continue
        try:
            path = files.resolve_library(condensed, absolute)
        except PathRefused as error:
            files.report_refusal(error, place)
            continue
        for name, shape in load_shapes(files, path, place, materials, _get_file_stem(path)).items():
            if name in shapes:
                files.report.error("duplicate-name", f"there are two shapes `{name}`", place, None)
            else:
                shapes[name] = shape


def scale_shape(shape: SkinShape, factor: float) -> SkinShape:
    """Return a shape converted to other units: its points and inverse bind matrices are scaled by `factor`."""
    capture = shape.capture
    if capture is not None:
        inverse = capture.inverse_matrices.copy()
        inverse[:, :3, 3] *= factor
        capture = replace(capture, inverse_matrices=inverse)
    return replace(shape, points=(shape.points * np.float32(factor)).astype(np.float32), capture=capture)


def _add_blend_attributes(reference: ShapeReference, node: JsonNode, files: BodyFiles, shape: SkinShape) -> SkinShape:
    """Return a shape with the blend-shape attributes of its reference. Report mistakes.

    If the shape is a base shape, the reference has the names and channels of its inputs. If the shape is an input, the reference
    has the names and weights of its in-betweens."""
    keys = {key for key in reference.model_fields_set if key.startswith("blendshape_")}
    if "deformDualQuaternionBlendAttrib" in reference.model_fields_set:
        shape = replace(shape, dual_quaternion_blend=reference.deformDualQuaternionBlendAttrib)
    if not keys:
        return shape
    names, channels, weights = (
        reference.blendshape_shapenames, reference.blendshape_channels, reference.blendshape_inbetweenweights,
    )  # fmt: skip
    if "blendshape_shapenames" not in keys:
        words = f"the shape `{shape.name}` has no list of the shapes that it blends"
        files.report.error("missing-key", words, node.marked_span, 'add `"blendshape_shapenames": ["…"]`')
        return shape
    if "blendshape_inbetweenweights" in keys:
        place = find_node(node, ("blendshape_inbetweenweights",)).span
        if len(weights) != len(names):
            words = f"there are {len(names)} in-between shapes, but {len(weights)} weights"
            files.report.error("wrong-value", words, place, "write one weight for each shape")
            return shape
        for name, weight in zip(names, weights, strict=True):
            if weight in (0, 1):
                words = f"the in-between shape `{name}` has the weight {weight:g}, which is reserved for complete shapes"
                files.report.error("out-of-range", words, place, "write `0.5`")
        return replace(shape, in_betweens=InBetweens(names, weights))
    if len(channels) != len(names):
        words = f"there are {len(names)} shapes to blend, but {len(channels)} channels"
        place = find_node(node, ("blendshape_channels" if "blendshape_channels" in keys else "blendshape_shapenames",)).span
        files.report.error("wrong-value", words, place, "write one channel for each shape")
        return shape
    attributes = tuple(reference.blendshape_attribs.split())
    blend = BlendTargets(names, channels, attributes, reference.blendshape_ptidattr, reference.blendshape_primidattr)
    return replace(shape, blend=blend)
