"""antdsl: text that describes how animals behave, compiled to array passes over all agents at once.

Public names are loaded on first use, so that `import antdsl` costs nothing. This file imports nothing at all. The reason: with
`python -m antdsl` the working directory is still the first folder of the search path when these lines run.
"""

TYPE_CHECKING = False  # a name that type checkers know; `typing` would be searched for in the working directory
if TYPE_CHECKING:
    from typing import Any

    from antdsl.pipeline import Shot, compile_files, open_scene, simulate

__version__ = "0.1.0"
__all__ = ["Shot", "__version__", "compile_files", "open_scene", "simulate"]


def __getattr__(name: str) -> "Any":
    if name in ("Shot", "compile_files", "open_scene", "simulate"):
        from importlib import import_module

        return getattr(import_module("antdsl.pipeline"), name)
    raise AttributeError(f"module `antdsl` has no `{name}`")
