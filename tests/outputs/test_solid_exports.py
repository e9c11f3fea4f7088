"""What was dug, as meshes and as a volume: the two say the same, and less is left as agents dig."""

from __future__ import annotations

from pathlib import Path

import digging_shots
import numpy as np
import pytest

from antdsl.outputs.cache.cache_reader import open_cache
from antdsl.outputs.cache.dug_solids import DugSolids
from tests.commands import run

trimesh = pytest.importorskip("trimesh")


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("solids")
    scene = digging_shots.SCENE.replace("units: mm", "units: cm").replace("1..40", "1..30")
    for name, mesh in (("ground", digging_shots.ground()), ("hill", digging_shots.hill())):
        digging_shots.save((mesh[0] / 10, mesh[1]), folder / f"{name}.ply")  # in cm
    for old_text, new_text in (("[60, 0, 0]", "[6, 0, 0]"), ("[45, 0, 0]", "[4.5, 0, 0]"), ("[-31, 0, 0]", "[-3.1, 0, 0]"),
                          ("[-20, 0, 0]", "[-2, 0, 0]")):  # fmt: skip
        scene = scene.replace(old_text, new_text)
    (folder / "dig.ant").write_text(digging_shots.PROGRAM)
    (folder / "scene.yaml").write_text(scene)
    process = run("run", "scene.yaml", "--out", "cache", "--backend", "numpy", "-q", cwd=folder)
    assert process.returncode == 0, process.stderr
    return folder / "cache"


def exported(cache: Path, path: Path, *words: str) -> str:
    process = run("export", str(cache), "--to", str(path), *words, cwd=path.parent)
    assert process.returncode == 0, process.stdout + process.stderr
    return process.stdout


def test_a_mesh_a_frame_and_the_volume_hold_the_same_solid(cache: Path, tmp_path: Path) -> None:
    from scipy.ndimage import map_coordinates

    exported(cache, tmp_path / "hill.###.ply", "--as", "solids")
    exported(cache, tmp_path / "hill.obj", "--as", "solids", "--frames", "30..30")
    assert "that of frame 30" in exported(cache, tmp_path / "hill.npz", "--as", "volume")
    meshes = {frame: trimesh.load(tmp_path / f"hill.{frame:03d}.ply") for frame in (1, 15, 30)}
    volumes = [meshes[frame].volume for frame in (1, 15, 30)]
    assert volumes[0] > volumes[1] > volumes[2] > 5.0, "cm^3"
    (solid,) = DugSolids(open_cache(cache), open_cache(cache).read_static()).at(30)
    assert np.allclose(trimesh.load(tmp_path / "hill.030.ply", process=False).vertices, solid.vertices, atol=1e-6)
    assert np.allclose(trimesh.load(tmp_path / "hill.0030.obj").volume, volumes[2], rtol=1e-6)
    with np.load(tmp_path / "hill.npz") as archive:
        distance, origin, cell = archive["hill.distance"], archive["hill.origin"], float(archive["hill.cell"])
        assert int(archive["frame"]) == 30 and cell == pytest.approx(0.1)
        at = (np.asarray(meshes[30].vertices) - origin) / cell
        off = map_coordinates(distance, at.T, order=1)
        assert np.abs(off).max() < 0.05 * cell, "the mesh lies where the distance is 0"
        inside = np.count_nonzero(distance < 0) * cell**3
        assert inside == pytest.approx(volumes[2], rel=0.03)
        middle = map_coordinates(distance, ((np.array([[0, 0.8, 1.5]]) - origin) / cell).T, order=1)
        assert middle[0] < -cell and np.allclose(archive["hill.band"], (distance.min(), distance.max()))
