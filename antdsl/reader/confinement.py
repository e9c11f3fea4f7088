"""The configuration of the reader process: module folders, readable folders, and environment."""

from __future__ import annotations

import os
import site
import sys
import sysconfig
from pathlib import Path

from antdsl.child_processes import INSTALLATION_FOLDER, isolate_search_paths

TRUST_VARIABLE = "ANTDSL_TRUST_USD"  # an environment variable, so that processes of pools and farms inherit it
# System folders from which libraries are loaded.
_SYSTEM_FOLDERS = ("/lib", "/lib32", "/lib64", "/usr/lib", "/usr/lib32", "/usr/lib64", "/usr/local/lib", "/etc/ld.so.cache",
"/nix/store",
           "/gnu/store", "/dev/null", "/dev/urandom", "/sys/devices/system/cpu", "/proc/self", "/proc/cpuinfo")  # fmt: skip
# Variables that a program needs to start. Others could name code to load (`PXR_PLUGINPATH_NAME`, `PYTHONPATH`).
_PASSED_VARIABLES = ("PATH", "LD_LIBRARY_PATH", "DYLD_LIBRARY_PATH", "SYSTEMROOT", "SystemRoot", "LANG", "LC_ALL", "PYTHONHOME")
_SET_VARIABLES = {
    "PYTHONSAFEPATH": "1",
    "PYTHONDONTWRITEBYTECODE": "1",
    "PYTHONUTF8": "1",
    "OPENBLAS_NUM_THREADS": "1",
    "OMP_NUM_THREADS": "1",
    "PXR_WORK_THREAD_LIMIT": "1",
    "MALLOC_ARENA_MAX": "1",
}


def is_usd_trusted() -> bool:
    """Return whether the user trusts all USD files, so that they are read without a sandbox."""
    return os.environ.get(TRUST_VARIABLE) == "1"


def trust_usd() -> None:
    """Trust USD files from now on, in this process and in processes that it starts."""
    os.environ[TRUST_VARIABLE] = "1"


def build_child_environment() -> dict[str, str]:
    """Return the environment of the child. It has the variables that the child needs, and none that names code or files of a
    project."""
    isolate_search_paths()
    variables = {name: value for name, value in os.environ.items() if name in _PASSED_VARIABLES or name.startswith("NPY_")}
    return variables | _SET_VARIABLES


def list_module_folders() -> list[str]:
    """Return the folders in which the child looks for modules.

    They are the absolute folders of this process without the working directory, followed by the folder of antdsl itself."""
    try:
        working_folder = os.path.realpath(os.getcwd())
    except OSError:
        working_folder = ""
    folders = [
        path
        for path in sys.path
        if os.path.isabs(path) and (os.path.realpath(path) != working_folder or _is_package_folder(path))
    ]
    return folders if INSTALLATION_FOLDER in folders else [*folders, INSTALLATION_FOLDER]


def list_readable_folders() -> list[str]:
    """Return the folders and files that the child may read: Python, installed packages and system libraries."""
    readable_paths = {sys.prefix, sys.base_prefix, sys.exec_prefix, str(_find_package_folder()), *_SYSTEM_FOLDERS}
    if sys.prefix == "/usr" or sys.base_prefix == "/usr":
        readable_paths -= {"/usr"}
    readable_paths |= {path for path in list_module_folders() if _is_package_folder(path)}
    readable_paths |= {path for name in ("stdlib", "platstdlib") if (path := sysconfig.get_path(name))}
    return sorted(path for path in readable_paths if os.path.exists(path))


def _find_package_folder() -> Path:
    """Return the folder of antdsl's own code."""
    return Path(__file__).resolve().parents[1]


def _is_package_folder(path: str) -> bool:
    """Return whether a module folder belongs to Python itself or contains installed packages."""
    real_path = os.path.realpath(path)
    roots = [sys.prefix, sys.base_prefix, *_list_site_packages()]
    if any(real_path == root or real_path.startswith(root + os.sep) for root in map(os.path.realpath, roots) if root != os.sep):
        return True
    return os.path.isfile(path) or any(os.path.isdir(os.path.join(path, name)) for name in ("numpy", "pxr"))


def _list_site_packages() -> list[str]:
    """Return the folders of installed packages. The user's own folder comes last."""
    user = site.getusersitepackages() if hasattr(site, "getusersitepackages") else ""
    return [*site.getsitepackages(), *([user] if user else [])]
