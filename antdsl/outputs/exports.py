"""What a cache is written as for other programs: by the ending of a file, and in which forms."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path

from antdsl.outputs.csv_export import export_csv
from antdsl.outputs.usd.stage import UsdOptions, XformOptions, export_instances, export_xforms


@dataclass(frozen=True, slots=True, eq=False)
class Export:
    """Files of some `endings`. `forms`: by name the functions that write frames of a cache into one; the first is the usual.
    `options`: by name of a form what it takes beside them, a dataclass."""

    endings: tuple[str, ...]
    forms: Mapping[str, Callable[..., Sequence[str] | None]]
    options: Mapping[str, type] = field(default_factory=dict)

    def takes(self, form: str) -> frozenset[str]:
        """The names of what a form takes beside frames and a path."""
        return frozenset(each.name for each in fields(self.options[form])) if form in self.options else frozenset()


EXPORTS = (
    Export(
        (".usdc", ".usda", ".usd"),
        {"instances": export_instances, "xforms": export_xforms},
        {"instances": UsdOptions, "xforms": XformOptions},
    ),
    Export((".csv",), {"keyframes": export_csv}),
)


def export_for(path: Path) -> Export | None:
    """The one whose endings the file's is among, in capitals or not."""
    return next((export for export in EXPORTS if path.suffix.lower() in export.endings), None)
