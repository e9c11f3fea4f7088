"""Mesh files that are odd but right, or wrong in small ways: each is read as it was meant, or says what is wrong."""

from __future__ import annotations

import json
import struct
from pathlib import Path

import numpy as np
import pytest
from commands import run
from scene.test_mesh_imports import WALKER, gltf

from antdsl.pipeline import check_path
from antdsl.scene.geometry.import_notes import ImportNotes
from antdsl.scene.geometry.mesh_files import read_mesh, read_mesh_arrays
from antdsl.scene.geometry.mesh_text import MeshError
from antdsl.scene.geometry.polygons import TooManyCornersError, triangulate_polygons

CORNERS = b"v 0 0 0\nv 0 0 9\nv 9 0 9\nv 9 0 0\n"
POINTS = np.array([(0, 0, 0), (4, 0, 0), (4, 0, 4), (0, 0, 4), (0, 0, 4)], float)


def words_of(data: bytes, name: str = "a.obj", group: str | None = None) -> tuple[int, list[str]]:
    """How many triangles a file gives, and the notes."""
    notes = ImportNotes()
    return len(read_mesh_arrays(data, name, group, notes=notes)[1]), notes.describe_skipped()


# --- polygons ----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("ring", "triangles"),
    [
        ([0, 1, 2, 2], [[0, 1, 2]]), ([0, 0, 1, 2], [[0, 1, 2]]), ([0, 1, 2, 0, 0], [[0, 1, 2]]),
        ([0, 1, 1, 2, 2, 3], [[0, 1, 2], [0, 2, 3]]), ([0, 1, 2, 3, 4], [[0, 1, 2], [0, 2, 3]]),
    ],
)  # fmt: skip
def test_repeated_corners_are_no_crossing(ring: list[int], triangles: list[list[int]]) -> None:
    indices = np.array([*ring, 0, 1, 2, 3])
    triangulation = triangulate_polygons(POINTS, np.array([len(ring), 4]), indices)
    assert indices[triangulation.corners].tolist() == [*triangles, [0, 1, 2], [0, 2, 3]]
    assert (
        not triangulation.crossing_polygons
        and not triangulation.concave_count
        and triangulation.polygon_indices.tolist() == [0] * len(triangles) + [1, 1]
    )


@pytest.mark.parametrize("ring", [[0, 0, 0, 0], [0, 1, 1, 0], [0, 1, 0, 1]])
def test_polygons_of_fewer_than_three_places_have_no_area(ring: list[int]) -> None:
    triangulation = triangulate_polygons(POINTS, np.array([4]), np.array(ring))
    assert not triangulation.crossing_polygons and len(triangulation.corners) == 2  # reported with the faces without area


def test_corners_on_a_straight_side_make_nothing_concave() -> None:
    angles = np.arange(12) * np.pi / 6
    ring = np.stack([np.cos(angles), 0 * angles, -np.sin(angles)], axis=1)[::3]
    ring = np.stack([ring, (ring + np.roll(ring, -1, axis=0)) / 2], axis=1).reshape(-1, 3)
    assert triangulate_polygons(ring, np.array([8]), np.arange(8)).concave_count == 0
    ring[1] *= 0.5
    assert triangulate_polygons(ring, np.array([8]), np.arange(8)).concave_count == 1


def test_a_disc_of_too_many_corners_is_called_a_polygon() -> None:
    angles = np.arange(25_000) * 2 * np.pi / 25_000
    disc = np.stack([np.cos(angles), 0 * angles, np.sin(angles)], axis=1)
    with pytest.raises(TooManyCornersError, match="has a polygon of 25,000 corners, more than 20,000"):
        triangulate_polygons(disc, np.array([25_000]), np.arange(25_000))


# --- text --------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("line", [b"mtllib C:\\x\\", b"usemtl a\\", b"o C:\\", b" G a\\ ", b"usemap b\\"])
def test_names_may_end_in_a_backslash(line: bytes) -> None:
    assert words_of(line + b"\n" + CORNERS + b"f 1 2 3 4\n") == (2, [])


@pytest.mark.parametrize("end", [b"\\", b"\\ ", b"\\\n", b"\\\n\n"])
def test_a_last_line_may_be_continued_by_nothing(end: bytes) -> None:
    assert words_of(CORNERS + b"f 1 2 \\\n3 4 " + end) == (2, [])


@pytest.mark.parametrize("head", [b"solid C:\\temp\\", b"# made by hand\nsolid a", b"\xef\xbb\xbf# one\r\n  # two\r\n solid a"])
def test_text_stl_has_names_and_comments(head: bytes) -> None:
    loop = b"outer loop\nvertex 0 0 0\nvertex 0 0 1\nvertex 1 0 0\nendloop\nendfacet\n"
    assert words_of(head + b"\nfacet normal 0 1 0\n" + loop + b"facet normal 0 1 0\n" + loop + b"endsolid\n", "a.stl") == (2, [])


def test_groups_may_begin_with_a_hash_and_report_their_own_lines_only() -> None:
    data = CORNERS + b"g #1 # first\nf 1 2 3\nl 1 2\ng # none\nf 1 2 3 4\no #two\nl 1 3\np 1\nf 1 3 4\n"
    assert words_of(data, group="#1") == (1, ["lines (`l`) (line 7)"])
    assert words_of(data, group="#two") == (1, ["lines (`l`) (line 11)", "points (`p`) (line 12)"])
    assert words_of(data, group="default") == (3, ["lines (`l`) (line 11)", "points (`p`) (line 12)"])


def test_a_property_twice_is_named() -> None:
    head = b"ply\nformat ascii 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float y\nproperty float z\n"
    with pytest.raises(MeshError, match="names the property `y` of `vertex` twice"):
        read_mesh_arrays(head + b"element face 1\nproperty list int int vertex_indices\nend_header\n" + b"0 0 0 0\n" * 4, "a.ply")


def test_formats_that_are_not_read_name_those_that_are() -> None:
    with pytest.raises(MeshError, match=r"\.glb") as caught:
        read_mesh_arrays(b"", "a.fbx")
    assert ".glb" in str(caught.value.help)


# --- glTF --------------------------------------------------------------------------------------------------------------


def glb_words(group: str | None = None, nodes: list[dict[str, object]] | None = None, **file: object) -> tuple[int, list[str]]:
    """Triangles and notes of the usual file; `nodes` are more words for each of its nodes."""
    tree = json.loads(gltf(**file)[0])  # type: ignore[arg-type]
    for node, properties in zip(tree["nodes"], nodes or [], strict=False):
        node |= properties
    mesh = read_mesh(json.dumps(tree).encode(), "a.gltf", group)
    return len(mesh.faces), mesh.notes.describe_skipped()


HIDDEN = {"extensions": {"KHR_node_visibility": {"visible": False}}}
VISIBLE = {"extensions": {"KHR_node_visibility": {"visible": True}}}


def test_nodes_that_are_left_out_are_noted() -> None:
    assert glb_words(scenes=[{"nodes": [1]}]) == (2, ["nodes with a mesh outside of the scene"])
    assert glb_words(nodes=[VISIBLE, HIDDEN, {}]) == (2, ["nodes with a mesh that are not visible (KHR_node_visibility)"])
    with pytest.raises(MeshError, match="no faces"):
        glb_words(nodes=[HIDDEN, HIDDEN, VISIBLE])


def test_left_over_corners_and_unknown_modes_are_noted() -> None:
    assert glb_words("right", indices=[0, 1, 2, 2, 1]) == (1, ["2 × corners of an incomplete triangle"])
    complete_primitives = [{"attributes": {"POSITION": 0}}, {"attributes": {"POSITION": 0}, "mode": 9}]
    meshes = [{"primitives": [*complete_primitives, {"attributes": {"POSITION": 0}, "mode": 0}]}]
    counts_and_notes = glb_words("right", meshes=meshes)
    assert counts_and_notes == (
        1,
        ["corners of an incomplete triangle", "primitives of the unknown mode `9`", "primitives of points"],
    )


# --- reports -----------------------------------------------------------------------------------------------------------


def test_a_scene_with_errors_has_its_import_report(tmp_path: Path) -> None:
    (tmp_path / "walker.ant").write_text(WALKER.replace("surface", "solid"))
    (tmp_path / "open.obj").write_bytes(CORNERS + b"v 0 123456.789 0\nf 1 2 3 4\nf 1 2 5\n")
    crowd = "crowd: [{species: walker, from: walker.ant, count: 9, place: {on: ground}}]\n"
    (tmp_path / "open.yaml").write_text("antdsl: 1\nworld: {ground: {mesh: open.obj, voxel: 10 m}}\n" + crowd)
    (tmp_path / "none.yaml").write_text("antdsl: 1\nworld: {ground: {mesh: none.obj, voxel: 10 m}}\n" + crowd)
    result = run("check", "--imports", "--cost", "open.yaml", "none.yaml", cwd=tmp_path)
    assert result.returncode == 1 and "open.yaml: ground: open.obj" in result.stdout and "123456.789" in result.stdout
    assert "no import report for `none.yaml`: it has 1 error (above)" in result.stdout
    assert "no costs for `open.yaml`: it has 1 error (above)" in result.stdout


def test_what_may_be_zero_is_reported_so(tmp_path: Path) -> None:
    for line, help in (("clearance -5 mm", "write 0 or more"), ("size -4 mm", "write more than 0")):
        (tmp_path / "a.ant").write_text(WALKER.replace("  size 4 mm\n", f"  {line}\n"))
        assert help in [each.help for each in check_path(tmp_path / "a.ant")[1].diagnostics]


# --- numbers -----------------------------------------------------------------------------------------------------------

SIGNALLING = struct.pack("<I", 0x7F800001)  # a NaN of which NumPy warns where it is made a float64


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("name", ["a.stl", "a.ply"])
def test_signalling_nans_are_no_finite_numbers(name: str) -> None:
    corners = [b"\0" * 12, struct.pack("<3f", 0, 0, 9), struct.pack("<2f", 9, 0) + SIGNALLING]
    if name == "a.stl":
        data = b"\0" * 80 + struct.pack("<I", 1) + b"\0" * 12 + b"".join(corners) + b"\0\0"
    else:
        head = b"ply\nformat binary_little_endian 1.0\nelement vertex 3\nproperty float x\nproperty float y\nproperty float z\n"
        head += b"element face 1\nproperty list uchar int vertex_indices\nend_header\n"
        data = head + b"".join(corners) + struct.pack("<B3i", 3, 0, 1, 2)
    with pytest.raises(MeshError, match="finite"):
        read_mesh(data, name)
