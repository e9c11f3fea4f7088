"""Outputs, processes and tools (R1 to R8), as far as a file can bring them about; the others are in `test_hostile_runs.py`."""

from __future__ import annotations

import os

from cases.hostile.rows import PROGRAM, Row

ROWS = [
    Row("R1 five million agents and one", "wrong-value", "", edits={"scene.yaml": ("count: 20", "count: 5000001")}),
    Row(
        "R1 frames without end",
        "wrong-value",
        "more than 1,000,000 frames",
        edits={"scene.yaml": ("frames: 1..6", "frames: 1..9000000")},
    ),
    Row("R3 half a program", "unclosed-brace", "", {"walker.ant": PROGRAM[:-3]}),
    Row(
        "R4 a program that cannot be read",
        "not-a-file",
        "",
        make=lambda f: ((f / "walker.ant").unlink(), (f / "walker.ant").mkdir()),
    ),
    Row(
        "R4 a program that is a pipe", "not-a-file", "", make=lambda f: ((f / "walker.ant").unlink(), os.mkfifo(f / "walker.ant"))
    ),
    Row("R4 a mesh that is a pipe", "not-a-file", "", make=lambda f: ((f / "ground.ply").unlink(), os.mkfifo(f / "ground.ply"))),
    Row(
        "R4 a mesh that is a link to itself",
        "bad-path",
        "link",
        make=lambda f: ((f / "ground.ply").unlink(), (f / "ground.ply").symlink_to("ground.ply")),
    ),
    Row(
        "R4 a program that is a link to a device",
        "bad-path",
        "link",
        make=lambda f: ((f / "walker.ant").unlink(), (f / "walker.ant").symlink_to("/dev/zero")),
    ),
    Row("R8 a scene asks for code", "unknown-key", "a scene cannot load code", edits={"scene.yaml": ("seed: 1", "plugin: x.py")}),
    Row("R8 a program asks for code", "unknown-library", "", edits={"walker.ant": ("use steering", "use os")}),
]
