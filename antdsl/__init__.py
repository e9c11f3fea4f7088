"""antdsl: text that says how animals behave, compiled to array passes over all agents at once.

Public names are loaded when they are first used, so that `import antdsl` costs nothing."""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from antdsl.pipeline import Shot, compile_files, open_scene, simulate

__version__ = "0.1.0"
__all__ = ["Shot", "__version__", "compile_files", "open_scene", "simulate"]


def __getattr__(name: str) -> Any:
    if name in ("Shot", "compile_files", "open_scene", "simulate"):
        return getattr(import_module("antdsl.pipeline"), name)
    raise AttributeError(f"module `antdsl` has no `{name}`")
