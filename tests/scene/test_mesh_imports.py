"""Meshes as other programs write them: the same mesh in many forms gives the same triangles, and what is not read is reported."""

from __future__ import annotations

import base64
import json
import struct
from collections import Counter
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from antdsl.scene.geometry.import_notes import ImportNotes
from antdsl.scene.geometry.mesh_files import read_mesh, read_mesh_arrays
from antdsl.scene.geometry.mesh_text import MeshError
from antdsl.scene.geometry.polygons import MAX_POLYGON_CORNERS, TooManyCornersError, split_triangle_strips, triangulate_polygons
from antdsl.scene.staging.mesh_imports import weld_vertices

POINTS = np.array([[-50, 0, -50], [-50, 0, 50], [0, 1.5, 50], [0, 0, -50], [50, 0, 50], [50, 0, -50], [80, 0, 0]], float)
FACES = [[0, 1, 2, 3], [3, 2, 4, 5], [5, 4, 6]]
TRIANGLES = [[0, 1, 2], [0, 2, 3], [3, 2, 4], [3, 4, 5], [5, 4, 6]]

BLANKS = st.sampled_from([b" ", b"\t", b"  ", b" \t ", b"\x0c", b"\xc2\xa0"])
INDENTS = st.sampled_from([b"", b" ", b"\t", b"   "])
ENDS = st.sampled_from([b"\n", b"\r\n", b"\r"])
TAILS = st.sampled_from([b"", b" ", b" # a comment", b"\t#f 1 2 3"])
NUMBERS = st.sampled_from(["{:g}", "{:.6f}", "{:E}", "{:+.3e}"])


@st.composite
def texts(draw: st.DrawFn, lines: list[list[bytes]], continued: bool) -> bytes:
    """Lines of words as a program might write them: any blanks, ends, comments, continuations."""
    one_end = draw(st.one_of(st.none(), ENDS))
    out = draw(st.sampled_from([b"", b"\xef\xbb\xbf"]))
    for words in lines:
        text = draw(INDENTS)
        for k, word in enumerate(words):
            glue = b" \\" + (one_end or b"\n") + b" " if continued and k > 1 and draw(st.integers(0, 9)) == 0 else draw(BLANKS)
            text += (glue if k else b"") + word
        out += text + draw(TAILS) + (one_end or draw(ENDS)) + draw(st.sampled_from([b"", b"", one_end or b"\n"]))
    return out.rstrip(b"\r\n") if draw(st.booleans()) else out


@st.composite
def wavefront(draw: st.DrawFn) -> bytes:
    form = draw(NUMBERS)
    upper = draw(st.booleans())
    vertices = [[b"v", *(form.format(x).encode() for x in point)] for point in POINTS]
    if draw(st.booleans()):
        vertices = [[*line, b"1.0", b"0.5", b"0.25"] for line in vertices]
    corner = draw(st.sampled_from(["{}", "{}/1", "{}//2", "{}/1/1"]))
    back = draw(st.booleans())
    faces = [[b"f", *(corner.format(k - len(POINTS) if back else k + 1).encode() for k in face)] for face in FACES]
    first = draw(st.booleans()) and not back
    lines = [[b"o", b"ground"], [b"mtllib", b"a.mtl"], *(faces + vertices if first else vertices + faces)]
    if upper:
        lines = [[line[0].upper(), *line[1:]] for line in lines]
    return draw(texts(lines, continued=True))


@st.composite
def polygons_ply(draw: st.DrawFn) -> bytes:
    order = draw(st.sampled_from(["ascii", "binary_little_endian", "binary_big_endian"]))
    end = draw(st.sampled_from([b"\n", b"\r\n"]))
    sign = ">" if "big" in order else "<"
    extra, faces_first, edges = (draw(st.booleans()) for _ in range(3))
    comment = b"comment after end_header comes the data" + end if draw(st.booleans()) else b""
    real, small, integer = draw(st.sampled_from([("float", "uchar", "int"), ("float64", "uint8", "uint32")]))
    index = draw(st.sampled_from(["vertex_index", "vertex_indices"]))
    vertex = [f"element vertex {len(POINTS)}", *(f"property {real} {axis}" for axis in "xyz")]
    face = (
        [f"element face {len(FACES)}"] + (["property uchar red"] if extra else []) + [f"property list {small} {integer} {index}"]
    )
    edge = ["element edge 2", "property int vertex1", "property list uchar float weights"]
    codes = ("f" if real == "float" else "d"), ("I" if integer == "uint32" else "i")
    if order == "ascii":
        rows = [
            end.join(b" ".join(str(x).encode() for x in point) for point in POINTS.tolist()) + end,
            b"".join(b" ".join([b"7"] * extra + [b"%d" % k for k in [len(f), *f]]) + end for f in FACES),
            b"3 2 0.5 0.5" + end + b"4 0" + end,
        ]
    else:
        rows = [
            b"".join(struct.pack(f"{sign}3{codes[0]}", *point) for point in POINTS),
            b"".join(b"\7" * extra + struct.pack(f"{sign}B{len(f)}{codes[1]}", len(f), *f) for f in FACES),
            struct.pack(f"{sign}iB2fiB", 3, 2, 0.5, 0.5, 4, 0),
        ]
    parts = [(vertex, rows[0]), (face, rows[1])]
    parts = parts[::-1] if faces_first else parts
    parts = [(edge, rows[2]), *parts] if edges else parts
    head = [b"ply", f"format {order} 1.0".encode(), *(line.encode() for lines, _ in parts for line in lines)]
    return end.join(head) + end + comment + b"obj_info by hand" + end + b"end_header" + end + b"".join(row for _, row in parts)


@settings(max_examples=60, deadline=None)
@given(wavefront())
def test_wavefront_in_any_layout_is_the_same_mesh(data: bytes) -> None:
    notes = ImportNotes()
    points, faces = read_mesh_arrays(data, "a.obj", notes=notes)
    assert np.allclose(points, POINTS) and faces.tolist() == TRIANGLES
    assert not notes.skipped_elements and notes.cut_polygons == 2 and not notes.concave_polygons


@settings(max_examples=60, deadline=None)
@given(polygons_ply())
def test_ply_in_any_layout_is_the_same_mesh(data: bytes) -> None:
    notes = ImportNotes()
    points, faces = read_mesh_arrays(data, "a.ply", notes=notes)
    assert np.allclose(points, POINTS) and faces.tolist() == TRIANGLES
    assert all("edge" in word for word in notes.skipped_elements)


@settings(max_examples=30, deadline=None)
@given(st.data())
def test_stl_in_any_layout_is_the_same_mesh(data: st.DataObject) -> None:
    lines = [[b"solid", b"vertex", b"facet"]]
    for face in TRIANGLES:
        lines += [[b"facet", b"normal", b"0", b"1", b"0"], [b"outer", b"loop"]]
        lines += [[b"vertex", *(b"%g" % x for x in POINTS[k])] for k in face] + [[b"endloop"], [b"endfacet"]]
    text = data.draw(texts([[word.upper() for word in line] for line in lines] if data.draw(st.booleans()) else lines, False))
    points, faces = read_mesh_arrays(text, "a.stl")
    assert np.allclose(points[faces], POINTS[np.array(TRIANGLES)])


FACET = struct.pack("<12fH", 0, 1, 0, *POINTS[:3].ravel(), 0)


@pytest.mark.parametrize("tail", [b"", b"\n", bytes(3), bytes(512), b" " * 100])
@pytest.mark.parametrize("head", [b"made by hand", b"solid ground"])
def test_binary_stl_may_be_padded(head: bytes, tail: bytes) -> None:
    notes = ImportNotes()
    assert len(read_mesh_arrays(head.ljust(80) + struct.pack("<I", 1) + FACET + tail, "a.stl", notes=notes)[1]) == 1
    assert not notes.skipped_elements


def test_bytes_after_a_binary_stl_are_reported_and_wrong_counts_are_errors() -> None:
    notes = ImportNotes()
    read_mesh_arrays(bytes(80) + struct.pack("<I", 1) + FACET + b"made by me", "a.stl", notes=notes)
    assert notes.describe_skipped() == ["10 bytes after the last face"]
    for count, words in ((2, "1 fit"), (0, "and has 1")):
        with pytest.raises(MeshError, match=words):
            read_mesh_arrays(bytes(80) + struct.pack("<I", count) + FACET, "a.stl")


@pytest.mark.parametrize(
    ("line", "words"),
    [(b"v 1,5 0 0", "line 3.*`1,5`"), (b"f 1 2 \\\n x", "`x`.*line 3"), (b"v 1 2", "line 3"), (b"f 1 2 9", "vertex 9.*line 3")],
)
def test_mistakes_in_text_have_their_line(line: bytes, words: str) -> None:
    with pytest.raises(MeshError, match=words):
        read_mesh_arrays(b"v 0 0 \\\n0\n" + line + b"\nv 1 0 0\nv 0 0 1\nf 1 3 2\n", "a.obj")


def test_utf_16_is_an_error_that_says_what_to_do() -> None:
    for name in ("a.obj", "a.stl"):
        with pytest.raises(MeshError, match="UTF-16") as caught:
            read_mesh_arrays("solid facet\n".encode("utf-16"), name)
        assert "UTF-8" in str(caught.value.help)


def test_what_is_not_read_is_noted_with_its_first_line() -> None:
    notes = ImportNotes()
    read_mesh_arrays(b"v 0 0 0\nv 1 0 0\nv 0 0 1\ng a#1\nl 1 2\nl 2 3\nfoo 1\ncurv 0 1 1 2\nf 1 2 3\n", "a.obj", notes=notes)
    assert notes.describe_skipped() == ["2 × lines (`l`) (line 5)", "unknown keyword `foo` (line 7)", "curves (`curv`) (line 8)"]


def test_triangle_strips_turn_and_begin_again() -> None:
    assert split_triangle_strips(np.array([0, 1, 2, 3])).tolist() == [[0, 1, 2], [2, 1, 3]]
    assert split_triangle_strips(np.array([0, 1, 2, 2, 3, 4, -1, 5, 6, 7])).tolist() == [[0, 1, 2], [3, 2, 4], [5, 6, 7]]
    head = b"ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\nelement tristrips 2\n"
    head += b"property list int int vertex_indices\nend_header\n0 0 0\n0 0 1\n1 0 0\n1 0 1\n"
    assert read_mesh_arrays(head + b"4 0 1 2 3\n7 0 1 2 -1 1 3 2\n", "a.ply")[1].tolist() == [
        [0, 1, 2], [2, 1, 3], [0, 1, 2], [1, 3, 2]
    ]  # fmt: skip


# --- polygons ----------------------------------------------------------------------------------------------------------

RINGS = {
    "U": [(-50, -50), (-50, 50), (50, 50), (50, -50), (20, -50), (20, 20), (-20, 20), (-20, -50)],
    "arrow": [(0, 0), (4, 1), (0, 4), (1, 1)],
    "cross with flat corners": [
        (1, 0), (1.5, 0), (2, 0), (2, 1), (3, 1), (3, 2), (2, 2), (2, 3), (1, 3), (1, 2), (0, 2), (0, 1), (1, 1),
    ],
    "square with flat corners": [(0, 0), (5, 0), (10, 0), (10, 5), (10, 10), (5, 10), (0, 10), (0, 5)],
    "keyhole": [(0, 0), (10, 0), (10, 10), (0, 10), (0, 0), (3, 3), (3, 7), (7, 7), (7, 3), (3, 3)],
    "comb": [(0, 0), (9, 0), (9, 9), (8, 9), (8, 1), (6, 1), (6, 9), (5, 9), (5, 1), (3, 1), (3, 9), (2, 9), (2, 1), (0, 1)],
}  # fmt: skip


def in_space(ring: np.ndarray, axis: int, slant: float) -> np.ndarray:
    points = np.zeros((len(ring), 3))
    points[:, (axis + 1) % 3], points[:, (axis + 2) % 3] = ring.T
    points[:, axis] = slant * ring.sum(axis=1) + 7
    return points


def covers(ring: np.ndarray, triangles: np.ndarray, names: list[int]) -> None:
    """The triangles are wound as the ring, cover its area once, and have its edges as their border."""
    a, b, c = (ring[triangles[:, k]] for k in range(3))
    areas = (b - a)[:, 0] * (c - a)[:, 1] - (b - a)[:, 1] * (c - a)[:, 0]
    x, y = ring.T
    ring_area = float((x * np.roll(y, -1) - y * np.roll(x, -1)).sum())
    assert (areas * np.sign(ring_area) > 0).all() and abs(areas.sum() - ring_area) < 1e-6 * abs(ring_area)
    edges = Counter((names[t[k]], names[t[(k + 1) % 3]]) for t in triangles.tolist() for k in range(3))
    border = {(a, b) for a, b in edges if (b, a) not in edges}
    ring_edges = {(names[k], names[(k + 1) % len(names)]) for k in range(len(names))}
    assert border == {(a, b) for a, b in ring_edges if (b, a) not in ring_edges} and max(edges.values()) == 1


@pytest.mark.parametrize("turned", [False, True])
@pytest.mark.parametrize(("axis", "slant"), [(0, 0.0), (1, 0.3), (2, -0.4)])
@pytest.mark.parametrize("name", RINGS)
def test_polygons_are_covered_once(name: str, axis: int, slant: float, turned: bool) -> None:
    ring = np.array(RINGS[name], float)[:: -1 if turned else 1]
    point_numbers = {tuple(point): k for k, point in reversed(list(enumerate(ring.tolist())))}
    names = [point_numbers[tuple(point)] for point in ring.tolist()]
    triangulation = triangulate_polygons(in_space(ring, axis, slant), np.array([len(ring)]), np.array(names))
    assert not triangulation.crossing_polygons and len(triangulation.corners) == len(ring) - 2
    covers(ring, triangulation.corners, names)


@settings(max_examples=150, deadline=None)
@given(st.lists(st.integers(1, 6), min_size=4, max_size=24), st.randoms(use_true_random=False))
def test_stars_of_any_shape_are_covered_once(radii: list[int], random: object) -> None:
    angles = np.arange(len(radii)) * 2 * np.pi / len(radii)
    ring = np.array(radii)[:, None] * np.stack([np.cos(angles), np.sin(angles)], axis=1)
    ring = np.roll(ring, radii[0], axis=0)
    triangulation = triangulate_polygons(in_space(ring, radii[1] % 3, 0.2), np.array([len(ring)]), np.arange(len(ring)))
    if not triangulation.crossing_polygons:  # stars about their middle never cross
        covers(ring, triangulation.corners, list(range(len(ring))))
    assert not triangulation.crossing_polygons


def test_convex_polygons_are_fans_and_many_are_cut_at_once() -> None:
    angles = np.arange(6) * np.pi / 3
    points = np.stack([np.cos(angles), 0 * angles, -np.sin(angles)], axis=1)
    triangulation = triangulate_polygons(points, np.array([6, 3, 0, 2, 4]), np.array([*range(6), 0, 1, 2, 0, 1, 0, 2, 3, 5]))
    assert triangulation.corners[:4].tolist() == [[0, 1, 2], [0, 2, 3], [0, 3, 4], [0, 4, 5]]
    assert triangulation.polygon_indices.tolist() == [0, 0, 0, 0, 1, 4, 4] and (
        triangulation.cut_count,
        triangulation.concave_count,
    ) == (2, 0)


def test_polygons_that_cross_themselves_are_named_and_huge_ones_are_errors() -> None:
    points = np.array([(0, 0, 0), (4, 0, 4), (4, 0, 0), (0, 0, 5)], float)
    assert triangulate_polygons(points, np.array([4]), np.arange(4)).crossing_polygons == (0,)
    angles = np.arange(5) * 4 * np.pi / 5
    star = np.stack([np.cos(angles), 0 * angles, np.sin(angles)], axis=1)
    assert triangulate_polygons(star, np.array([5]), np.arange(5)).crossing_polygons == (0,)
    count = MAX_POLYGON_CORNERS + 2
    around = np.arange(count) * 2 * np.pi / count
    radius = np.where(np.arange(count) % 2, 1.0, 0.5) * np.where(np.arange(count) < count // 2, 1.0, -0.2)
    with pytest.raises(TooManyCornersError):
        triangulate_polygons(
            np.stack([radius * np.cos(around), 0 * around, np.sin(around)], axis=1), np.array([count]), np.arange(count)
        )


# --- glTF --------------------------------------------------------------------------------------------------------------


def gltf(mode: int = 4, indices: list[int] | None = None, uri: str | None = None, **changes: object) -> tuple[bytes, bytes]:
    """A file of one square at two nodes, one of which mirrors; and its buffer."""
    points = np.array([(0, 0, 0), (0, 0, 1), (1, 0, 0), (1, 0, 1)], np.float32)
    corners = np.array([0, 1, 2, 2, 1, 3] if indices is None else indices, np.uint16)
    data = points.tobytes() + corners.tobytes()
    tree = {
        "asset": {"version": "2.0"}, "scene": 0, "scenes": [{"nodes": [0]}],
        "nodes": [
            {"name": "set", "children": [1, 2], "translation": [10, 0, 0]},
            {"name": "left", "mesh": 0, "scale": [-1, 1, 1]},
            {"name": "right", "mesh": 0, "rotation": [0, 1, 0, 0], "translation": [0, 2, 0]},
        ],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1, "mode": mode}]}],
        "accessors": [
            {"bufferView": 0, "componentType": 5126, "count": 4, "type": "VEC3"},
            {"bufferView": 1, "componentType": 5123, "count": len(corners), "type": "SCALAR"},
        ],
        "bufferViews": [{"buffer": 0, "byteLength": 48}, {"buffer": 0, "byteOffset": 48, "byteLength": 2 * len(corners)}],
        "buffers": [
            {"byteLength": len(data), "uri": uri or "data:x;base64," + base64.b64encode(data).decode()}
        ],
    } | changes  # fmt: skip
    return json.dumps(tree).encode(), data


def test_gltf_nodes_are_placed_and_mirrored_ones_keep_their_outside() -> None:
    data, _ = gltf()
    mesh = read_mesh(data, "a.gltf")
    a, b, c = np.moveaxis(mesh.vertices[mesh.faces], 1, 0)
    assert len(mesh.faces) == 4 and (np.cross(b - a, c - a)[:, 1] > 0).all()
    assert mesh.vertices[:, 0].min() == 9 and mesh.vertices[:, 1].tolist() == [0] * 4 + [2] * 4
    assert np.allclose(read_mesh(data, "a.gltf", "right").vertices[3], [9, 2, -1])
    with pytest.raises(MeshError, match="did you mean `right`"):
        read_mesh(data, "a.gltf", "rigth")


@pytest.mark.parametrize(("mode", "indices"), [(5, [0, 1, 2, 3]), (6, [0, 1, 3, 2])])
def test_gltf_strips_and_fans_are_read(mode: int, indices: list[int]) -> None:
    mesh = read_mesh(gltf(mode, indices)[0], "a.gltf", "right")
    a, b, c = np.moveaxis(mesh.vertices[mesh.faces], 1, 0)
    assert np.cross(b - a, c - a)[:, 1].tolist() == [1, 1]


def test_gltf_reports_what_it_leaves_out_and_says_what_to_do_about_compression() -> None:
    assert read_mesh(gltf()[0], "a.gltf").notes.form == "glTF"
    with pytest.raises(MeshError, match="no faces"):
        read_mesh(gltf(1)[0], "a.gltf")
    with pytest.raises(MeshError, match="Draco") as caught:
        read_mesh(gltf(extensionsRequired=["KHR_draco_mesh_compression"])[0], "a.gltf")
    assert caught.value.help == "export it without compression"


WALKER = """ant 1
use steering
world { surface ground }
species walker {
  size 4 mm
  max_speed 25 mm/s
  start stroll
  state stroll "Strolls" amber { steer wander() }
  layers { state }
}
"""


def checked(folder: Path, thing: str, kind: str = "surface") -> tuple[list[str], dict[str, object]]:
    """Codes and imports of a scene with one mesh."""
    from antdsl.pipeline import RunChoices, check_path, read_mesh_imports

    (folder / "walker.ant").write_text(WALKER.replace("surface", kind))
    scene = folder / "scene.yaml"
    scene.write_text(
        f"antdsl: 1\nworld: {{ground: {thing}}}\n"
        "crowd: [{species: walker, from: walker.ant, count: 9, place: {on: ground}}]\n"
    )
    _, report = check_path(scene)
    return [each.code for each in report.diagnostics], dict(read_mesh_imports(scene, RunChoices())[0])


def test_gltf_is_in_metres_and_its_buffer_lies_in_the_project(tmp_path: Path) -> None:
    (tmp_path / "set").mkdir()
    text, data = gltf(uri="../my%20buffer.bin")
    (tmp_path / "set" / "a.gltf").write_bytes(text)
    (tmp_path / "my buffer.bin").write_bytes(data)
    codes, imports = checked(tmp_path, "{mesh: set/a.gltf, group: right}")
    assert codes == [] and imports["ground"].high == (10000.0, 2000.0, 0.0)  # type: ignore[attr-defined]
    (tmp_path / "set" / "a.gltf").write_bytes(gltf(uri="../../etc/passwd")[0])
    assert checked(tmp_path, "{mesh: set/a.gltf}")[0] == ["bad-path"]
    (tmp_path / "set" / "a.gltf").write_bytes(gltf(uri="/etc/passwd")[0])
    assert checked(tmp_path, "{mesh: set/a.gltf}")[0] == ["bad-path"]


# --- welding -----------------------------------------------------------------------------------------------------------


def split_box(noise: float) -> bytes:
    """A box of which each face has its own corners, a little off."""
    points = np.array([(x, y, z) for x in (-20, 20) for y in (-20, 20) for z in (-20, 20)], float)
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    corners = points[np.array(quads).ravel()] + np.random.default_rng(1).uniform(-noise, noise, (24, 3))
    lines = [b"v %r %r %r" % tuple(map(float, place)) for place in corners]
    return b"\n".join([*lines, *(b"f %d %d %d %d" % tuple(range(k, k + 4)) for k in range(1, 25, 4))])


def test_vertices_are_welded_to_the_first_of_them() -> None:
    points = np.array([[1, 0, 0], [0, 0, 0], [1, 0, 0.01], [0, 0, 0], [1, 0, 0.02], [5, 0, 0]], float)
    welded_points, count = weld_vertices(points, 0.015)
    assert welded_points[:, 2].tolist() == [0] * 6 and count == 2 and weld_vertices(points, 0.001)[1] == 0


@pytest.mark.parametrize(("noise", "weld", "codes", "moved"), [
    (0.0, "", [], 0), (1e-5, "", [], 16), (0.05, "", ["bad-mesh"], None), (0.05, ", weld: 0.3 mm", [], 16),
])  # fmt: skip
def test_solids_with_gaps_between_vertices_are_closed(
    tmp_path: Path, noise: float, weld: str, codes: list[str], moved: int | None
) -> None:
    (tmp_path / "box.obj").write_bytes(split_box(noise))
    error_codes, imports = checked(tmp_path, f"{{mesh: box.obj, voxel: 1 mm{weld}}}", "solid")
    assert error_codes == codes
    if moved is not None:
        assert imports["ground"].welded >= moved and imports["ground"].border_edges == 0  # type: ignore[attr-defined]


def test_a_hash_in_a_name_is_a_name_where_a_file_has_it(tmp_path: Path) -> None:
    (tmp_path / "ground#1.obj").write_bytes(b"v -50 0 -50\nv -50 0 50\nv 50 0 0\nf 1 2 3\nl 1 2\n")
    codes, imports = checked(tmp_path, '{mesh: "ground#1.obj"}')
    assert codes == ["unread-content"] and imports["ground"].triangles == 1  # type: ignore[attr-defined]


def test_imports_are_listed_by_check_and_info(tmp_path: Path) -> None:
    from commands import run

    (tmp_path / "u.obj").write_bytes(
        b"".join(b"v %d 0 %d\n" % point for point in RINGS["U"]) + b"f 8 7 6 5 4 3 2 1\nbla\n"  # type: ignore[operator]
    )
    checked(tmp_path, "{mesh: u.obj}")
    result = run("check", "--imports", "scene.yaml", cwd=tmp_path)
    for words in ("1 polygon triangulated, 1 of them concave", "100 × 0 × 100 mm", "8 border edges", "unknown keyword `bla`"):
        assert words in result.stdout
    assert "unread-content" in run("check", "--format", "json", "scene.yaml", cwd=tmp_path).stdout
