"""The entry point of `python -m antdsl`. It does the same as the command `antdsl`."""

import os
import sys


def _working_directory() -> str:
    """Return the working directory, or "" if it no longer exists."""
    try:
        return os.getcwd()
    except OSError:  # it was removed
        return ""


# With `-m` Python looks for modules in the working directory first: no line may be imported from there. `sys` and `os` are loaded
# before any folder is searched, and the package's own `__init__` imports nothing.
if not sys.flags.safe_path and sys.path and sys.path[0] in ("", _working_directory()):
    del sys.path[0]

if __name__ == "__main__":
    from antdsl.cli import main

    main()
