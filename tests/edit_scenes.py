"""A cache with two species, feet, clips, births, deaths, events and items, for tests of edits."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import stick_bodies
from numpy.typing import NDArray
from typer.testing import CliRunner

from antdsl.cli import app
from antdsl.outputs.cache.cache_reader import Arrays, Cache
from antdsl.outputs.edits.frame_rows import FrameRows

RUN = CliRunner()
FRAMES = 24
BUG = """ant 1
use steering
world { surface ground; items food }
species bug {
  size 5 mm
  max_speed 30 mm/s
  response 1 step
  start go
  state go "Goes" green {
    play walk
    steer wander(swing: 200 deg)
    when alarm -> split
    when chance 60 %/s -> split
    when age > 0.5 s and id > 4 -> gone
  }
  state split "Splits" red { enter { spawn bug; emit alarm }; play antennate; steer coast(); when after 0.2 s -> go }
  state gone { enter { die } }
  layers { state }
}
"""
SCENE = """antdsl: 1
units: mm
fps: 24
frames: 1..{frames}
seed: 5
world:
  ground: {{mesh: ground.ply}}
  food: {{leaf: {{at: [10, 0, 0]}}, seed: {{at: [-20, 0, 12]}}}}
crowd:
  - {{species: bug, from: bug.ant, count: 8, place: {{on: ground, radius: 40 mm}}}}
  - {{name: hunters, species: walker, from: walker.ant, count: 6, body: body.json, place: {{on: ground, radius: 40 mm}}}}
  - {{name: guards, species: walker, from: walker.ant, count: 4, body: body.json, place: {{on: ground, radius: 60 mm}}}}
output: {{attributes: [P, v, orient, id, pscale, Cd, state, age, group], checkpoint: 10, events: [emit, contact]}}
"""


def run(*arguments: object) -> str:
    """Run a command that succeeds, and return its output."""
    result = RUN.invoke(app, [str(each) for each in arguments])
    assert result.exit_code == 0, f"{result.output}{getattr(result.exception, 'message', result.exception)}"
    return result.output


def fail(*arguments: object) -> str:
    """Run a command that fails with a message, and return all that it reports."""
    result = RUN.invoke(app, [str(each) for each in arguments])
    assert result.exit_code != 0, result.output
    assert isinstance(result.exception, SystemExit) or hasattr(result.exception, "message"), repr(result.exception)
    return result.output + str(getattr(result.exception, "message", "")) + str(getattr(result.exception, "hint", ""))


def write_scene(folder: Path) -> Path:
    """Write the scene and its files into a folder."""
    stick_bodies.write_scene(folder, 6, "hill", count=1)
    (folder / "bug.ant").write_text(BUG)
    (folder / "scene.yaml").write_text(SCENE.format(frames=FRAMES))
    return folder / "scene.yaml"


def simulate(folder: Path) -> Path:
    """Return the folder of the scene's cache."""
    run("run", write_scene(folder), "--out", folder / "cache", "--backend", "numpy", "-q")
    return folder / "cache"


def iterate_rows(cache: Cache, arrays: Arrays) -> Iterator[tuple[str, NDArray[Any], NDArray[np.int64]]]:
    """Yield the arrays of a frame with rows of agents, and the agent of each row."""
    for name, keys in FrameRows(arrays, cache.manifest).iterate_agent_arrays():
        yield name, arrays[name], keys


def take_agents(cache: Cache, frame: int, keys: NDArray[np.int64]) -> dict[str, bytes]:
    """Return the bytes of the rows of some agents in all arrays of a frame."""
    arrays = cache.frame(frame)
    return {name: array[np.isin(own, keys)].tobytes() for name, array, own in iterate_rows(cache, arrays)}


def assert_same_frames(one: Cache, other: Cache) -> None:
    """Check that two caches have the same frames, to the bit."""
    assert one.frames() == other.frames()
    for number in one.frames():
        first, second = one.frame(number), other.frame(number)
        assert list(first) == list(second)
        assert_same_arrays(first, second, number)


def assert_same_arrays(first: Mapping[str, NDArray[Any]], second: Mapping[str, NDArray[Any]], number: int) -> None:
    """Check that two frames have arrays of the same types, shapes and bytes."""
    for name, array in first.items():
        other = second[name]
        assert (array.dtype, array.shape) == (other.dtype, other.shape), (number, name)
        assert array.tobytes() == other.tobytes(), (number, name)
