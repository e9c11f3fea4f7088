"""Looks of surfaces and natural colours of bodies: from the scene to the cache, pictures and exports."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import trimesh
from meshes import box, grid

from antdsl.bodies.posed_body import NO_DRIVEN_POSE
from antdsl.outputs.cache.cache_reader import Arrays, CacheView, open_cache
from antdsl.outputs.exports import find_export
from antdsl.outputs.gallery import Gallery
from antdsl.outputs.pictures import compute_legend_width
from antdsl.outputs.pictures.light import decode_srgb
from antdsl.outputs.pictures.surface_materials import KIND_NAMES, PictureScales, make_surface_material
from antdsl.outputs.recording import begin_recording, record_frames
from antdsl.pipeline import open_scene
from antdsl.runtime import Options
from antdsl.scene.looks import LOOK_WORDS, SURFACE_KINDS, find_kind_by_name

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
        and ", ".join(f"`{word}`" for word in LOOK_WORDS) in diagnostic.message
        and diagnostic.help == "did you mean `metal`?"
    )


@pytest.mark.parametrize("kind", sorted(SURFACE_KINDS.keys() - {"metal", "light"}))
def test_surfaces_are_drawn_in_the_colour_that_exports_have(kind: str) -> None:
    rng = np.random.default_rng(5)
    points, up = rng.uniform(-200, 200, (4000, 3)).astype(np.float32), np.array([0, 1, 0], np.float32)
    normal = np.tile(up, (len(points), 1))
    kinds, none = np.full(len(points), KIND_NAMES.index(kind), np.uint8), np.zeros((len(points), 4), np.float32)
    drawn = make_surface_material(kinds, points, normal, up, np.full(len(points), 2.0, np.float32), PictureScales(400, 6), none)
    assert np.isfinite(drawn.albedo).all() and (drawn.albedo >= 0).all()
    assert np.allclose(drawn.albedo.mean(axis=0), decode_srgb(SURFACE_KINDS[kind].colour), atol=0.02)


@pytest.mark.parametrize(("name", "kind"), [("Oak_bark", "bark"), ("leaf.3", "leaf"), ("sandbox", "sand"), ("floor", None)])
def test_names_of_meshes_choose_their_look(name: str, kind: str | None) -> None:
    assert find_kind_by_name(name) == kind


class _Recoloured(CacheView):
    """A cache in which the first agent has another colour, as after an edit."""

    def frame(self, number: int, names: frozenset[str] | None = None) -> Arrays:
        arrays = dict(self.source.frame(number, names))
        arrays["Cd"] = np.concatenate([np.array([[0.1, 0.9, 0.2]], np.float32), arrays["Cd"][1:]])
        return arrays


@pytest.fixture(scope="module")
def shot_folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("natural")
    shot, report = open_scene(project(folder))
    assert shot is not None, str(report)
    for _ in record_frames(begin_recording(shot, folder / "out", Options(), resume=False, force=False)):
        pass
    return folder / "out"


def test_bodies_have_natural_colours_and_those_of_states_and_edits_on_request(shot_folder: Path) -> None:
    cache = open_cache(shot_folder)
    stored = cache.frame(2)["Cd"]
    natural, of_states = (Gallery(cache, shows_states=shows).make_picture(2) for shows in (False, True))
    body = natural.crowds[0].body
    assert np.allclose(decode_srgb(natural.crowds[0].colour), body.compute_natural_colours(NO_DRIVEN_POSE, 3), atol=1e-6)
    assert (of_states.crowds[0].colour == stored).all() and not np.allclose(natural.crowds[0].colour, stored, atol=0.05)
    assert natural.legend[0].colour is None and of_states.legend[0].colour is not None
    assert compute_legend_width(natural, 960, ()) == compute_legend_width(of_states, 960, ())
    edited = Gallery(_Recoloured.of(cache)).make_picture(2).crowds[0]
    assert np.allclose(edited.colour[0], [0.1, 0.9, 0.2]) and (edited.colour[1:] == natural.crowds[0].colour[1:]).all()
    assert edited.is_marked is not None and edited.is_marked.tolist() == [True, False, False]


def test_gltf_has_natural_colours_and_the_materials_of_surfaces(shot_folder: Path, tmp_path: Path) -> None:
    export = find_export(tmp_path / "a.gltf")
    assert export is not None
    materials = {}
    for shows in (False, True):
        export.forms["skinned"](Gallery(open_cache(shot_folder), shows_states=shows), [1, 2], tmp_path / "a.gltf")
        parts = json.loads((tmp_path / "a.gltf").read_text())["materials"]
        materials[shows] = {part["name"]: part["pbrMetallicRoughness"] for part in parts}
    body = Gallery(open_cache(shot_folder)).make_picture(2).crowds[0].body
    natural = body.compute_natural_colours(NO_DRIVEN_POSE, 1)[0]
    assert np.allclose(materials[False]["state"]["baseColorFactor"][:3], natural, atol=1e-5)
    assert not np.allclose(materials[True]["state"]["baseColorFactor"][:3], natural, atol=0.02)
    assert materials[False]["metal"]["metallicFactor"] == 1.0 and materials[False]["leaf"]["roughnessFactor"] == 0.5


def test_a_crowd_of_no_agents_has_no_colours(shot_folder: Path) -> None:
    picture = Gallery(open_cache(shot_folder)).make_picture(2)
    crowd = picture.crowds[0].select_rows(np.zeros(3, np.bool_))
    assert crowd.body.compute_natural_colours(NO_DRIVEN_POSE, 0).shape == (0, 3) and crowd.is_marked is not None
    assert len(crowd.is_marked) == 0 and replace(crowd, is_marked=None).colour.shape == (0, 3)
