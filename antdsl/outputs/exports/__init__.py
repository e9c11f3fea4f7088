"""Exports of a cache for other programs. The extension of the file selects the export. Options select its form and the agents."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from antdsl.outputs.cache.cache_reader import Arrays, CacheView, select_arrays
from antdsl.outputs.cache.frame_agents import IDENTITY_ARRAYS, find_array_subject
from antdsl.outputs.edits.frame_rows import keep_rows
from antdsl.outputs.exports.csv_export import export_csv
from antdsl.outputs.exports.events_export import export_csv_events, export_npz_events
from antdsl.outputs.exports.geo_export import export_geo
from antdsl.outputs.exports.gltf_export import GltfOptions, export_gltf
from antdsl.outputs.exports.mesh_export import export_meshes, export_usd_meshes
from antdsl.outputs.exports.npz_export import export_arrays
from antdsl.outputs.exports.poses_export import export_poses
from antdsl.outputs.exports.solid_export import export_solids, export_volumes
from antdsl.outputs.exports.trajectory_export import export_trajectories
from antdsl.outputs.numbered_files import make_numbered_path
from antdsl.outputs.usd.stage import UsdOptions, XformOptions, export_instances, export_xforms


@dataclass(frozen=True, slots=True, eq=False)
class ExportFormat:
    """An export to files with one of the `extensions`.

    `forms`: by name, the functions that write frames of a cache to a file. The first is the default. They return messages about
    what was omitted or changed. `per_frame_forms`: the forms that write one file per frame, with the frame number in its name.
    `coloured_forms`: the forms that write the colours of agents, either natural colours or those of states. `options`: by form,
    the dataclass of its additional options. `forbidden_strings`: strings that file names must not contain, because they have a
    special meaning for the libraries used."""

    extensions: tuple[str, ...]
    forms: Mapping[str, Callable[..., Sequence[str] | None]]
    per_frame_forms: frozenset[str] = frozenset()
    coloured_forms: frozenset[str] = frozenset()
    options: Mapping[str, type] = field(default_factory=dict)
    forbidden_strings: tuple[str, ...] = ()

    def paths(self, form: str, path: Path, frames: list[int]) -> list[Path]:
        """Return the paths of the files that a form writes for these frames."""
        return [make_numbered_path(path, frame) for frame in frames] if form in self.per_frame_forms else [path]

    def list_option_names(self, form: str) -> frozenset[str]:
        """Return the names of the additional options of a form."""
        return frozenset(each.name for each in fields(self.options[form])) if form in self.options else frozenset()


EXPORT_FORMATS = (
    ExportFormat(
        (".usdc", ".usda", ".usd"),
        {"instances": export_instances, "xforms": export_xforms, "meshes": export_usd_meshes},
        coloured_forms=frozenset({"instances", "xforms", "meshes"}),
        options={"instances": UsdOptions, "xforms": XformOptions},
        forbidden_strings=("\\", ":SDF_FORMAT_ARGS:"),
    ),
    ExportFormat(
        (".glb", ".gltf"), {"skinned": export_gltf}, coloured_forms=frozenset({"skinned"}), options={"skinned": GltfOptions}
    ),
    ExportFormat((".geo",), {"points": export_geo}, frozenset({"points"})),
    ExportFormat((".csv",), {"keyframes": export_csv, "events": export_csv_events}),
    ExportFormat((".txt",), {"trajectories": export_trajectories}),
    ExportFormat(
        (".npz",), {"arrays": export_arrays, "poses": export_poses, "volume": export_volumes, "events": export_npz_events}
    ),
    ExportFormat(
        (".ply", ".obj"),
        {"meshes": export_meshes, "solids": export_solids},
        frozenset({"meshes", "solids"}),
        frozenset({"meshes"}),
    ),
)


# Other endings that users request, and what to write instead; docs/exports.md explains why.
ALTERNATIVE_ADVICE = {
    ".abc": "`.usdc` with `--as meshes`",
    ".bclip": "`.glb`",
    ".bgeo": "`.geo`",
    ".fbx": "`.glb`, which Blender can convert to .fbx",
    ".vdb": "`.npz` with `--as volume`",
}


def find_export(path: Path) -> ExportFormat | None:
    """Return the export for the extension of a path, in upper or lower case. None if there is none."""
    return next((export for export in EXPORT_FORMATS if path.suffix.lower() in export.extensions), None)


@dataclass(frozen=True, eq=False)
class AgentSubset(CacheView):
    """A view of another cache that contains only the agents with these `keys` (`make_agent_keys`). Everything else is
    unchanged."""

    keys: frozenset[int]

    @cached_property
    def _sorted_keys(self) -> NDArray[np.int64]:
        return np.array(sorted(self.keys), np.int64)

    def frame(self, number: int, names: frozenset[str] | None = None) -> Arrays:
        """Return the arrays of a frame with only the rows of the chosen agents. `names`: the arrays to return; None for all."""
        arrays = self.source.frame(number, None if names is None else names | IDENTITY_ARRAYS | _list_id_arrays(names))
        if "id" in arrays:
            arrays = keep_rows(arrays, self.manifest, lambda keys: np.isin(keys, self._sorted_keys))
        return select_arrays(arrays, names)


def _list_id_arrays(names: frozenset[str]) -> set[str]:
    """Return the names of the id arrays that belong to the given arrays of pairs and events."""
    return {f"{name.rpartition('.')[0]}.id" for name in names if find_array_subject(name) in ("pair", "event")}
