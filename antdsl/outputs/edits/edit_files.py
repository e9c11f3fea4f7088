"""Reads the files that edits name: meshes and bodies, which are stored with the edits as arrays, and other caches."""

from __future__ import annotations

import hashlib
import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from antdsl import limits
from antdsl.bodies.agents.packed import ARRAY_NAMES, pack_definition
from antdsl.bodies.files.reading import read_definition
from antdsl.diagnostics import Report
from antdsl.outputs.cache.cache_reader import Cache, open_cache
from antdsl.outputs.cache.manifest import Manifest, ManifestError
from antdsl.outputs.cache.npz import encode_npz
from antdsl.outputs.edits.edit_layer import EditFile
from antdsl.outputs.edits.edit_lines import EditList
from antdsl.scene.geometry.mesh_files import read_mesh
from antdsl.scene.geometry.mesh_text import MeshError
from antdsl.scene.paths import PathRefused, Roots
from antdsl.source import Span

ArrayDict = dict[str, NDArray[Any]]
_PARTS_BY_KIND = {"mesh": ("vertices", "faces"), "body": ARRAY_NAMES}


def read_edit_files(edits: EditList, manifest: Manifest, folder: Path) -> tuple[ArrayDict, dict[str, Cache], Report]:
    """Return the contents of the files that edits name: arrays of meshes and bodies (as `PATH.PART`), caches by path, and a
    report.

    `folder`: the folder of the edits, which contains the files."""
    arrays: ArrayDict = {}
    caches: dict[str, Cache] = {}
    report, roots = Report(), Roots(folder)
    for edit in edits.edits:
        for file in edit.line.list_files(manifest):
            span = edits.span(edit, file.key)
            try:
                if file.kind == "cache":
                    caches[file.path] = open_cache(roots.find_folder(file.path))
                elif file.kind == "mesh":
                    mesh = read_mesh(roots.read_file(file.path, limits.MAX_MESH_BYTES), file.path)
                    arrays |= {f"{file.path}.vertices": mesh.vertices, f"{file.path}.faces": mesh.faces}
                else:
                    arrays |= _read_body(file, roots, report, span)
            except PathRefused as refused:
                report.error(refused.code, str(refused), span, refused.help)
            except MeshError as why:
                report.error("bad-mesh", f"the mesh `{file.path}` {why}", span, why.help)
            except ManifestError as why:
                report.error("cannot-read", str(why), span, "write the path of a cache")
    return arrays, caches, report


def find_missing_file(edits: EditList, manifest: Manifest, arrays: Mapping[str, Any], caches: Mapping[str, Any]) -> str | None:
    """Return a file that an edit names but that is not stored with the edits. None if there is none."""
    for edit in edits.edits:
        for file in edit.line.list_files(manifest):
            names = (f"{file.path}.{part}" for part in _PARTS_BY_KIND.get(file.kind, ()))
            if not all(name in arrays for name in names) or (file.kind == "cache" and file.path not in caches):
                return file.path
    return None


def _read_body(file: EditFile, roots: Roots, report: Report, span: Span) -> Mapping[str, NDArray[Any]]:
    """Return the arrays of the agent definition in a file. Empty after an error, which is added to the report."""
    definition, findings = read_definition(file.path, roots, span)
    report.extend(findings)
    return {} if definition is None else {f"{file.path}.{part}": array for part, array in pack_definition(definition).items()}


def encode_edit_arrays(arrays: ArrayDict) -> tuple[str, bytes]:
    """Return the name and the content of the file that stores these arrays next to the manifest."""
    data = encode_npz(arrays)
    return f"edits.{hashlib.blake2b(data, digest_size=16).hexdigest()}.npz", data


def find_cache_path(cache: Cache, folder: Path) -> str:
    """Return the path of another cache relative to a cache's folder. `folder`: the folder of the first cache."""
    return Path(os.path.relpath(cache.folder.resolve(), folder.resolve())).as_posix()
