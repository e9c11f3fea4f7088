"""The packages that antdsl requires, by the module that each provides, and the advice for one that is missing.

The light installation (`docs/ci.md`) has only the packages of LIGHT_PACKAGES. It can check and format programs, and serve
editors. All other commands report the package that they need."""

from __future__ import annotations

from importlib.util import find_spec
from typing import TYPE_CHECKING, Final

if TYPE_CHECKING:
    from antdsl.diagnostics import Report

DISTRIBUTION_BY_MODULE: Final = {
    "numpy": "numpy", "scipy": "scipy", "lark": "lark", "pydantic": "pydantic", "yaml": "pyyaml", "typer": "typer",
    "rich": "rich", "pygments": "pygments", "trimesh": "trimesh", "mapbox_earcut": "mapbox_earcut", "PIL": "pillow",
    "skimage": "scikit-image", "open3d": "open3d", "llvmlite": "llvmlite",
}  # fmt: skip
LIGHT_PACKAGES: Final = ("lark", "pydantic", "pyyaml", "typer", "rich", "pygments", "numpy", "pygls")
INSTALL_ADVICE: Final = "install antdsl with everything it needs: `pip install antdsl`"


def find_missing_distribution(problem: BaseException) -> str | None:
    """Return the name of the missing distribution that caused an exception, or None for any other exception."""
    cause: BaseException | None = problem
    while isinstance(cause, ImportError):
        module = (cause.name or "").split(".")[0]
        if isinstance(cause, ModuleNotFoundError) and module in DISTRIBUTION_BY_MODULE:
            return DISTRIBUTION_BY_MODULE[module]
        cause = cause.__cause__
    return None


def check_extra(purpose: str, extra: str, module: str, alternative: str = "") -> Report:
    """Return an empty report if a module of an extra is installed. Otherwise return a report with one error that names the
    extra. `purpose`: what needs the module, such as `the preview`. `alternative`: words to add to the advice, such as `or …`."""
    from antdsl.diagnostics import Report

    report = Report()
    if find_spec(module) is None:
        message = f"{purpose} needs the extra `[{extra}]`, which is not installed"
        report.error("missing-extra", message, None, f'run `pip install "antdsl[{extra}]"`{alternative and ", " + alternative}')
    return report
