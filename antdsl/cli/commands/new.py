"""`antdsl new DIR` writes a starter project, and `antdsl examples` copies an example. `docs/ci.md` lists the files of a
project."""

from __future__ import annotations

import shlex
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import typer

from antdsl import __version__
from antdsl.atomic_write import create_folder_durably, write_atomically
from antdsl.cli.exits import CommandError, ExitCode
from antdsl.cli.printing.messages import print_note, print_result
from antdsl.diagnostics.suggestion import find_nearest_name
from antdsl.resources import example_file, list_example_names, project_template_file

# The path of each file, and its name among the package's templates.
TEMPLATE_FILES = {
    "walker.ant": "walker.ant",
    "scene.yaml": "scene.yaml",
    "README.md": "README.md",
    ".gitignore": "gitignore",
    ".github/workflows/antdsl.yml": "antdsl.yml",
    ".pre-commit-config.yaml": "pre-commit-config.yaml",
}
DEFAULT_TEMPLATE = "minimal"  # the package's own files; the other templates are examples
EXAMPLE_BY_TEMPLATE = {
    "foraging": "foraging", "arena": "arena", "roaches": "roaches", "evacuation": "evacuation",
    "digging": "tunnel", "war": "battle",
}  # fmt: skip
_EXAMPLE_SUFFIXES = (".ant", ".yaml", ".json", ".ply", ".png", ".glb", ".py", ".md")  # of the files of examples
_PROGRAM_AND_SCENE = ("walker.ant", "scene.yaml")  # an example has its own


def read_template_file(name: str, title: str = "Walkers", program: str = "walker.ant") -> str:
    """Return the text of a template file for a new project. `title`, `program`: the heading and the main program to insert in the
    README."""
    text = project_template_file(TEMPLATE_FILES[name]).read_text(encoding="utf-8")
    replacements = {"antdsl-VERSION-": f"antdsl-{__version__}-", "PROJECT-TITLE": title, "PROGRAM-FILE": program}
    for placeholder, value in replacements.items():
        text = text.replace(placeholder, value)
    return text


def run_new_command(
    folder: Path = typer.Argument(..., metavar="DIR", help="A new or empty folder."),
    template: str = typer.Option(
        DEFAULT_TEMPLATE, "--template", metavar="NAME", help=f"{', '.join((DEFAULT_TEMPLATE, *EXAMPLE_BY_TEMPLATE))}."
    ),
) -> None:
    """Write a small project to start from, with its specs and what checks it in CI."""
    require_new_folder(folder)
    if template == DEFAULT_TEMPLATE:
        files = {name: read_template_file(name).encode() for name in TEMPLATE_FILES} | {"ground.ply": build_ground_ply()}
        program = "walker.ant"
    elif template in EXAMPLE_BY_TEMPLATE:
        files = read_example_files(EXAMPLE_BY_TEMPLATE[template])
        program = next(name for name in files if name.endswith(".ant"))
        title = template.capitalize()
        for name in TEMPLATE_FILES:
            if name not in _PROGRAM_AND_SCENE:
                files[name] = read_template_file(name, title, program).encode()
    else:
        names = (DEFAULT_TEMPLATE, *EXAMPLE_BY_TEMPLATE)
        usual = f"write one of {', '.join(f'`{name}`' for name in names)}"
        raise _make_unknown_name_error("template", template, names, usual)
    write_files(folder, files)
    print_note(f"{program} and scene.yaml are in {folder}; now:")
    for words in (("run", folder / "scene.yaml"), ("test", folder), ("render", folder / "out" / "scene", "--sheet")):
        print_note(f"  {shlex.join(['antdsl', *map(str, words)])}")
    print_note(f"{folder / 'README.md'} explains more; a GitHub workflow and pre-commit hooks are included")


def run_examples_command(
    name: str | None = typer.Argument(None, metavar="NAME", help="An example to copy; without it, all are listed."),
    folder: Path | None = typer.Argument(None, metavar="DIR", help="A new or empty folder. [default: NAME]"),
) -> None:
    """List the examples that come with antdsl, or copy one into a folder."""
    names = list_example_names()
    if name is None:
        width = max(map(len, names), default=0)
        for each in names:
            print_result(f"{each:<{width}}  {describe_example(each)}")
        print_note("`antdsl examples NAME` copies one into a folder of its name")
        return
    if name not in names:
        raise _make_unknown_name_error("example", name, names, "`antdsl examples` lists all")
    folder = folder or Path(name)
    require_new_folder(folder)
    files = read_example_files(name)
    write_files(folder, files)
    scene = next(file for file in sorted(files, key=lambda file: (file != "scene.yaml", file)) if file.endswith(".yaml"))
    print_note(f"{len(files)} files are in {folder}; now:")
    print_note(f"  antdsl run {folder / scene}")


def _make_unknown_name_error(kind: str, name: str, names: tuple[str, ...], usual: str) -> CommandError:
    """Return the error for a name that is not in `names`. `kind`: the kind of name, for the message. `usual`: the advice if no
    valid name is similar."""
    near = find_nearest_name(name, names)
    return CommandError(ExitCode.USAGE, f"error: there is no {kind} `{name}`", f"did you mean `{near}`?" if near else usual)


def require_new_folder(folder: Path) -> None:
    """Raise CommandError if a folder exists and is not empty."""
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise CommandError(ExitCode.INPUT_OUTPUT, f"error: `{folder}` already exists and is not empty", "name another folder")


def describe_example(name: str) -> str:
    """Return the description of an example, from the help text of its program or the first comment of its scene."""
    for path in (*sorted(example_file(name).glob("*.ant")), example_file(name) / "scene.yaml"):
        for line in path.read_text(encoding="utf-8").splitlines() if path.is_file() else ():
            if line.startswith(('"', "# ")):
                return line.strip('"# ')
    return ""


def read_example_files(name: str) -> dict[str, bytes]:
    """Return the content of each file of an example, by file name. Results of earlier runs in the folder are left out."""
    files = sorted(path for path in example_file(name).iterdir() if path.suffix in _EXAMPLE_SUFFIXES and path.is_file())
    return {path.name: path.read_bytes() for path in files}


def write_files(folder: Path, files: Mapping[str, bytes]) -> None:
    """Write files into a folder, creating missing folders. `files`: contents by path relative to `folder`."""
    for name, content in files.items():
        create_folder_durably((folder / name).parent)
        write_atomically(folder / name, content)


def build_ground_ply(side: int = 49, width: float = 200.0) -> bytes:
    """Return a gently rolling ground as a binary .ply file. It has `side` × `side` vertices and is `width` mm wide; y is up."""
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
