"""A cache written as USD: what other programs read of it is what the cache holds, and USD's own validators find nothing."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

pxr = pytest.importorskip("pxr")

import meshes  # noqa: E402
import usd_sets  # noqa: E402

from antdsl.bodies.body import build_rotation_matrices  # noqa: E402
from antdsl.cli import _run_without_warnings as run_command  # noqa: E402
from antdsl.outputs.cache.cache_reader import open_cache  # noqa: E402
from antdsl.outputs.recording import begin_recording, record_frames  # noqa: E402
from antdsl.pipeline import RunChoices, Shot, open_scene  # noqa: E402
from antdsl.runtime import Options  # noqa: E402
from antdsl.scene import Roots  # noqa: E402
from antdsl.scene.geometry.usd import open_stage, read_usd_camera, read_usd_mesh  # noqa: E402


def command(monkeypatch: pytest.MonkeyPatch, *words: str) -> int:
    monkeypatch.setattr("sys.argv", ["antdsl", *words])
    return run_command()


@pytest.fixture(scope="module")
def shot_and_cache(tmp_path_factory: pytest.TempPathFactory) -> tuple[Shot, Path]:
    """A short run of the set that moves, and its cache."""
    folder = tmp_path_factory.mktemp("export")
    path = usd_sets.write_usd(folder / "assets", folder / "usd")
    text = path.read_text().replace("frames: 1..40", "frames: 1..6").replace("count: 60", "count: 25")
    path.write_text(text.replace("up: y", "up: z").replace("units: mm", "units: cm"))
    shot, report = open_scene(path, RunChoices({"assets": folder / "assets"}))
    assert shot is not None, report.errors
    for _ in record_frames(begin_recording(shot, folder / "cache", Options(), resume=False, force=False)):
        pass
    return shot, folder / "cache"


@pytest.mark.parametrize("suffix", ["usda", "usdc"])
def test_a_cache_is_read_back_from_usd(
    shot_and_cache: tuple[Shot, Path], tmp_path: Path, suffix: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    from pxr import Gf, Usd, UsdGeom

    _, folder = shot_and_cache
    file = tmp_path / f"out.{suffix}"
    assert command(monkeypatch, "export", str(folder), "--to", str(file), "--skeletons", "0") == 0
    assert [path.name for path in tmp_path.iterdir()] == [file.name], "nothing is left beside it"
    stage = Usd.Stage.Open(str(file))
    assert UsdGeom.GetStageUpAxis(stage) == "Z" and UsdGeom.GetStageMetersPerUnit(stage) == 0.01
    assert (stage.GetStartTimeCode(), stage.GetEndTimeCode(), stage.GetTimeCodesPerSecond()) == (1, 6, 24)
    ants = UsdGeom.PointInstancer(stage.GetPrimAtPath("/World/walker"))
    assert list(ants.GetPrim().GetCustomDataByKey("states")) == ["stroll", "eat"]
    cache = open_cache(folder)
    for frame in range(1, 7):
        arrays = cache.frame(frame)
        assert np.array_equal(ants.GetPositionsAttr().Get(frame), arrays["P"])
        assert np.array_equal(ants.GetIdsAttr().Get(frame), arrays["id"])
        state = UsdGeom.PrimvarsAPI(ants).GetPrimvar("state")
        assert np.array_equal(state.GetIndices(frame), arrays["state"]) and list(state.Get()) == ["stroll", "eat"]
        assert np.array_equal(np.array(ants.GetScalesAttr().Get(frame))[:, 1], arrays["pscale"])
        # where an instance turns the body's head (+x) and back (+y)
        transforms = ants.ComputeInstanceTransformsAtTime(frame, frame, UsdGeom.PointInstancer.ExcludeProtoXform)
        for matrix, orient in zip(transforms, build_rotation_matrices(arrays["orient"].astype(np.float64)), strict=True):
            turn = np.array([matrix.TransformDir(Gf.Vec3d(*axis)).GetNormalized() for axis in np.eye(3).tolist()])
            assert np.abs(turn - orient.T).max() < 5e-3, "quaternions of half precision"
    poses = ants.GetPrototypesRel().GetTargets()
    assert len(poses) > 1 and max(ants.GetProtoIndicesAttr().Get(3)) < len(poses)
    one, six = (np.array(ants.GetProtoIndicesAttr().Get(frame)) for frame in (1, 6))
    assert (one != six).any(), "legs move"
    box = np.array(ants.GetExtentAttr().Get(4))
    assert (box[0] <= arrays["P"].min(axis=0) + 1).all() and (box[1] >= arrays["P"].max(axis=0) - 1).all()


def test_the_validators_of_usd_find_nothing(
    shot_and_cache: tuple[Shot, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    from pxr import Usd

    UsdValidation = pytest.importorskip("pxr.UsdValidation")
    assert (
        command(monkeypatch, "export", str(shot_and_cache[1]), "--to", str(tmp_path / "out.usdc"), "--frames", "2..4", "-q") == 0
    )
    stage = Usd.Stage.Open(str(tmp_path / "out.usdc"))
    assert stage.GetStartTimeCode() == 2
    validators = UsdValidation.ValidationRegistry().GetOrLoadAllValidators()
    assert len(validators) > 10
    errors = UsdValidation.ValidationContext(validators).Validate(stage)
    assert [(e.GetName(), e.GetMessage()) for e in errors] == []
    # what is wrong would be found
    stage.GetPrimAtPath("/World").GetReferences().AddReference("./none.usda")
    assert UsdValidation.ValidationContext(validators).Validate(stage)


def test_meshes_and_camera_come_back_through_a_scene(
    shot_and_cache: tuple[Shot, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The world that was written, read as a set: the same meshes, moving alike, and the same camera."""
    shot, folder = shot_and_cache
    assert command(monkeypatch, "export", str(folder), "--to", str(tmp_path / "out.usdc"), "-q") == 0
    stage_arguments = {"up": "z", "frames": range(1, 7), "fps": shot.setting.fps}
    for name in ("ground", "stones", "roller"):
        original_mesh = {**shot.setting.surfaces, **shot.setting.obstacles}[name]
        loaded_mesh = read_usd_mesh(open_stage(Roots(tmp_path, {}), "out.usdc", f"/World/{name}", **stage_arguments))
        assert (
            np.array_equal(loaded_mesh.raw_mesh.faces, original_mesh.faces)
            and np.abs(loaded_mesh.raw_mesh.vertices - original_mesh.vertices).max() < 1e-4
        )
        assert (loaded_mesh.motion is not None) == (name == "roller")
    assert loaded_mesh.motion is not None
    moves = shot.setting.motion.meshes["roller"]
    for k in range(6):
        assert (
            np.abs(
                loaded_mesh.motion.compute_vertices(loaded_mesh.raw_mesh.vertices, k)
                - moves.compute_vertices(original_mesh.vertices, k)
            ).max()
            < 1e-4
        )
    camera = read_usd_camera(open_stage(Roots(tmp_path, {}), "out.usdc", "/World/camera", **stage_arguments))
    own = shot.setting.cameras["shot"]
    assert own is not None and np.allclose(camera.at, own.at) and np.allclose(camera.look_at, own.look_at, atol=1e-3)
    assert np.allclose(camera.up, own.up) and np.allclose(camera.focal, 35)
    from pxr import Usd, UsdGeom

    stage = Usd.Stage.Open(str(tmp_path / "out.usdc"))
    assert all(prim.IsA(UsdGeom.Imageable) for prim in stage.Traverse() if str(prim.GetPath()).startswith("/World/items"))
    food = read_usd_mesh(open_stage(Roots(tmp_path, {}), "out.usdc", "/World/items/food_0", **stage_arguments))
    middle = (food.raw_mesh.vertices.min(axis=0) + food.raw_mesh.vertices.max(axis=0)) / 2
    assert np.linalg.norm(middle - shot.setting.items["food"][0].position) < 10


def test_what_stays_for_a_while_does_not_drift(tmp_path: Path) -> None:
    """USD goes evenly from sample to sample: one that stays until it jumps has a sample before the jump."""
    from pxr import Sdf, Usd

    from antdsl.outputs.usd.values import StageOutput

    stage = Usd.Stage.CreateInMemory()
    attribute = stage.DefinePrim("/a").CreateAttribute("x", Sdf.ValueTypeNames.Float)
    samples = StageOutput(stage).add_samples(attribute, lambda v: float(v[0]))
    for frame, value in enumerate((1, 1, 1, 1, 9, 9, 3), 1):
        samples.set(frame, [value])
    assert attribute.GetTimeSamples() == [1, 4, 5, 6, 7]
    assert [attribute.Get(frame) for frame in range(1, 8)] == [1, 1, 1, 1, 9, 9, 3]


def test_crowds_that_grow(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    from pxr import Usd, UsdGeom

    program = """ant 1
use steering
world { surface ground }
species breeder {
  max_speed 20 mm/s
  size 4 mm
  start go
  state go amber { steer wander(); when chance 500 %/s -> go { spawn breeder } }
  layers { state }
}
"""
    (tmp_path / "breed.ant").write_text(program)
    usd_sets.write_obj(tmp_path / "ground.obj", *meshes.grid(80, 8))
    (tmp_path / "scene.yaml").write_text(
        "antdsl: 1\nframes: 1..5\nworld:\n  ground: {mesh: ground.obj}\n"
        "crowd:\n  - {species: breeder, from: breed.ant, count: 8, place: {on: ground}}\n"
    )
    shot, report = open_scene(tmp_path / "scene.yaml")
    assert shot is not None, report.errors
    for _ in record_frames(begin_recording(shot, tmp_path / "cache", Options(), resume=False, force=False)):
        pass
    assert (
        command(monkeypatch, "export", str(tmp_path / "cache"), "--to", str(tmp_path / "out.usda"), "-q", "--skeletons", "0") == 0
    )
    stage = Usd.Stage.Open(str(tmp_path / "out.usda"))
    ants = UsdGeom.PointInstancer(stage.GetPrimAtPath("/World/breeder"))
    cache = open_cache(tmp_path / "cache")
    counts = []
    for frame in range(1, 6):
        ids = cache.frame(frame)["id"]
        counts.append(len(ids))
        samples = [
            a.Get(frame) for a in (ants.GetPositionsAttr(), ants.GetIdsAttr(), ants.GetProtoIndicesAttr(), ants.GetScalesAttr())
        ]
        assert {len(values) for values in samples} == {len(ids)} and np.array_equal(samples[1], ids)
    assert counts[-1] > counts[0]


def test_a_mesh_that_is_dug_changes_its_faces() -> None:
    from pxr import Usd, UsdGeom

    from antdsl.outputs.pictures.model import Solid
    from antdsl.outputs.usd.values import StageOutput
    from antdsl.outputs.usd.world import _MeshWriter

    stage = Usd.Stage.CreateInMemory()
    writer = _MeshWriter(StageOutput(stage), "/hill")
    box, ball = meshes.box((0, 0, 0), (1, 1, 1)), meshes.ball(2, rings=4)
    for frame, (points, faces) in enumerate((box, box, ball, ball), 1):
        writer.frame(frame, Solid("hill", points, faces))
    hill = UsdGeom.Mesh(stage.GetPrimAtPath("/hill"))
    for frame, (points, faces) in enumerate((box, box, ball, ball), 1):
        assert np.array_equal(hill.GetFaceVertexIndicesAttr().Get(frame), faces.ravel())
        assert np.allclose(hill.GetPointsAttr().Get(frame), points) and len(hill.GetFaceVertexCountsAttr().Get(frame)) == len(
            faces
        )
    assert hill.GetPointsAttr().GetTimeSamples() == [1, 2, 3]


def test_wrong_commands_are_reported(
    shot_and_cache: tuple[Shot, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    cache, file = str(shot_and_cache[1]), str(tmp_path / "out.usda")
    assert command(monkeypatch, "export", cache, "--to", str(tmp_path / "out.abc")) == 2
    assert command(monkeypatch, "export", cache, "--to", file, "--frames", "90..95") == 3
    assert command(monkeypatch, "export", str(tmp_path), "--to", file) == 3
    assert list(tmp_path.iterdir()) == []
    assert command(monkeypatch, "export", cache, "--to", file, "--for", "maya") == 2
    assert command(monkeypatch, "export", cache, "--to", file, "--as", "xforms", "--for", "houdini") == 2
    printed = capsys.readouterr().err
    assert "Traceback" not in printed and "`maya` is none of blender, houdini, usdview" in printed and "--for" in printed
    assert list(tmp_path.iterdir()) == []


def test_an_export_ends_with_the_program_that_it_is_for(
    shot_and_cache: tuple[Shot, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    from pxr import Usd

    for target, is_instance in (("blender", False), ("houdini", True), ("usdview", True)):
        words = () if target == "blender" else ("--for", target)
        assert command(monkeypatch, "export", str(shot_and_cache[1]), "--to", str(tmp_path / f"{target}.usdc"), *words) == 0
        assert capsys.readouterr().out.splitlines()[-1].startswith(f"written for {target};")
        stage = Usd.Stage.Open(str(tmp_path / f"{target}.usdc"))
        assert stage.GetPrimAtPath("/World/walker/agent_0").IsInstance() == is_instance
