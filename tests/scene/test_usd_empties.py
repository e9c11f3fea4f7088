"""Empties of other programs as items: by kind or below a prim, with places, ways they face and properties."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
import pytest

pxr = pytest.importorskip("pxr")

from antdsl import limits  # noqa: E402
from antdsl.diagnostics import Report  # noqa: E402
from antdsl.pipeline import RunChoices, Shot, check_path, open_scene, simulate  # noqa: E402
from antdsl.reload import migrate_world  # noqa: E402
from antdsl.runtime import Options, bind  # noqa: E402
from antdsl.runtime.world import Population  # noqa: E402

PROGRAM = """ant 1
use steering
world {
  surface floor
  items lures    { reach = 300 mm; since = 0 s; strength = 1 }
  items aligners { reach = 500 mm; facing = 0 deg; pace = 60 mm/s; ax = 0; ay = 0; az = 0 }
}
species roach {
  size 30 mm
  max_speed 200 mm/s
  let lure = nearest(lures, with: distance(it) < it.reach and time > it.since)
  on spawn {
    velocity = sum(a in all(aligners): rotate(vector(1, 0, 0), about: up, by: a.facing) * a.pace)
  }
  start run
  state run { steer if lure then seek(lure) else coast() }
  layers { state }
}
"""
SCENE = """antdsl: 1
units: mm
up: {up}
frames: 1..10
world:
  floor: {{mesh: floor.obj}}
  lures: {lures}
  aligners: {aligners}
crowd:
  - {{species: roach, from: roach.ant, count: 5, place: {{on: floor, radius: 200 mm}}}}
"""
# As Blender writes empties: Xforms with matrices or ops, custom properties in the namespace userProperties.
SET = """#usda 1.0
(
  metersPerUnit = 0.01
  upAxis = "Z"
  timeCodesPerSecond = 24
  defaultPrim = "root"
)
def Xform "root" {
  def Xform "crumb" {
    custom string userProperties:kind = "lures"
    custom double userProperties:reach = 12
    custom string userProperties:since = "0.5 s"
    custom int userProperties:strength = 3
    custom string userProperties:blender:object_name = "crumb"
    double3 xformOp:translate = (10, 20, 0)
    uniform token[] xformOpOrder = ["xformOp:translate"]
    def Xform "below" {
      custom token userProperties:kind = "lures"
      custom string userProperties:reach = "7 cm"
      double3 xformOp:translate.timeSamples = { 1: (0, 0, 5), 10: (9, 0, 5) }
      uniform token[] xformOpOrder = ["xformOp:translate"]
    }
  }
  def Xform "arrows" {
    float3 xformOp:rotateXYZ = (0, 0, 90)
    uniform token[] xformOpOrder = ["xformOp:rotateXYZ"]
    def Xform "one" {
      custom float userProperties:pace = 5
      double3 xformOp:translate = (1, 0, 0)
      float3 xformOp:rotateXYZ = (0, 0, 30)
      float3 xformOp:scale = (2, 2, 2)
      uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:rotateXYZ", "xformOp:scale"]
    }
    def Xform "steep" {
      float3 xformOp:rotateXYZ = (0, -90, 0)
      uniform token[] xformOpOrder = ["xformOp:rotateXYZ"]
    }
    def Xform "told" {
      custom double userProperties:facing = -45
    }
  }
  def Xform "lamp" {
    custom string userProperties:kind = "scares"
  }
}
"""
LURES, ALIGNERS = "{usd: set.usda}", "{usd: set.usda, prim: /root/arrows, turn: facing}"


def opened(
    folder: Path, lures: str = LURES, aligners: str = ALIGNERS, *, text: str = SET, up: str = "z"
) -> tuple[Shot | None, Report]:
    corners = ("-900 -900 0", "900 -900 0", "900 900 0", "-900 900 0")
    if up == "y":
        corners = ("-900 0 900", "900 0 900", "900 0 -900", "-900 0 -900")
    (folder / "floor.obj").write_text("".join(f"v {c}\n" for c in corners) + "f 1 2 3\nf 1 3 4\n")
    (folder / "roach.ant").write_text(PROGRAM)
    (folder / "set.usda").write_text(text)
    (folder / "scene.yaml").write_text(SCENE.format(up=up, lures=lures, aligners=aligners))
    return open_scene(folder / "scene.yaml", RunChoices())


def items(folder: Path, *scene: str, **options: str) -> dict[str, dict[str, tuple[np.ndarray, dict[str, float]]]]:
    shot, report = opened(folder, *scene, **options)
    assert shot is not None and not report.errors, report.errors
    return {
        name: {item.name: (np.array(item.position), dict(item.attributes)) for item in them}
        for name, them in shot.setting.items.items()
    }


def test_empties_of_a_kind_are_found_anywhere_with_their_properties(tmp_path: Path) -> None:
    lures = items(tmp_path)["lures"]
    assert list(lures) == ["crumb", "below"]
    place, properties = lures["crumb"]
    assert place.tolist() == [100, 200, 0]
    assert properties == {"reach": 120, "since": 0.5, "strength": 3}, "numbers in the file's unit, words with theirs"
    place, properties = lures["below"]
    assert place.tolist() == [100, 200, 50] and properties == {"reach": 70}


def test_ways_that_empties_face_are_those_of_local_to_world(tmp_path: Path) -> None:
    aligners = items(tmp_path)["aligners"]
    place, properties = aligners["one"]
    assert np.allclose(place, [0, 10, 0], atol=1e-6), "its parent is turned by a quarter"
    assert properties["facing"] == pytest.approx(np.radians(120)) and properties["pace"] == pytest.approx(50)
    assert "facing" not in aligners["steep"][1], "straight up is no angle"
    assert aligners["told"][1]["facing"] == pytest.approx(np.radians(-45)), "a property of that name goes before"


def test_the_scenes_axes_and_its_own_turn_come_after(tmp_path: Path) -> None:
    aligners = items(tmp_path, up="y")["aligners"]
    place, properties = aligners["one"]
    assert np.allclose(place, [0, 0, -10], atol=1e-6) and properties["facing"] == pytest.approx(np.radians(120))
    turned = items(tmp_path, LURES, "{usd: set.usda, prim: /root/arrows, turn: facing, rotate: [0, 0, -100]}")["aligners"]["one"]
    assert turned[1]["facing"] == pytest.approx(np.radians(20))
    axes = items(tmp_path, LURES, "{usd: set.usda, prim: /root/arrows, turn: [ax, ay, az]}")["aligners"]
    facing = [axes["one"][1][key] for key in ("ax", "ay", "az")]
    assert facing == pytest.approx([np.cos(np.radians(120)), np.sin(np.radians(120)), 0], abs=1e-6)
    assert [axes["steep"][1][key] for key in ("ax", "ay", "az")] == pytest.approx([0, 0, 1], abs=1e-6)


def test_what_moves_in_the_file_moves_and_agents_read_the_properties(tmp_path: Path) -> None:
    shot, report = opened(tmp_path)
    assert shot is not None, report.errors
    track = shot.setting.motion.items["lures"]
    assert track[:, 0].tolist() == [[100, 200, 0]] * 10 and track[-1, 1].tolist() == [190, 200, 50]
    crowd = next(iter(simulate(shot, Options(backend="numpy")))).populations["roach"]
    mean_velocity = np.array([crowd.now[f"velocity.{axis}"] for axis in "xyz"]).mean(axis=1)
    paces, angles = np.array([50, 60, 60]), np.radians([120, 0, -45])
    assert mean_velocity == pytest.approx([paces @ np.cos(angles), paces @ np.sin(angles), 0], abs=0.01), "aligners say where to"


def summarise_report(report: Report) -> list[tuple[str, str, str]]:
    return [(d.code, "" if d.span is None else d.span.text, f"{d.message}; {d.help}") for d in report.diagnostics]


@pytest.mark.parametrize(
    ("lures", "aligners", "old", "new", "code", "at", "words"),
    [
        ("{usd: set.usda, kind: lurs}", ALIGNERS, "", "", "no-such-prim", "lurs", "`kind: lures`"),
        ("{usd: set.usda, kind: beds}", ALIGNERS, "", "", "no-such-prim", "beds", "the kinds `lures`, `scares`"),
        (LURES, ALIGNERS, ' = "lures"', ' = ""', "no-such-prim", "", "there are the kinds"),
        (LURES, ALIGNERS, '"7 cm"', '"7 elbows"', "bad-usd", "set.usda", "`reach` of `below` in `set.usda` has `7 elbows`"),
        (LURES, ALIGNERS, "reach = 12", "reach = inf", "bad-usd", "set.usda", "`reach` of `/root/crumb` is inf"),
        (LURES, ALIGNERS, '"7 cm"', '"7 s"', "wrong-unit", "set.usda", "`reach` is a length"),
        (
            LURES,
            ALIGNERS,
            "userProperties:reach = 12",
            "userProperties:reech = 12",
            "usd-left-out",
            "set.usda",
            "did you mean `reach`",
        ),
        (LURES, "{usd: set.usda, prim: /root/arrows, turn: fcing}", "", "", "unknown-thing", "fcing", "`facing`"),
        (LURES, "{usd: set.usda, prim: /root/arrows, turn: pace}", "", "", "wrong-unit", "pace", "`pace = 0 deg`"),
        (LURES, "{usd: set.usda, prim: /root/arrows, turn: [ax, ay, pace]}", "", "", "wrong-unit", "pace", "`pace = 0`"),
    ],
)
def test_mistakes_are_reported(
    tmp_path: Path, lures: str, aligners: str, old: str, new: str, code: str, at: str, words: str
) -> None:
    _, report = opened(tmp_path, lures, aligners, text=SET.replace(old, new) if old else SET)
    matches = [each for each in summarise_report(report) if each[0] == code]
    assert len(matches) == 1, summarise_report(report)
    assert matches[0][1] == at or not at
    assert words in matches[0][2]


def test_a_surface_has_no_kind_and_a_file_may_be_a_surface_whole(tmp_path: Path) -> None:
    quad = 'def Mesh "m" {\n point3f[] points = [(-90,-90,0),(90,-90,0),(90,90,0),(-90,90,0)]\n'
    quad += " int[] faceVertexCounts = [4]\n int[] faceVertexIndices = [0,1,2,3]\n}"
    opened(tmp_path, text=SET + quad)
    text = (tmp_path / "scene.yaml").read_text()
    (tmp_path / "scene.yaml").write_text(text.replace("{mesh: floor.obj}", "{usd: set.usda, kind: floor}"))
    _, report = open_scene(tmp_path / "scene.yaml", RunChoices())
    assert [each[:2] for each in summarise_report(report)] == [("wrong-kind", "kind")]
    (tmp_path / "scene.yaml").write_text(text.replace("{mesh: floor.obj}", "{usd: set.usda}"))
    shot, report = open_scene(tmp_path / "scene.yaml", RunChoices())
    assert shot is not None and np.abs(shot.setting.surfaces["floor"].vertices).max() == 900, report.errors


def test_too_many_are_refused_before_they_are_placed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(limits, "MAX_AGENTS", 4)
    many = SET + "".join(f'def Xform "n{k}" {{\n custom string userProperties:kind = "lures"\n}}\n' for k in range(9))
    shot, report = opened(tmp_path, text=many)
    assert shot is None and "too-large" in {d.code for d in report.errors}


def test_without_usd_core_the_extra_is_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from antdsl.scene.geometry.usd import errors

    errors.import_pxr_module.cache_clear()
    for name in [name for name in sys.modules if name.split(".")[0] == "pxr"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "pxr", None)
    _, report = opened(tmp_path)
    errors.import_pxr_module.cache_clear()
    assert {d.code for d in report.errors} == {"missing-extra"}
    assert report.errors[0].help == 'install it: pip install "antdsl[usd]"'


def test_agents_begin_at_empties(tmp_path: Path) -> None:
    coordinates = [(-40, 10), (0, 20), (55, -5)]
    boids = "".join(
        f'def Xform "boid{k}" {{\n custom string userProperties:kind = "roach"\n double3 xformOp:translate = ({x}, {y}, 3)\n'
        f' uniform token[] xformOpOrder = ["xformOp:translate"]\n}}\n'
        for k, (x, y) in enumerate(coordinates)
    )
    opened(tmp_path, text=SET + boids)
    text = (tmp_path / "scene.yaml").read_text().replace("count: 5, place: {on: floor, radius: 200 mm}", "count: 3, place: PLACE")
    for place in ("{on: floor, points: {usd: set.usda}}", "{points: {usd: set.usda, prim: /, kind: roach}}"):
        (tmp_path / "scene.yaml").write_text(text.replace("PLACE", place))
        shot, report = open_scene(tmp_path / "scene.yaml", RunChoices())
        assert shot is not None, report.errors
        points = shot.setting.crowds[0].place.points
        assert points is not None and points.tolist() == [[10 * x, 10 * y, 30] for x, y in coordinates]
    crowd = next(iter(simulate(shot, Options(backend="numpy")))).populations["roach"]
    born = np.array([crowd.now[f"position.{axis}"] for axis in "xyz"]).T[np.argsort(crowd.ids)]
    assert np.abs(born - [[10 * x, 10 * y, 0] for x, y in coordinates]).max() < 12, "a step of 200 mm/s from there, on the floor"
    for place, at in (("{points: {usd: set.usda, kind: bed}}", "bed"), ("{points: {usd: none.usda}}", "none.usda")):
        (tmp_path / "scene.yaml").write_text(text.replace("PLACE", place))
        _, report = open_scene(tmp_path / "scene.yaml", RunChoices())
        assert [each[1] for each in summarise_report(report)] == [at], summarise_report(report)


BOIDS = """ant 1
use steering
world { surface floor }
species roach {
  size  30 mm
  radius size / 2
  max_speed 200 mm/s
  nerve = 0.25
  calm  = false
  reach = size * 4
  seen  = 0 mm
  on spawn { seen = reach }
  start run
  state run { steer coast(); when calm and seen > nerve * 1 m -> rest }
  state rest { when not calm -> run }
  layers { state }
}
"""


def boids(folder: Path, floor: str = "-900 -900 0", extra: str = "") -> tuple[Shot, Report]:
    """Three empties: one turned by 30 degrees and pitched, with properties; one that points straight up; one with fewer."""
    empties = [
        ("a", (-40, 10, 3), (0, -20, 30), 'custom double userProperties:size = 5\n custom string userProperties:nerve = "0.75"'),
        ("b", (0, 20, 3), (0, -90, 0), "custom bool userProperties:calm = true\n custom double userProperties:reach = 9"),
        ("c", (55, -5, 3), (0, 0, -90), ""),
    ]
    text = "".join(
        f'def Xform "{name}" {{\n custom string userProperties:kind = "roach"\n {own}\n {extra if name == "a" else ""}\n'
        f" double3 xformOp:translate = {at}\n float3 xformOp:rotateXYZ = {turn}\n"
        f' uniform token[] xformOpOrder = ["xformOp:translate", "xformOp:rotateXYZ"]\n}}\n'
        for name, at, turn, own in empties
    )
    opened(folder, text=SET + text)
    (folder / "roach.ant").write_text(BOIDS)
    (folder / "floor.obj").write_text(f"v {floor}\nv 900 -900 0\nv 900 900 0\nv -900 900 0\nf 1 2 3\nf 1 3 4\n")
    scene = "antdsl: 1\nunits: mm\nup: z\nframes: 1..10\nworld: {floor: {mesh: floor.obj}}\ncrowd:\n"
    scene += "  - {species: roach, from: roach.ant, count: 4, place: {on: floor, points: {usd: set.usda}}}\n"
    (folder / "scene.yaml").write_text(scene)
    shot, report = open_scene(folder / "scene.yaml", RunChoices())
    assert shot is not None, report.errors
    return shot, report


def of_all(crowd: Population, *names: str) -> np.ndarray:
    return np.stack([crowd.now[name] for name in names], axis=1)[np.argsort(crowd.ids)].astype(np.float64)


AHEAD = ("heading.x", "heading.y", "heading.z")


@pytest.mark.parametrize("backend", ["numpy", "reference"])
def test_agents_face_as_their_empties_do(tmp_path: Path, backend: str) -> None:
    crowd = bind(boids(tmp_path)[0].plan, boids(tmp_path)[0].setting, Options(backend=backend)).populations["roach"]
    heading = of_all(crowd, *AHEAD)
    thirty = np.radians(30)
    assert heading[0] == pytest.approx([np.cos(thirty), np.sin(thirty), 0], abs=1e-6), "flattened to the floor"
    assert heading[2] == pytest.approx([0, -1, 0], abs=1e-6)
    assert heading[3] == pytest.approx(heading[0], abs=1e-6), "the empties begin anew when they run out"
    assert np.abs(np.linalg.norm(heading, axis=1) - 1).max() < 1e-6 and heading[1][2] == 0, "straight up is no way: it is drawn"
    velocity = of_all(crowd, "velocity.x", "velocity.y", "velocity.z")
    assert np.abs(np.cross(velocity, heading)).max() < 1e-4 and (np.einsum("ij,ij->i", velocity, heading) >= 0).all()


def test_headings_lie_along_a_slope(tmp_path: Path) -> None:
    shot, _ = boids(tmp_path, floor="-900 -900 400")
    crowd = bind(shot.plan, shot.setting).populations["roach"]
    up, heading = of_all(crowd, "up.x", "up.y", "up.z"), of_all(crowd, *AHEAD)
    assert np.abs(np.einsum("ij,ij->i", up, heading)).max() < 1e-6 and np.abs(heading[0, 2]) > 0.05
    empty_direction = np.array(
        [np.cos(np.radians(30)) * np.cos(np.radians(20)), 0.5 * np.cos(np.radians(20)), np.sin(np.radians(20))]
    )
    flat = empty_direction - (empty_direction @ up[0]) * up[0]
    assert heading[0] == pytest.approx(flat / np.linalg.norm(flat), abs=1e-5), "the empty's own +x, laid along the ground"


@pytest.mark.parametrize("backend", ["numpy", "reference"])
def test_properties_of_empties_are_what_agents_begin_with(tmp_path: Path, backend: str) -> None:
    shot, report = boids(tmp_path)
    assert [d.code for d in (*report.diagnostics, *check_path(tmp_path / "scene.yaml")[1].diagnostics)] == []
    crowd = bind(shot.plan, shot.setting, Options(backend=backend)).populations["roach"]
    own = of_all(crowd, "size", "radius", "nerve", "calm", "reach", "seen")
    assert own[0].tolist() == [50, 25, 0.75, 0, 200, 200], "in the file's unit; what is worked out from it follows"
    assert own[1].tolist() == [30, 15, 0.25, 1, 90, 90], "`on spawn` sees it too"
    assert own[2].tolist() == [30, 15, 0.25, 0, 120, 120] and own[3].tolist() == own[0].tolist()


def test_what_empties_give_stays_through_an_edit_and_follows_the_file(tmp_path: Path) -> None:
    shot, _ = boids(tmp_path)
    world = bind(shot.plan, shot.setting)
    (tmp_path / "roach.ant").write_text(BOIDS.replace("size  30 mm", "size  36 mm\n  more = nerve"))
    edited, _ = open_scene(tmp_path / "scene.yaml", RunChoices())
    assert edited is not None
    edited_world, _ = migrate_world(world, edited.plan, edited.setting)
    assert of_all(edited_world.populations["roach"], "size", "more").tolist() == [[50, 0.75], [36, 0.25], [36, 0.25], [50, 0.75]]
    text = (tmp_path / "set.usda").read_text()
    (tmp_path / "set.usda").write_text(text.replace("userProperties:size = 5", "userProperties:size = 6"))
    again, _ = open_scene(tmp_path / "scene.yaml", RunChoices())
    assert again is not None
    last, _ = migrate_world(edited_world, again.plan, again.setting)
    assert of_all(last.populations["roach"], "size").ravel().tolist() == [60, 36, 36, 60]


def test_properties_of_boids_are_read_with_care(tmp_path: Path) -> None:
    _, report = boids(tmp_path, extra="custom double userProperties:nerv = 1")
    left_out = [d for d in report.diagnostics if d.code == "usd-left-out"]
    assert len(left_out) == 1 and left_out[0].help == "`nerv`: did you mean `nerve`?"
    text = (tmp_path / "set.usda").read_text()
    (tmp_path / "set.usda").write_text(text.replace('userProperties:nerve = "0.75"', 'userProperties:nerve = "2 mm"'))
    shot, report = open_scene(tmp_path / "scene.yaml", RunChoices())
    assert shot is None and [d.code for d in report.errors] == ["wrong-unit"]
    assert report.errors[0].span is not None and report.errors[0].span.text == "set.usda"
