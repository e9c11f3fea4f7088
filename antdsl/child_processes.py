"""How child processes start: with search paths that never name the working directory.

Python looks for modules in the working directory first when it starts with `-c` or `-m`. So does every child that the standard
library or Dask starts. `isolate` disables that for this process and for all its children, whatever code starts them.
`module_command` and `module_environment` start a module of ours.

An empty or relative entry of `PATH`, `PYTHONPATH` or a list of library folders means the working directory. It is removed: people
rarely write it on purpose (`PYTHONPATH=$PYTHONPATH:/studio` with an empty variable), and a project that is opened must not gain
from it. Absolute entries are the user's own choice."""

import os
import sys

# Lists of folders in the environment, from which Python, the system's loader and `exec` take code.
SEARCH_PATH_VARIABLES = ("PATH", "PYTHONPATH", "LD_LIBRARY_PATH", "DYLD_LIBRARY_PATH", "DYLD_FALLBACK_LIBRARY_PATH")
# The folder that has the package `antdsl`: site-packages, or a checkout.
INSTALLATION_FOLDER = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))


def isolate() -> None:
    """Remove the working directory from all search paths of this process and of its children. A second call changes nothing.

    The change lasts for the life of the process: a pool starts its children when tasks come, and libraries start theirs in
    separate threads."""
    relative = _relative_entries(os.environ.get("PYTHONPATH", ""))
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


def module_command(module: str, *arguments: str) -> list[str]:
    """The command that runs a module of ours in a new interpreter. It needs `module_environment`."""
    return [sys.executable, "-P", "-m", module, *arguments]


def module_environment() -> dict[str, str]:
    """Return the environment of such a command: this process's own, so that the child imports the same antdsl."""
    isolate()
    path = [entry for entry in os.environ.get("PYTHONPATH", "").split(os.pathsep) if entry]
    if os.path.basename(INSTALLATION_FOLDER) not in ("site-packages", "dist-packages") and INSTALLATION_FOLDER not in path:
        path.insert(0, INSTALLATION_FOLDER)
    return {**os.environ, "PYTHONPATH": os.pathsep.join(path)} if path else dict(os.environ)


def _relative_entries(value: str) -> list[str]:
    return [entry for entry in value.split(os.pathsep) if not os.path.isabs(entry)] if value else []
