"""`antdsl new DIR`: a project to start from: a program, a scene and a ground, ready to run, and ready for CI. `docs/ci.md`
shows the files."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Any

import typer

from antdsl import __version__
from antdsl.cli.exits import CommandError, ExitCode
from antdsl.cli.printing.messages import print_note
from antdsl.whole import make_folder, write_atomically

_PROGRAM = """\
ant 1
"Walkers that stroll, and rest now and then."
use steering

world { surface ground }

species walker {
  param pace = 30 mm/s in 5 mm/s .. 100 mm/s "How fast a walker strolls"

  size      4 mm
  max_speed pace

  start stroll
  state stroll "Taking a walk" amber {
    steer wander(swing: 40 deg)
    when chance 10 %/s -> rest
  }
  state rest "Having a rest" blue {
    when after 1 s -> stroll
  }

  layers {
    separate(radius: 2 * size) when state == stroll
    state
  }
}

spec "walkers keep moving, none too fast" on "scene.yaml" {
  for 5 s
  always: share(state == rest) < 50 %
  always: motion.circling < 10 %
  each walker {
    always: speed < 1.01 * pace
    always: time_in_state < 0.8 s or state == stroll or speed < 0.1 mm/s
  }
}
"""

_SCENE = """\
antdsl: 1
units: mm
up: y
fps: 24
frames: 1..240
seed: 1
world:
  ground: {mesh: ground.ply}
crowd:
  - {species: walker, from: walker.ant, count: 200, place: {on: ground, radius: 60 mm}}
set: {walker.pace: 25 mm/s}
camera: {at: [0, 130, 190], look_at: [0, 0, 0], focal: 35 mm}
"""

_WORKFLOW = """\
name: antdsl
on: [push, pull_request]

permissions:
  contents: read
  security-events: write # for the findings under Security, Code scanning

env:
  # antdsl is on no package index yet: its wheel lies in this repository. It is made by
  # `pip wheel --no-deps --wheel-dir wheels FOLDER`, FOLDER being the one with antdsl's pyproject.toml.
  ANTDSL: wheels/antdsl-VERSION-py3-none-any.whl

jobs:
  crowd:
    runs-on: ubuntu-latest
    steps:
      - uses: actions/checkout@v4
      - uses: actions/setup-python@v5
        with:
          python-version: "3.12"
      - run: sudo apt-get update && sudo apt-get install -y libegl1 libgl1 libusb-1.0-0
      - run: pip install "$ANTDSL"
      - name: The one layout
        run: antdsl fmt --check .
      - name: Mistakes, each at its line of the pull request
        if: always()
        run: antdsl check . --strict --format github
      - name: The same as SARIF
        if: always()
        run: antdsl check . --strict --format sarif > antdsl.sarif
      - uses: github/codeql-action/upload-sarif@v3
        if: always()
        continue-on-error: true # where code scanning is not switched on
        with:
          sarif_file: antdsl.sarif
      - name: What the crowd must do
        if: always()
        run: antdsl test . --junit antdsl-junit.xml
      - uses: actions/upload-artifact@v4
        if: always()
        with:
          name: antdsl
          path: antdsl-junit.xml
""".replace("VERSION", __version__)

_HOOKS = """\
repos:
  - repo: local
    hooks:
      - id: antdsl-fmt
        name: antdsl fmt
        entry: antdsl fmt
        language: system
        files: \\.ant$
      - id: antdsl-check
        name: antdsl check
        entry: antdsl check . --strict
        language: system
        pass_filenames: false
        files: \\.(ant|yaml|yml|ply|obj|json)$
      - id: antdsl-test
        name: antdsl test
        entry: antdsl test . --quiet
        language: system
        pass_filenames: false
        files: \\.(ant|yaml|yml|ply|obj|json)$
        stages: [pre-push]
"""

_README = """\
# Walkers

`walker.ant` says what the animals do, `scene.yaml` how many there are and on what ground, `ground.ply` is the ground.

```sh
antdsl check .
antdsl test .
antdsl run scene.yaml
antdsl render out/scene --sheet
antdsl graph walker.ant
```

On GitHub, `.github/workflows/antdsl.yml` checks and tests each push. It installs antdsl from a wheel in this repository,
which is yet to be put there: `pip wheel --no-deps --wheel-dir wheels FOLDER` makes it from the FOLDER that has antdsl's
`pyproject.toml`. For the same checks before each commit and push, on your own machine:

```sh
pip install pre-commit
pre-commit install --hook-type pre-commit --hook-type pre-push
```
"""

# What a run, a picture and the workflow leave.
_IGNORED = """\
/out/
/antdsl.sarif
/antdsl-junit.xml
"""

FILES: tuple[tuple[str, str], ...] = (
    ("walker.ant", _PROGRAM),
    ("scene.yaml", _SCENE),
    ("README.md", _README),
    (".gitignore", _IGNORED),
    (".github/workflows/antdsl.yml", _WORKFLOW),
    (".pre-commit-config.yaml", _HOOKS),
)


def new(folder: Path = typer.Argument(..., metavar="DIR", help="A folder that is not there yet, or is empty.")) -> None:
    """Write a small project to start from, with its specs and what checks it in CI."""
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise CommandError(ExitCode.INPUT_OUTPUT, f"error: `{folder}` already exists and is not empty", "name another folder")
    for name, text in FILES:
        path = folder / name
        make_folder(path.parent)
        write_atomically(path, text.encode())
    write_atomically(folder / "ground.ply", ground())
    print_note(f"walker.ant, scene.yaml and ground.ply are in {folder}; now:")
    for words in (("run", folder / "scene.yaml"), ("test", folder), ("render", folder / "out" / "scene", "--sheet")):
        print_note(f"  {shlex.join(['antdsl', *map(str, words)])}")
    print_note(f"{folder / 'README.md'} says more; a workflow for GitHub and hooks for pre-commit are there too")


def ground(side: int = 49, width: float = 200.0) -> bytes:
    """A gently rolling square as a binary .ply file: `side` × `side` vertices, `width` mm wide, y up."""
    import numpy as np

    line = np.linspace(-width / 2, width / 2, side)
    x, z = np.meshgrid(line, line, indexing="ij")
    y = 6 * np.sin(x / 23) * np.cos(z / 31) + 3 * np.sin((x + 2 * z) / 41) + 1.2 * np.cos((x - z) / 11)
    vertices = np.stack([x, y, z], axis=-1).reshape(-1, 3).astype("<f4")
    corner = (np.arange(side - 1)[:, None] * side + np.arange(side - 1)[None, :]).ravel()
    first = np.stack([corner, corner + 1, corner + side], axis=1)
    second = np.stack([corner + 1, corner + side + 1, corner + side], axis=1)
    faces = np.concatenate([first, second])
    rows: Any = np.empty(len(faces), np.dtype([("count", "u1"), ("corners", "<i4", 3)]))
    rows["count"], rows["corners"] = 3, faces
    lines = (
        "ply",
        "format binary_little_endian 1.0",
        f"element vertex {len(vertices)}",
        *(f"property float {axis}" for axis in "xyz"),
        f"element face {len(faces)}",
        "property list uchar int vertex_indices",
        "end_header",
    )
    return "\n".join(lines).encode() + b"\n" + bytes(vertices.tobytes()) + bytes(rows.tobytes())
