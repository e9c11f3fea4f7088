"""The feed function of caches: one file of a small cache is replaced, then the cache is described, verified, exported and resumed
as the commands do."""

from __future__ import annotations

import contextlib
import io
import json
import shutil
import tempfile
from functools import lru_cache
from pathlib import Path
from zlib import crc32

from cases.hostile.rows import GROUND
from fuzz.oracle import Feed, Violation

from antdsl.cli.commands.info import _verify_cache, describe_cache
from antdsl.cli.exits import CommandError
from antdsl.outputs.cache.cache_reader import CacheError, open_cache
from antdsl.outputs.cache.cache_writer import DifferentHashes, DifferentInputs, ForeignFolder, PathBlocked
from antdsl.outputs.cache.manifest import ManifestError
from antdsl.outputs.exports import find_export
from antdsl.outputs.gallery import Gallery, PictureUnavailable
from antdsl.outputs.numbered_files import ExportUnavailable
from antdsl.outputs.recording import NothingToResume, begin_recording, record_frames
from antdsl.pipeline import Shot, open_scene
from antdsl.runtime import Options
from antdsl.scene.geometry.usd import UsdError

OPTIONS = Options(backend="numpy")
PROGRAM = b"""ant 1
use steering
world { surface ground; items food { load = 3 } }
field trail on ground { cell 20 mm; half_life 8 s }
species walker {
  size 4 mm
  max_speed 30 mm/s
  load = 0
  start stroll
  state stroll amber {
    deposit trail 2 /s
    steer wander(swing: 40 deg)
    when speed > 1 mm/s held 0.1 s -> rest
  }
  state rest blue { when after 0.1 s -> stroll }
}
"""
SCENE = b"""antdsl: 1
units: mm
up: y
fps: 24
frames: 1..4
seed: 1
world:
  ground: {mesh: ground.ply}
  food: {a: {at: [0, 0, 5], load: 3}}
output: {checkpoint: 2, attributes: [P, v, orient, id, pscale, Cd, state, species, age, load]}
crowd:
  - {species: walker, from: walker.ant, count: 4, place: {on: ground}}
"""
PROJECT = {"ground.ply": GROUND, "walker.ant": PROGRAM, "scene.yaml": SCENE}
REFUSED = (CacheError, ManifestError, PictureUnavailable, ExportUnavailable, UsdError)
EXPORTS = (("a.csv", "keyframes"), ("a.npz", "arrays"), ("a.####.geo", "points"), ("a.####.ply", "meshes"), ("a.glb", "skinned"))


def _write_project(folder: Path) -> Shot:
    for name, data in PROJECT.items():
        (folder / name).write_bytes(data)
    shot, report = open_scene(folder / "scene.yaml")
    assert shot is not None, [each.message for each in report.errors]
    return shot


@lru_cache(maxsize=1)
def cache_files() -> dict[str, bytes]:
    """The files of a cache of 4 frames, by their paths."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        shot = _write_project(folder)
        out = folder / "out/scene"
        for _ in record_frames(begin_recording(shot, out, OPTIONS, resume=False, force=False)):
            pass
        return {path.relative_to(out).as_posix(): path.read_bytes() for path in sorted(out.rglob("*")) if path.is_file()}


def cache_inputs() -> list[bytes]:
    """Each file of the cache as an input: its path, a line end, its bytes."""
    return [name.encode() + b"\n" + data for name, data in cache_files().items()]


def feed_cache(folder: Path) -> Feed:
    shot = _write_project(folder)
    good = cache_files()
    out = folder / "out/scene"
    hashes = _state_hashes(good)

    def feed(data: bytes) -> str:
        name, _, content = data.partition(b"\n")
        names = sorted(good)
        chosen = name.decode("utf-8", "replace")
        chosen = chosen if chosen in good else names[len(name) % len(names)]
        shutil.rmtree(folder / "out", ignore_errors=True)
        for each, bytes_ in good.items():
            path = out / each
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content if each == chosen else bytes_)
        lines = [
            chosen,
            *_described(out),
            *_exported(out, folder / "to", EXPORTS[crc32(data) % len(EXPORTS)]),
            *_resumed(shot, out),
        ]
        if lines[-1] == "resumed":
            again = _state_hashes({"hashes.jsonl": (out / "hashes.jsonl").read_bytes()})
            if again != hashes:
                raise Violation("resume", f"other states after a resume: {again} and {hashes}")
        return "\n".join(lines)

    return feed


def _state_hashes(files: dict[str, bytes]) -> dict[int, str]:
    """The state hash of each frame; a later line of a frame counts."""
    lines = [json.loads(line) for line in files["hashes.jsonl"].splitlines()]
    return {line["frame"]: line["hash"] for line in lines}


def _described(out: Path) -> list[str]:
    printed = io.StringIO()
    try:
        cache = open_cache(out)
        lines = describe_cache(cache)
        with contextlib.redirect_stdout(printed):
            _verify_cache(cache)
    except (*REFUSED, CommandError) as why:
        return [f"refused {why} {getattr(why, 'words', '')}"]
    return [*lines, printed.getvalue()]


def _exported(out: Path, to: Path, chosen: tuple[str, str]) -> list[str]:
    """One export, or its error."""
    name, form = chosen
    shutil.rmtree(to, ignore_errors=True)
    to.mkdir()
    export = find_export(to / name)
    assert export is not None
    try:
        cache = open_cache(out)
        frames = cache.frames()
        if frames:
            export.forms[form](Gallery(cache), frames, to / name)
        return [f"{name} {sum(path.stat().st_size for path in to.iterdir())}"]
    except REFUSED as why:
        return [f"{name} refused {why}"]


def _resumed(shot: Shot, out: Path) -> list[str]:
    try:
        recording = begin_recording(shot, out, OPTIONS, resume=True, force=False)
        for _ in record_frames(recording):
            pass
    except (DifferentInputs, DifferentHashes, ForeignFolder, PathBlocked, NothingToResume) as why:
        return [f"refused {why}"]
    return [*recording.notes, "resumed"]
