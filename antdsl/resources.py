"""Paths of the files that come with antdsl: grammar, behaviour library, documentation, preview page, examples and project
templates. No other module knows these locations."""

from __future__ import annotations

import os
from pathlib import Path

_PACKAGE_FOLDER = Path(__file__).resolve().parent


def _locate_folder(name: str) -> Path:
    """Return the path of a folder: in `_data` in an installed package, next to the package in a checkout."""
    packed = _PACKAGE_FOLDER / "_data" / name
    return packed if packed.is_dir() else _PACKAGE_FOLDER.parent / name


def grammar_folder() -> Path:
    """Return the folder of the grammar, its tables and the language reference."""
    return _locate_folder("grammar")


def behaviours_folder() -> Path:
    """Return the folder of the library; it has one `.ant` file for each name that `use NAME` accepts."""
    return _locate_folder("behaviours")


def grammar_file(name: str) -> Path:
    """Return the path of a file of the grammar's folder, such as `tables.json`."""
    return grammar_folder() / name


def list_library_names() -> tuple[str, ...]:
    """Return the names that `use NAME` accepts, sorted."""
    return tuple(sorted(path.stem for path in behaviours_folder().glob("*.ant")))


def find_library_file(name: str) -> Path | None:
    """Return the file behind `use NAME`, or None if the library has no such file."""
    file = behaviours_folder() / f"{name}.ant"
    return file if name.isidentifier() and os.path.isfile(file) else None  # whatever its length


def list_example_names() -> tuple[str, ...]:
    """Return the names of the examples, sorted; those of the lessons are `learn/NAME`. Each is a folder with scenes."""
    folder = _locate_folder("examples")
    scenes = (*folder.glob("*/*.yaml"), *folder.glob("learn/*/*.yaml"))
    return tuple(sorted({path.parent.relative_to(folder).as_posix() for path in scenes}))


def example_file(name: str) -> Path:
    """Return the path of a file of the examples, such as `foraging/scene.yaml`, or of an example's folder."""
    return _locate_folder("examples") / name


def documentation_folder() -> Path:
    """Return the folder in which `docs`, `grammar` and `examples` have the pages of the documentation."""
    return _locate_folder("docs").parent


def project_template_file(name: str) -> Path:
    """Return the path of a file of the project that `antdsl new` writes."""
    return _PACKAGE_FOLDER / "cli" / "project" / name


def find_code_page(code: str) -> Path | None:
    """Return the Markdown page of a diagnostic's code, or None if there is none."""
    page = _locate_folder("docs/codes") / f"{code}.md"
    return page if page.is_file() else None


def preview_page_file(name: str) -> Path:
    """Return a built file of the preview's page: `index.html`, `app.js`, `app.css`."""
    return _PACKAGE_FOLDER / "preview" / "page" / name


def body_file(name: str) -> Path:
    """Return the path of a file of the bodies that come with antdsl: `bodies.json`, `ant.json`, `ant.glb`."""
    return _PACKAGE_FOLDER / "bodies" / "data" / name
