"""Imports Open3D when it is first used."""

from __future__ import annotations

import os
import sys
from functools import cache
from importlib import import_module
from importlib.util import find_spec
from types import ModuleType
from typing import Any

_PLOTLY_MODULE = "open3d.visualization.draw_plotly"


class _DeferredModule(ModuleType):
    """A placeholder for a module, which is imported when one of its functions is called."""

    def __getattr__(self, name: str) -> Any:
        if name.startswith("__"):
            raise AttributeError(name)

        def call_function(*arguments: Any, **keywords: Any) -> Any:
            if sys.modules.get(self.__name__) is self:
                del sys.modules[self.__name__]
            return getattr(import_module(self.__name__), name)(*arguments, **keywords)

        return call_function


@cache
def load_open3d() -> Any:
    """Return the Open3D module. The first call imports it.

    Its plotting parts are not imported. They would need a web server and an HTTP client (dash, requests), open a socket, and take
    half of the import time."""
    if "open3d" not in sys.modules:
        # In a notebook, Open3D would otherwise start its web viewer and print about it.
        os.environ.setdefault("OPEN3D_DISABLE_WEB_VISUALIZER", "true")
        sys.modules.setdefault(_PLOTLY_MODULE, _DeferredModule(_PLOTLY_MODULE))
    try:
        import open3d
    except (ImportError, OSError) as problem:
        raise ImportError(_describe_load_failure(str(problem)), name="open3d") from problem
    return open3d


def _describe_load_failure(reason: str) -> str:
    """Return an error message for a failed import, with a remedy."""
    return (
        f"open3d cannot be loaded ({reason}): install the package `open3d-cpu`; on a bare Linux system it also needs "
        "the system packages libegl1 libgl1 libusb-1.0-0"
    )


@cache
def require_open3d() -> None:
    """Raise ImportError if Open3D is not installed.

    This check is fast. Without it, a run might fail late, when it first needs Open3D."""
    if find_spec("open3d") is None:
        raise ImportError(_describe_load_failure("the package is not installed"), name="open3d")
