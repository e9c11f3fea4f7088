"""A scene adds real geometry and numbers to a program. `load` reads a scene.

`document` reads YAML and stores the location of every value.
`inheritance` merges a scene with the scenes that it extends.
`scene_model` defines the keys of a scene and their types.
`crowds` and `notes` contain the models of crowd lines and of notes.
`checks` checks a scene against a program.
`staging` reads the scene's files (with `geometry`) and returns the `Setting`.
`paths` opens all files that a scene or a program names.

The `Setting` is the complete input of the run time, in mm, seconds and the scene's own axes."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from antdsl.scene.paths import PathRefused, Roots

if TYPE_CHECKING:
    from antdsl.scene.load import Scene, load_scene_text

__all__ = ["PathRefused", "Roots", "Scene", "load_scene_text"]


def __getattr__(name: str) -> Any:
    if name in ("Scene", "load_scene_text"):  # loaded on first use: the reader process needs only `geometry`
        return getattr(import_module("antdsl.scene.load"), name)
    raise AttributeError(f"module `antdsl.scene` has no `{name}`")
