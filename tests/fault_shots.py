"""A small shot, and the commands that write something of it: what faults and kills are tried on."""

from __future__ import annotations

import json
import re
import shutil
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from subprocess import CompletedProcess

import commands

from antdsl.executors import Task
from antdsl.executors.processes import ProcessEngine
from antdsl.executors.tasks import WorkerContext, run_task
from antdsl.outputs.cache.cache_reader import make_frame_path
from antdsl.outputs.cache.hashes import HASHES_FILE_NAME, read_lines

OUTPUT_FOLDER = "made"
EXPORTS = {
    "csv": ("a.csv",), "events": ("e.csv", "--as", "events"), "npz": ("a.npz",), "poses": ("p.npz", "--as", "poses"),
    "events npz": ("e.npz", "--as", "events"), "geo": ("a.####.geo",), "ply": ("a.####.ply",), "obj": ("a.####.obj",),
    "glb": ("a.glb",), "gltf": ("a.gltf",), "usdc": ("a.usdc",), "usda": ("a.usda", "--as", "meshes"),
    "chunks": ("c.usdc", "--as", "xforms", "--chunk", "2"),
}  # fmt: skip
EXPORTED = {name: ("export", "out/scene", "--to", f"{OUTPUT_FOLDER}/{to}", *words) for name, (to, *words) in EXPORTS.items()}
SMALL = ("--width", "48", "--height", "32", "--threads", "1")
WRITERS: dict[str, tuple[str, ...]] = {
    **EXPORTED,
    "edit": ("edit", "out/scene", "--smooth", "orient:3", "--out", f"{OUTPUT_FOLDER}/edited"),
    "stills": ("render", "out/scene", "--frames", "1..2", "--out", OUTPUT_FOLDER, *SMALL),
    "sheet": ("render", "out/scene", "--sheet", "--frames", "1..2", "--out", OUTPUT_FOLDER, *SMALL),
    "summary": ("run", "scene.yaml", "--resume", "--threads", "1", "--summary", f"{OUTPUT_FOLDER}/summary.json"),
    "sweep": ("sweep", "scene.yaml", "--seeds", "2", "--jobs", "1", "--no-plots", "--out", f"{OUTPUT_FOLDER}/sweep"),
    "golden": ("test", "scene.yaml", "--update", "--threads", "1"),
    "graph": ("graph", "walker.ant", "--out", f"{OUTPUT_FOLDER}/walker.svg"),
    "body": ("body", "ant", "--to", f"{OUTPUT_FOLDER}/ant.json"),
    "new": ("new", f"{OUTPUT_FOLDER}/project"),
    "fmt": ("fmt", "walker.ant"),
}
BESIDE = {"golden": ("scene.golden.json",), "fmt": ("walker.ant",)}  # what is written beside the scene
_TIMES = re.compile(rb'"(seconds|fps|hash)": "?[0-9a-f.-]+"?')
PROGRAM = """ant 1
use steering
species walker {
       size 4 mm
  max_speed 25 mm/s
  start stroll
  state stroll amber {
    steer wander(swing: 40 deg)
    when chance 50 %/s -> rest
  }
  state rest blue { when after 0.1 s -> stroll }
  layers { separate(radius: 2 * size); state }
}
spec "they walk" on "scene.yaml" { always: count(walker) > 0 }
"""
SCENE = """antdsl: 1
frames: 1..5
seed: 1
crowd: [{species: walker, from: walker.ant, count: 6, place: {radius: 30 mm}}]
output: {checkpoint: 2}
"""
LAST = 5


def project(folder: Path) -> Path:
    """The scene of a small crowd on the endless plane."""
    folder.mkdir(parents=True)
    (folder / "walker.ant").write_text(PROGRAM)
    (folder / "scene.yaml").write_text(SCENE)
    (folder / "out").mkdir()
    return folder


def ran(folder: Path, *words: str) -> CompletedProcess[str]:
    result = commands.run("run", "scene.yaml", "--threads", "1", "--backend", "numpy", *words, cwd=folder)
    assert "Traceback" not in result.stderr, result.stderr
    return result


def assert_same(folder: Path, unbroken: Path) -> None:
    """The cache has the frames of a run that nothing happened to, and no leftovers."""
    mine, reference = folder / "out" / "scene", unbroken / "out" / "scene"
    for frame in range(1, LAST + 1):
        assert make_frame_path(mine, frame).read_bytes() == make_frame_path(reference, frame).read_bytes()
    lines = read_lines(reference / HASHES_FILE_NAME)
    assert {f: (line.hash, line.file) for f, line in read_lines(mine / HASHES_FILE_NAME).items()} == {
        f: (line.hash, line.file) for f, line in lines.items()
    }
    assert not [path for path in mine.rglob("*.part")]


class Inline(ProcessEngine):
    """Runs of a sweep in this process, so that their faults are its own."""

    def start(self) -> None:
        self.pool = ThreadPoolExecutor(1)

    def submit(self, task: Task) -> Future[str]:
        return self.pool.submit(run_task, task.function, json.dumps(task.document), WorkerContext(1))

    def find_frame(self, future: Future[str]) -> int | None:
        return None

    def stop(self) -> None:
        self.pool.shutdown()


def files(folder: Path, name: str) -> dict[str, bytes]:
    """What a writer has written, by path."""
    paths = {str(path.relative_to(folder)): path for path in sorted((folder / OUTPUT_FOLDER).rglob("*")) if path.is_file()}
    paths |= {each: folder / each for each in BESIDE.get(name, ()) if (folder / each).exists()}
    return {each: path.read_bytes() for each, path in paths.items() if path.name not in ("lock", ".antdsl-cache")}


def copied(unbroken: Path, folder: Path) -> Path:
    shutil.copytree(unbroken, folder)
    (folder / OUTPUT_FOLDER).mkdir()
    return folder


def written(folder: Path, name: str) -> tuple[int, str]:
    result = commands.run(*WRITERS[name], cwd=folder)
    assert "Traceback" not in result.stderr, (name, result.stderr)
    return result.returncode, result.stderr


def same(name: str, path: str, data: bytes, new: bytes) -> bool:
    """Whether a file is the one that an undisturbed command writes, but for how long that took."""
    if name == "summary":
        return json.loads(data).keys() == json.loads(new).keys()
    return data == new if name != "sweep" else _TIMES.sub(b"", data) == _TIMES.sub(b"", new)
