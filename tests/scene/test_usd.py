"""USD files by prim path: what is read of them, in which units, axes and hand; which files may be opened; other messages."""

from __future__ import annotations

import os
import sys
import tracemalloc
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path

import numpy as np
import pytest

pxr = pytest.importorskip("pxr")

import usd_sets  # noqa: E402

from antdsl import limits  # noqa: E402
from antdsl.diagnostics import Report  # noqa: E402
from antdsl.pipeline import RunChoices, Shot, open_scene, simulate  # noqa: E402
from antdsl.runtime import Options  # noqa: E402
from antdsl.scene import Roots  # noqa: E402
from antdsl.scene.geometry.mesh_files import MeshError, read_mesh  # noqa: E402
from antdsl.scene.geometry.usd import (  # noqa: E402
    UsdError,
    UsdStage,
    open_stage,
    read_usd_camera,
    read_usd_curve,
    read_usd_mesh,
    read_usd_points,
)
from antdsl.scene.setting import SolvedFlowData, SpreadFlowData  # noqa: E402

CORNERS = "point3f[] points = [(0,0,0), (1,0,0), (1,1,0), (0,1,0)]\n"
SQUARE = f"int[] faceVertexCounts = [4]\nint[] faceVertexIndices = [0, 1, 2, 3]\n{CORNERS}"
MM = "metersPerUnit = 0.001"


def usda(body: str, head: str = "") -> str:
    return f"#usda 1.0\n({head}\n)\n{body}\n"


def mesh(name: str = "m", properties: str = "", metadata: str = "") -> str:
    return f'def Mesh "{name}" {metadata} {{\n{SQUARE}{properties}\n}}\n'


def opened(
    folder: Path, body: str, prim: str = "/m", *, head: str = "", frames: range = range(1, 2), **changes: object
) -> UsdStage:
    (folder / "a.usda").write_text(usda(body, head))
    options = {"up": "y", "fps": Fraction(24), **changes}
    return open_stage(Roots(folder, {}), "a.usda", prim, frames=frames, **options)  # type: ignore[arg-type]


def refused(why: Callable[[], object]) -> UsdError:
    with pytest.raises(UsdError) as error:
        why()
    return error.value


# --- meshes --------------------------------------------------------------------------------------------------------------


def test_units_and_axes_are_the_files(tmp_path: Path) -> None:
    cm = read_usd_mesh(opened(tmp_path, mesh()))
    assert cm.raw_mesh.vertices.max() == 10 and cm.motion is None
    metres = read_usd_mesh(opened(tmp_path, mesh(), head='metersPerUnit = 1\nupAxis = "Z"'))
    # x y of a z-up file lie level in a y-up scene, seen from above as before
    assert metres.raw_mesh.vertices.tolist() == [[0, 0, 0], [1000, 0, 0], [1000, 0, -1000], [0, 0, -1000]]
    a, b, c = metres.raw_mesh.vertices[metres.raw_mesh.faces[0]]
    assert np.cross(b - a, c - a)[1] > 0
    same = read_usd_mesh(opened(tmp_path, mesh(), head='metersPerUnit = 0.001\nupAxis = "Z"', up="z"))
    assert same.raw_mesh.vertices.tolist() == [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]


def test_the_other_hand_mirrors_and_holes_are_minded(tmp_path: Path) -> None:
    plain = read_usd_mesh(opened(tmp_path, mesh())).raw_mesh
    assert plain.faces.tolist() == [[0, 1, 2], [0, 2, 3]]
    left = read_usd_mesh(opened(tmp_path, mesh(properties='uniform token orientation = "leftHanded"'))).raw_mesh
    assert left.faces.tolist() == [[0, 3, 2], [0, 2, 1]]
    flip = 'double3 xformOp:scale = (-1, 1, 1)\nuniform token[] xformOpOrder = ["xformOp:scale"]'
    mirrored = read_usd_mesh(opened(tmp_path, mesh(properties=flip))).raw_mesh
    a, b, c = mirrored.vertices[mirrored.faces[0]]
    assert np.cross(b - a, c - a)[2] > 0, "outside stays outside"
    two = SQUARE.replace("[4]", "[3, 3]").replace("[0, 1, 2, 3]", "[0, 1, 2, 0, 2, 3]")
    holed = read_usd_mesh(opened(tmp_path, f'def Mesh "m" {{\n{two}int[] holeIndices = [0]\n}}')).raw_mesh
    assert len(holed.faces) == 1 and len(holed.vertices) == 3 and holed.file_vertex_indices.tolist() == [0, 2, 3]


def test_only_visible_prims_of_the_requested_purpose_are_read(tmp_path: Path) -> None:
    body = (
        'def Xform "s" {\n' + mesh("a")
        + mesh("b", 'token visibility = "invisible"') + mesh("c", 'uniform token purpose = "guide"')
        + mesh("d", 'uniform token purpose = "proxy"') + mesh("e", metadata="(active = false)") + 'def Sphere "f" {}\n}'
    )  # fmt: skip
    usd_mesh = read_usd_mesh(opened(tmp_path, body, "/s"))
    assert len(usd_mesh.raw_mesh.faces) == 2 and usd_mesh.unread_shape_types == ("Sphere",)
    assert len(read_usd_mesh(opened(tmp_path, body, "/s", purpose="proxy")).raw_mesh.faces) == 4
    proxy = refused(lambda: read_usd_mesh(opened(tmp_path, body, "/s/d")))
    assert proxy.code == "no-such-prim" and proxy.help == "its meshes are of the purpose `proxy`: write `purpose: proxy`"
    assert "only Sphere" in str(refused(lambda: read_usd_mesh(opened(tmp_path, body, "/s/f"))))


def test_transforms_nest_instances_are_baked_and_moves_are_stored_separately(tmp_path: Path) -> None:
    body = """def Xform "w" {
  double3 xformOp:translate.timeSamples = { 1: (0, 0, 0), 3: (2, 0, 0) }
  uniform token[] xformOpOrder = ["xformOp:translate"]
  def PointInstancer "i" {
    point3f[] positions = [(0, 0, 1), (0, 0, 2), (0, 0, 3)]
    int[] protoIndices = [0, 0, 0]
    int64[] invisibleIds = [1]
    rel prototypes = </w/i/p>
    float3[] scales = [(1, 1, 1), (1, 1, 1), (2, 2, 2)]
    over "p" {
      MESH
    }
  }
}
""".replace("MESH", mesh("m"))
    usd_mesh = read_usd_mesh(opened(tmp_path, body + mesh("still"), "/w", frames=range(1, 5), head=MM))
    assert usd_mesh.raw_mesh.vertices.reshape(2, 4, 3)[:, 2].tolist() == [[1, 1, 1], [2, 2, 3]]
    assert usd_mesh.motion is not None and usd_mesh.motion.frame_count == 4
    at = [usd_mesh.motion.compute_vertices(usd_mesh.raw_mesh.vertices, k)[0, 0] for k in range(-1, 6)]
    assert at == [0, 0, 1, 2, 2, 2, 2], "held before the first and after the last"
    complete_mesh = read_usd_mesh(opened(tmp_path, body + mesh("still"), "/", frames=range(1, 5), head=MM))
    assert complete_mesh.motion is not None and len(complete_mesh.raw_mesh.vertices) == 12
    moved = complete_mesh.motion.compute_vertices(complete_mesh.raw_mesh.vertices, 2) - complete_mesh.raw_mesh.vertices
    assert sorted(moved[:, 0].tolist()) == [0] * 4 + [2] * 8


def test_points_that_bend_and_frames_per_second(tmp_path: Path) -> None:
    square = SQUARE.replace("point3f[] points = [(0,0,0), (1,0,0), (1,1,0), (0,1,0)]", "")
    square += (
        "point3f[] points.timeSamples = { 0: [(0,0,0), (1,0,0), (1,1,0), (0,1,0)], 48: [(0,0,4), (1,0,0), (1,1,0), (0,1,0)] }"
    )
    body = f'def Mesh "m" {{\n{square}\n}}'
    # 48 codes a second on 24 frames a second: frame 12 is code 24
    head = f"{MM}\ntimeCodesPerSecond = 48"
    usd_mesh = read_usd_mesh(opened(tmp_path, body, frames=range(0, 25), head=head))
    assert usd_mesh.motion is not None
    assert [usd_mesh.motion.compute_vertices(usd_mesh.raw_mesh.vertices, k)[0, 2] for k in (0, 12, 24)] == [0, 2, 4]
    other = body.replace("48: [(0,0,4), ", "48: [(0,0,4), (0,0,4), ")
    assert refused(lambda: read_usd_mesh(opened(tmp_path, other, frames=range(0, 25), head=head))).code == "moving-topology"
    faces = mesh().replace(
        "int[] faceVertexIndices = [0, 1, 2, 3]", "int[] faceVertexIndices.timeSamples = { 1: [0, 1, 2, 3], 2: [0, 2, 1, 3] }"
    )
    assert refused(lambda: read_usd_mesh(opened(tmp_path, faces, frames=range(1, 3)))).code == "moving-topology"
    assert read_usd_mesh(opened(tmp_path, faces)).motion is None, "one frame has one set of faces"


def test_damaged_meshes_are_reported(tmp_path: Path) -> None:
    for old, new in (("[0, 1, 2, 3]", "[0, 1, 2, 4]"), ("[4]", "[5]"), ("(1,1,0)", "(nan,1,0)")):
        with pytest.raises(MeshError, match=r"names a missing|does not match its faces|finite"):
            read_usd_mesh(opened(tmp_path, mesh().replace(old, new)))


def test_too_many_faces_are_refused_before_they_are_made(tmp_path: Path) -> None:
    body = f'def PointInstancer "i" {{\nrel prototypes = </i/m>\n{mesh()}}}'
    (tmp_path / "a.usda").write_text(usda(body))
    from pxr import Usd, UsdGeom, Vt

    stage = Usd.Stage.Open(str(tmp_path / "a.usda"))
    instancer = UsdGeom.PointInstancer(stage.GetPrimAtPath("/i"))
    instancer.CreatePositionsAttr(Vt.Vec3fArray(10))
    instancer.CreateProtoIndicesAttr(Vt.IntArray(10))
    stage.Save()
    del stage
    usd_stage = open_stage(Roots(tmp_path, {}), "a.usda", "/i", up="y", frames=range(1, 2), fps=Fraction(24))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(limits, "MAX_MESH_FACES", 19)
        tracemalloc.start()
        assert refused(lambda: read_usd_mesh(usd_stage)).code == "too-large"
        assert tracemalloc.get_traced_memory()[1] < 1e6
        tracemalloc.stop()


def test_primvars_of_vertices_turn_with_their_mesh(tmp_path: Path) -> None:
    properties = """float[] primvars:damp = [0, 1, 2, 3] ( interpolation = "vertex" )
    vector3f[] primvars:comb = [(1,0,0), (1,0,0), (0,0.5,0), (1,0,0)] ( interpolation = "vertex" )
    float[] primvars:few = [1, 2] ( interpolation = "uniform" )
    double xformOp:rotateZ = 90
    uniform token[] xformOpOrder = ["xformOp:rotateZ"]"""
    stage = opened(tmp_path, mesh(properties=properties))
    values = read_usd_mesh(stage, ["damp", "comb"]).values
    assert values["damp"].tolist() == [0, 1, 2, 3]
    assert np.allclose(values["comb"], [(0, 1, 0), (0, 1, 0), (-0.5, 0, 0), (0, 1, 0)])
    assert refused(lambda: read_usd_mesh(stage, ["dry"])).help == "paint `primvars:dry` on it"
    assert "2 values for 4 points" in str(refused(lambda: read_usd_mesh(stage, ["few"])))


# --- curves, points, cameras ---------------------------------------------------------------------------------------------


def curve(kind: str, points: str, properties: str = "") -> str:
    count = points.count("(")
    head = f'def BasisCurves "c" {{\nuniform token type = "{kind}"\n'
    return f"{head}int[] curveVertexCounts = [{count}]\npoint3f[] points = [{points}]\n{properties}\n}}\n"


def test_curves_of_every_basis(tmp_path: Path) -> None:
    mm = MM

    def line(*arguments: str) -> np.ndarray:
        return read_usd_curve(opened(tmp_path, curve(*arguments), "/c", head=mm))[0]

    assert line("linear", "(0,0,0), (5,0,0)").tolist() == [[0, 0, 0], [5, 0, 0]]
    straight = "(0,0,0), (3,0,0), (6,0,0), (9,0,0)"
    bezier = line("cubic", straight, 'uniform token basis = "bezier"')
    assert bezier[0, 0] == 0 and bezier[-1, 0] == 9 and np.allclose(np.diff(bezier[:, 0]), 9 / 16)
    for basis in ("bspline", "catmullRom"):
        inner = line("cubic", straight, f'uniform token basis = "{basis}"')
        assert np.allclose(inner[[0, -1], 0], [3, 6])
        pinned = line("cubic", straight, f'uniform token basis = "{basis}"\nuniform token wrap = "pinned"')
        assert np.allclose(pinned[[0, -1], 0], [0, 9])
    ring = line("cubic", "(0,0,0), (3,0,0), (3,3,0), (0,3,0)", 'uniform token basis = "bspline"\nuniform token wrap = "periodic"')
    assert np.allclose(ring[0], ring[-1]) and len(ring) == 4 * 16 + 1


def test_a_curve_that_moves_and_what_is_no_single_curve(tmp_path: Path) -> None:
    properties = (
        'double3 xformOp:translate.timeSamples = { 1: (0,0,0), 2: (0,0,7) }\nuniform token[] xformOpOrder = ["xformOp:translate"]'
    )
    curve_points = read_usd_curve(
        opened(tmp_path, curve("linear", "(0,0,0), (5,0,0)", properties), "/c", head=MM, frames=range(1, 3))
    )
    assert curve_points.shape == (2, 2, 3) and curve_points[1, 0].tolist() == [0, 0, 7]
    assert refused(lambda: read_usd_curve(opened(tmp_path, mesh()))).code == "no-such-prim"
    two = (
        'def Xform "s" {\n'
        + curve("linear", "(0,0,0), (5,0,0)")
        + curve("linear", "(0,0,0), (5,0,0)").replace('"c"', '"d"')
        + "}"
    )
    assert refused(lambda: read_usd_curve(opened(tmp_path, two, "/s"))).help == "name one of them: `/s/c`, `/s/d`"
    odd = curve("cubic", "(0,0,0), (5,0,0), (6,0,0), (7,0,0), (8,0,0)", 'uniform token basis = "bezier"')
    assert "no bezier curve can have" in str(refused(lambda: read_usd_curve(opened(tmp_path, odd, "/c"))))


def test_points_and_locators_are_items(tmp_path: Path) -> None:
    body = """def Points "p" {
  point3f[] points = [(1,0,0), (0,2,0)]
  float[] widths = [4, 6]
  float[] primvars:load = [3, 5] ( interpolation = "vertex" )
  string[] primvars:name = ["apple", "donut"] ( interpolation = "vertex" )
}
def Xform "spots" {
  def Xform "left" {
    double3 xformOp:translate = (1, 1, 1)
    uniform token[] xformOpOrder = ["xformOp:translate"]
    float primvars:load = 9
  }
  def Xform "right" {}
}
"""
    usd_points = read_usd_points(opened(tmp_path, body, "/p"))
    assert (
        usd_points.names == ("apple", "donut")
        and np.allclose(usd_points.radius, [20, 30])
        and usd_points.values["load"].tolist() == [3, 5]
    )
    assert usd_points.positions.tolist() == [[[10, 0, 0], [0, 20, 0]]]
    spots = read_usd_points(opened(tmp_path, body, "/spots"))
    assert spots.names == ("left", "right") and spots.positions[0, 0].tolist() == [10, 10, 10]
    assert spots.values["load"][0] == 9 and np.isnan(spots.values["load"][1]) and np.isnan(spots.radius).all()
    assert refused(lambda: read_usd_points(opened(tmp_path, body, "/spots/left"))).code == "no-such-prim"


def test_cameras(tmp_path: Path) -> None:
    body = """def Camera "c" {
  float focalLength.timeSamples = { 1: 50, 2: 100 }
  float horizontalAperture = 25
  float focusDistance = 3
  double xformOp:rotateX = -90
  uniform token[] xformOpOrder = ["xformOp:rotateX"]
}"""
    camera = read_usd_camera(opened(tmp_path, body, "/c", frames=range(1, 3)))
    assert camera.focal.tolist() == [72, 144], "for a sensor 36 mm wide"
    assert np.allclose(camera.look_at - camera.at, [0, -30, 0]) and np.allclose(camera.up, [0, 0, -1])
    assert refused(lambda: read_usd_camera(opened(tmp_path, mesh()))).code == "no-such-prim"


# --- which prim, which files ---------------------------------------------------------------------------------------------


def test_a_missing_prim_is_reported_with_those_present(tmp_path: Path) -> None:
    body = 'def Xform "set" {\n' + mesh("stones") + mesh("off", metadata="(active = false)") + "}"
    near = refused(lambda: opened(tmp_path, body, "/set/stonse"))
    assert near.code == "no-such-prim" and near.help == "did you mean `/set/stones`?"
    assert refused(lambda: opened(tmp_path, body, "/sat/stones")).help == "did you mean `/set`?"
    assert refused(lambda: opened(tmp_path, body, "/set/xxxxxxx/y")).help == "available below `/set`: `stones`, `off`"
    assert "is inactive" in str(refused(lambda: opened(tmp_path, body, "/set/off")))
    assert refused(lambda: opened(tmp_path, body, "set/stones")).code == "no-such-prim"


def linked(path: str) -> str:
    return f'def "m" ( references = @{path}@ ) {{}}'


@pytest.mark.parametrize(
    ("path", "code"),
    [
        ("https://host/x.usda", "bad-path"), ("/etc/x.usda", "bad-path"), ("../outside.usda", "bad-path"),
        ("gone.usda", "no-such-file"),
        ("./link.usda", "bad-path"), ("x.usda:SDF_FORMAT_ARGS:target=1", "bad-path"), ("pipe.usda", "not-a-file"),
        ("x.abc", "bad-usd"), ("torn.usda", "bad-usd"), ("anon:0x1:x.usda", "bad-path"),
    ],
)  # fmt: skip
def test_a_file_is_made_of_files_below_the_granted_roots_only(tmp_path: Path, path: str, code: str) -> None:
    inside = tmp_path / "in"
    inside.mkdir()
    for name in ("outside.usda", "in/x.usda"):
        (tmp_path / name).write_text(usda(mesh(), 'defaultPrim = "m"'))
    (inside / "link.usda").symlink_to(tmp_path / "outside.usda")
    (inside / "x.abc").write_text("x")
    (inside / "torn.usda").write_text("#usda 1.0\ndef {")
    os.mkfifo(inside / "pipe.usda")
    error = refused(lambda: opened(inside, linked(path)))
    assert error.code == code and error.key == "usd", str(error)
    assert refused(lambda: opened(inside, linked(path).replace("references", "payload"))).code == code
    assert refused(lambda: opened(inside, mesh(), head=f"subLayers = [@{path}@]")).code == code


def test_files_within_other_granted_roots_are_read_and_hashed(tmp_path: Path) -> None:
    for name in ("scene", "lib", "lib/parts"):
        (tmp_path / name).mkdir()
    head = 'defaultPrim = "m"'
    (tmp_path / "lib" / "parts" / "b.usda").write_text(usda(mesh(), head))
    (tmp_path / "lib" / "a.usda").write_text(usda(linked("./parts/b.usda"), head))
    (tmp_path / "scene" / "a.usda").write_text(usda(linked("../lib/a.usda"), head))
    options = {"up": "y", "frames": range(1, 2), "fps": Fraction(24)}
    stage = open_stage(Roots(tmp_path / "scene", {"lib": tmp_path / "lib"}), "a.usda", "/m", **options)
    assert len(read_usd_mesh(stage).raw_mesh.faces) == 2
    assert sorted(stage.hashes) == ["a.usda", "lib:a.usda", "lib:parts/b.usda"]
    with pytest.raises(UsdError, match="lies outside the scene's folder"):
        open_stage(Roots(tmp_path / "scene", {}), "a.usda", "/m", **options)


def test_value_clips_are_refused_and_packages_read(tmp_path: Path) -> None:
    clips = 'def Xform "m" ( clips = { dictionary default = { asset[] assetPaths = [@/etc/passwd@] } } ) {}'
    assert "value clips" in str(refused(lambda: opened(tmp_path, clips)))
    from pxr import UsdUtils

    (tmp_path / "b.usda").write_text(usda(mesh(), 'defaultPrim = "m"'))
    (tmp_path / "top.usda").write_text(usda(linked("./b.usda"), 'defaultPrim = "m"'))
    assert UsdUtils.CreateNewUsdzPackage(str(tmp_path / "top.usda"), str(tmp_path / "set.usdz"))
    stage = open_stage(Roots(tmp_path, {}), "set.usdz", "/m", up="y", frames=range(1, 2), fps=Fraction(24))
    assert len(read_usd_mesh(stage).raw_mesh.faces) == 2 and list(stage.hashes) == ["set.usdz"]


def test_a_file_that_changed_is_read_again(tmp_path: Path) -> None:
    assert len(read_usd_mesh(opened(tmp_path, mesh())).raw_mesh.faces) == 2
    one = mesh().replace("[4]", "[3]").replace("[0, 1, 2, 3]", "[0, 1, 2]")
    assert len(read_usd_mesh(opened(tmp_path, one)).raw_mesh.faces) == 1


# --- in scenes -----------------------------------------------------------------------------------------------------------


def scene(folder: Path, text: str, **choices: object) -> tuple[Shot | None, Report]:
    (folder / "scene.yaml").write_text(text)
    (folder / "walker.ant").write_text(usd_sets.PROGRAM)
    return open_scene(folder / "scene.yaml", RunChoices(**choices))  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def both(tmp_path_factory: pytest.TempPathFactory) -> tuple[Shot, Shot]:
    """The set through USD and as it was baked by hand."""
    folder = tmp_path_factory.mktemp("set")
    path = usd_sets.write_usd(folder / "assets", folder / "usd")
    shots = []
    for file, choices in ((path, RunChoices({"assets": folder / "assets"})), (usd_sets.bake(folder / "baked"), RunChoices())):
        shot, report = open_scene(file, choices)
        assert shot is not None and not report.diagnostics, report.diagnostics
        shots.append(shot)
    return shots[0], shots[1]


def test_the_set_is_what_was_baked_by_hand(both: tuple[Shot, Shot]) -> None:
    usd, baked = (shot.setting for shot in both)
    for name in ("ground", "stones", "roller"):
        one, two = ({**s.surfaces, **s.obstacles}[name] for s in (usd, baked))
        assert np.array_equal(one.faces, two.faces) and np.abs(one.vertices - two.vertices).max() < 1e-5
    for frame in (0, 1, 20, 39):
        one, two = (s.motion.meshes["roller"].compute_vertices(s.obstacles["roller"].vertices, frame) for s in (usd, baked))
        assert np.abs(one - two).max() < 1e-5
    assert np.abs(usd.curves["way"] - baked.curves["way"]).max() < 1e-5
    for one, two in zip(usd.items["food"], baked.items["food"], strict=True):
        assert one.name == two.name and np.allclose(one.position, two.position, atol=1e-5) and one.attributes == two.attributes
        assert one.radius == pytest.approx(two.radius)
    assert len(usd.cameras["shot"].at) == 40
    assert np.allclose(usd.cameras["shot"].at[[0, -1]], [(-50, 282.8427, 282.8427), (50, 282.8427, 282.8427)], atol=1e-3)
    assert {"assets:set/set.usda", "assets:set/parts/stone.usdc"} <= set(both[0].inputs)
    assert {"roller.0001.obj", "roller.0040.obj"} <= set(both[1].inputs)


def winding(points: np.ndarray, vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """How often a closed mesh lies around points (van Oosterom, Strackee, The Solid Angle of a Plane Triangle, 1983, p. 125)."""
    a, b, c = (vertices[faces[:, k]][None] - points[:, None] for k in range(3))
    la, lb, lc = (np.linalg.norm(v, axis=2) for v in (a, b, c))
    above = (a * np.cross(b, c)).sum(axis=2)
    below = la * lb * lc + (a * b).sum(axis=2) * lc + (b * c).sum(axis=2) * la + (c * a).sum(axis=2) * lb
    return np.arctan2(above, below).sum(axis=1) / (2 * np.pi)


def test_both_run_alike_and_no_agent_is_ever_inside_a_stone(both: tuple[Shot, Shot]) -> None:
    worst = 0.0
    pushed = np.inf
    for one, two in zip(simulate(both[0]), simulate(both[1]), strict=True):
        walkers = [world.populations["walker"] for world in (one, two)]
        position_sets = [p.position[p.get_rows_by_id()] for p in walkers]
        worst = max(worst, float((np.abs(position_sets[0] - position_sets[1]).max(axis=1) / 5.0).max()))
        stones = both[0].setting.obstacles["stones"]
        assert np.abs(winding(position_sets[0], stones.vertices, stones.faces)).max() < 0.5
        rest = both[0].setting.obstacles["roller"]
        at = both[0].setting.motion.meshes["roller"].compute_vertices(rest.vertices, one.frame - 1)
        assert np.abs(winding(position_sets[0], at, rest.faces)).max() < 0.5, one.frame
        pushed = min(pushed, float(np.linalg.norm(position_sets[0] - at.mean(axis=0), axis=1).min()))
        states = [p.now["main.state"][p.get_rows_by_id()] for p in walkers]
        assert np.array_equal(*states)
    assert worst < 1e-5, worst
    assert pushed < 25, "somebody is in the way of the roller, whose radius is 15 mm"


def test_winding_numbers_tell_inside_from_outside() -> None:
    points, faces = usd_sets.stone()
    query_points = np.array([[0.0, 0, 0], [5.0, 0, 0]])
    assert np.allclose(winding(query_points, points.astype(np.float64), faces), [1, 0], atol=1e-6)


def test_mistakes_are_reported_at_their_place(tmp_path: Path) -> None:
    usd_sets.write_usd(tmp_path / "assets", tmp_path)
    grants = {"assets": tmp_path / "assets"}

    def find_error(old: str, new: str) -> tuple[str, str]:
        shot, report = scene(tmp_path, usd_sets.FROM_USD.replace(old, new), grants=grants)
        assert shot is None and len(report.errors) == 1, report.errors
        error = report.errors[0]
        assert error.span is not None
        return error.code, error.span.text

    assert find_error("/set/stones}", "/set/stnes}") == ("no-such-prim", "/set/stnes")
    assert find_error("/set/way}", "/set/stones}") == ("no-such-prim", "/set/stones")
    assert find_error("/shot/camera}", "/set/food}") == ("no-such-prim", "/set/food")
    assert find_error("prim: /set/stones}", "prim: /set/stones, units: cm}") == ("unknown-key", "units")
    assert find_error("each: {load: 5}", "each: {lod: 5}") == ("unknown-thing", "lod")
    assert find_error("prim: /set/stones}", "prim: /set/stones, each: {load: 1}}")[0] == "wrong-kind"
    assert find_error("assets:set/set.usda, prim: /set/stones", "assets:set/sat.usda, prim: /set/stones") == (
        "no-such-file",
        "assets:set/sat.usda",
    )
    assert find_error("place: {on: ground}", "place: {on: ground, around: nobody, radius: 5 mm}") == ("unknown-thing", "nobody")
    shot, report = scene(
        tmp_path,
        usd_sets.FROM_USD.replace("place: {on: ground}", "place: {on: ground, around: food_1, radius: 5 mm}"),
        grants=grants,
    )
    assert shot is not None and shot.setting.crowds[0].place.disc_centre == shot.setting.items["food"][1].position
    _, report = scene(tmp_path, usd_sets.FROM_USD)
    assert {d.code for d in report.errors} == {"root-not-granted"}


HOMING_PROGRAM = """ant 1
use steering
world { surface ground; flow home; items food }
species walker {
  size 4 mm
  start go
  state go { steer toward(home) }
}
"""
SPOTS = """def Xform "food" {
  def Xform "a" {}
  def Xform "b" { double3 xformOp:translate = (1, 0, 2)
    uniform token[] xformOpOrder = ["xformOp:translate"]
  }
}
"""


@pytest.mark.parametrize(
    ("goal", "which", "positions"),
    [("food", None, [[0, 0, 0], [1, 0, 2]]), ("a", 0, [[0, 0, 0]]), ("b", 1, [[1, 0, 2]]), ("c", None, [])],
)
@pytest.mark.parametrize("key", ["solved", "toward"])
def test_flows_lead_to_items_of_a_file(
    tmp_path: Path, key: str, goal: str, which: int | None, positions: list[list[float]]
) -> None:
    (tmp_path / "set.usda").write_text(usda(SPOTS + mesh(), MM))
    (tmp_path / "walker.ant").write_text(HOMING_PROGRAM)
    path = tmp_path / "scene.yaml"
    path.write_text(
        "antdsl: 1\nworld:\n  ground: {usd: set.usda, prim: /m}\n  food: {usd: set.usda, prim: /food}\n"
        f"  home: {{{key}: {goal}}}\ncrowd:\n  - {{species: walker, from: walker.ant, count: 1}}\n"
    )
    shot, report = open_scene(path, RunChoices())
    if positions:
        assert shot is not None, report.errors
        flow = shot.setting.flows["home"]
        assert isinstance(flow, SolvedFlowData | SpreadFlowData)
        assert (flow.target.name, flow.target.item_index, flow.target.positions.tolist()) == ("food", which, positions)
    else:
        [error] = report.errors
        assert error.code == "unknown-thing" and error.span is not None and error.span.text == goal
        assert error.help == "known: `a`, `b`, `food`"


def test_without_usd_core_the_extra_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from antdsl.scene.geometry.usd import errors

    usd_sets.write_usd(tmp_path / "assets", tmp_path)
    errors.import_pxr_module.cache_clear()
    for name in [name for name in sys.modules if name.split(".")[0] == "pxr"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "pxr", None)
    _, report = scene(tmp_path, usd_sets.FROM_USD, grants={"assets": tmp_path / "assets"})
    errors.import_pxr_module.cache_clear()
    assert {d.code for d in report.errors} == {"missing-extra"}
    assert report.errors[0].help == 'install it: pip install "antdsl[usd]"'


def test_shapes_that_are_no_meshes_are_warned_of(tmp_path: Path) -> None:
    path = usd_sets.write_usd(tmp_path / "assets", tmp_path)
    file = tmp_path / "assets" / "set" / "set.usda"
    from pxr import Usd, UsdGeom

    stage = Usd.Stage.Open(str(file))
    UsdGeom.Sphere.Define(stage, "/set/stones/ball")
    stage.Save()
    del stage
    shot, report = open_scene(path, RunChoices({"assets": tmp_path / "assets"}))
    assert shot is not None and [d.code for d in report.diagnostics] == ["usd-left-out"]


PAINTED = """ant 1
use steering
world { surface ground; flow comb; map damp }
species walker {
  size 4 mm
  max_speed 20 mm/s
  wet = 0
  start go
  state go amber { steer along(comb); wet = damp }
  layers { state }
}
"""


def test_paint_comes_out_of_the_file_of_its_surface(tmp_path: Path) -> None:
    """Painted in a z-up file along its y, on ground that the scene turns about its up and carries off."""
    primvars = 'float[] primvars:damp = [0, 1, 1, 0] ( interpolation = "vertex" )\n'
    primvars += 'vector3f[] primvars:comb = [(0,2,0), (0,1,0), (0,1,0), (0,1,0)] ( interpolation = "vertex" )'
    head = 'metersPerUnit = 0.1\nupAxis = "Z"'
    (tmp_path / "g.usda").write_text(usda(mesh(properties=primvars), head))
    (tmp_path / "w.ant").write_text(PAINTED)
    text = "antdsl: 1\nframes: 1..5\nworld:\n  ground: {usd: g.usda, prim: /m, KEYS}\n"
    text += "  comb: {painted: g.usda, on: ground}\n  damp: {painted: g.usda, attribute: damp}\n"
    text += "crowd: [{species: walker, from: w.ant, count: 30, place: {on: ground}}]\n"
    for keys, direction in (
        ("rotate: [0, 90, 0]", (-1, 0, 0)),
        ("keys: {1: {rotate: [0, 0, 0]}, 5: {at: [0, 0, 50], rotate: [0, 90, 0]}}", (0, 0, -1)),
    ):
        (tmp_path / "scene.yaml").write_text(text.replace("KEYS", keys))
        shot, report = open_scene(tmp_path / "scene.yaml")
        assert shot is not None and not report.errors, report.errors
        painted = shot.setting.flows["comb"].values  # type: ignore[union-attr]
        assert np.allclose(painted, [direction] * 4, atol=1e-12), "along the file's y, and no longer than 1"
        for world in simulate(shot):
            walkers = world.populations["walker"]
        turned = np.array([(-1.0, 0, 0)])  # in both the ground has turned by a quarter at the end
        heading = walkers.read_vector("velocity")
        fast = np.linalg.norm(heading, axis=1) > 1
        assert fast.any() and (heading[fast] @ turned[0] > 0.9 * np.linalg.norm(heading[fast], axis=1)).mean() > 0.9
        corner = walkers.now["wet"]
        assert corner.min() >= 0 and corner.max() <= 1 and np.ptp(corner) > 0.5
    for old, new, code in (
        ("attribute: damp", "attribute: dry", "no-such-prim"),
        ("attribute: damp", "attribute: comb", "bad-paint"),
    ):
        (tmp_path / "scene.yaml").write_text(text.replace("KEYS", "scale: 2").replace(old, new))
        assert [d.code for d in open_scene(tmp_path / "scene.yaml")[1].errors] == [code]


# --- groups of an .obj ---------------------------------------------------------------------------------------------------

GROUPED = b"v 0 0 0\nv 1 0 0\nv 0 0 1\nv 0 1 0\no hill\nf 1 2 3\ng stones big\nf 1 2 4\nf 2 3 4\ng\nf 1 3 4\no tree\nf 1 3 4\n"


def test_an_obj_is_read_by_group_or_object() -> None:
    assert len(read_mesh(GROUPED, "a.obj").faces) == 4  # one is given twice
    assert len(read_mesh(GROUPED, "a.obj", "stones").faces) == 2
    assert len(read_mesh(GROUPED, "a.obj", "tree").faces) == 1
    with pytest.raises(MeshError, match="did you mean `stones`"):
        read_mesh(GROUPED, "a.obj", "stone")
    with pytest.raises(MeshError, match="has no groups"):
        read_mesh(b"ply", "a.ply", "stones")


def test_a_group_in_a_scene(tmp_path: Path) -> None:
    usd_sets.bake(tmp_path)
    (tmp_path / "all.obj").write_bytes(
        b"g other\nv 9 9 9\n" + b"g stones\n" + (tmp_path / "stones.obj").read_bytes().replace(b"f ", b"f ")
    )
    text = (tmp_path / "scene.yaml").read_text()
    shifted = (tmp_path / "all.obj").read_text().splitlines()
    faces = ["f " + " ".join(str(int(k) + 1) for k in line.split()[1:]) if line.startswith("f ") else line for line in shifted]
    (tmp_path / "all.obj").write_text("\n".join(faces) + "\n")
    shot, report = scene(tmp_path, text.replace("{mesh: stones.obj}", "{mesh: all.obj, group: stones}"))
    assert shot is not None and not report.diagnostics
    plain, _ = scene(tmp_path, text)
    assert plain is not None and np.array_equal(
        shot.setting.obstacles["stones"].vertices, plain.setting.obstacles["stones"].vertices
    )
    _, report = scene(tmp_path, text.replace("{mesh: stones.obj}", "{mesh: all.obj, group: stnes}"))
    assert [(d.code, d.span.text) for d in report.errors if d.span] == [("bad-mesh", "stnes")]


def test_backends_agree_on_a_set_that_moves(both: tuple[Shot, Shot]) -> None:
    from itertools import islice

    from antdsl.runtime import state_hash

    runs = [
        [state_hash(w) for w in islice(simulate(both[0], o), 4)]
        for o in (Options(), Options(backend="reference"), Options(chunk=7, threads=2, shuffle_rows=3))
    ]
    assert runs[0] == runs[1] == runs[2]
