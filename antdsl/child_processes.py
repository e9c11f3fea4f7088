"""Child processes with search paths that never contain the working directory.

If Python is started with `-c` or `-m`, it looks for modules in the working directory first. All child processes that the
standard library or Dask start do the same. `isolate_search_paths` disables this for the current process and all its children,
whatever code starts them.
`build_module_command` and `build_module_environment` start a module of antdsl.

An empty or relative entry of `PATH`, `PYTHONPATH` or a list of library folders means the working directory.
`isolate_search_paths` removes such entries. They are rarely intended (`PYTHONPATH=$PYTHONPATH:/studio` with an empty variable),
and would let an opened project run its own code. Absolute entries are the user's own choice.
"""

import os
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from types import ModuleType

# Lists of folders in the environment, from which Python, the system's loader and `exec` take code.
SEARCH_PATH_VARIABLES = ("PATH", "PYTHONPATH", "LD_LIBRARY_PATH", "DYLD_LIBRARY_PATH", "DYLD_FALLBACK_LIBRARY_PATH")
# The folder that has the package `antdsl`: site-packages, or a checkout.
INSTALLATION_FOLDER = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))


def isolate_search_paths() -> None:
    """Remove the working directory from all search paths of this process and of its child processes. A second call changes
    nothing.

    The change lasts as long as the process. It cannot be limited to one call: a pool starts its processes when tasks arrive, and
    libraries start theirs in separate threads.
    """
    relative = _find_relative_entries(os.environ.get("PYTHONPATH", ""))
    for name in SEARCH_PATH_VARIABLES:
        if value := os.environ.get(name):
            entries = [entry for entry in value.split(os.pathsep) if os.path.isabs(entry)]
            if entries:
                os.environ[name] = os.pathsep.join(entries)
            else:
                del os.environ[name]
    os.environ["PYTHONSAFEPATH"] = "1"
    # Python has made absolute paths of the relative entries, so they are recognised by what they led to.
    unwanted = {os.path.abspath(entry) for entry in relative} - set(os.environ.get("PYTHONPATH", "").split(os.pathsep))
    sys.path[:] = [entry for entry in sys.path if os.path.isabs(entry) and entry not in unwanted]
    if INSTALLATION_FOLDER not in sys.path:
        sys.path.append(INSTALLATION_FOLDER)  # last, so that nothing in a checkout hides a package of that name


def build_module_command(module: str, *arguments: str) -> list[str]:
    """Return the command that runs a module of antdsl in a new interpreter, for use with `build_module_environment`."""
    return [sys.executable, "-P", "-m", module, *arguments]


def build_module_environment() -> dict[str, str]:
    """Return the environment variables with which a child process imports the same antdsl."""
    isolate_search_paths()
    path = [entry for entry in os.environ.get("PYTHONPATH", "").split(os.pathsep) if entry]
    if os.path.basename(INSTALLATION_FOLDER) not in ("site-packages", "dist-packages") and INSTALLATION_FOLDER not in path:
        path.insert(0, INSTALLATION_FOLDER)
    return {**os.environ, "PYTHONPATH": os.pathsep.join(path)} if path else dict(os.environ)


def _find_relative_entries(value: str) -> list[str]:
    """Return the empty and relative entries in a list of folders, such as the value of `PATH`."""
    return [entry for entry in value.split(os.pathsep) if not os.path.isabs(entry)] if value else []


@contextmanager
def hide_main_module() -> Iterator[None]:
    """While the context is active, start child processes that do not run the user's script again.

    The tasks of antdsl need nothing from that script. A script that does not test its `__name__` would start further children in
    each child."""
    main = sys.modules["__main__"]
    sys.modules["__main__"] = ModuleType("__main__")
    try:
        yield
    finally:
        sys.modules["__main__"] = main
