"""What a cache is written as for other programs: by the ending of a file, and in which forms."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

from antdsl.outputs.csv_export import export_csv
from antdsl.outputs.gallery import Gallery
from antdsl.outputs.usd.stage import export_crowds, export_xforms


@dataclass(frozen=True, slots=True, eq=False)
class Export:
    """Files of some `endings`. `forms`: by name the functions that write frames of a cache into one; the first is the usual."""

    endings: tuple[str, ...]
    forms: Mapping[str, Callable[[Gallery, list[int], Path], None]]


EXPORTS = (
    Export((".usdc", ".usda", ".usd"), {"instances": export_crowds, "xforms": export_xforms}),
    Export((".csv",), {"keyframes": export_csv}),
)


def export_for(path: Path) -> Export | None:
    """The one whose endings the file's is among, in capitals or not."""
    return next((export for export in EXPORTS if path.suffix.lower() in export.endings), None)
