"""The import of Open3D, when it is first needed."""

from __future__ import annotations

import sys
from functools import cache
from importlib import import_module
from importlib.util import find_spec
from types import ModuleType
from typing import Any

_PLOTS = "open3d.visualization.draw_plotly"


class _DeferredModule(ModuleType):
    """Stands for a module of functions, which is imported when one of them is called."""

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)

        def call(*arguments: Any, **named: Any) -> Any:
            if sys.modules.get(self.__name__) is self:
                del sys.modules[self.__name__]
            return getattr(import_module(self.__name__), name)(*arguments, **named)

        return call


@cache
def open3d() -> Any:
    """The module, imported when it is first needed.

    Its plots are not imported with it: they need a web server and a HTTP client (dash, requests), which take half of the time
    and bind a socket."""
    if "open3d" not in sys.modules:
        sys.modules.setdefault(_PLOTS, _DeferredModule(_PLOTS))
    try:
        import open3d
    except (ImportError, OSError) as problem:
        raise ImportError(_not_loaded(str(problem))) from problem
    return open3d


def _not_loaded(why: str) -> str:
    return (
        f"open3d cannot be loaded ({why}): install the package `open3d-cpu`; on a bare Linux system it also needs "
        "the system packages libegl1 libgl1 libusb-1.0-0"
    )


@cache
def require_open3d() -> None:
    """Raise ImportError where Open3D is not installed: its import takes long, and may only be needed late in a run."""
    if find_spec("open3d") is None:
        raise ImportError(_not_loaded("there is no such package"))
