"""The only module that uses matplotlib. Figures have its packaged defaults, and ignore settings of the user and the working
directory.

Settings of matplotlib can start programs (`text.usetex` starts LaTeX), and it looks for settings in the working directory first.
So matplotlib is imported while the working directory is a folder of antdsl, with environment variables that point to the
installation.
"""

from __future__ import annotations

import os
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, chdir, contextmanager, suppress
from functools import cache
from importlib.util import find_spec
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import TYPE_CHECKING, Any

from antdsl.atomic_write import atomic_file
from antdsl.user_folders import cache_folder, make_private_folder

if TYPE_CHECKING:
    from matplotlib.figure import Figure

PACKAGE_NAME = "matplotlib"


def is_matplotlib_available() -> bool:
    """Return whether matplotlib is installed, without importing it."""
    return find_spec(PACKAGE_NAME) is not None


@contextmanager
def open_figure(width: float, height: float, path: Path) -> Iterator[Figure]:
    """Yield a figure. When the context ends, the figure is written to `path` as a PNG file. `width`, `height`: its size in
    inches. Raises OSError if writing fails."""
    matplotlib = _import_matplotlib()
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    with matplotlib.rc_context():
        matplotlib.rcdefaults()
        plot = Figure(figsize=(width, height), layout="constrained")
        FigureCanvasAgg(plot)
        yield plot
        with atomic_file(path) as file:
            plot.savefig(file, format="png", dpi=110, metadata={"Software": "antdsl"})


@cache
def _import_matplotlib() -> Any:
    """Return matplotlib, after importing all its modules that read settings or the font list. The font list is stored in a
    folder that only this user can write to."""
    import importlib

    with ExitStack() as opened:
        try:
            folder = cache_folder() / "antdsl" / PACKAGE_NAME
            make_private_folder(folder.parent)
            make_private_folder(folder)
        except OSError:  # no home folder
            folder = Path(opened.enter_context(TemporaryDirectory(prefix="antdsl-fonts-")))
        spec = find_spec(PACKAGE_NAME)
        assert spec is not None and spec.origin is not None
        defaults = str(Path(spec.origin).parent / "mpl-data" / "matplotlibrc")
        environment = {"MATPLOTLIBRC": defaults, "MPLCONFIGDIR": str(folder), "MPLBACKEND": "agg"}
        # Without a search path, matplotlib does not find `fc-list`, which lists more fonts than needed.
        opened.enter_context(_set_environment({**environment, "PATH": str(folder)}))
        with suppress(FileNotFoundError):  # the working directory was deleted, so nothing is found in it
            opened.enter_context(chdir(folder))
        for module in ("font_manager", "style", "figure", "backends.backend_agg"):
            importlib.import_module(f"{PACKAGE_NAME}.{module}")
        return importlib.import_module(PACKAGE_NAME)


@contextmanager
def _set_environment(values: Mapping[str, str]) -> Iterator[None]:
    """Set environment variables of this process while the context is active."""
    previous_values = {name: os.environ.get(name) for name in values}
    os.environ.update(values)
    try:
        yield
    finally:
        for name, value in previous_values.items():
            if value is None:
                del os.environ[name]
            else:
                os.environ[name] = value
