"""Caches: arrays survive the way to disk, damage is seen, and a run killed at any instant goes on to the same hashes."""

from __future__ import annotations

import errno
import io
import json
import os
import shutil
import signal
import subprocess
import sys
import time
import warnings
import zipfile
from collections.abc import Callable
from dataclasses import replace
from hashlib import sha256
from pathlib import Path

import commands
import numpy as np
import pytest
from children import child_environment
from sampling import sampled
from typer.testing import CliRunner

from antdsl.atomic_write import write_atomically
from antdsl.cli import _run_without_warnings as run_in_process
from antdsl.cli import app
from antdsl.cli.commands.new import build_ground_ply
from antdsl.cli.exits import CommandError
from antdsl.outputs.cache.cache_reader import SURFACE_ERROR_KEY, CacheError, make_checkpoint_path, make_frame_path, open_cache
from antdsl.outputs.cache.cache_writer import ForeignFolder, prepare_folder
from antdsl.outputs.cache.hashes import HASHES_FILE_NAME, read_lines
from antdsl.outputs.cache.lock import FolderLock, FolderLocked
from antdsl.outputs.cache.npz import ArrayFileError, encode_npz, parse_npy, read_npz
from antdsl.outputs.recording import begin_recording, record_frames
from antdsl.pipeline import open_scene
from antdsl.runtime import CheckpointError, Options, bind, restore_checkpoint, take_checkpoint
from antdsl.runtime.checkpoints import STATE_HASH_VERSION, Arrays

ROOT = Path(__file__).resolve().parents[2]
ARRAYS = {
    "P": np.arange(12, dtype=np.float32).reshape(4, 3),
    "id": np.arange(4),
    "on": np.array([True, False, True, False]),
    "none": np.zeros((0, 3)),
    "one": np.array(7, np.int64),
    "species.a->b#1.x": np.arange(3, dtype=np.uint8),
}


def test_arrays_come_back_as_they_were_and_numpy_reads_them(tmp_path: Path) -> None:
    path = tmp_path / "a.npz"
    write_atomically(path, encode_npz(ARRAYS), sync=True)
    back = read_npz(path)
    plain = np.load(io.BytesIO(encode_npz(ARRAYS)))
    for name, array in ARRAYS.items():
        for read_array in (back[name], plain[name]):
            assert read_array.dtype == array.dtype and np.array_equal(read_array, array)
    assert encode_npz(ARRAYS) == encode_npz(ARRAYS)
    assert [p.name for p in tmp_path.iterdir()] == ["a.npz"]


def read_hashes(path: Path) -> dict[int, str]:
    return {frame: line.hash for frame, line in read_lines(path).items()}


def zipped(entries: list[tuple[str, bytes]], compression: int = zipfile.ZIP_STORED) -> bytes:
    buffer = io.BytesIO()
    with warnings.catch_warnings(action="ignore"), zipfile.ZipFile(buffer, "w", compression) as file:
        for name, data in entries:
            file.writestr(name, data)
    return buffer.getvalue()


def npy(header: str, body: bytes = b"") -> bytes:
    data = header.encode()
    return b"\x93NUMPY\x01\x00" + len(data).to_bytes(2, "little") + data + body


BOMB = npy("{'descr': '|u1', 'fortran_order': False, 'shape': (10000000,), }\n", b"\0" * 10_000_000)
GOOD = npy("{'descr': '<f4', 'fortran_order': False, 'shape': (2,), }\n", b"\0" * 8)


@pytest.mark.parametrize(
    "bad",
    [
        pytest.param(b"", id="empty"),
        pytest.param(b"PK" + b"\0" * 100, id="not a zip"),
        pytest.param(encode_npz(ARRAYS)[:-40], id="cut off"),
        pytest.param(zipped([("a.npy", GOOD), ("a.npy", GOOD)]), id="one name twice"),
        pytest.param(zipped([("../a.npy", GOOD)]), id="a name that leaves the folder"),
        pytest.param(zipped([("a.txt", GOOD)]), id="no array"),
        pytest.param(zipped([("a.npy", BOMB)], zipfile.ZIP_DEFLATED), id="bomb"),
    ],
)  # fmt: skip
def test_strange_files_are_refused(tmp_path: Path, bad: bytes) -> None:
    path = tmp_path / "a.npz"
    path.write_bytes(bad)
    with pytest.raises(ArrayFileError):
        read_npz(path)


@pytest.mark.parametrize(
    "header",
    [
        "{'descr': '|O', 'fortran_order': False, 'shape': (1,), }\n",
        "{'descr': '<U2147483647', 'fortran_order': False, 'shape': (1,), }\n",
        "{'descr': '>f4', 'fortran_order': False, 'shape': (2,), }\n",
        "{'descr': '<f4', 'fortran_order': True, 'shape': (2,), }\n",
        "{'descr': '<f4', 'fortran_order': False, 'shape': (65536, 65536), }\n",
        "{'descr': '<f4', 'fortran_order': False, 'shape': (-2,), }\n",
        "{'descr': '<f4', 'fortran_order': False, 'shape': (True,), }\n",
        "{'descr': [('a', '<f4')], 'fortran_order': False, 'shape': (2,), }\n",
        "{'descr': '<f4', 'fortran_order': False, 'shape': (4611686018427387904, 4), }\n",
        "__import__('os').system('true')\n",
    ],
)
def test_strange_headers_are_refused(header: str) -> None:
    assert parse_npy(GOOD, "a").tolist() == [0, 0]
    with pytest.raises(ArrayFileError):
        parse_npy(npy(header, b"\0" * 8), "a")


def test_every_flipped_byte_of_the_values_is_seen(tmp_path: Path) -> None:
    original = encode_npz({"P": np.arange(64, dtype=np.float32)})
    path = tmp_path / "a.npz"
    start = original.index(np.float32(1).tobytes())
    for place in range(start, start + 200, 7):
        data = bytearray(original)
        data[place] ^= 0x10
        path.write_bytes(data)
        with pytest.raises(ArrayFileError):
            read_npz(path)


def test_a_foreign_folder_is_left_alone(tmp_path: Path) -> None:
    (tmp_path / "thesis.txt").write_text("years of work")
    with pytest.raises(ForeignFolder, match=r"thesis\.txt"):
        prepare_folder(tmp_path, force=False)
    prepare_folder(tmp_path, force=True)
    assert (tmp_path / "thesis.txt").read_text() == "years of work"
    prepare_folder(tmp_path, force=False)


def test_two_runs_do_not_write_to_one_folder(tmp_path: Path) -> None:
    with FolderLock(tmp_path), pytest.raises(FolderLocked, match=str(os.getpid())), FolderLock(tmp_path):
        pass
    with FolderLock(tmp_path):
        pass


def test_hash_lines_that_were_cut_off_are_left_out(tmp_path: Path) -> None:
    path = tmp_path / "hashes.jsonl"
    path.write_text('{"frame": 1, "hash": "aa"}\n{"frame": 2, "hash": "bb"}\n{"frame": 3, "ha')
    assert read_hashes(path) == {1: "aa", 2: "bb"}


def test_feelers_of_a_program_are_found_and_turned_into_rays(tmp_path: Path) -> None:
    from antdsl.outputs.feelers import compute_feeler_rays, list_feelers
    from antdsl.pipeline import compile_files

    path = tmp_path / "a.ant"
    text = PROGRAM.replace("WORLD", "world { surface ground; obstacle stones }")
    path.write_text(text.replace("layers {", "layers { avoid(stones, feelers: 3, spread: 90 deg, reach: 2 mm + 1.5 * size);"))
    program, report = compile_files([path])
    assert program is not None and report.ok, report.errors
    (entry,) = list_feelers(program, "walker", {}, 10.0, 0.04)
    assert entry.count == 3 and entry.spread == pytest.approx(np.pi / 2)
    assert entry.reach == pytest.approx(0.2) and entry.per_length == pytest.approx(1.5)
    segments = compute_feeler_rays(entry, np.zeros((1, 3)), np.array([[1.0, 0, 0]]), np.array([[0, 1.0, 0]]), np.array([0.4]))
    ends = segments[np.argsort(segments[:, 1, 2]), 1]
    assert np.abs(ends - 0.8 * np.array([[0, 0, -1], [1, 0, 0], [0, 0, 1]])).max() < 1e-12


# --- whole runs, in processes of their own -------------------------------------------------------------------------------


PROGRAM = """ant 1
use steering
WORLD
species walker {
  size 4 mm
  max_speed 25 mm/s
  start stroll
  state stroll amber {
    steer wander(swing: 40 deg)
    when chance 50 %/s -> rest
  }
  state rest blue { when after 0.5 s -> stroll }
  layers { separate(radius: 2 * size); state }
}
"""
SCENE = """antdsl: 1
frames: 1..60
seed: 1
crowd: [{species: walker, from: walker.ant, count: 40, place: {radius: 60 mm}}]
output: {checkpoint: 8}
"""


def project(folder: Path, hills: bool = False) -> Path:
    """Walkers, by themselves on the endless plane, which starts faster than a mesh."""
    folder.mkdir(exist_ok=True)
    (folder / "walker.ant").write_text(PROGRAM.replace("WORLD", "world { surface ground }" if hills else ""))
    (folder / "ground.ply").write_bytes(build_ground_ply(17))
    scene = folder / "scene.yaml"
    scene.write_text(SCENE + ("world: {ground: {mesh: ground.ply}}\n" if hills else ""))
    return scene


def start(scene: Path, *words: str) -> subprocess.Popen[str]:
    command = [sys.executable, "-m", "antdsl", "run", str(scene), "--threads", "1", *words]
    env = child_environment(NO_COLOR="1")
    return subprocess.Popen(
        command, env=env, cwd=scene.parent, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
    )


def finished(run: subprocess.Popen[str]) -> tuple[int, str]:
    out, problems = run.communicate(timeout=60)
    assert "Traceback" not in problems, problems[-600:]
    return run.returncode, out + problems


def ran(scene: Path, *words: str) -> tuple[int, str]:
    """As `finished(start(…))`, for a run that nothing happens to on its way."""
    process = commands.run("run", str(scene), "--threads", "1", *words, cwd=scene.parent)
    assert "Traceback" not in process.stderr, process.stderr[-600:]
    return process.returncode, process.stdout + process.stderr


@pytest.fixture(scope="module")
def unbroken(tmp_path_factory: pytest.TempPathFactory) -> tuple[Path, dict[int, str]]:
    scene = project(tmp_path_factory.mktemp("project"))
    code, words = ran(scene)
    assert code == 0, words
    hashes = read_hashes(scene.parent / "out" / "scene" / "hashes.jsonl")
    assert sorted(hashes) == list(range(1, 61))
    return scene, hashes


def test_the_summary_has_its_keys_and_the_last_hash(tmp_path: Path) -> None:
    scene = project(tmp_path / "p", hills=True)
    assert ran(scene, "--summary", "summary.json")[0] == 0
    hashes = read_hashes(scene.parent / "out" / "scene" / "hashes.jsonl")
    summary_values = json.loads((scene.parent / "summary.json").read_text())
    required_keys = "agents frames fps seconds states transitions items faults max_surface_error motion state_hash peak_memory"
    assert set(required_keys.split()) <= set(summary_values)
    assert summary_values["agents"] == 40 == sum(summary_values["states"].values()) and summary_values["frames"] == 60
    static = open_cache(scene.parent / "out" / "scene").read_static()
    assert static["mesh.ground.faces"].max() + 1 == len(static["mesh.ground.vertices"]) == 17 * 17
    assert (
        summary_values["state_hash"] == hashes[60]
        and summary_values["max_surface_error"] < 1e-3
        and summary_values["faults"] == 0
    )


def test_the_summary_of_a_run_that_goes_on_is_of_all_frames(tmp_path: Path) -> None:
    scene = project(tmp_path / "p", hills=True)
    folder, summary = scene.parent / "out" / "scene", scene.parent / "summary.json"

    def worst(*words: str) -> float | None:
        assert ran(scene, "--frames", "1..12", "--summary", summary.name, *words)[0] == 0
        error: float | None = json.loads(summary.read_text())["max_surface_error"]
        return error

    unbroken = worst()
    assert unbroken is not None and unbroken > 0 and worst("--resume") == unbroken == worst("--resume")
    make_checkpoint_path(folder, 12).unlink()
    assert worst("--resume") == unbroken
    as_before(folder)
    line = read_lines(folder / HASHES_FILE_NAME)[12]
    arrays = dict(read_npz(make_checkpoint_path(folder, 12)))
    arrays.pop(SURFACE_ERROR_KEY)  # as before it was stored
    make_checkpoint_path(folder, 12).write_bytes(encode_npz(arrays))
    with open(folder / HASHES_FILE_NAME, "ab") as hashes:
        hashes.write(replace(line, checkpoint="").text(12))
    assert worst("--resume") is None is worst("--resume")


def test_frames_hold_what_the_manifest_says(unbroken: tuple[Path, dict[int, str]]) -> None:
    cache = open_cache(unbroken[0].parent / "out" / "scene")
    arrays = cache.frame(30)
    assert set(cache.manifest.attributes) <= set(arrays)
    assert arrays["P"].shape == (40, 3) and arrays["P"].dtype == np.float32
    assert arrays["id"].tolist() == sorted(arrays["id"].tolist())
    assert np.linalg.norm(arrays["orient"], axis=1) == pytest.approx(1, abs=1e-5)
    step = np.linalg.norm(cache.frame(31)["P"] - arrays["P"], axis=1)
    assert 0 < step.max() <= 25 / 24 * 1.01


def flipped(path: Path, at: float) -> None:
    """A bit of a file turned over; `at` from 0, the first byte, to 1."""
    data = bytearray(path.read_bytes())
    data[int(at * (len(data) - 1))] ^= 4
    path.write_bytes(data)


def swapped(one: Path, other: Path) -> None:
    data = one.read_bytes()
    one.write_bytes(other.read_bytes())
    other.write_bytes(data)


def lines_changed(folder: Path, frame: int, **change: str) -> None:
    """The line of a frame with other values, in good JSON."""
    entries = [json.loads(line) for line in (folder / HASHES_FILE_NAME).read_text().splitlines()]
    for entry in entries:
        entry |= change if entry["frame"] == frame else {}
    (folder / HASHES_FILE_NAME).write_text("".join(json.dumps(entry) + "\n" for entry in entries))


def renumbered(folder: Path, number: int) -> None:
    """A whole frame of another number, written as that of `number`."""
    arrays = {**read_npz(make_frame_path(folder, 30)), "frame": np.array(number, np.int64)}
    make_frame_path(folder, number).write_bytes(encode_npz(arrays))


def of_another_run(path: Path) -> None:
    """Another whole checkpoint of the same frame: the state is the same, what was counted on the way is not."""
    arrays = dict(read_npz(path))
    path.write_bytes(encode_npz(arrays | {"world.faults": arrays["world.faults"] + 5}))


def in_line_of(folder: Path, frame: int) -> int:
    """A byte amid the line of a frame."""
    text = (folder / HASHES_FILE_NAME).read_bytes()
    begin = text.index(b'{"frame": %d,' % frame)
    return (begin + text.index(b"\n", begin)) // 2


# What may happen to a cache of 60 frames with checkpoints at 1, 9, 17, …; the frame that a run goes on after; the message.
DAMAGE: dict[str, tuple[Callable[[Path], object], int | None, str]] = {
    "nothing": (lambda f: None, 60, ""),
    "a frame cut off": (lambda f: os.truncate(make_frame_path(f, 12), 100), 9, "frame.0012.npz` was changed or damaged"),
    "an empty frame": (lambda f: os.truncate(make_frame_path(f, 30), 0), 25, "frame.0030.npz` was changed or damaged"),
    "a bit of a frame": (lambda f: flipped(make_frame_path(f, 47), 0.5), 41, "frame.0047.npz` was changed or damaged"),
    "a bit of a name in a frame": (
        lambda f: flipped(make_frame_path(f, 47), 0.999), 41, "frame.0047.npz` was changed or damaged",
    ),
    "the first frame": (lambda f: flipped(make_frame_path(f, 1), 0.7), None, "frames 1 to 60 are computed again"),
    "two frames swapped": (
        lambda f: swapped(make_frame_path(f, 20), make_frame_path(f, 22)), 17, "frames 18 to 60 are computed again",
    ),
    "a whole frame with another's number": (lambda f: renumbered(f, 34), 33, "frame.0034.npz` was changed or damaged"),
    "a missing frame": (lambda f: make_frame_path(f, 26).unlink(), 25, "frame.0026.npz` does not exist"),
    "missing frames": (lambda f: [make_frame_path(f, n).unlink() for n in range(20, 50)], 17, "frame.0020.npz` does not exist"),
    "a pipe for a frame": (
        lambda f: (make_frame_path(f, 40).unlink(), os.mkfifo(make_frame_path(f, 40))), 33, "not a regular file",
    ),
    "a link for a frame": (
        lambda f: (make_frame_path(f, 40).rename(f / "x"), make_frame_path(f, 40).symlink_to(f / "x")), 33, "it is a link",
    ),
    "a bit of a checkpoint": (lambda f: flipped(make_checkpoint_path(f, 60), 0.5), 57, "checkpoint.0060.npz"),
    "a checkpoint cut off": (lambda f: os.truncate(make_checkpoint_path(f, 60), 5000), 57, "frames 58 to 60 are computed again"),
    "an early checkpoint": (lambda f: flipped(make_checkpoint_path(f, 9), 0.5), 60, "so the checkpoint is removed"),
    "two checkpoints swapped": (
        lambda f: swapped(make_checkpoint_path(f, 60), make_checkpoint_path(f, 49)), 57, "0060.npz` was changed or damaged",
    ),
    "a checkpoint of another run": (
        lambda f: of_another_run(make_checkpoint_path(f, 60)), 57, "checkpoint.0060.npz` was changed or damaged",
    ),
    "an early one of another run": (
        lambda f: of_another_run(make_checkpoint_path(f, 9)), 60, "checkpoint.0009.npz` was changed or damaged",
    ),
    "other meshes": (
        lambda f: swapped(f / "static.npz", make_checkpoint_path(f, 9)), 60, "static.npz` was changed or damaged",
    ),
    "no meshes": (lambda f: (f / "static.npz").unlink(), 60, "static.npz` does not exist; it is written again"),
    "no checkpoints": (lambda f: [p.unlink() for p in (f / "checkpoints").iterdir()], None, "no checkpoint with complete frames"),
    "a hash of another state": (lambda f: lines_changed(f, 33, hash="0" * 32), 25, "frame.0033.npz` was changed or damaged"),
    "a hash of another file": (lambda f: lines_changed(f, 12, file="0" * 32), 9, "frame.0012.npz` was changed or damaged"),
    "a hash of other feet": (lambda f: lines_changed(f, 33, feet="0" * 32), 25, "frame.0033.npz` was changed or damaged"),
    "no hash of a checkpoint": (lambda f: lines_changed(f, 60, checkpoint=""), 57, "checkpoint.0060.npz` has no hash in"),
    "a cut line": (lambda f: os.truncate(f / HASHES_FILE_NAME, in_line_of(f, 31)), 25, "has no hash in `hashes.jsonl`"),
    "no hashes": (lambda f: (f / HASHES_FILE_NAME).unlink(), None, "frame.0001.npz` has no hash in `hashes.jsonl`"),
}  # fmt: skip


@pytest.mark.parametrize("name", ["mesh.ground.vertices", "mesh.ground.faces"])
def test_meshes_that_the_manifest_names_are_there(tmp_path: Path, name: str) -> None:
    """Where the file is whole and has other arrays, as one that was edited by hand."""
    scene = project(tmp_path / "p", hills=True)
    assert ran(scene, "--frames", "1..1")[0] == 0
    cache = open_cache(scene.parent / "out" / "scene")
    others = {key: array for key, array in cache.read_static().items() if key != name}
    (cache.folder / "static.npz").write_bytes(encode_npz(others))
    with pytest.raises(CacheError, match=f"static.npz` has no `{name}`"):
        cache.read_static()


def verified(folder: Path) -> tuple[int, str]:
    result = CliRunner().invoke(app, ["info", str(folder), "--verify"])
    return result.exit_code, result.output


@pytest.mark.parametrize("kind", DAMAGE)
def test_damage_in_a_cache_is_reported_and_repaired(unbroken: tuple[Path, dict[int, str]], tmp_path: Path, kind: str) -> None:
    damage, resume_frame, note = DAMAGE[kind]
    shutil.copytree(unbroken[0].parent, tmp_path / "p")
    scene = tmp_path / "p" / "scene.yaml"
    folder, intact_folder = scene.parent / "out" / "scene", unbroken[0].parent / "out" / "scene"
    shot, _ = open_scene(scene)
    assert shot is not None
    damage(folder)
    code, words = verified(folder)
    assert (code == 0) == (kind in ("nothing", "no checkpoints")), words
    recording = begin_recording(shot, folder, Options(), resume=True, force=False)
    assert recording.resumed_from == resume_frame
    assert note in " ".join(recording.notes) and bool(recording.notes) == (kind != "nothing"), recording.notes
    for _ in record_frames(recording):
        pass
    for frame in range(1, 61):
        assert make_frame_path(folder, frame).read_bytes() == make_frame_path(intact_folder, frame).read_bytes()
    assert read_lines(folder / HASHES_FILE_NAME) == read_lines(intact_folder / HASHES_FILE_NAME)
    assert verified(folder)[0] == 0


def as_before(folder: Path) -> None:
    """A cache of files with hashes of all their bytes, as they had before these were made of headers."""

    def of(begin: str, path: Path) -> str:
        return sha256(begin.encode() + path.read_bytes()).hexdigest()[:32]

    manifest = json.loads((folder / "manifest.json").read_text())
    (folder / "manifest.json").write_text(json.dumps(manifest | {"static": of("static ", folder / "static.npz")}))
    lines = []
    for frame, line in read_lines(folder / HASHES_FILE_NAME).items():
        point = of(f"checkpoint {frame} {line.hash} ", make_checkpoint_path(folder, frame)) if line.checkpoint else ""
        lines.append(
            replace(line, file=of(f"{frame} {line.hash} ", make_frame_path(folder, frame)), checkpoint=point).text(frame)
        )
    (folder / HASHES_FILE_NAME).write_bytes(b"".join(lines))


@pytest.mark.parametrize("kind", ["nothing", "a bit of a frame", "a bit of a checkpoint", "other meshes", "a frame cut off"])
def test_a_cache_with_hashes_of_all_bytes_is_held_against_them_and_gone_on_with(
    unbroken: tuple[Path, dict[int, str]], tmp_path: Path, kind: str
) -> None:
    damage, resume_frame, note = DAMAGE[kind]
    shutil.copytree(unbroken[0].parent, tmp_path / "p")
    folder, intact_folder = tmp_path / "p" / "out" / "scene", unbroken[0].parent / "out" / "scene"
    as_before(folder)
    assert verified(folder) == (0, verified(intact_folder)[1])
    old = read_lines(folder / HASHES_FILE_NAME)
    assert all(len(line.file) == 32 for line in old.values())
    damage(folder)
    assert (verified(folder)[0] == 0) == (kind == "nothing")
    shot, _ = open_scene(tmp_path / "p" / "scene.yaml")
    assert shot is not None
    recording = begin_recording(shot, folder, Options(), resume=True, force=False)
    assert recording.resumed_from == resume_frame and note in " ".join(recording.notes)
    for _ in record_frames(recording):
        pass
    assert resume_frame is not None and verified(folder)[0] == 0
    new = read_lines(intact_folder / HASHES_FILE_NAME)
    assert {frame: line.file for frame, line in read_lines(folder / HASHES_FILE_NAME).items()} == {
        frame: (old if frame <= resume_frame else new)[frame].file for frame in range(1, 61)
    }


def test_a_cache_from_before_checkpoints_had_hashes_is_read_and_said_to_be_not_checked(
    unbroken: tuple[Path, dict[int, str]], tmp_path: Path
) -> None:
    shutil.copytree(unbroken[0].parent, tmp_path / "p")
    folder = tmp_path / "p" / "out" / "scene"
    as_before(folder)
    manifest = json.loads((folder / "manifest.json").read_text())
    assert manifest.pop("static")
    (folder / "manifest.json").write_text(json.dumps(manifest))
    lines = {frame: replace(line, checkpoint="") for frame, line in read_lines(folder / HASHES_FILE_NAME).items()}
    (folder / HASHES_FILE_NAME).write_bytes(b"".join(line.text(frame) for frame, line in lines.items()))
    code, words = verified(folder)
    assert code == 0 and "60 frames, 0 checkpoints" in words
    assert "not checked  `static.npz`, checkpoints 1 9 17 25 33 41 49 57 60" in words
    swapped(make_checkpoint_path(folder, 60), make_checkpoint_path(folder, 49))
    assert verified(folder)[0] == 1
    shot, _ = open_scene(tmp_path / "p" / "scene.yaml")
    assert shot is not None
    recording = begin_recording(shot, folder, Options(), resume=True, force=False)
    assert recording.resumed_from == 57 and "does not hold frame 60" in recording.notes[0]
    for _ in record_frames(recording):
        pass
    code, words = verified(folder)
    assert code == 0 and "60 frames, 1 checkpoint\n" in words and "not checked  checkpoints 1 9 17 25 33 41 57" in words


def test_only_the_written_form_of_a_name_is_a_frame(unbroken: tuple[Path, dict[int, str]], tmp_path: Path) -> None:
    shutil.copytree(unbroken[0].parent, tmp_path / "p")
    folder = tmp_path / "p" / "out" / "scene"
    for name in ("frames/frame.12.npz", "frames/frame.00012.npz", "frames/checkpoint.0012.npz", "checkpoints/checkpoint.9.npz"):
        shutil.copy(make_frame_path(folder, 12), folder / name)
    cache = open_cache(folder)
    assert (
        cache.frames() == list(range(1, 61)) and cache.checkpoints() == open_cache(unbroken[0].parent / "out/scene").checkpoints()
    )
    stopped = CliRunner().invoke(app, ["info", str(folder), "--verify"]).exception
    assert (
        isinstance(stopped, CommandError) and stopped.code == 1 and "move away" in stopped.hint and "--resume" not in stopped.hint
    )
    shutil.copy(make_frame_path(folder, 12), make_frame_path(folder, 70))
    shot, _ = open_scene(tmp_path / "p" / "scene.yaml")
    assert shot is not None
    notes = "\n".join(begin_recording(shot, folder, Options(), resume=True, force=False).notes)
    for name in ("frame.12.npz", "frame.00012.npz", "frames/checkpoint.0012.npz", "checkpoint.9.npz"):
        assert f"{name}` is not a " in stopped.message and f"{name}` is not a " in notes
    assert "frame 70 is beyond frame 60, the last, and is removed" in notes and "made again" not in notes


def test_a_damaged_frame_is_reported_and_rewritten(tmp_path: Path) -> None:
    scene = project(tmp_path / "p")
    assert ran(scene, "--frames", "1..20")[0] == 0
    folder = scene.parent / "out" / "scene"
    intact_bytes = make_frame_path(folder, 12).read_bytes()
    make_frame_path(folder, 12).write_bytes(intact_bytes[: len(intact_bytes) // 2])
    with pytest.raises(CacheError):
        open_cache(folder).frame(12)
    code, words = ran(scene, "--frames", "1..20", "--resume")
    assert code == 0 and "continues after frame 9" in words, words
    assert "frame.0012.npz` was changed or damaged" in words and "frames 10 to 20 are computed again" in words
    assert make_frame_path(folder, 12).read_bytes() == intact_bytes


def test_a_link_where_a_file_is_being_written_is_not_followed(tmp_path: Path) -> None:
    """A cache of another user may have one, and it would lead to a file of the user who continues it."""
    mine = tmp_path / "mine.txt"
    mine.write_text("mine")
    (tmp_path / ".a.npz.part").symlink_to(mine)
    write_atomically(tmp_path / "a.npz", encode_npz(ARRAYS), sync=False)
    assert mine.read_text() == "mine" and not (tmp_path / "a.npz").is_symlink() and (tmp_path / ".a.npz.part").is_symlink()
    assert read_npz(tmp_path / "a.npz").keys() == ARRAYS.keys()


STRANGE: dict[str, Callable[[Arrays], dict[str, object]]] = {
    "a face that is not there": lambda a: {"species.walker.footing.face": np.full_like(a["species.walker.footing.face"], 10**6)},
    "a mesh that is not there": lambda a: {"species.walker.footing.mesh": np.full_like(a["species.walker.footing.mesh"], 99)},
    "other numbers of rows": lambda a: {"species.walker.ids": a["species.walker.ids"][:7]},
    "a number of another kind": lambda a: {"species.walker.ids": a["species.walker.ids"].astype(np.float64)},
    "a frame that is a list": lambda a: {"frame": np.arange(3)},
    "a frame that is no number": lambda a: {"frame": np.array(np.nan)},
    "names that are no text": lambda a: {"transitions.names": np.full(3, 255, np.uint8)},
    "more names than counts": lambda a: {"transitions.counts": np.arange(99)},
    "counts that are no numbers": lambda a: {"transitions.counts": np.array([np.inf])},
    "next of all ids": lambda a: {"species.walker.next_id": np.array([[1, 2]])},
}


@pytest.mark.parametrize("kind", STRANGE)
def test_a_forged_checkpoint_is_refused_and_reads_no_other_memory(
    unbroken: tuple[Path, dict[int, str]], kind: str, tmp_path: Path
) -> None:
    scene = project(tmp_path / "p", hills=True)
    shot, _ = open_scene(scene)
    assert shot is not None
    world = bind(shot.plan, shot.setting, Options())
    arrays = take_checkpoint(world)
    restore_checkpoint(world, arrays)
    with pytest.raises(CheckpointError):
        restore_checkpoint(world, {**arrays, **STRANGE[kind](arrays)})  # type: ignore[dict-item]


@pytest.mark.parametrize("last_frame", sampled([0, 7, 22, 43], [22]))
def test_a_run_killed_at_any_instant_ends_with_the_same_hashes(
    unbroken: tuple[Path, dict[int, str]], tmp_path: Path, last_frame: int
) -> None:
    """Killed as soon as some frame is there, in the midst of whatever comes next; a half-written file is left behind as well."""
    scene = project(tmp_path / "p")
    folder = scene.parent / "out" / "scene"
    run = start(scene)
    began = time.monotonic()
    awaited_path = folder if last_frame == 0 else make_frame_path(folder, last_frame)
    while not awaited_path.exists() and run.poll() is None and time.monotonic() - began < 30:
        time.sleep(0.0005)
    run.send_signal(signal.SIGKILL)
    run.communicate()
    if (folder / "hashes.jsonl").exists():
        (folder / "frames" / ".frame.0044.npz.part").write_bytes(b"PK half")
        with open(folder / "hashes.jsonl", "ab") as hashes:
            hashes.write(b'{"frame": 44, "ha')
    code, words = ran(scene, "--resume")
    assert code == 0, words
    assert read_hashes(folder / "hashes.jsonl") == unbroken[1]
    mine, intact_cache = open_cache(folder), open_cache(unbroken[0].parent / "out" / "scene")
    for frame in range(1, 61):
        assert make_frame_path(mine.folder, frame).read_bytes() == make_frame_path(intact_cache.folder, frame).read_bytes()
    assert not list((folder / "frames").glob(".*"))


def test_a_termination_leaves_a_checkpoint_and_its_own_exit_code(unbroken: tuple[Path, dict[int, str]], tmp_path: Path) -> None:
    """As a farm ends a task: SIGTERM to all processes of the run, more than once; the next attempt has the same words."""
    scene = project(tmp_path / "p")
    folder = scene.parent / "out" / "scene"
    run = start(scene, "--frames", "1..4000", "--resume")
    while not make_frame_path(folder, 12).exists() and run.poll() is None:
        time.sleep(0.001)
    for _ in range(3):
        os.killpg(run.pid, signal.SIGTERM)
    code, words = finished(run)
    assert code == 75 and "which has a checkpoint" in words and "--resume" in words, words
    cache = open_cache(folder)
    assert cache.checkpoints()[-1] == cache.frames()[-1] >= 12
    if cache.frames()[-1] < 60:
        assert ran(scene, "--resume")[0] == 0
        assert read_hashes(folder / "hashes.jsonl") == unbroken[1]


def test_a_termination_before_the_first_frame_has_the_same_exit_code(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    scene = project(tmp_path / "p")
    for place in ("antdsl.pipeline.open_scene", "antdsl.outputs.recording.begin_recording"):
        with monkeypatch.context() as patch:
            patch.setattr(place, lambda *words, **keywords: signal.raise_signal(signal.SIGTERM))
            patch.setattr("sys.argv", ["antdsl", "run", str(scene)])
            previous_handler = signal.getsignal(signal.SIGTERM)
            assert run_in_process() == 75 and signal.getsignal(signal.SIGTERM) is previous_handler
            assert "stopped before the first frame" in capfd.readouterr().err


def test_ctrl_c_leaves_a_cache_that_goes_on(unbroken: tuple[Path, dict[int, str]], tmp_path: Path) -> None:
    """Ctrl-C in a terminal, which reaches all processes of the run."""
    scene = project(tmp_path / "p")
    folder = scene.parent / "out" / "scene"
    run = start(scene, "--frames", "1..4000")
    while not make_frame_path(folder, 12).exists() and run.poll() is None:
        time.sleep(0.001)
    os.killpg(run.pid, signal.SIGINT)
    code, words = finished(run)
    assert code == 130 and "--resume" in words, words
    cache = open_cache(folder)
    assert cache.checkpoints()[-1] == cache.frames()[-1]
    if cache.frames()[-1] < 60:
        assert ran(scene, "--resume")[0] == 0
    assert {f: h for f, h in read_hashes(folder / "hashes.jsonl").items() if f <= 60} == unbroken[1]


def test_other_inputs_are_named_and_not_continued(tmp_path: Path) -> None:
    scene = project(tmp_path / "p")
    assert ran(scene, "--frames", "1..10")[0] == 0
    program = scene.parent / "walker.ant"
    program.write_text(program.read_text().replace("40 deg", "41 deg"))
    code, words = ran(scene, "--frames", "1..20", "--resume")
    assert code == 1 and "`walker.ant`" in words and "`scene`" not in words, words


def test_states_hashed_with_another_method_are_reported_and_not_compared(
    unbroken: tuple[Path, dict[int, str]], tmp_path: Path
) -> None:
    """A cache from before has no word of how; its frames are read and verified as ever."""
    shutil.copytree(unbroken[0].parent, tmp_path / "p")
    scene, manifest = tmp_path / "p" / "scene.yaml", tmp_path / "p" / "out" / "scene" / "manifest.json"
    said = json.loads(manifest.read_text())
    assert said.pop("state_hash") == STATE_HASH_VERSION
    manifest.write_text(json.dumps(said))
    stopped = CliRunner().invoke(app, ["run", str(scene), "--resume"]).exception
    assert isinstance(stopped, CommandError) and "computes state hashes in another way" in stopped.message
    assert CliRunner().invoke(app, ["info", str(manifest.parent), "--verify"]).exit_code == 0


def test_a_run_begins_where_another_cache_was(unbroken: tuple[Path, dict[int, str]]) -> None:
    scene, _ = unbroken
    second = scene.with_name("second.yaml")
    second.write_text(scene.read_text().replace("1..60", "101..105") + "from: {cache: out/scene, frame: 57}\n")
    assert ran(second)[0] == 0
    first_cache, second_cache = open_cache(scene.parent / "out" / "scene"), open_cache(scene.parent / "out" / "second")
    assert np.array_equal(first_cache.frame(57)["P"], second_cache.frame(101)["P"])
    assert not np.array_equal(second_cache.frame(105)["P"], second_cache.frame(101)["P"])
    second.write_text(second.read_text().replace("frame: 57", "frame: 56"))
    code, words = ran(second)
    assert code == 1 and "write one of" in words and "57" in words


@pytest.mark.parametrize("words", sampled([(), ("--profile", "--summary", "s.json")], [()]))
def test_a_run_without_a_reader_of_its_output_continues_to_its_end(tmp_path: Path, words: tuple[str, ...]) -> None:
    """As with `| head -1`."""
    scene = project(tmp_path / "p")
    run = start(scene, "--frames", "1..6", *words)
    assert run.stdout is not None and run.stderr is not None
    run.stdout.close()
    assert run.stderr.read() == "" and run.wait(60) == 0
    assert open_cache(scene.parent / "out" / "scene").frames() == [1, 2, 3, 4, 5, 6]
    assert not words or (scene.parent / "s.json").is_file()


@pytest.mark.parametrize(
    "kind", ["frames/frame.0012.npz", "frames/frame.0099.npz", "static.npz", "checkpoints/checkpoint.0009.npz"]
)
def test_a_folder_in_the_place_of_a_file_is_reported_before_anything_is_removed(
    unbroken: tuple[Path, dict[int, str]], tmp_path: Path, kind: str
) -> None:
    shutil.copytree(unbroken[0].parent, tmp_path / "p")
    scene = tmp_path / "p" / "scene.yaml"
    folder = scene.parent / "out" / "scene"
    (folder / kind).unlink(missing_ok=True)
    (folder / kind / "work").mkdir(parents=True)
    initial_paths = sorted(path for path in folder.rglob("*"))
    for words in ([], ["--resume"]):
        stopped = CliRunner().invoke(app, ["run", str(scene), *words]).exception
        assert isinstance(stopped, CommandError) and f"{kind}` is a folder" in stopped.message and "move it away" in stopped.hint
        assert sorted(path for path in folder.rglob("*")) == initial_paths


@pytest.mark.parametrize(
    ("number", "advice"), [("ENOSPC", "make room, then continue"), ("EIO", "once that is corrected, continue")]
)
def test_only_a_full_disk_is_to_be_made_room_on(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, number: str, advice: str
) -> None:
    def broken(*_: object) -> None:
        raise OSError(getattr(errno, number), os.strerror(getattr(errno, number)))

    scene = project(tmp_path / "p")
    monkeypatch.setattr("antdsl.atomic_write._replace_file", broken)
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / ".antdsl-cache").write_text("")
    stopped = CliRunner().invoke(app, ["run", str(scene), "--out", str(tmp_path / "out"), "--frames", "1..2"]).exception
    assert (
        isinstance(stopped, CommandError)
        and advice in stopped.hint
        and f"`{tmp_path / 'out' / 'hashes.jsonl'}`" in stopped.message
    )


def test_a_full_disk_ends_in_words_and_the_run_goes_on_later(unbroken: tuple[Path, dict[int, str]], tmp_path: Path) -> None:
    """The system refuses to let any file grow beyond what a few frames' hashes need."""
    scene = project(tmp_path / "p")
    scene.write_text(SCENE.replace("count: 40", "count: 400"))
    command = [sys.executable, "-m", "antdsl", "run", "scene.yaml", "--threads", "1"]
    env = child_environment()
    limit = f"import resource as r, os; r.setrlimit(r.RLIMIT_FSIZE, (20000, 20000)); os.execv({sys.executable!r}, {command!r})"
    process = subprocess.run([sys.executable, "-c", limit], env=env, cwd=scene.parent, capture_output=True, text=True, timeout=60)
    assert process.returncode == 3 and "Traceback" not in process.stderr, process.stderr[-600:]
    assert "cannot write the cache: file too large" in process.stderr and "--resume" in process.stderr
    assert ran(scene, "--resume")[0] == 0
    assert len(read_hashes(scene.parent / "out" / "scene" / "hashes.jsonl")) == 60
