"""What a cache was made with stands in its manifest, the same bytes wherever it is made, and `info` shows it."""

from __future__ import annotations

import json
import platform
import shlex
import shutil
from pathlib import Path

import numpy as np
import pytest
from commands import run

from antdsl import source_hash
from antdsl.outputs import provenance
from antdsl.outputs.cache.manifest import MANIFEST_FILE_NAME, ManifestError, read_manifest
from antdsl.scene.values import FrameRange

MINIMAL = Path(__file__).resolve().parents[2] / "examples" / "minimal"


def create_cache(folder: Path, *words: str, out: str = "out/scene") -> Path:
    """The cache of a run of the smallest scene in a folder."""
    folder.mkdir(parents=True)
    for name in ("walker.ant", "ground.ply", "scene.yaml"):
        shutil.copy(MINIMAL / name, folder)
    process = run("run", "scene.yaml", "-q", "--frames", "1..2", *words, cwd=folder)
    assert process.returncode == 0, process.stderr
    return folder / out


def test_a_manifest_says_what_made_it_and_names_no_folder(tmp_path: Path) -> None:
    cache = create_cache(tmp_path / "private" / "name", "--seed", "7", "--threads", "1")
    creation_info = read_manifest(cache).made_with
    assert creation_info is not None
    assert (creation_info.python, creation_info.numpy) == (platform.python_version(), np.__version__)
    assert (
        creation_info.platform == f"{platform.system()} {platform.machine()}"
        and creation_info.sources == source_hash.hash_sources()
    )
    assert creation_info.command == "antdsl run scene.yaml --frames 1..2 --seed 7"
    text = (cache / MANIFEST_FILE_NAME).read_text()
    assert "private" not in text and str(tmp_path) not in text
    output = run("info", str(cache), cwd=tmp_path).stdout
    assert "made with\n" in output
    for value in creation_info.model_dump().values():
        assert value in output
    other = create_cache(tmp_path / "elsewhere", "--seed", "7", "--backend", "reference", "--out", "away", out="away")
    other_manifest = json.loads((other / MANIFEST_FILE_NAME).read_text())
    manifest = json.loads(text)
    assert {**other_manifest, "scene_path": ""} == {**manifest, "scene_path": ""}
    frame = Path("frames", "frame.0001.npz")
    assert (other / frame).read_bytes() == (cache / frame).read_bytes()


def test_the_command_can_be_given_again_whatever_names_it_has() -> None:
    inputs = {"scene.yaml": "00", "--set pace": "4 mm/s; rm", "edit 1": "smooth orient:9"}
    words = shlex.split(provenance.make_command("my $(scene).yaml", FrameRange(-3, 9), 5, inputs))
    assert words == ["antdsl", "run", "my $(scene).yaml", "--frames", "-3..9", "--seed", "5", "--set", "pace=4 mm/s; rm"]
    assert len(provenance.make_command("x" * 5000, FrameRange(1, 2), 0, {})) == 2000


def test_sources_are_all_that_a_result_depends_on(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for name in ("package", "behaviours", "grammar"):
        (tmp_path / name).mkdir()
    (tmp_path / "package" / "__init__.py").write_text("one = 1\n")
    monkeypatch.setattr(source_hash.antdsl, "__file__", str(tmp_path / "package" / "__init__.py"))
    for name in ("behaviours", "grammar"):
        monkeypatch.setattr(source_hash, f"{name}_folder", lambda name=name: tmp_path / name)
    hashes = []

    def note() -> bool:
        """Whether the hash is another one than all before."""
        hashes.append(source_hash.hash_sources.__wrapped__())
        return hashes[-1] not in hashes[:-1]

    assert note()
    for path, text in (
        ("package/__init__.py", "one = 2\n"),
        ("package/two.py", ""),
        ("package/inner.json", "{}"),
        ("behaviours/steering.ant", "ant 1\n"),
        ("grammar/tables.json", "[]"),
    ):
        (tmp_path / path).write_text(text)
        assert note(), path
    for path in ("package/__pycache__/two.py", "package/web/two.py", "package/note.txt"):
        (tmp_path / path).parent.mkdir(exist_ok=True)
        (tmp_path / path).write_text("other")
        assert not note(), path


@pytest.mark.parametrize(
    ("change", "readable"),
    [
        (lambda entry: None, True),
        (lambda entry: {**entry, "command": "x" * 2001}, False),
        (lambda entry: {**entry, "llvm": "x" * 501}, False),
        (lambda entry: {**entry, "python": 3}, False),
        (lambda entry: {k: v for k, v in entry.items() if k != "numpy"}, False),
        (lambda entry: "text", False),
        (lambda entry: {**entry, "command": "\x1b[2Jgone\u202e", "more": [1]}, True),
    ],
    ids=["none", "long", "long word", "number", "missing", "text", "escape"],
)
def test_what_a_stranger_wrote_there_is_bounded_and_shown_without_escapes(
    tmp_path: Path,
    change,  # type: ignore[no-untyped-def]
    readable: bool,
) -> None:
    cache = create_cache(tmp_path / "shot")
    document = json.loads((cache / MANIFEST_FILE_NAME).read_text())
    document["made_with"] = change(document["made_with"])
    (cache / MANIFEST_FILE_NAME).write_text(json.dumps(document))
    process = run("info", str(cache), cwd=tmp_path)
    assert (process.returncode == 0) == readable
    assert "\x1b" not in process.stdout + process.stderr and "\u202e" not in process.stdout + process.stderr
    if not readable:
        with pytest.raises(ManifestError, match="damaged"):
            read_manifest(cache)


def test_the_command_that_continues_a_cache_is_that_of_its_manifest(tmp_path: Path) -> None:
    cache = create_cache(tmp_path / "it's", "--seed", "7", out="out/scene")
    (cache / "frames" / "frame.0002.npz").unlink()
    words = shlex.split(provenance.make_resume_command(cache))
    assert words[1:] == [
        "run", str(cache.parents[1] / "scene.yaml"), "--frames", "1..2", "--seed", "7", "--out", str(cache), "--resume",
    ]  # fmt: skip
    process = run("info", str(cache), cwd=tmp_path)
    assert f"no; continue with: {shlex.join(words)}" in process.stdout
    assert run(*words[1:], "-q", cwd=tmp_path).returncode == 0
    assert "complete     yes" in run("info", str(cache), cwd=tmp_path).stdout
    process = run(*words[1:5], "--seed", "8", *words[7:], cwd=tmp_path)
    assert process.returncode == 1 and "error: the cache was made with seed 7, not 8" in process.stderr
    process = run(*words[1:3], "--frames", "2..3", *words[5:], cwd=tmp_path)
    assert process.returncode == 1 and "error: the cache was made from frame 1, not 2" in process.stderr


def test_a_strangers_manifest_puts_no_command_into_the_advice(tmp_path: Path) -> None:
    cache = create_cache(tmp_path / "p")
    path = cache / MANIFEST_FILE_NAME
    document = json.loads(path.read_text())
    document["scene_path"] = None
    document["scene"] = "a; rm -rf $(x)"
    document["inputs"] |= {"--set w.pace": "1; ls", "assets:a.ply": "0", "scene": "0"}
    path.write_text(json.dumps(document))
    words = shlex.split(provenance.make_resume_command(cache))
    assert words[2] == "a; rm -rf $(x)" and "w.pace=1; ls" in words and "assets=FOLDER" in words
    path.unlink()
    assert provenance.make_resume_command(cache) == shlex.join(["antdsl", "run", "SCENE", "--out", str(cache), "--resume"])
