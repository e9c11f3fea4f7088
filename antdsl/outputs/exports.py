"""What a cache is written as for other programs: by the ending of a file, and in which forms."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path

from antdsl.outputs.csv_export import export_csv
from antdsl.outputs.events_export import export_csv_events, export_npz_events
from antdsl.outputs.geo_export import export_geo
from antdsl.outputs.gltf_export import export_gltf
from antdsl.outputs.mesh_export import export_meshes, export_usd_meshes
from antdsl.outputs.npz_export import export_arrays
from antdsl.outputs.numbered_files import numbered
from antdsl.outputs.poses_export import export_poses
from antdsl.outputs.solid_export import export_solids, export_volumes
from antdsl.outputs.usd.stage import UsdOptions, XformOptions, export_instances, export_xforms


@dataclass(frozen=True, slots=True, eq=False)
class Export:
    """Files of some `endings`. `forms`: by name the functions that write frames of a cache into one; the first is the usual.
    `each`: the forms that write a file for each frame, with the frame's number before its ending. `options`: by name of a form
    what it takes beside them, a dataclass. `barred`: what its libraries take for something else in the name of a file. A form
    returns what was left out or is not as it was, in sentences."""

    endings: tuple[str, ...]
    forms: Mapping[str, Callable[..., Sequence[str] | None]]
    each: frozenset[str] = frozenset()
    options: Mapping[str, type] = field(default_factory=dict)
    barred: tuple[str, ...] = ()

    def paths(self, form: str, path: Path, frames: list[int]) -> list[Path]:
        """The files that a form writes."""
        return [numbered(path, frame) for frame in frames] if form in self.each else [path]

    def takes(self, form: str) -> frozenset[str]:
        """The names of what a form takes beside frames and a path."""
        return frozenset(each.name for each in fields(self.options[form])) if form in self.options else frozenset()


EXPORTS = (
    Export(
        (".usdc", ".usda", ".usd"),
        {"instances": export_instances, "xforms": export_xforms, "meshes": export_usd_meshes},
        options={"instances": UsdOptions, "xforms": XformOptions},
        barred=("\\", ":SDF_FORMAT_ARGS:"),
    ),
    Export((".glb", ".gltf"), {"skinned": export_gltf}),
    Export((".geo",), {"points": export_geo}, frozenset({"points"})),
    Export((".csv",), {"keyframes": export_csv, "events": export_csv_events}),
    Export((".npz",), {"arrays": export_arrays, "poses": export_poses, "volume": export_volumes, "events": export_npz_events}),
    Export((".ply", ".obj"), {"meshes": export_meshes, "solids": export_solids}, frozenset({"meshes", "solids"})),
)


# What else is asked for, and what to write for it: docs/exports.md says why.
INSTEAD = {
    ".abc": "`.usdc` with `--as meshes`",
    ".bclip": "`.glb`",
    ".bgeo": "`.geo`",
    ".fbx": "`.glb`, of which Blender makes an .fbx file",
    ".vdb": "`.npz` with `--as volume`",
}


def export_for(path: Path) -> Export | None:
    """The one whose endings the file's is among, in capitals or not."""
    return next((export for export in EXPORTS if path.suffix.lower() in export.endings), None)
