"""Keyframes out: angles without jumps, a table of text, an Xform an agent in USD; each read back is what the cache holds."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

from antdsl.bodies.body import build_rotation_matrices
from antdsl.cli import app
from antdsl.outputs.cache.cache_reader import open_cache
from antdsl.outputs.euler_angles import EulerAngles, find_nearest_angles

RUN = CliRunner()
BUG = """ant 1
use steering
world { surface ground }
species bug {
  response 1 step
  size 4 mm
  start go
  state go { steer wander(swing: 200 deg); when chance 60 %/s -> split; when age > 0.6 s and id > 9 -> gone }
  state split { enter { spawn bug }; steer coast(); when after 0.2 s -> go }
  state gone { enter { die } }
  layers { state }
}
"""
MITE = """ant 1
use steering
world { surface ground }
species mite {
  size 2 mm
  start go
  state go { steer wander() }
  layers { state }
}
"""
SCENE = """antdsl: 1
frames: 3..30
world: {ground: {mesh: ground.obj}}
crowd:
  - {species: bug, from: bug.ant, count: 20, place: {on: ground}}
  - {species: mite, from: mite.ant, count: 3, place: {on: ground}}
"""


def axis_rotations(axis: int, degrees: np.ndarray) -> np.ndarray:
    """Matrices (n, 3, 3) of turns about an axis."""
    angle = np.radians(degrees)
    matrices = np.zeros((len(angle), 3, 3))
    matrices[:, axis, axis] = 1
    a, b = [k for k in range(3) if k != axis]
    sign = -1.0 if axis == 1 else 1.0
    matrices[:, a, a] = matrices[:, b, b] = np.cos(angle)
    matrices[:, a, b], matrices[:, b, a] = -sign * np.sin(angle), sign * np.sin(angle)
    return matrices


def composed(degrees: np.ndarray) -> np.ndarray:
    """About x first, then y, then z."""
    return axis_rotations(2, degrees[:, 2]) @ axis_rotations(1, degrees[:, 1]) @ axis_rotations(0, degrees[:, 0])


def quaternions(turn: np.ndarray) -> np.ndarray:
    from scipy.spatial.transform import Rotation

    return Rotation.from_matrix(turn).as_quat()


def test_random_turns_come_back() -> None:
    quats = np.random.default_rng(4).normal(size=(5000, 4))
    angles = np.degrees(find_nearest_angles(build_rotation_matrices(quats), np.zeros((5000, 3))))
    assert np.abs(composed(angles) - build_rotation_matrices(quats)).max() < 1e-12
    assert np.abs(angles).max() < 180.1 and angles[:, 1].min() < -90 and angles[:, 1].max() > 90


@pytest.mark.parametrize("away", [0.0, 1e-9, 1e-7, 1e-5, 1e-3])
@pytest.mark.parametrize("side", [-90.0, 90.0])
def test_where_two_axes_lie_on_each_other_the_three_still_make_the_turn(away: float, side: float) -> None:
    inner = np.linspace(-170, 170, 35)
    turn = composed(np.stack([inner, np.full(35, side - away), np.full(35, 20.0)], axis=1))
    previous_angles = np.radians(np.tile([3.0, side, 25.0], (35, 1)))
    assert np.abs(composed(np.degrees(find_nearest_angles(turn, previous_angles))) - turn).max() < 2e-6


def test_curves_go_on_over_whole_turns_and_past_the_quarter() -> None:
    frames = np.arange(200.0)
    yaw = np.stack([0 * frames, 7.0 * frames, 0 * frames], axis=1)  # on flat ground, y up, through ±90 degrees again and again
    roll = np.stack([-11.0 * frames, 20 + 0 * frames, 5 + 0 * frames], axis=1)
    angles, curves = EulerAngles(), []
    ids = np.array([4, 9])
    for k in range(200):
        curves.append(angles.compute_angles(ids, quaternions(composed(np.stack([yaw[k], roll[k]])))))
    assert np.abs(np.array(curves)[:, 0] - yaw).max() < 1e-4 and np.abs(np.array(curves)[:, 1] - roll).max() < 1e-4


def test_new_agents_start_afresh_and_others_continue() -> None:
    angles = EulerAngles()
    for degrees in (170.0, 190.0):
        both = angles.compute_angles(np.array([1, 5]), quaternions(axis_rotations(0, np.array([degrees, 10.0]))))
    assert both[0, 0] == pytest.approx(190)
    later = angles.compute_angles(np.array([1, 3, 5]), quaternions(axis_rotations(0, np.array([200.0, 200.0, 10.0]))))
    assert later[:, 0] == pytest.approx([200, -160, 10])


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("keyframes")
    (folder / "bug.ant").write_text(BUG)
    (folder / "mite.ant").write_text(MITE)
    (folder / "scene.yaml").write_text(SCENE)
    (folder / "ground.obj").write_text("v -90 0 -90\nv 90 30 -90\nv 90 0 90\nv -90 -50 90\nf 1 4 3\nf 1 3 2\n")
    result = RUN.invoke(app, ["run", str(folder / "scene.yaml"), "--out", str(folder / "cache"), "--backend", "numpy", "-q"])
    assert result.exit_code == 0, result.output
    return folder / "cache"


def export(cache: Path, *words: str) -> str:
    result = RUN.invoke(app, ["export", str(cache), *words])
    assert result.exit_code == 0, result.output
    return result.output


def test_a_table_is_read_back(cache: Path, tmp_path: Path) -> None:
    assert "frames 3..30, 2 species" in export(cache, "--to", str(tmp_path / "keys.csv"))
    with open(tmp_path / "keys.csv", newline="") as file:
        rows = list(csv.DictReader(file))
    assert list(rows[0]) == ["id", "frame", "tx", "ty", "tz", "rx", "ry", "rz", "sx", "sy", "sz", "species"]
    stored_cache, row_count, turned = open_cache(cache), 0, 0.0
    last: dict[tuple[str, str], np.ndarray] = {}
    for frame in range(3, 31):
        arrays = stored_cache.frame(frame)
        frame_rows = [row for row in rows if row["frame"] == str(frame)]
        assert len(frame_rows) == len(arrays["P"])
        table = np.array([[float(row[key]) for key in list(row)[:11]] for row in frame_rows])
        assert np.array_equal(table[:, 0], arrays["id"]) and np.array_equal(table[:, 2:5].astype(np.float32), arrays["P"])
        assert np.array_equal(table[:, 8:].astype(np.float32), np.repeat(arrays["pscale"][:, None], 3, axis=1))
        assert [("bug", "mite")[k] for k in arrays["species"]] == [row["species"] for row in frame_rows]
        assert np.abs(composed(table[:, 5:8]) - build_rotation_matrices(arrays["orient"].astype(np.float64))).max() < 1e-6
        for row, angles in zip(frame_rows, table[:, 5:8], strict=True):
            name = row["species"], row["id"]
            if name in last:
                turned = max(turned, float(np.abs(angles - last[name]).max()))
            last[name] = angles
        row_count += len(frame_rows)
    assert row_count == len(rows) and turned < 179.0


def test_some_frames_alone(cache: Path, tmp_path: Path) -> None:
    export(cache, "--to", str(tmp_path / "KEYS.CSV"), "--frames", "5..6", "-q")
    assert {line.split(",")[1] for line in (tmp_path / "KEYS.CSV").read_text().splitlines()[1:]} == {"5", "6"}


def test_an_xform_an_agent_is_read_back(cache: Path, tmp_path: Path) -> None:
    pytest.importorskip("pxr")
    from pxr import Gf, Usd, UsdGeom

    export(cache, "--to", str(tmp_path / "keys.usda"), "--as", "xforms")
    stage = Usd.Stage.Open(str(tmp_path / "keys.usda"))
    stored_cache, hidden = open_cache(cache), 0
    prims = {prim.GetName(): prim for prim in stage.GetPrimAtPath("/World/bug").GetChildren()}
    assert len(stage.GetPrimAtPath("/World/mite").GetChildren()) == 3 and not stage.GetPrimAtPath("/World/bug/poses")
    for frame in range(3, 31):
        arrays, time = stored_cache.frame(frame), Usd.TimeCode(frame)
        rows = np.flatnonzero(arrays["species"] == 0)
        turn = build_rotation_matrices(arrays["orient"].astype(np.float64))
        for row in rows:
            prim = prims[f"agent_{arrays['id'][row]}"]
            assert UsdGeom.Imageable(prim).ComputeVisibility(time) == "inherited"
            matrix = UsdGeom.Xformable(prim).ComputeLocalToWorldTransform(time)
            assert np.allclose(matrix.ExtractTranslation(), arrays["P"][row], atol=1e-5)
            axes = np.array([matrix.TransformDir(Gf.Vec3d(*axis)) for axis in np.eye(3).tolist()])
            assert np.allclose(axes.T, turn[row] * arrays["pscale"][row], atol=1e-5)
            assert prim.GetAttribute("userProperties:id").Get() == arrays["id"][row]
            assert prim.GetAttribute("userProperties:state").Get(time) == arrays["state"][row]
        away = set(prims) - {f"agent_{name}" for name in arrays["id"][rows].tolist()}
        assert all(UsdGeom.Imageable(prims[name]).ComputeVisibility(time) == "invisible" for name in away)
        hidden += len(away)
    assert hidden > 20, "some are born and some die"
    one = UsdGeom.Xformable(prims["agent_0"])
    assert [op.GetOpName() for op in one.GetOrderedXformOps()] == ["xformOp:translate", "xformOp:rotateXYZ", "xformOp:scale"]
    shape = prims["agent_0"].GetChild("body")
    assert shape.IsA(UsdGeom.Mesh) and len(UsdGeom.Mesh(shape).GetPointsAttr().Get()) > 50
    assert shape.HasAuthoredPayloads() and len(UsdGeom.PrimvarsAPI(shape).GetPrimvar("displayColor").Get(3)) == 1
    assert stage.GetPrimAtPath("/World/ground").IsA(UsdGeom.Mesh)
    UsdValidation = pytest.importorskip("pxr.UsdValidation")
    validators = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    errors = UsdValidation.ValidationContext(validators).Validate(stage)
    assert [(e.GetName(), e.GetMessage()) for e in errors] == []


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("keys.csv", "xforms"), "keyframes"),
        (("keys.usda", "points"), "xforms"),
        (("keys.fbx", "xforms"), ".glb"),
        (("keys.xyz", "xforms"), ".csv"),
    ],
)
def test_unknown_forms_are_reported(cache: Path, tmp_path: Path, words: tuple[str, str], message: str) -> None:
    result = RUN.invoke(app, ["export", str(cache), "--to", str(tmp_path / words[0]), "--as", words[1]])
    assert result.exit_code == 2 and message in result.output and not list(tmp_path.iterdir())


def test_trajectories_are_in_metres_seen_from_above(cache: Path, tmp_path: Path) -> None:
    output = export(cache, "--to", str(tmp_path / "people.txt"), "--frames", "5..6")
    assert "id times 2" in output and "bug 0, mite 1" in output
    lines = (tmp_path / "people.txt").read_text().splitlines()
    assert lines[:2] == ["# framerate: 24", "# id frame x/m y/m z/m"]
    table = np.array([line.split() for line in lines[2:]], float)
    stored_cache = open_cache(cache)
    for frame in (5, 6):
        arrays, rows = stored_cache.frame(frame), table[table[:, 1] == frame]
        names = arrays["id"] * 2 + arrays["species"]
        order = np.argsort(names)
        assert np.array_equal(rows[:, 0], names[order])
        x, up, z = arrays["P"][order].astype(np.float64).T / 1000
        assert np.allclose(rows[:, 2:], np.column_stack((x, -z, up)), atol=1e-6)
    assert len(table) == sum(len(stored_cache.frame(frame)["P"]) for frame in (5, 6))
