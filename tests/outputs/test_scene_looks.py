"""`look` of a scene: set for meshes and items, stored in the cache, drawn; an unknown word is reported with the known ones."""

from __future__ import annotations

from pathlib import Path

import trimesh
from meshes import box, grid

from antdsl.outputs.cache.cache_reader import open_cache
from antdsl.outputs.gallery import Gallery
from antdsl.outputs.recording import begin_recording, record_frames
from antdsl.pipeline import open_scene
from antdsl.runtime import Options

PROGRAM = """ant 1
use steering
world { surface ground
  obstacle can
  items food { load = 1 } }
species walker { max_speed 30 mm/s
  start stroll
  state stroll { steer wander() }
  layers { state } }
"""
SCENE = """antdsl: 1
units: mm
frames: 1..2
world:
  ground: {mesh: ground.ply, look: leaf}
  can: {mesh: can.ply, look: metal}
  food: {crumb: {at: [0, 0, 20], look: light}, hidden: {at: [9, 0, 20], look: none}, apple: {at: [20, 0, 0]}}
crowd: [{species: walker, from: walker.ant, count: 3, place: {on: ground}}]
"""


def project(folder: Path, scene: str = SCENE) -> Path:
    (folder / "walker.ant").write_text(PROGRAM)
    for name, (vertices, faces) in {"ground": grid(200.0, 8), "can": box((30, 0, 30), (50, 20, 50))}.items():
        trimesh.Trimesh(vertices, faces, process=False).export(folder / f"{name}.ply")
    (folder / "scene.yaml").write_text(scene)
    return folder / "scene.yaml"


def test_pictures_draw_what_the_scene_says_and_the_cache_keeps_it(tmp_path: Path) -> None:
    shot, report = open_scene(project(tmp_path))
    assert shot is not None, str(report)
    for _ in record_frames(begin_recording(shot, tmp_path / "out", Options(), resume=False, force=False)):
        pass
    cache = open_cache(tmp_path / "out")
    assert {mesh.name: mesh.look for mesh in cache.manifest.meshes} == {"ground": "leaf", "can": "metal"}
    picture = Gallery(cache).make_picture(2)
    assert {solid.name: solid.kind for solid in picture.solids} == {"ground": "leaf", "can": "metal"}
    assert {item.name: (item.shape, item.look) for item in picture.items} == {
        "crumb": ("crumb", "light"), "hidden": ("none", None), "apple": ("apple", None),
    }  # fmt: skip


def test_a_mesh_that_is_not_to_be_seen_is_walked_on_all_the_same(tmp_path: Path) -> None:
    shot, report = open_scene(project(tmp_path, SCENE.replace("look: leaf", "look: none")))
    assert shot is not None, str(report)
    for _ in record_frames(begin_recording(shot, tmp_path / "out", Options(), resume=False, force=False)):
        pass
    picture = Gallery(open_cache(tmp_path / "out")).make_picture(2)
    assert [solid.name for solid in picture.solids] == ["can"] and len(picture.crowds[0].position) == 3


def test_an_unknown_look_is_reported_with_the_known_ones(tmp_path: Path) -> None:
    shot, report = open_scene(project(tmp_path, SCENE.replace("look: metal", "look: mettal")))
    diagnostic = report.sort_by_place()[0]
    assert (
        shot is None
        and "`metal`, `soil`, `leaf`, `light`, `none`" in diagnostic.message
        and diagnostic.help == "did you mean `metal`?"
    )
