"""`antdsl new DIR`: a project to start from: a program, a scene and a ground, ready to run, and ready for CI."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Any

import typer

from antdsl.cli.exits import Exit, Stop
from antdsl.cli.printing.messages import say
from antdsl.cli.project import FILES
from antdsl.whole import make_folder, write_whole


def new(
    folder: Path = typer.Argument(..., metavar="DIR", help="A folder that is not there yet, or is empty."),
) -> None:
    """Write a small project to start from, with its specs and what checks it in CI."""
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise Stop(Exit.INPUT_OUTPUT, f"error: `{folder}` is there already and not empty", "name another folder")
    for name, text in FILES:
        path = folder / name
        make_folder(path.parent)
        write_whole(path, text.encode())
    write_whole(folder / "ground.ply", ground())
    say(f"walker.ant, scene.yaml and ground.ply are in {folder}; now:")
    for words in (("run", folder / "scene.yaml"), ("test", folder), ("render", folder / "out" / "scene", "--sheet")):
        say(f"  {shlex.join(['antdsl', *map(str, words)])}")
    say(f"{folder / 'README.md'} says more; a workflow for GitHub and hooks for pre-commit are there too")


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
