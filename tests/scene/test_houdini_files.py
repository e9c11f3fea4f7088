"""Geometry of Houdini: polygons, runs, soups, packed geometry and pages, as text and as binary JSON, and what is left out."""

from __future__ import annotations

from typing import Any

import houdini_files
import numpy as np
import pytest
from houdini_files import CUBE_FACES, CUBE_POINTS, attribute, cube, geometry, library, to_binary, to_text

from antdsl.scene.geometry.mesh_files import MeshError, RawMesh, read_mesh, read_named_meshes

FORMS = [
    pytest.param(lambda value: (to_text(value), "a.geo"), id="text"),
    pytest.param(lambda value: (to_binary(value), "a.bgeo"), id="little"),
    pytest.param(lambda value: (to_binary(value, ">"), "a.bgeo"), id="big"),
]


def volume(mesh: RawMesh) -> float:
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    return float((a * np.cross(b, c)).sum() / 6)


@pytest.mark.parametrize("form", FORMS)
def test_a_cube_has_its_points_and_faces_outside(form: Any) -> None:
    mesh = read_mesh(*form(cube()))
    assert np.allclose(mesh.vertices, CUBE_POINTS) and len(mesh.faces) == 12
    assert volume(mesh) == pytest.approx(1.0)


def test_older_runs_single_polygons_and_soups_are_the_same_cube() -> None:
    corners = [corner for face in CUBE_FACES for corner in face]
    faces = np.arange(24).reshape(6, 4).tolist()
    run = [
        ["type", "run", "runtype", "Poly", "varyingfields", ["vertex"], "uniformfields", {"closed": True}],
        [[f] for f in faces],
    ]
    polygons = [[["type", "Poly"], ["vertex", face, "closed", True]] for face in faces]
    curve = [["type", "Poly"], ["vertex", [0, 1, 2], "closed", False]]
    soup = [["type", "PolySoup"], ["vertex", list(range(24)), "polyinfo", [[4], [6], list(range(24))]]]
    plain = [["type", "Polygon_run"], ["startvertex", 0, "nprimitives", 6, "nvertices", [4] * 6]]
    expected = read_mesh(to_text(cube()), "a.geo")
    for primitives in ([run], [*polygons, curve], [soup], [plain]):
        for mesh in (
            read_mesh(to_text(geometry(CUBE_POINTS, corners, primitives, count=7)), "a.geo"),
            read_mesh(to_binary(geometry(CUBE_POINTS, corners, primitives, count=7)), "a.bgeo"),
        ):
            assert np.array_equal(mesh.faces, expected.faces) and np.allclose(mesh.vertices, expected.vertices)


def test_pages_with_constant_and_separate_parts_are_unpacked() -> None:
    points = np.array(CUBE_POINTS)
    raw = [*points[:4, :2].ravel().tolist(), -0.5, *points[4:, :2].ravel().tolist(), *points[4:, 2].tolist()]
    points[:4, 2] = -0.5
    pages = attribute("P", [], 3, pagesize=4, packing=[2, 1], constantpageflags=[[False, False], [True, False]], rawpagedata=raw)
    value = cube(point_attributes=[pages])
    for data, name in ((to_text(value), "a.geo"), (to_binary(value), "a.bgeo")):
        mesh = read_mesh(data, name)
        assert np.allclose(mesh.vertices, points[mesh.file_vertex_indices])


@pytest.mark.parametrize("form", FORMS)
def test_packed_geometry_is_at_its_point_and_has_its_name(form: Any) -> None:
    data, name = form(library())
    mesh = read_mesh(data, name)
    assert len(mesh.faces) == 24 and np.allclose(mesh.vertices.max(axis=0), (11, 1, 1))
    assert volume(mesh) == pytest.approx(9.0)
    (sphere,) = mesh.notes.describe_skipped()
    offset = int(sphere.split()[3].replace(",", ""))
    assert sphere.startswith("`Sphere` from byte") and data[offset:].lstrip(b'"\x06')[:6] == b"Sphere"
    assert list(read_named_meshes(data, name)) == ["head", "box"]
    assert volume(read_mesh(data, name, group="box")) == pytest.approx(8.0)
    with pytest.raises(MeshError, match="has no primitives with the name `boxes`"):
        read_mesh(data, name, group="boxes")


def test_a_fragment_is_the_named_part_of_its_geometry() -> None:
    inner = cube(primitive_attributes=[houdini_files.texts("name", ["low", "side"], [1, 1, 1, 1, 0, 1])])
    fragment = [["type", "PackedFragment"], ["parameters", {"embedded": "e", "attribute": "name", "name": "low"}, "vertex", 0]]
    outer = geometry([[0, 0, 0]], [0], [fragment], shared=["PackedFragment", ["gu:embeddedgeo", "e", inner]])
    mesh = read_mesh(to_text(outer), "a.geo")
    assert len(mesh.faces) == 2 and np.allclose(mesh.vertices[:, 1], -0.5)


SPHERE = geometry([[0, 0, 0]], [0], [[["type", "Sphere"], ["vertex", 0]]])


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (to_binary(cube())[:-40], "ends within a value at byte"),
        (b"\x7fNSJb\x5b\x99\x5d", "unknown token 0x99 at byte 6"),
        (b"\x7fNSJb\x5b\x26\x07\x5d", r"refers to a missing text \(number 7\) at byte 6"),
        (b"\x7fNSJb" + b"\x5b" * 100, "nested lists at byte"),
        (b"\x7fNSJb\x40\x19\xf8" + b"\x7f" * 8, "ends within a value at byte"),
        (to_binary(SPHERE), "has no polygons: `Sphere` from byte"),
        (to_text(SPHERE), "has no polygons: `Sphere` from byte"),
        (to_text(geometry(CUBE_POINTS, [0, 1, 9], [[["type", "Poly"], ["vertex", [0, 1, 2]]]])), "names a missing point"),
        (to_text(geometry(CUBE_POINTS, [0, 1], [[["type", "Poly"], ["vertex", [0, 1, 2]]]])), "names a missing vertex"),
        (to_text(geometry(CUBE_POINTS, [0], [[["type", "p_r"], ["s_v", 0, "n_p", 9**9, "r_v", [4, 9**9]]]])), "primitives"),
        (to_text(["fileversion", "1", "pointcount", 10**9]), "more than fit in its bytes"),
        (to_text({"pointcount": -1}), "in the place of a number"),
        (to_text([1, 2]), "has no names in the geometry"),
        (b"PGEOMETRY V5\n", r"classic form of Houdini 11 and earlier \(at byte 0\)"),
        (b"BgeoV\0\0\0\5", "classic form"),
        (b"scf1\0\0", "compressed with Blosc"),
        (b'["pointcount", }', "is not JSON at byte 15"),
    ],
)
def test_errors_state_the_byte(data: bytes, words: str) -> None:
    for name in ("a.bgeo", "a.geo"):
        with pytest.raises(MeshError, match=words):
            read_mesh(data, name)


def test_packed_geometry_within_itself_takes_little_time() -> None:
    inner: list[Any] = SPHERE
    for _ in range(9):
        packed = ["type", "run", "runtype", "PackedGeometry", "varyingfields", ["parameters"], "uniformfields", {"vertex": 0}]
        rows = [[{"embedded": "e"}]] * 12
        inner = geometry([[0, 0, 0]], [0], [[packed, rows]], shared=["PackedGeometry", ["gu:embeddedgeo", "e", inner]])
    with pytest.raises(MeshError, match="in more than 8 levels"):
        read_mesh(to_text(inner), "a.geo")
    with pytest.raises(MeshError, match="has no polygons"):
        read_mesh(to_text(inner[-1][1][2]), "a.geo")
