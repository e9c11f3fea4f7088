"""The page of swaps: each changes one line, and what it says of the rest is so."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest

from antdsl.outputs.cache.cache_reader import Cache, open_cache
from tests.commands import run
from tests.gltf_scene import Scene

PAGE = (Path(__file__).parents[2] / "docs" / "swaps.md").read_text(encoding="utf-8")
FILES = dict(re.findall(r"^```text file=(\S+)\n(.*?)^```", PAGE, flags=re.M | re.S))
SWAPS = dict(re.findall(r"^```text swap=(\S+)\n(.*?)^```", PAGE, flags=re.M | re.S))


def written(folder: Path, swap: str = "") -> None:
    """The page's files in a folder, with one line of one of them changed."""
    files = dict(FILES)
    if swap:
        name, old_line, new_line = SWAPS[swap].splitlines()
        assert old_line[0] == "-" and new_line[0] == "+" and files[name].count(old_line[1:] + "\n") == 1
        files[name] = files[name].replace(old_line[1:] + "\n", new_line[1:] + "\n")
    folder.mkdir(exist_ok=True)
    for name, text in files.items():
        (folder / name).write_text(text)
    (folder / "ground.obj").write_text("v -120 0 -120\nv 120 6 -120\nv 120 0 120\nv -120 -4 120\nf 1 4 3\nf 1 3 2\n")


def ran(folder: Path, swap: str = "") -> Cache:
    written(folder, swap)
    result = run("run", "scene.yaml", "--out", "cache", "--backend", "numpy", "-q", cwd=folder)
    assert result.returncode == 0, result.stderr
    return open_cache(folder / "cache")


@pytest.fixture(scope="module")
def plain(tmp_path_factory: pytest.TempPathFactory) -> Cache:
    return ran(tmp_path_factory.mktemp("plain"))


def test_the_page_has_five_swaps_of_a_line_each() -> None:
    assert set(SWAPS) == {"body", "species", "library", "states", "export"} and len(FILES) == 5
    for text in SWAPS.values():
        assert len(re.findall(r"^[-+]", text, flags=re.M)) == 2


def test_another_body_changes_what_is_seen_alone(plain: Cache, tmp_path: Path) -> None:
    from antdsl.outputs.gallery import Gallery

    other = ran(tmp_path, "body")
    assert other.read_state_hashes() == plain.read_state_hashes()
    for frame in (1, 36):
        mine, theirs = plain.frame(frame), other.frame(frame)
        for name in ("P", "v", "orient", "state", "Cd", "id"):
            assert np.array_equal(mine[name], theirs[name])
    a, b = (Gallery(cache).make_picture(36).crowds[0].body for cache in (plain, other))
    assert a is not None and b is not None and len(a.faces) != len(b.faces)


def test_another_species_begins_in_the_same_places(plain: Cache, tmp_path: Path) -> None:
    other = ran(tmp_path, "species")
    mine, theirs = plain.frame(1), other.frame(1)
    assert np.array_equal(mine["P"], theirs["P"]) and np.array_equal(mine["id"], theirs["id"])
    assert other.manifest.camera == plain.manifest.camera and other.manifest.meshes == plain.manifest.meshes
    assert {state.name for state in other.manifest.species[0].machines[0].states} == {"dash", "listen"}
    far = [np.linalg.norm(c.frame(36)["P"] - c.frame(1)["P"], axis=1).mean() for c in (plain, other)]
    assert far[1] > 1.5 * far[0]


def test_another_library_changes_how_they_go_and_not_when_they_change(plain: Cache, tmp_path: Path) -> None:
    other = ran(tmp_path, "library")
    for frame in (1, 12, 36):
        assert np.array_equal(plain.frame(frame)["state"], other.frame(frame)["state"])
    assert np.array_equal(plain.frame(1)["P"], other.frame(1)["P"])
    far = [np.linalg.norm(c.frame(36)["P"] - c.frame(1)["P"], axis=1).mean() for c in (plain, other)]
    assert far[1] < 0.7 * far[0]


def test_another_state_is_entered_in_the_same_frames_and_others_go_on(plain: Cache, tmp_path: Path) -> None:
    other = ran(tmp_path, "states")
    been = np.zeros(40, bool)
    for frame in range(1, 37):
        mine, theirs = plain.frame(frame), other.frame(frame)
        assert np.array_equal(mine["state"], theirs["state"])
        been |= mine["state"] == 1
        assert np.array_equal(mine["P"][~been], theirs["P"][~been])
    assert 5 < been.sum() < 40 and (np.abs(mine["P"] - theirs["P"]).max(axis=1)[been] > 0).mean() > 0.8
    assert [state.label for state in other.manifest.species[0].machines[0].states] == ["Strolls", "Stands"]


def test_another_export_has_the_same_places(plain: Cache, tmp_path: Path) -> None:
    for line in SWAPS["export"].splitlines():
        words = line[1:].split()[1:]
        result = run(*words, "--frames", "30..36", cwd=plain.folder.parent)
        assert result.returncode == 0, result.stderr
    scene = Scene((plain.folder.parent / "walkers.glb").read_bytes())
    world, _ = scene.at(0.25)
    names = [node["name"] for node in scene.tree["nodes"]]
    with np.load(plain.folder.parent / "walkers.npz") as arrays:
        rows = slice(*arrays["rows"][6:8])
        for one, place in zip(arrays["id"][rows].tolist(), arrays["P"][rows], strict=True):
            assert np.allclose(world[names.index(f"walker_{one}")][:3, 3], place / 1000, atol=1e-6)
