"""Surfaces and solids of which little or nothing is left: thin faces, tiny meshes, and a `weld` that is too large."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from plans import bare, block
from scene.test_mesh_imports import WALKER

from antdsl.diagnostics import Diagnostic
from antdsl.ground.mesh.topology import build
from antdsl.pipeline import check_path
from antdsl.runtime.binding.bind_world import bind
from antdsl.scene.geometry.live_faces import has_live_face
from antdsl.scene.setting import CrowdData, MeshData, PlaceData, Setting


def quad(width: float, depth: float) -> bytes:
    points = [(-width, 0, -depth), (width, 0, -depth), (width, 0, depth), (-width, 0, depth)]
    return b"".join(b"v %r %r %r\n" % tuple(map(float, point)) for point in points) + b"f 4 3 2 1\n"


def findings(folder: Path, world: str, place: str = "on: ground", kind: str = "surface") -> list[Diagnostic]:
    """What `check` says about a scene with some meshes."""
    things = "surface ground" if kind == "surface" else f"{kind} ground"
    more = "; surface dot" if "dot:" in world else ""
    (folder / "walker.ant").write_text(WALKER.replace("surface ground", things + more))
    scene = folder / "scene.yaml"
    scene.write_text(
        f"antdsl: 1\nworld: {{{world}}}\ncrowd: [{{species: walker, from: walker.ant, count: 9, place: {{{place}}}}}]\n"
    )
    return check_path(scene)[1].sorted()


@pytest.mark.parametrize("place", ["on: ground", "on: ground, by: above", "on: ground, by: area"])
@pytest.mark.parametrize("depth", [1e-6, 1e-10])
def test_a_ground_as_thin_as_a_line_is_an_error(tmp_path: Path, place: str, depth: float) -> None:
    (tmp_path / "needle.obj").write_bytes(quad(1000, depth))
    (found,) = [each for each in findings(tmp_path, "ground: {mesh: needle.obj}", place) if each.severity == "error"]
    assert found.code == "bad-mesh" and found.span is not None and found.span.text == "needle.obj" and found.help


def test_a_ground_far_smaller_than_the_others_is_an_error(tmp_path: Path) -> None:
    (tmp_path / "big.obj").write_bytes(quad(5e6, 5e6))
    (tmp_path / "dot.obj").write_bytes(quad(1, 1))
    found = findings(tmp_path, "ground: {mesh: big.obj}, dot: {mesh: dot.obj}", "on: dot")
    assert "`dot.obj` is less than a millionth" in "".join(each.message for each in found if each.severity == "error")


def test_a_scene_and_its_ground_agree_on_what_is_ground() -> None:
    rng = np.random.default_rng(3)
    seen = set()
    for _ in range(60):
        vertices = rng.normal(size=(9, 3)) * 10.0 ** rng.uniform(-8, 1, (1, 3))
        vertices[::2] += 1e6 * rng.integers(0, 2)
        vertices[rng.integers(0, 9, 3)] = vertices[0]
        faces = rng.integers(0, 9, (3, 3)).astype(np.int32)
        extent = float(np.ptp(vertices[faces].reshape(-1, 3), axis=0).max())
        live = bool(build(vertices, faces, np.zeros(3, np.int32), extent).live.any())
        assert has_live_face(vertices, faces, extent) == live
        seen.add(live)
    assert seen == {True, False}


@pytest.mark.parametrize("around", [None, (0.0, 0.0, 0.0)])
@pytest.mark.parametrize("by_area", [False, True])
def test_a_world_without_live_faces_is_bound(by_area: bool, around: tuple[float, float, float] | None) -> None:
    flat = MeshData(np.array([[0, 0, 0], [1, 0, 0], [2, 0, 0]], float), np.array([[0, 1, 2]], np.int32))
    place = PlaceData(on=("ground",), by_area=by_area, around=around, radius=5.0 if around else None)
    setting = Setting(surfaces={"ground": flat}, crowds=(CrowdData("ant", 4, place),))
    world = bind(bare(block(), things={"surface": ("ground",)}), setting)
    assert len(world.populations["ant"]) == 4
