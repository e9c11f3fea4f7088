"""Caches of a crowd that is not there in some frames, or in none: every export of the table writes files that open again, every
camera draws, and commands answer."""

from __future__ import annotations

import csv
import json
import warnings
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import empty_scenes
import numpy as np
import pytest
from commands import run
from empty_scenes import CASES, FIRST, LAST
from sampling import sampled

from antdsl.outputs.cache.cache_reader import Cache, open_cache
from antdsl.outputs.drawing import AgentMissing, DrawRequest, FrameDrawer
from antdsl.outputs.edits.frame_rows import SPECIES_PER_KEY
from antdsl.outputs.exports import EXPORT_FORMATS, find_export
from antdsl.outputs.gallery import Gallery
from antdsl.outputs.numbered_files import ExportUnavailable
from antdsl.outputs.recording import begin_recording, record_frames
from antdsl.pipeline import open_scene
from antdsl.runtime import Options
from antdsl.runtime.backends import BACKENDS
from antdsl.scene.camera_models import CAMERA_VIEWS

FRAMES = range(FIRST, LAST + 1)
FORMS = [f"{form} {ending}" for export in EXPORT_FORMATS for form in export.forms for ending in export.extensions]
"""All files that `antdsl export` writes."""


def cached(scene: Path, backend: str = "numpy", folder: str = "cache") -> Cache:
    shot, report = open_scene(scene)
    assert shot is not None and report.ok, [each.message for each in report.errors]
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        for _ in record_frames(begin_recording(shot, scene.parent / folder, Options(backend), resume=False, force=False)):  # type: ignore[arg-type]
            pass
    return open_cache(scene.parent / folder)


@pytest.fixture(scope="module", params=sampled(CASES, ["not_at_the_end"]))
def cache(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cache]:
    yield cached(empty_scenes.scene(tmp_path_factory.mktemp("empty") / "scene", request.param))


def agents(cache: Cache) -> list[int]:
    """How many there are in each frame."""
    return [len(cache.frame(frame)["id"]) for frame in FRAMES]


def opened_again(path: Path, counts: list[int], form: str) -> None:
    """Whether a file says as much as the cache has."""
    match path.suffix:
        case ".usdc" | ".usda" | ".usd":
            _is_stage(path, counts, form)
        case ".glb" | ".gltf":
            data = path.read_bytes()
            tree = json.loads(data[20 : 20 + int.from_bytes(data[12:16], "little")] if path.suffix == ".glb" else data)
            assert tree["asset"]["version"] == "2.0" and tree["scenes"][tree["scene"]]
            assert all(each["count"] > 0 for each in tree.get("accessors", ()))
            names = [node.get("name", "") for node in tree.get("nodes", ())]
            assert any(name.startswith(("person_", "ant_", "egg_")) for name in names) == any(counts)
        case ".geo":
            flat = json.loads(path.read_text())
            assert (
                dict(zip(flat[::2], flat[1::2], strict=True))["pointcount"] == counts[int(path.stem.rpartition(".")[2]) - FIRST]
            )
        case ".csv":
            head, *rows = csv.reader(path.read_text().splitlines())
            assert "frame" in head and all(len(row) == len(head) for row in rows)
            assert form == "events" or len(rows) == sum(counts)
        case ".npz":
            with np.load(path, allow_pickle=False) as arrays:
                named_arrays: dict[str, Any] = {name: arrays[name] for name in arrays.files}
            assert named_arrays and (
                form != "poses" or sum(len(a) for n, a in named_arrays.items() if n.endswith(".id")) == sum(counts)
            )
        case _:
            text = path.read_bytes()
            assert text.startswith(b"ply\n") or not text or text.startswith((b"o ", b"# framerate"))


def _is_stage(path: Path, counts: list[int], form: str) -> None:
    from pxr import Usd, UsdGeom  # type: ignore[import-not-found]

    stage = Usd.Stage.Open(str(path))
    assert stage and (stage.GetStartTimeCode(), stage.GetEndTimeCode()) == (FIRST, LAST)
    if form == "meshes":
        return
    for frame, count in zip(FRAMES, counts, strict=True):
        visible_count = 0
        for prim in stage.Traverse():
            if prim.IsA(UsdGeom.PointInstancer) and _is_seen(prim, frame):
                instancer = UsdGeom.PointInstancer(prim)
                sizes = {len(each.Get(frame) or ()) for each in (instancer.GetPositionsAttr(), instancer.GetProtoIndicesAttr())}
                assert len(sizes) == 1
                visible_count += sizes.pop()
            elif prim.GetAttribute("userProperties:id").IsValid():
                visible_count += _is_seen(prim, frame)
        assert visible_count == count, (path.name, frame)


def _is_seen(prim: Any, frame: int) -> bool:
    from pxr import UsdGeom

    return bool(UsdGeom.Imageable(prim).ComputeVisibility(frame) != "invisible")


SAMPLE = [each for each in FORMS if not each.endswith((".usd", ".usdc", ".gltf", ".obj"))]


@pytest.mark.parametrize("kind", sampled(FORMS, SAMPLE))
def test_every_export_opens_again(cache: Cache, tmp_path: Path, kind: str) -> None:
    form, _, ending = kind.partition(" ")
    path = tmp_path / f"crowd{ending}"
    export = find_export(path)
    assert export is not None
    if ending.startswith(".usd"):
        pytest.importorskip("pxr")
    options = [{}] if form not in export.options else [{"options": export.options[form](**each)} for each in _options(kind)]
    for arguments in options:
        try:
            export.forms[form](Gallery(cache), list(FRAMES), path, **arguments)
        except ExportUnavailable as why:  # of a mesh sequence: all frames have the same points
            assert form == "meshes" and any(agents(cache)) and "in all of these frames" in str(why)
            return
        for file in export.paths(form, path, list(FRAMES)):
            opened_again(file, agents(cache), form)


def _options(kind: str) -> list[dict[str, Any]]:
    every: list[dict[str, Any]] = [{}]
    if kind == "instances .usda":
        every = [{"skeletons": 0}, {"skeletons": 9}]
    if kind == "instances .usdc":
        every += [{"skeletons": 0, "shutter": (-0.2, 0.2)}, {"copies": True, "close": True, "chunk": 3}]
    return every


@pytest.mark.parametrize("camera", sampled(CAMERA_VIEWS, ["eye"]))
def test_every_camera_draws_frames_without_agents(cache: Cache, camera: str) -> None:
    counts = agents(cache)
    show = ("trail", "flow", "feelers", "velocity", "paths", "ids")
    options = DrawRequest(48, 27, camera, show, blur=0.5)
    chosen = [FIRST, FIRST + counts.index(min(counts)), LAST]
    drawer = FrameDrawer(options.gallery(cache), options, chosen, 1)
    assert all(drawer.draw(frame).shape == (27, 48, 3) for frame in dict.fromkeys(chosen))
    if camera == "eye" and not min(counts):
        with pytest.raises(AgentMissing, match=f"no agent 7 for the camera to follow; frame {chosen[1]} has no agents"):
            FrameDrawer(options.gallery(cache), DrawRequest(48, 27, camera, (), agents=(7 * SPECIES_PER_KEY,)), chosen[1:2], 1)


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES)
def test_backends_write_the_same_caches(tmp_path: Path, case: str) -> None:
    scene = empty_scenes.scene(tmp_path / "scene", case)
    hash_texts = [(cached(scene, backend, backend).folder / "hashes.jsonl").read_text() for backend in BACKENDS]
    assert len(set(hash_texts)) == 1


COMMANDS = (
    ("check", "scene.yaml"),
    ("run", "scene.yaml", "--out", "out", "--summary", "summary.json", "--profile"),
    ("run", "scene.yaml", "--out", "out", "--resume"),
    ("info", "out", "--verify"),
    ("edit", "out", "--smooth", "orient:3", "--out", "smooth"),
    ("info", "smooth", "--verify"),
    ("render", "out", "--sheet", "--width", "64", "--height", "36", "--out", "sheet"),
    ("test", "scene.yaml"),
    ("test", "crowd.ant", "--update", "--coverage"),
    ("test", "crowd.ant", "--json", "results.json"),
    ("graph", "crowd.ant"),
    ("bench", "scene.yaml", "--pairs", "1", "--steps", "1", "--backend", "numpy"),
)


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES)
def test_every_command_answers(tmp_path: Path, case: str) -> None:
    scene = empty_scenes.scene(tmp_path / "scene", case)
    for words in COMMANDS:
        process = run(*words, cwd=scene.parent)
        said = process.stdout + process.stderr
        assert process.returncode == 0 and "Warning" not in said and "nan" not in said.split(), (words, said)
    summary = json.loads((scene.parent / "summary.json").read_text(), parse_constant=pytest.fail)
    assert summary
    for species in ("person", "ant", "egg"):
        process = run("explain", "out", "--agent", "0", "--frame", str(FIRST + 3), "--species", species, cwd=scene.parent)
        assert process.returncode in (0, 2) and (
            process.returncode == 0 or "does not exist" in process.stderr or "no " in process.stderr
        )
