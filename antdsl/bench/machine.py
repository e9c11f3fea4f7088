"""What was measured on, when, and with which versions."""

from __future__ import annotations

import datetime
import os
import platform
from importlib.metadata import PackageNotFoundError, version

from antdsl import __version__
from antdsl.executors.machine import processor

PACKAGES = ("numpy", "scipy", "llvmlite", "numba", "open3d", "open3d-cpu")


def machine() -> dict[str, str]:
    """Names to words: date, machine, system, versions."""
    found = {
        "date": datetime.date.today().isoformat(),
        "machine": f"{processor()}, {os.cpu_count()} cores",
        "system": f"{platform.system()} {platform.machine()}",
        "antdsl": __version__,
        "python": platform.python_version(),
    }
    for name in PACKAGES:
        try:
            found[name] = version(name)
        except PackageNotFoundError:
            continue
    return found
