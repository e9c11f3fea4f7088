"""Computed tables of a mesh are cached while it is the same mesh, and never for one that can change."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from antdsl.pipeline import open_scene
from antdsl.scene.setting import MeshData
from antdsl.scene.staging.mesh_cache import cache_per_mesh

FORAGING = Path(__file__).parents[2] / "examples" / "foraging"


def mesh(writeable: bool) -> MeshData:
    new_mesh = MeshData(np.eye(3), np.array([[0, 1, 2]], np.int32))
    new_mesh.vertices.setflags(write=writeable)
    return new_mesh


def test_work_is_done_once_for_a_mesh_that_cannot_change() -> None:
    calls = []

    @cache_per_mesh
    def work(what: MeshData, number: int) -> int:
        calls.append(what)
        return number

    fixed, other, loose = mesh(False), mesh(False), mesh(True)
    assert [work(fixed, 1), work(fixed, 1), work(other, 1), work(fixed, 2)] == [1, 1, 1, 2]
    assert calls == [fixed, other, fixed], "another mesh is another one though it holds the same"
    work(loose, 1)
    loose.vertices[0] = 7
    work(loose, 1)
    assert calls[3:] == [loose, loose]


def test_a_scene_that_is_staged_again_is_given_the_same_meshes_and_another_scene_others(tmp_path: Path) -> None:
    for file in FORAGING.iterdir():
        if file.is_file():
            (tmp_path / file.name).write_bytes(file.read_bytes())
    shots = [open_scene(tmp_path / "scene.yaml")[0] for _ in range(2)]
    assert shots[0] is not None and shots[1] is not None
    assert shots[0].setting.surfaces["ground"] is shots[1].setting.surfaces["ground"]
    assert not shots[0].setting.surfaces["ground"].vertices.flags.writeable
    scene = tmp_path / "scene.yaml"
    scene.write_text(scene.read_text().replace("mesh: terrain.ply", "mesh: terrain.ply, scale: 1.5"))
    wider, report = open_scene(scene)
    assert wider is not None, [d.message for d in report.errors]
    np.testing.assert_allclose(wider.setting.surfaces["ground"].vertices, 1.5 * shots[0].setting.surfaces["ground"].vertices)
    assert wider.setting.items["food"][0].position[1] != shots[0].setting.items["food"][0].position[1], "laid on it anew"


def test_a_scene_with_very_many_items_keeps_no_more_than_it_may() -> None:
    calls = []

    @cache_per_mesh
    def work(what: MeshData, *, number: int) -> int:
        calls.append(number)
        return number

    fixed = mesh(False)
    assert [work(fixed, number=k) for k in range(5000)] == list(range(5000))
    assert work(fixed, number=4999) == 4999 and len(calls) == 5000
    assert work(fixed, number=0) == 0 and len(calls) == 5001, "what was forgotten is worked out again"
