"""Surfaces and solids of which little or nothing is left: thin faces, tiny meshes, and a `weld` that is too large."""

from __future__ import annotations

import tracemalloc
from pathlib import Path

import numpy as np
import pytest
from plans import bare, block
from scene.test_mesh_imports import WALKER

from antdsl.diagnostics import Diagnostic
from antdsl.ground.mesh.topology import build_topology
from antdsl.pipeline import RunChoices, check_path, read_mesh_imports
from antdsl.runtime.binding.bind_world import bind
from antdsl.scene.geometry.import_notes import format_import_report
from antdsl.scene.geometry.live_faces import has_any_face_with_area
from antdsl.scene.setting import CrowdData, MeshData, PlacementData, WorldSetting


def quad(width: float, depth: float) -> bytes:
    points = [(-width, 0, -depth), (width, 0, -depth), (width, 0, depth), (-width, 0, depth)]
    return b"".join(b"v %r %r %r\n" % tuple(map(float, point)) for point in points) + b"f 4 3 2 1\n"


def findings(folder: Path, world: str, place: str = "on: ground", kind: str = "surface") -> list[Diagnostic]:
    """What `check` says about a scene with some meshes."""
    things = "surface ground" if kind == "surface" else f"{kind} ground"
    dot_surface = "; surface dot" if "dot:" in world else ""
    (folder / "walker.ant").write_text(WALKER.replace("surface ground", things + dot_surface))
    scene = folder / "scene.yaml"
    scene.write_text(
        f"antdsl: 1\nworld: {{{world}}}\ncrowd: [{{species: walker, from: walker.ant, count: 9, place: {{{place}}}}}]\n"
    )
    return check_path(scene)[1].sort_by_place()


@pytest.mark.parametrize("place", ["on: ground", "on: ground, by: above", "on: ground, by: area"])
@pytest.mark.parametrize("depth", [1e-6, 1e-10])
def test_a_ground_as_thin_as_a_line_is_an_error(tmp_path: Path, place: str, depth: float) -> None:
    (tmp_path / "needle.obj").write_bytes(quad(1000, depth))
    (error,) = [each for each in findings(tmp_path, "ground: {mesh: needle.obj}", place) if each.severity == "error"]
    assert error.code == "bad-mesh" and error.span is not None and error.span.text == "needle.obj" and error.help


def test_a_ground_far_smaller_than_the_others_is_an_error(tmp_path: Path) -> None:
    (tmp_path / "big.obj").write_bytes(quad(5e6, 5e6))
    (tmp_path / "dot.obj").write_bytes(quad(1, 1))
    problems = findings(tmp_path, "ground: {mesh: big.obj}, dot: {mesh: dot.obj}", "on: dot")
    assert "`dot.obj` is less than a millionth" in "".join(each.message for each in problems if each.severity == "error")


def test_a_scene_and_its_ground_agree_on_what_is_ground() -> None:
    rng = np.random.default_rng(3)
    outcomes = set()
    for _ in range(60):
        vertices = rng.normal(size=(9, 3)) * 10.0 ** rng.uniform(-8, 1, (1, 3))
        vertices[::2] += 1e6 * rng.integers(0, 2)
        vertices[rng.integers(0, 9, 3)] = vertices[0]
        faces = rng.integers(0, 9, (3, 3)).astype(np.int32)
        extent = float(np.ptp(vertices[faces].reshape(-1, 3), axis=0).max())
        live = bool(build_topology(vertices, faces, np.zeros(3, np.int32), extent).is_live.any())
        assert has_any_face_with_area(vertices, faces, extent) == live
        outcomes.add(live)
    assert outcomes == {True, False}


@pytest.mark.parametrize("around", [None, (0.0, 0.0, 0.0)])
@pytest.mark.parametrize("by_area", [False, True])
def test_a_world_without_live_faces_is_bound(by_area: bool, around: tuple[float, float, float] | None) -> None:
    flat = MeshData(np.array([[0, 0, 0], [1, 0, 0], [2, 0, 0]], float), np.array([[0, 1, 2]], np.int32))
    place = PlacementData(surfaces=("ground",), is_by_area=by_area, disc_centre=around, radius=5.0 if around else None)
    setting = WorldSetting(surfaces={"ground": flat}, crowds=(CrowdData("ant", 4, place),))
    world = bind(bare(block(), thing_names_by_kind={"surface": ("ground",)}), setting)
    assert len(world.populations["ant"]) == 4


# --- welding -----------------------------------------------------------------------------------------------------------


def box(half: float, split: bool, noise: float = 0.0, lid: bool = True) -> bytes:
    """A box; with `split` each face has its own corners, a little off; without `lid` a face is missing."""
    points = np.array([(x, y, z) for x in (-half, half) for y in (-half, half) for z in (-half, half)], float)
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)][: 6 if lid else 5]
    if split:
        points = points[np.array(quads).ravel()]
        quads = [tuple(range(k, k + 4)) for k in range(0, len(points), 4)]
    corners = points + np.random.default_rng(1).uniform(-noise, noise, points.shape)
    lines = [b"v %r %r %r" % tuple(map(float, place)) for place in corners]
    return b"\n".join([*lines, *(b"f %d %d %d %d" % tuple(k + 1 for k in quad) for quad in quads)])


@pytest.mark.parametrize(("kind", "extra"), [("surface", ""), ("obstacle", ""), ("solid", ", voxel: 1 mm")])
@pytest.mark.parametrize("weld", ["41 mm", "60 mm", "1000 m"])
def test_a_weld_that_leaves_nothing_is_an_error(tmp_path: Path, kind: str, extra: str, weld: str) -> None:
    (tmp_path / "box.obj").write_bytes(box(20, split=False))
    (error,) = findings(tmp_path, f"ground: {{mesh: box.obj{extra}, weld: {weld}}}", "around: [0, 0, 0], radius: 5 mm", kind)
    assert error.code == "wrong-value" and error.span is not None and error.span.text == weld
    assert f"`weld: {weld}` moves corners of every face of `ground`" in error.message
    assert error.help == "write less than 40 mm, its shortest edge"


def test_a_weld_that_flattens_a_solid_is_an_error(tmp_path: Path) -> None:
    low = box(20, split=False).replace(b"v -20.0 ", b"v -0.05 ").replace(b"v 20.0 ", b"v 0.05 ")
    (tmp_path / "box.obj").write_bytes(low)
    (error,) = findings(tmp_path, "ground: {mesh: box.obj, voxel: 1 mm, weld: 0.2 mm}", kind="solid")
    assert (
        "leaves the solid `ground` without a volume" in error.message
        and error.help == "write less than 0.1 mm, its shortest edge"
    )


def test_a_flat_solid_is_an_error(tmp_path: Path) -> None:
    (tmp_path / "flat.obj").write_bytes(quad(20, 20) + b"f 1 2 3 4\nv 0 0 0\nf 1 2 5\nf 2 1 5\n")
    (error,) = [x for x in findings(tmp_path, "ground: {mesh: flat.obj, voxel: 1 mm}", kind="solid") if x.severity == "error"]
    assert "has no volume" in error.message


def grid(size: int) -> bytes:
    """A square of squares of 1 mm."""
    lines = [b"v %d 0 %d" % (x, z) for x in range(size) for z in range(size)]
    cells = [x * size + z + 1 for x in range(size - 1) for z in range(size - 1)]
    return b"\n".join([*lines, *(b"f %d %d %d %d" % (k, k + 1, k + size + 1, k + size) for k in cells)]) + b"\n"


def test_faces_that_welding_removes_are_counted(tmp_path: Path) -> None:
    (tmp_path / "grid.obj").write_bytes(grid(5) + b"v 4 0 4.1\nv 5 0 4\nf 25 26 27\n")
    world = "ground: {mesh: grid.obj, weld: 0.2 mm}"
    assert "degenerate-faces" not in [each.code for each in findings(tmp_path, world)]
    ground_import = read_mesh_imports(tmp_path / "scene.yaml", RunChoices())[0]["ground"]
    assert (ground_import.triangles, ground_import.dropped, ground_import.left, ground_import.welded) == (33, 1, 32, 1)
    assert "1 degenerate or doubled triangle dropped, 32 triangles left" in " ".join(format_import_report(ground_import, "mm"))
    codes = [each.code for each in findings(tmp_path, "ground: {mesh: grid.obj, weld: 0.6 mm}")]
    assert "degenerate-faces" in codes


def test_a_weld_among_many_vertices_takes_no_more_memory_than_they_do(tmp_path: Path) -> None:
    (tmp_path / "grid.obj").write_bytes(grid(90) + b"v 9999 0 0\nv 9999 0 9999\nf 1 90 8101\nf 1 8101 8102\n")
    tracemalloc.start()
    problems = findings(tmp_path, "ground: {mesh: grid.obj, weld: 100 mm}")
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert "is farther than from each vertex to dozens of others" in problems[0].message and most < 4e7
    assert problems[0].help == "write less than 1 mm, its shortest edge"


@pytest.mark.parametrize(
    ("data", "help"),
    [
        (box(20, split=True, noise=0.05), "its gaps are up to 0.092 mm wide: write `weld: 0.1 mm`"),
        (
            box(20, split=False, lid=False),
            "it has a hole of 4 edges, up to 40 mm long: close it in the program that made the mesh",
        ),
        (box(20, split=True, noise=9), "it has 6 holes, the largest of 4 edges, up to"),
    ],
)
def test_an_open_solid_has_its_gaps_and_holes_measured(tmp_path: Path, data: bytes, help: str) -> None:
    (tmp_path / "box.obj").write_bytes(data)
    (error,) = findings(tmp_path, "ground: {mesh: box.obj, voxel: 1 mm}", kind="solid")
    assert error.code == "bad-mesh" and str(error.help).startswith(help)
    if "weld" in help:
        assert not findings(tmp_path, "ground: {mesh: box.obj, voxel: 1 mm, " + help.split("`")[1] + "}", kind="solid")
