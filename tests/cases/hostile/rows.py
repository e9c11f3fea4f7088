"""Files of a stranger, each with its verdict: a project of a ground and some walkers, and what is changed in it.

A verdict is the code of an error or a warning, with words of its message or help, or nothing where the file is accepted."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path

GROUND = b"""ply
format ascii 1.0
element vertex 4
property float x
property float y
property float z
element face 2
property list uchar int vertex_indices
end_header
-100 0 -100
-100 0 100
100 0 100
100 0 -100
3 0 1 2
3 0 2 3
"""
PROGRAM = b"""ant 1
use steering
world { surface ground }
species walker {
  size 4 mm
  max_speed 30 mm/s
  start stroll
  state stroll amber { steer wander(swing: 40 deg) }
}
"""
SCENE = b"""antdsl: 1
units: mm
up: y
fps: 24
frames: 1..6
seed: 1
world:
  ground: {mesh: ground.ply}
crowd:
  - {species: walker, from: walker.ant, count: 20, place: {on: ground}}
"""
PROJECT = {"ground.ply": GROUND, "walker.ant": PROGRAM, "scene.yaml": SCENE}


@dataclass(frozen=True)
class Row:
    """`name` begins with the row of the list of bad inputs; `files` are put in the project, `edits` replace text in its files."""

    name: str
    verdict: str  # a code of an error or a warning; empty: accepted without a word
    words: str = ""
    files: Mapping[str, bytes | Callable[[], bytes]] = field(default_factory=dict)
    edits: Mapping[str, tuple[str, str]] = field(default_factory=dict)
    make: Callable[[Path], object] | None = None
    warned: bool = False  # whether it is accepted with warnings about something else
    frames: int = 0  # that are run where it is accepted
    faults: bool = False  # whether agents get values that are none, which are stopped or put in quarantine


def named(file: str, extra: str = "") -> dict[str, tuple[str, str]]:
    """An edit of the scene: another mesh for the ground."""
    return {"scene.yaml": ("ground.ply}", f"{file}{extra}}}")}
