"""A scene: real geometry and numbers for a program. `load.load` reads one.

`document` reads YAML with a place for every value, `inheritance` joins what a scene extends, `model` types it, `matching`
holds it against a program, `staging` reads its files (`geometry`) and gives the `Setting`: all that the run time gets, in mm,
seconds and the scene's own axes. `paths` is the one door to files that a scene or a program names."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

from antdsl.scene.paths import PathRefused, Roots

if TYPE_CHECKING:
    from antdsl.scene.load import Scene, load_text

__all__ = ["PathRefused", "Roots", "Scene", "load_text"]


def __getattr__(name: str) -> Any:
    if name in ("Scene", "load_text"):  # read when first used: the reader's process needs geometry alone
        return getattr(import_module("antdsl.scene.load"), name)
    raise AttributeError(f"module `antdsl.scene` has no `{name}`")
