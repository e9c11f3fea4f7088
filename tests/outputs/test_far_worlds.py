"""Worlds far from the zero point: caches, exports and pictures are those of the same world near it, moved by the origin."""

from __future__ import annotations

import csv
import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from PIL import Image

from antdsl.outputs.cache.cache_reader import open_cache
from antdsl.outputs.cut_plane import CutPlane
from antdsl.outputs.exports import EXPORT_FORMATS
from antdsl.outputs.gallery import Gallery
from tests.commands import run
from tests.far_pairs import ORIGIN, far_pair, write_scene

Pair = tuple[Path, Path]
NEAR = 1e-8  # metres: 15 digits at 530 km, 9 near the zero point


@pytest.fixture(scope="module")
def pair(tmp_path_factory: pytest.TempPathFactory) -> Pair:
    return far_pair(tmp_path_factory.mktemp("far"), last=6)


@pytest.fixture(scope="module")
def z_pair(tmp_path_factory: pytest.TempPathFactory) -> Pair:
    return far_pair(tmp_path_factory.mktemp("far_z"), last=3, up="z")


def check_caches(pair: Pair) -> None:
    near, far = (open_cache(cache) for cache in pair)
    assert near.manifest.origin == (0, 0, 0) and far.manifest.origin == tuple(ORIGIN)
    for name in ("items", "camera", "fields", "units"):
        assert getattr(near.manifest, name) == getattr(far.manifest, name)
    assert near.frames() == far.frames() and len(near.frames()) > 2
    for a, b in [(near.read_static(), far.read_static()), *((near.frame(k), far.frame(k)) for k in near.frames())]:
        assert list(a) == list(b)
        for name, array in a.items():
            assert array.tobytes() == b[name].tobytes(), name


def test_arrays_of_a_cache_are_those_near_the_zero_point(pair: Pair) -> None:
    check_caches(pair)
    names = open_cache(pair[0]).frame(4)
    assert {"feet.bug.P", "mesh.wall.vertices", "events.emit.P", "events.contact.P", "solid.heap.balls"} <= set(names)
    assert len(open_cache(pair[0]).read_static()["flow.drift.P"]) and len(open_cache(pair[0]).read_static()["field.trail.P"])


@pytest.mark.slow
def test_arrays_of_a_cache_with_z_up_are_those_near_the_zero_point(z_pair: Pair) -> None:
    check_caches(z_pair)


# ---- exports: how each is read back, and what differs


def tables(paths: Pair) -> None:
    near, far = (list(csv.DictReader(path.open(newline=""))) for path in paths)
    assert len(near) == len(far) > 2
    axes = ("tx", "ty", "tz") if "tx" in near[0] else ("x", "y", "z")
    for a, b in zip(near, far, strict=True):
        assert {name: value for name, value in a.items() if name not in axes} == {n: v for n, v in b.items() if n not in axes}
        assert np.abs([float(b[axis]) - float(a[axis]) for axis in axes] - ORIGIN).max() < NEAR


def arrays(paths: Pair) -> None:
    with np.load(paths[0]) as near, np.load(paths[1]) as far:
        assert near.files == far.files
        origins = [np.array(json.loads(bytes(file["about"]))["origin"]) for file in (near, far) if "about" in file]
        origins = origins or [file["origin"] for file in (near, far)]
        assert origins[0].tolist() == [0, 0, 0] and origins[1].tolist() == ORIGIN.tolist()
        for name in set(near.files) - {"about", "origin"}:
            assert near[name].tobytes() == far[name].tobytes(), name


def moved_arrays(paths: Pair) -> None:
    """Arrays in double precision from the zero point."""
    with np.load(paths[0]) as near, np.load(paths[1]) as far:
        assert near.files == far.files
        moved = [name for name in near.files if near[name].tobytes() != far[name].tobytes()]
        assert moved in (["bug.place"], ["heap.origin"])
        a, b = (file[moved[0]] for file in (near, far))
        if a.ndim == 3:
            assert np.array_equal(a[:, :3, :3], b[:, :3, :3]) and len(a) > 10
            a, b = a[:, :3, 3], b[:, :3, 3]
        assert np.abs(b - a - ORIGIN).max() < NEAR


def points_for_houdini(paths: Pair) -> None:
    near, far = (json.loads(path.read_text()) for path in paths)
    (attributes,) = (file[file.index("attributes") + 1] for file in (far,))
    global_attributes = attributes[attributes.index("globalattributes") + 1]
    head, values = global_attributes.pop()
    assert "origin" in head and values[values.index("values") + 1][-1] == [ORIGIN.tolist()]
    assert near == far, "all else is the same"


def meshes(paths: Pair) -> None:
    (a, faces), (b, others) = (_mesh_file(path) for path in paths)
    assert len(a) > 10 and np.array_equal(faces, others) and np.abs(b - a - ORIGIN).max() < NEAR


def _mesh_file(path: Path) -> tuple[np.ndarray, np.ndarray]:
    if path.suffix == ".obj":
        lines = [line.split() for line in path.read_text().splitlines()]
        return tuple(np.array([[float(w.split("/")[0]) for w in line[1:]] for line in lines if line[0] == kind]) for kind in "vf")  # type: ignore[return-value]
    data = path.read_bytes()
    end = data.index(b"end_header\n") + 11
    words = [line.split() for line in data[:end].decode().splitlines()]
    kinds = {"float": "<f4", "double": "<f8", "uchar": "u1"}
    kind = np.dtype([(w[2], kinds[w[1]]) for w in words if w[0] == "property" and len(w) == 3])
    count = int(next(w[2] for w in words if w[:2] == ["element", "vertex"]))
    rows = np.frombuffer(data[end:], kind, count)
    corners = np.frombuffer(data[end + kind.itemsize * count :], np.dtype([("n", "u1"), ("v", "<i4", 3)]))
    return np.stack([rows[axis].astype(np.float64) for axis in "xyz"], axis=1), corners["v"]


def gltf(paths: Pair, expected_origin: np.ndarray = ORIGIN) -> None:
    from tests.gltf_scene import Scene

    near, far = (Scene(path.read_bytes()) for path in paths)
    far.check()
    (world,) = (node for node in far.tree["nodes"] if node["name"] == "World")
    assert world.pop("translation") == expected_origin.tolist()
    binary = [path.read_bytes() for path in paths]
    a, b = (data[20 + int.from_bytes(data[12:16], "little") :] for data in binary)
    assert near.tree == far.tree and len(a) > 10000 and a == b


def stages(paths: Pair) -> None:
    usd, geom = pytest.importorskip("pxr.Usd"), pytest.importorskip("pxr.UsdGeom")
    near, far = (usd.Stage.Open(str(path)) for path in paths)
    root = far.GetPrimAtPath("/World").GetAttribute("xformOp:translate:origin")
    assert root.GetTypeName() == "double3" and tuple(root.Get()) == tuple(ORIGIN)
    assert not near.GetPrimAtPath("/World").HasAttribute("xformOp:translate:origin")
    prim_count = 0
    for prim in near.TraverseAll():
        other = far.GetPrimAtPath(prim.GetPath())
        for attribute in prim.GetAttributes():
            if str(attribute.GetPath()) == "/World.xformOpOrder":
                continue
            other_attribute = other.GetAttribute(attribute.GetName())
            assert attribute.GetTimeSamples() == other_attribute.GetTimeSamples()
            for time in (3.0, usd.TimeCode.Default()):
                assert attribute.Get(time) == other_attribute.Get(time), attribute.GetPath()
        if geom.Xformable(prim) and str(prim.GetPath()).startswith("/World/"):
            a, b = (geom.Xformable(each).ComputeLocalToWorldTransform(3.0) for each in (prim, other))
            assert np.abs(np.array(b.ExtractTranslation()) - np.array(a.ExtractTranslation()) - ORIGIN).max() < NEAR
            prim_count += 1
    assert prim_count > 5


READ: dict[tuple[str, str], Callable[[Pair], None]] = {
    (".usdc", "instances"): stages, (".usdc", "xforms"): stages, (".usdc", "meshes"): stages, (".glb", "skinned"): gltf,
    (".geo", "points"): points_for_houdini, (".csv", "keyframes"): tables, (".csv", "events"): tables,
    (".npz", "arrays"): arrays, (".npz", "poses"): moved_arrays, (".npz", "volume"): moved_arrays, (".npz", "events"): arrays,
    (".ply", "meshes"): meshes, (".ply", "solids"): meshes,
}  # fmt: skip
QUICK = {"points", "keyframes", "arrays", "skinned"}


def exported(pair: Pair, folder: Path, ending: str, form: str) -> Pair:
    """The same form of both caches; of one file a frame that of frame 3."""
    export = next(each for each in EXPORT_FORMATS if ending in each.extensions)
    paths = []
    for cache, name in zip(pair, ("near", "far"), strict=True):
        path = folder / f"{name}{ending}"
        export.forms[form](Gallery(open_cache(cache)), [1, 2, 3], path)
        paths.append(export.paths(form, path, [3])[0])
    return paths[0], paths[1]


@pytest.mark.parametrize(
    ("ending", "form"),
    [
        pytest.param(export.extensions[0], form, marks=() if form in QUICK else pytest.mark.slow)
        for export in EXPORT_FORMATS
        for form in export.forms
    ],
)
def test_an_export_is_that_of_the_near_world_moved(pair: Pair, tmp_path: Path, ending: str, form: str) -> None:
    READ[ending, form](exported(pair, tmp_path, ending, form))


@pytest.mark.parametrize("form", ["meshes", "solids"])
@pytest.mark.slow
def test_obj_files_are_moved(pair: Pair, tmp_path: Path, form: str) -> None:
    meshes(exported(pair, tmp_path, ".obj", form))


@pytest.mark.slow
def test_axes_of_a_world_with_z_up_turn_with_its_origin(z_pair: Pair, tmp_path: Path) -> None:
    x, y, z = ORIGIN.tolist()
    gltf(exported(z_pair, tmp_path, ".glb", "skinned"), np.array([x, z, -y]))
    far = json.loads(exported(z_pair, tmp_path, ".geo", "points")[1].read_text())
    attributes = far[far.index("attributes") + 1]
    assert attributes[attributes.index("globalattributes") + 1][-1][1][-1][-1] == [[x, z, -y]]
    stages(exported(z_pair, tmp_path, ".usdc", "xforms"))


# ---- pictures, and what is made of a cache


def drawn(cache: Path, name: str, *words: str) -> np.ndarray:
    folder = cache.parent / name
    words = ("--frames", "4..4", "--width", "96", "--height", "64", "--out", str(folder), *words)
    process = run("render", str(cache), *words, cwd=cache.parent)
    assert process.returncode == 0, process.stdout + process.stderr
    (picture,) = folder.glob("*.png")
    with Image.open(picture) as image:  # the file names its cache
        return np.asarray(image.convert("RGB"))


@pytest.mark.slow
def test_pictures_are_those_of_the_near_world(pair: Pair) -> None:
    for camera in ("scene", "fit", "top", "eye"):
        near, far = (drawn(cache, camera, "--camera", camera) for cache in pair)
        assert np.ptp(near) > 100 and np.array_equal(near, far), camera


def test_a_cut_is_at_a_place_of_the_scene(pair: Pair) -> None:
    near = Gallery(open_cache(pair[0]), CutPlane.parse("x > 1")).make_picture(4)
    far = Gallery(open_cache(pair[1]), CutPlane.parse("x > 530001")).make_picture(4)
    full_picture = Gallery(open_cache(pair[0])).make_picture(4)
    assert 0 < len(near.crowds[0].position) < len(full_picture.crowds[0].position)
    assert np.array_equal(near.crowds[0].position, far.crowds[0].position)
    for a, b in zip(near.solids, far.solids, strict=True):
        assert np.array_equal(a.vertices, b.vertices) and np.array_equal(a.faces, b.faces)


def test_info_shows_the_origin_of_a_far_world(pair: Pair) -> None:
    near, far = (run("info", str(cache), cwd=cache.parent).stdout for cache in pair)
    assert "origin       530000 25 -180000 m\n" in far and "origin" not in near


def test_an_edited_cache_has_the_origin(pair: Pair, tmp_path: Path) -> None:
    process = run("edit", str(pair[1]), "--smooth", "orient:3", "--out", "edited", cwd=tmp_path)
    assert process.returncode == 0, process.stderr
    edited_cache, was = open_cache(tmp_path / "edited"), open_cache(pair[1])
    assert edited_cache.manifest.origin == tuple(ORIGIN) and np.array_equal(edited_cache.frame(4)["P"], was.frame(4)["P"])


def test_a_run_that_is_continued_has_the_same_frames(pair: Pair, tmp_path: Path) -> None:
    place = tmp_path / "far"
    shutil.copytree(pair[1].parent, place)
    lines = [json.loads(line) for line in (place / "cache" / "hashes.jsonl").read_bytes().splitlines()]
    expected_files = {line["frame"]: line["file"] for line in lines}
    for frame in (5, 6):
        (place / "cache" / "frames" / f"frame.{frame:04d}.npz").unlink()
    process = run("run", "scene.yaml", "--out", "cache", "--resume", "-q", cwd=place)
    assert process.returncode == 0, process.stderr
    lines = [json.loads(line) for line in (place / "cache" / "hashes.jsonl").read_bytes().splitlines()]
    assert {line["frame"]: line["file"] for line in lines} == expected_files
    manifest: dict[str, Any] = json.loads((place / "cache" / "manifest.json").read_text())
    del manifest["origin"]  # as a cache was written before it had one
    (place / "cache" / "manifest.json").write_text(json.dumps(manifest))
    assert open_cache(place / "cache").manifest.origin == (0, 0, 0)
    process = run("run", "scene.yaml", "--out", "cache", "--resume", "-q", cwd=place)
    assert process.returncode == 3 and "a different origin" in process.stderr and "without `--resume`" in process.stderr


def test_a_run_begins_with_a_cache_of_the_same_place_alone(pair: Pair, tmp_path: Path) -> None:
    caches = []
    for cache, origin in zip(pair, (np.zeros(3), ORIGIN), strict=True):
        place = tmp_path / cache.parent.name
        place.mkdir()
        write_scene(place, origin, 3)
        shutil.copytree(cache, place / "other")
        scene = place / "scene.yaml"
        scene.write_text(scene.read_text() + "from: {cache: other, frame: 5}\n")
        process = run("run", "scene.yaml", "--out", "cache", "-q", cwd=place)
        assert process.returncode == 0, process.stdout + process.stderr
        caches.append(place / "cache")
    check_caches((caches[0], caches[1]))
    shutil.rmtree(tmp_path / "far" / "other")
    shutil.copytree(pair[0], tmp_path / "far" / "other")
    process = run("run", "scene.yaml", "--out", "cache", "--force", "-q", cwd=tmp_path / "far")
    assert (
        process.returncode == 1
        and "origin at 0 0 0 m, and this scene's world at 530000 25 -180000 m" in process.stdout + process.stderr
    )


@pytest.mark.slow
def test_an_explanation_has_places_of_the_scene(pair: Pair) -> None:
    positions = []
    for cache in pair:
        process = run("explain", str(cache), "--agent", "3", "--frame", "4", "--json", cwd=cache.parent)
        assert process.returncode == 0, process.stdout + process.stderr
        (change,) = (each for each in json.loads(process.stdout)["changes"] if each["name"] == "position")
        positions.append(np.array([change["before"], change["after"]]))
    assert np.abs(positions[1] - positions[0] - ORIGIN * 1000).max() < 1e-3, "mm"
