"""Agents on the command line: ids, or the names of crowd lines and species with numbers, as in scenes."""

from __future__ import annotations

from pathlib import Path

import meshes
import numpy as np
import pytest
from commands import run
from directed import write_mesh
from PIL import Image

from antdsl.outputs.cache.cache_reader import open_cache
from antdsl.outputs.chosen_agents import ChosenAgent, UnknownAgent, find_agent, find_agents

PROGRAM = """ant 1
use steering
world { surface ground }
species ant { size 5 mm; max_speed 20 mm/s; start walk; state walk { steer wander() }; layers { state } }
species beetle { size 6 mm; max_speed 10 mm/s; start walk; state walk { steer wander() }; layers { state } }
"""
SCENE = """antdsl: 1
frames: 1..6
world: {ground: {mesh: ground.obj}}
crowd:
  - {name: guards, species: ant, from: a.ant, count: 4, place: {on: ground, radius: 60 mm}}
  - {name: queen, species: ant, from: a.ant, count: 1, place: {on: ground, radius: 60 mm}}
  - {species: beetle, from: a.ant, count: 6, place: {on: ground, radius: 60 mm}}
output: {checkpoint: 2}
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("named")
    write_mesh(folder / "ground.obj", *meshes.terrain(200.0, 8))
    (folder / "a.ant").write_text(PROGRAM)
    (folder / "scene.yaml").write_text(SCENE)
    assert run("run", "scene.yaml", "--out", "cache", "--quiet", cwd=folder).returncode == 0
    return folder


def test_texts_name_agents_of_lines_species_and_all_with_an_id(folder: Path) -> None:
    manifest = open_cache(folder / "cache").manifest
    assert find_agents("3, guards.1..2,queen,beetle.0", manifest) == [
        ChosenAgent(None, 3),
        ChosenAgent("ant", 1),
        ChosenAgent("ant", 2),
        ChosenAgent("ant", 4),
        ChosenAgent("beetle", 0),
    ]
    assert find_agent("queen.0", manifest) == find_agent("queen", manifest) == ChosenAgent("ant", 4)
    for text, words, help in (
        ("quen.0", "no crowd line or species is named `quen`", "did you mean `queen`?"),
        ("queen.3", "`queen.3` does not exist: `queen` has 1 agent", "write `queen.0`"),
        ("guards.4", "`guards` has 4 agents", "write a number from 0 to 3"),
        ("beetle", "`beetle` is a species", "`beetle.0..9`"),
        ("guards", "`guards` names 4 agents", "write a single agent, such as `guards.0`"),
        ("guards.", "names no agents", "`guards.17`"),
        ("-3", "names no agents", "`3,8..12`"),
        ("ant.0..99999999", "more than a million ids", "fewer"),
        ("ant.999999999999999999", "has an id above", "`guards.17`"),
        ("999999999999999999", "names no agents", "`3,8..12`"),
        ("", "names no agents", "`3,8..12`"),
        ("0..3", "names 4 agents", "such as `0`"),
        ("guards.1..2", "names 2 agents", "such as `guards.1`"),
    ):
        with pytest.raises(UnknownAgent) as error:
            find_agent(text, manifest)
        assert words in str(error.value) and help in error.value.help, text


def test_an_agent_is_explained_by_its_name(folder: Path) -> None:
    named, by_id = (
        run("explain", "cache", "--agent", *agent, "--frame", "5", cwd=folder)
        for agent in (("queen.0",), ("4", "--species", "ant"))
    )
    assert named.returncode == 0 and named.stdout == by_id.stdout, named.stderr
    wrong = run("explain", "cache", "--agent", "quen.0", "--frame", "5", cwd=folder)
    assert wrong.returncode == 2 and "named `quen`" in wrong.stderr and "did you mean `queen`?" in wrong.stderr
    other = run("explain", "cache", "--agent", "queen.0", "--species", "beetle", "--frame", "5", cwd=folder)
    assert other.returncode == 2 and "`queen.0` is of the species `ant`" in other.stderr


def test_exports_and_pictures_take_names(folder: Path) -> None:
    for ids, expected in (("queen.0,beetle.4", [4, 4]), ("4", [4, 4]), ("queen.0", [4]), ("guards.1..9", None)):
        result = run("export", "cache", "--to", "some.npz", "--ids", ids, "--frames", "2..2", cwd=folder)
        if expected is None:
            assert result.returncode == 2 and "write a number from 0 to 3" in " ".join(result.stderr.split()), result.stderr
        else:
            assert result.returncode == 0, result.stderr
            assert np.load(folder / "some.npz")["id"].reshape(-1).tolist() == expected
    small = ("--camera", "eye", "--width", "64", "--height", "48", "--legend", "none", "--frames", "2..2")
    for agent in ("queen.0", "4"):
        assert run("render", "cache", *small, "--agents", agent, "--out", f"pictures_{agent}", cwd=folder).returncode == 0
    pictures = [next((folder / f"pictures_{agent}").glob("*.png")) for agent in ("queen.0", "4")]
    named, by_id = (np.asarray(Image.open(picture)) for picture in pictures)
    assert (named == by_id).all()
    wrong = run("render", "cache", *small, "--agents", "quen.0", cwd=folder)
    assert wrong.returncode == 2 and "did you mean `queen`?" in " ".join(wrong.stderr.split())
