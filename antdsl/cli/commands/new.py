"""`antdsl new DIR`: writes a project to start from: a program, a scene and a ground, ready to run and ready for CI. `docs/ci.md`
lists the files."""

from __future__ import annotations

import shlex
from pathlib import Path
from typing import Any

import typer

from antdsl import __version__
from antdsl.atomic_write import create_folder_durably, write_atomically
from antdsl.cli.exits import CommandError, ExitCode
from antdsl.cli.printing.messages import print_note
from antdsl.resources import project_template_file

# The path of each file, and its name among the package's templates.
TEMPLATE_FILES = {
    "walker.ant": "walker.ant",
    "scene.yaml": "scene.yaml",
    "README.md": "README.md",
    ".gitignore": "gitignore",
    ".github/workflows/antdsl.yml": "antdsl.yml",
    ".pre-commit-config.yaml": "pre-commit-config.yaml",
}


def read_template_file(name: str) -> str:
    """Return the text of a file of the project."""
    return (
        project_template_file(TEMPLATE_FILES[name])
        .read_text(encoding="utf-8")
        .replace("antdsl-VERSION-", f"antdsl-{__version__}-")
    )


def new(folder: Path = typer.Argument(..., metavar="DIR", help="A new or empty folder.")) -> None:
    """Write a small project to start from, with its specs and what checks it in CI."""
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise CommandError(ExitCode.INPUT_OUTPUT, f"error: `{folder}` already exists and is not empty", "name another folder")
    for name in TEMPLATE_FILES:
        create_folder_durably((folder / name).parent)
        write_atomically(folder / name, read_template_file(name).encode())
    write_atomically(folder / "ground.ply", build_ground_ply())
    print_note(f"walker.ant, scene.yaml and ground.ply are in {folder}; now:")
    for words in (("run", folder / "scene.yaml"), ("test", folder), ("render", folder / "out" / "scene", "--sheet")):
        print_note(f"  {shlex.join(['antdsl', *map(str, words)])}")
    print_note(f"{folder / 'README.md'} explains more; a GitHub workflow and pre-commit hooks are included")


def build_ground_ply(side: int = 49, width: float = 200.0) -> bytes:
    """Return a gently rolling square as a binary .ply file: `side` × `side` vertices, `width` mm wide, y up."""
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
