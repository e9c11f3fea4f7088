"""Exports of a cache for other programs. The ending of the file selects the export, and options select its form and the
agents."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from antdsl.outputs.cache.cache_reader import Arrays, Cache
from antdsl.outputs.cache.frame_agents import ALWAYS_SAVED_ARRAYS, IDENTITY_ARRAYS, find_species_rows, get_agent_ids
from antdsl.outputs.exports.csv_export import export_csv
from antdsl.outputs.exports.events_export import export_csv_events, export_npz_events
from antdsl.outputs.exports.geo_export import export_geo
from antdsl.outputs.exports.gltf_export import export_gltf
from antdsl.outputs.exports.mesh_export import export_meshes, export_usd_meshes
from antdsl.outputs.exports.npz_export import export_arrays
from antdsl.outputs.exports.poses_export import export_poses
from antdsl.outputs.exports.solid_export import export_solids, export_volumes
from antdsl.outputs.numbered_files import make_numbered_path
from antdsl.outputs.usd.stage import UsdOptions, XformOptions, export_instances, export_xforms
from antdsl.program.tables.columns import FRAME_COLUMNS

_SUBJECT_BY_ARRAY_PREFIX = {each.name.partition(".")[0]: each.of for each in FRAME_COLUMNS}  # by the first word of a name


@dataclass(frozen=True, slots=True, eq=False)
class ExportFormat:
    """An export to files with some `endings`.

    `forms`: by name, the functions that write frames of a cache into a file; the first is the default. They return
    messages about omissions and changes.
    `per_frame_forms`: the forms that write one file per frame, with the frame number in the name.
    `options`: by form, the dataclass of its additional options.
    `forbidden_strings`: strings that file names must not contain, because they have a special meaning for the export's
    libraries."""

    endings: tuple[str, ...]
    forms: Mapping[str, Callable[..., Sequence[str] | None]]
    per_frame_forms: frozenset[str] = frozenset()
    options: Mapping[str, type] = field(default_factory=dict)
    forbidden_strings: tuple[str, ...] = ()

    def paths(self, form: str, path: Path, frames: list[int]) -> list[Path]:
        """Return the paths of the files that a form writes."""
        return [make_numbered_path(path, frame) for frame in frames] if form in self.per_frame_forms else [path]

    def list_option_names(self, form: str) -> frozenset[str]:
        """Return the names of a form's additional options."""
        return frozenset(each.name for each in fields(self.options[form])) if form in self.options else frozenset()


EXPORT_FORMATS = (
    ExportFormat(
        (".usdc", ".usda", ".usd"),
        {"instances": export_instances, "xforms": export_xforms, "meshes": export_usd_meshes},
        options={"instances": UsdOptions, "xforms": XformOptions},
        forbidden_strings=("\\", ":SDF_FORMAT_ARGS:"),
    ),
    ExportFormat((".glb", ".gltf"), {"skinned": export_gltf}),
    ExportFormat((".geo",), {"points": export_geo}, frozenset({"points"})),
    ExportFormat((".csv",), {"keyframes": export_csv, "events": export_csv_events}),
    ExportFormat(
        (".npz",), {"arrays": export_arrays, "poses": export_poses, "volume": export_volumes, "events": export_npz_events}
    ),
    ExportFormat((".ply", ".obj"), {"meshes": export_meshes, "solids": export_solids}, frozenset({"meshes", "solids"})),
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
    """Return the export for the ending of a path, in any case; None if there is none."""
    return next((export for export in EXPORT_FORMATS if path.suffix.lower() in export.endings), None)


@dataclass(frozen=True, eq=False)
class AgentSubset(Cache):
    """A view of another cache that contains only the agents with some `ids`, in all species. Everything else is unchanged."""

    ids: frozenset[int] = frozenset()

    def frame(self, number: int, names: frozenset[str] | None = None) -> Arrays:
        """Return the arrays of a frame, limited to the rows of the chosen agents. `names`: the names to return; None for all."""
        arrays = super().frame(number, None if names is None else names | IDENTITY_ARRAYS | self._list_id_arrays(names))
        if "id" not in arrays:
            return arrays
        chosen = np.isin(get_agent_ids(arrays), sorted(self.ids))
        by_species = {entry.name: chosen[find_species_rows(arrays, k)] for k, entry in enumerate(self.manifest.species)}
        named = {*self.manifest.attributes, *ALWAYS_SAVED_ARRAYS}
        chosen_arrays = {name: array for name, array in arrays.items() if names is None or name in names or name == "frame"}
        for name, array in chosen_arrays.items():
            rows = chosen if name in named else self._select_rows(name, arrays, by_species)
            if rows is not None and array.ndim and len(array) == len(rows):
                chosen_arrays[name] = array[rows]
        return chosen_arrays

    def _list_id_arrays(self, names: frozenset[str]) -> set[str]:
        """Return the names of the id arrays that arrays of pairs and events need."""
        return {f"{name.rpartition('.')[0]}.id" for name in names if _find_array_subject(name) in ("pair", "event")}

    def _select_rows(self, name: str, arrays: Arrays, by_species: dict[str, NDArray[np.bool_]]) -> NDArray[np.bool_] | None:
        """Return which rows of an array belong to the chosen agents; None for an array that is not about agents."""
        if _find_array_subject(name) in ("pair", "event"):
            owners = arrays.get(f"{name.rpartition('.')[0]}.id")
            return None if owners is None else np.isin(np.asarray(owners), sorted(self.ids))
        return by_species.get(name.split(".")[1]) if _find_array_subject(name) == "one" else None


def _find_array_subject(name: str) -> str | None:
    """Return the kind of row that an array has (`one`, `pair`, `event`), by the first word of its name; None for others."""
    return _SUBJECT_BY_ARRAY_PREFIX.get(name.partition(".")[0]) if "." in name else None
