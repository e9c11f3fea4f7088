"""Paths of the files that come with antdsl: grammar, behaviour library, documentation, preview page, examples and project
templates. No other module knows these locations."""

from __future__ import annotations

import os
from pathlib import Path

_PACKAGE_FOLDER = Path(__file__).resolve().parent


def _locate_folder(name: str) -> Path:
    """Return the path of a folder of resources: in `_data` of an installed package, or next to the package in a checkout."""
    packed = _PACKAGE_FOLDER / "_data" / name
    return packed if packed.is_dir() else _PACKAGE_FOLDER.parent / name


def grammar_folder() -> Path:
    """Return the folder of the grammar, its tables and the language reference."""
    return _locate_folder("grammar")


def behaviours_folder() -> Path:
    """Return the folder of the behaviour library. It has one `.ant` file for each name that `use NAME` accepts."""
    return _locate_folder("behaviours")


def grammar_file(name: str) -> Path:
    """Return the path of a file in the grammar folder, such as `tables.json`."""
    return grammar_folder() / name


def list_library_names() -> tuple[str, ...]:
    """Return the names that `use NAME` accepts, in alphabetical order."""
    return tuple(sorted(path.stem for path in behaviours_folder().glob("*.ant")))


def find_library_file(name: str) -> Path | None:
    """Return the path of the library file behind `use NAME`, or None if there is no such file."""
    file = behaviours_folder() / f"{name}.ant"
    return file if name.isidentifier() and os.path.isfile(file) else None  # whatever its length


def list_example_names() -> tuple[str, ...]:
    """Return the names of the examples, in alphabetical order. Each is a folder with scenes; lessons are called `learn/NAME`."""
    folder = _locate_folder("examples")
    scenes = (*folder.glob("*/*.yaml"), *folder.glob("learn/*/*.yaml"))
    return tuple(sorted({path.parent.relative_to(folder).as_posix() for path in scenes}))


def example_file(name: str) -> Path:
    """Return the path of a file in the examples, such as `foraging/scene.yaml`, or of the folder of an example."""
    return _locate_folder("examples") / name


def documentation_folder() -> Path:
    """Return the folder that contains the pages of the documentation, in its subfolders `docs`, `grammar` and `examples`."""
    return _locate_folder("docs").parent


def project_template_file(name: str) -> Path:
    """Return the path of a template file for the project that `antdsl new` writes."""
    return _PACKAGE_FOLDER / "cli" / "project" / name


def find_code_page(code: str) -> Path | None:
    """Return the path of the Markdown page about a diagnostic code, or None if there is none."""
    page = _locate_folder("docs/codes") / f"{code}.md"
    return page if page.is_file() else None


def preview_page_file(name: str) -> Path:
    """Return the path of a built file of the preview page: `index.html`, `app.js` or `app.css`."""
    return _PACKAGE_FOLDER / "preview" / "page" / name


def body_file(name: str) -> Path:
    """Return the path of a file of the bodies that come with antdsl: `bodies.json`, `ant.json` or `ant.glb`."""
    return _PACKAGE_FOLDER / "bodies" / "data" / name
