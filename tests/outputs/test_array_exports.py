"""Arrays, poses, points for Houdini and meshes out of a cache, each read back apart from what wrote it."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from antdsl.bodies.body import build_rotation_matrices, rotate_vectors
from antdsl.numerics.records import select_record_rows
from antdsl.outputs.cache.cache_reader import open_cache
from antdsl.outputs.gallery import Gallery
from tests.commands import run
from tests.outputs.test_gltf_export import create_cache


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return create_cache(tmp_path_factory.mktemp("arrays"), "y")


@pytest.fixture(scope="module")
def z_cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return create_cache(tmp_path_factory.mktemp("arrays"), "z")


def exported(cache: Path, path: Path, *words: str) -> str:
    process = run("export", str(cache), "--to", str(path), *words, cwd=path.parent)
    assert process.returncode == 0, process.stdout + process.stderr
    return process.stdout


def test_arrays_are_those_of_all_frames(cache: Path, tmp_path: Path) -> None:
    exported(cache, tmp_path / "all.npz")
    stored_cache = open_cache(cache)
    with np.load(tmp_path / "all.npz") as archive:
        metadata = json.loads(bytes(archive["about"]))
        assert (
            metadata["units"] == "cm"
            and metadata["fps"] == "24/1"
            and metadata["species"][0]["machines"][0]["states"][1]["name"] == "grin"
        )
        assert set(metadata["agents"]) == {"P", "v", "orient", "id", "pscale", "Cd", "state"}
        assert archive["frames"].tolist() == stored_cache.frames() and len(set(np.diff(archive["rows"]))) > 2
        for k, frame in enumerate(stored_cache.frames()):
            for name, array in stored_cache.frame(frame).items():
                if array.ndim:
                    rows = archive["rows" if name in metadata["agents"] else f"{name}.rows"]
                    assert np.array_equal(archive[name][rows[k] : rows[k + 1]], array) and archive[name].dtype == array.dtype


def test_some_agents_are_their_rows_of_each_array(cache: Path, tmp_path: Path) -> None:
    exported(cache, tmp_path / "some.npz", "--ids", "2,4..5", "--frames", "5..6")
    with np.load(tmp_path / "some.npz") as archive:
        assert archive["id"].tolist() == [2, 4, 5] * 2 and archive["frames"].tolist() == [5, 6]
        all_arrays = open_cache(cache).frame(6)
        chosen = np.isin(all_arrays["id"], (2, 4, 5))
        for name in ("P", "clips.bug.main.turns", "clips.bug.main.clip"):
            assert np.array_equal(archive[name][3:], all_arrays[name][chosen])


def test_poses_bring_the_points_of_a_shape_where_they_are_drawn(cache: Path, tmp_path: Path) -> None:
    exported(cache, tmp_path / "poses.npz", "--as", "poses", "--ids", "0..12", "--frames", "9..20")
    gallery = Gallery(open_cache(cache))
    with np.load(tmp_path / "poses.npz") as archive:
        metadata = json.loads(bytes(archive["about"]))["bug"]
        assert metadata == {"joints": ["root", "elbow"], "parents": [-1, 0], "channels": ["arm.smile"]}
        rows = slice(*archive["bug.rows"][11:13])
        (crowd,) = gallery.make_picture(20).crowds
        assert crowd.body is not None and crowd.ids is not None
        among = np.isin(crowd.ids, archive["bug.id"][rows])
        assert archive["bug.id"][rows].tolist() == crowd.ids[among].tolist() and 8 < among.sum() < len(among)
        local, world = archive["bug.local"][rows], archive["bug.world"][rows]
        assert np.allclose(world[:, 1], world[:, 0] @ local[:, 1], atol=1e-6) and np.allclose(world[:, 0], local[:, 0])
        body = crowd.body.definition
        shape, smile = body.shapes["arm"], body.shapes["arm.smile"]
        assert shape.capture is not None
        points = shape.points + archive["bug.channels"][rows, 0, None, None] * (smile.points - shape.points)
        points = np.concatenate([points, np.ones_like(points[..., :1])], axis=2)
        matrices = (world @ shape.capture.inverse_matrices)[:, shape.capture.joints]
        placed = np.einsum("nij,pk,npkjl,npl->npi", archive["bug.place"][rows], shape.capture.weights, matrices, points)[..., :3]
        drawn = crowd.body.pose_vertices(select_record_rows(crowd.machine_clips, among), int(among.sum()))[0].astype(float)
        expected = rotate_vectors(crowd.orient[among], drawn) * crowd.scale[among, None, None] + crowd.position[among, None]
        assert np.abs(placed - expected).max() < 1e-5


def pairs(items: list[Any]) -> dict[str, Any]:
    return dict(zip(items[0::2], items[1::2], strict=True))


def geo(path: Path) -> dict[str, Any]:
    """The point attributes of a .geo file, as lists of keys and values say them."""
    tree = pairs(json.loads(path.read_text()))
    attributes: dict[str, Any] = {}
    for head, body in pairs(tree["attributes"])["pointattributes"]:
        head, body = pairs(head), pairs(body)
        if head["type"] == "string":
            table, indices = body["strings"], pairs(body["indices"])["arrays"][0]
            attributes[head["name"]] = [table[k] if k >= 0 else "" for k in indices]
        else:
            values = pairs(body["values"])
            attributes[head["name"]] = np.array(values["tuples"] if values["size"] > 1 else values["arrays"][0])
        assert len(attributes[head["name"]]) == tree["pointcount"]
    return attributes


@pytest.mark.parametrize("up", ["y", "z"])
def test_points_for_houdini(up: str, tmp_path: Path, request: pytest.FixtureRequest) -> None:
    cache = request.getfixturevalue("cache" if up == "y" else "z_cache")
    assert "bugs.0003.geo .. bugs.0026.geo" in exported(cache, tmp_path / "bugs.geo")
    stored_cache = open_cache(cache)
    arrays, next_arrays = stored_cache.frame(20), stored_cache.frame(21)
    attributes = geo(tmp_path / "bugs.0020.geo")

    def upright(vectors: np.ndarray) -> np.ndarray:
        return vectors if up == "y" else np.stack([vectors[:, 0], vectors[:, 2], -vectors[:, 1]], axis=1)

    assert np.allclose(attributes["P"], upright(arrays["P"])) and np.allclose(attributes["v"], upright(arrays["v"]))
    turn, own = build_rotation_matrices(attributes["orient"]), build_rotation_matrices(arrays["orient"].astype(float))
    assert np.allclose(turn[:, :, 2], upright(own[:, :, 0]), atol=1e-6), "+z is the heading"
    assert np.allclose(turn[:, :, 1], upright(own[:, :, 1]), atol=1e-6), "+y is up"
    from scipy.spatial.transform import Rotation

    both = np.isin(arrays["id"], next_arrays["id"])
    step = Rotation.from_rotvec(attributes["w"][both] / 24).as_matrix() @ turn[both]
    later = geo(tmp_path / "bugs.0021.geo")
    assert np.allclose(step, build_rotation_matrices(later["orient"])[np.isin(later["id"], arrays["id"])], atol=1e-5)
    states = [state.name for state in stored_cache.manifest.species[0].machines[0].states]
    assert attributes["state"] == [states[k] for k in arrays["state"]] and attributes["agentname"][0] == f"bug_{arrays['id'][0]}"
    assert np.array_equal(attributes["id"], arrays["id"]) and np.allclose(attributes["pscale"], arrays["pscale"])
    names = [clip.name for clip in stored_cache.manifest.species[0].clips]
    assert attributes["clip1"] == [names[k] if k >= 0 else "" for k in arrays["clips.bug.main.clip"]]
    assert {"bend", "smile", "hop"} >= set(attributes["clip1"]) >= {"bend", "smile"} and set(attributes["clip0"]) > {""}
    assert np.allclose(attributes["clip1_time"], arrays["clips.bug.main.turns"], atol=1e-6), "a second each"
    fading = arrays["clips.bug.main.fade"] > 0
    assert fading.any() and np.allclose((attributes["clip0_weight"] + attributes["clip1_weight"])[fading], 1)


def test_a_machine_over_another_takes_what_it_weighs() -> None:
    from antdsl.bodies.agents.machine_clips import MachineClips
    from antdsl.outputs.exports.geo_export import _make_clip_slots

    def machine(weight: float) -> MachineClips:
        one, none = np.ones(1, np.float32), np.zeros(1, np.float32)
        return MachineClips(np.zeros(1, np.int16), none, weight * one, np.full(1, -1, np.int16), none, one, none)

    for weight in (0.25, 0.5, 1.0):
        (_, walk, _, wave) = (each[2][0] for each in _make_clip_slots([machine(1.0), machine(weight)], 1))
        assert walk == 1.0 and wave / (walk + wave) == pytest.approx(weight, abs=1e-5)


def test_meshes_have_the_same_points_in_each_frame(cache: Path, tmp_path: Path) -> None:
    trimesh = pytest.importorskip("trimesh")
    output = exported(cache, tmp_path / "bugs.####.ply", "--ids", "0..12")
    assert "bugs.0003.ply .. bugs.0026.ply" in output and "do not exist in all of these frames, and are omitted" in output
    exported(cache, tmp_path / "bugs.obj", "--ids", "0..12", "--frames", "26..26")
    gallery = Gallery(open_cache(cache))
    first, last = (trimesh.load(tmp_path / f"bugs.{frame:04d}.ply", process=False) for frame in (3, 26))
    assert np.array_equal(first.faces, last.faces) and first.vertices.shape == last.vertices.shape
    (crowd,) = gallery.make_picture(26).crowds
    assert crowd.body is not None and crowd.ids is not None
    is_common = np.isin(crowd.ids, np.asarray(gallery.make_picture(3).crowds[0].ids)) & (crowd.ids <= 12)
    drawn = crowd.body.pose_vertices(crowd.machine_clips, len(is_common))[0].astype(float)
    expected = rotate_vectors(crowd.orient, drawn) * crowd.scale[:, None, None] + crowd.position[:, None]
    assert np.allclose(last.vertices.reshape(is_common.sum(), -1, 3), expected[is_common], atol=1e-6)
    text = (tmp_path / "bugs.0026.obj").read_text()
    names = [line[2:] for line in text.splitlines() if line.startswith("o ")]
    assert names == [f"bug_{one}" for one in crowd.ids[is_common].tolist()]
    obj = trimesh.load(tmp_path / "bugs.0026.obj", process=False, split_object=False, group_material=False)
    assert np.allclose(np.sort(obj.vertices.ravel()), np.sort(last.vertices.ravel()), atol=1e-6)


def test_meshes_over_time_in_usd(cache: Path, tmp_path: Path) -> None:
    pytest.importorskip("pxr")
    from pxr import Usd, UsdGeom

    exported(cache, tmp_path / "bugs.usdc", "--as", "meshes", "--ids", "0..3")
    stage = Usd.Stage.Open(str(tmp_path / "bugs.usdc"))
    (crowd,) = Gallery(open_cache(cache)).make_picture(15).crowds
    assert crowd.body is not None and crowd.ids is not None
    drawn = crowd.body.pose_vertices(crowd.machine_clips, len(crowd.position))[0].astype(float)
    expected = rotate_vectors(crowd.orient, drawn) * crowd.scale[:, None, None] + crowd.position[:, None]
    for row in np.flatnonzero(crowd.ids < 4):
        mesh = UsdGeom.Mesh(stage.GetPrimAtPath(f"/World/bug/agent_{crowd.ids[row]}"))
        assert np.allclose(mesh.GetPointsAttr().Get(15), expected[row], atol=1e-6)
        assert not mesh.GetFaceVertexIndicesAttr().GetTimeSamples() and len(mesh.GetPointsAttr().GetTimeSamples()) > 10


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("a.npz", "--ids", "3-5"), "3,8..12"), (("a.npz", "--ids", "5..3"), "3,8..12"),
        (("a.ply", "--as", "solids"), "no solid"),
        (("a.npz", "--as", "volume"), "no solid"),
    ],
)  # fmt: skip
def test_impossible_exports_are_reported(cache: Path, tmp_path: Path, words: tuple[str, ...], message: str) -> None:
    process = run("export", str(cache), "--to", *words, cwd=tmp_path)
    assert process.returncode in (1, 2) and message in process.stderr and not list(tmp_path.iterdir())


def test_agents_that_never_live_leave_an_empty_file_and_a_note(cache: Path, tmp_path: Path) -> None:
    process = run("export", str(cache), "--to", "a.glb", "--ids", "900", cwd=tmp_path)
    assert process.returncode == 0 and "these frames have no agents" in process.stdout + process.stderr
    assert (tmp_path / "a.glb").is_file()
