"""antdsl: text that describes how animals behave, compiled to array passes over all agents at once.

Public names are loaded on first use, so that `import antdsl` costs nothing. This module imports nothing at all, because `python
-m antdsl` runs it while the working directory is still first in the search path.
"""

TYPE_CHECKING = False  # a name that type checkers know; `typing` would be searched for in the working directory
if TYPE_CHECKING:
    from typing import Any

    from antdsl.api import AntdslError, Simulation, SweepResult, open_scene, sweep

__version__ = "0.1.0"
__all__ = ["AntdslError", "Simulation", "SweepResult", "__version__", "open_scene", "sweep"]


def __getattr__(name: str) -> "Any":
    if name in __all__:
        from importlib import import_module

        return getattr(import_module("antdsl.api"), name)
    raise AttributeError(f"module `antdsl` has no `{name}`")


def __dir__() -> list[str]:
    return __all__
