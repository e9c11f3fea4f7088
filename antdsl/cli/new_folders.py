"""Folders that commands fill with files of a project: a new project, or a copy of an example."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from antdsl.atomic_write import create_folder_durably, write_atomically
from antdsl.cli.exits import CommandError, ExitCode
from antdsl.resources import example_file

_SUFFIXES = (".ant", ".yaml", ".json", ".ply", ".png", ".glb", ".py", ".md")  # of the files of examples


def check_new_folder(folder: Path) -> None:
    """Raise CommandError if a folder exists and is not empty."""
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise CommandError(ExitCode.INPUT_OUTPUT, f"error: `{folder}` already exists and is not empty", "name another folder")


def describe_example(name: str) -> str:
    """Return the description of an example: the text at the top of its first program, else the first comment of its scene."""
    for path in (*sorted(example_file(name).glob("*.ant")), example_file(name) / "scene.yaml"):
        for line in path.read_text(encoding="utf-8").splitlines() if path.is_file() else ():
            if line.startswith(('"', "# ")):
                return line.strip('"# ')
    return ""


def read_example_files(name: str) -> dict[str, bytes]:
    """Return the content of each file of an example, by its name. Results of runs in its folder are left out."""
    files = sorted(path for path in example_file(name).iterdir() if path.suffix in _SUFFIXES and path.is_file())
    return {path.name: path.read_bytes() for path in files}


def write_files(folder: Path, files: Mapping[str, bytes]) -> None:
    """Write files into a folder, by their paths relative to it. Missing folders are created."""
    for name, content in files.items():
        create_folder_durably((folder / name).parent)
        write_atomically(folder / name, content)
