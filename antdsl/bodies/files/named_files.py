"""Opens files that a definition names. They must be below the folder of the definition file, or below a granted root.

Problems become findings at the location where the file is named."""

from __future__ import annotations

import os
import posixpath
import re
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path

from antdsl import limits
from antdsl.bodies.agents.definition import BodyError, Definition, Rig
from antdsl.bodies.files.gltf.gltf_body import read_gltf
from antdsl.bodies.files.houdini_clip import read_clip_text
from antdsl.bodies.files.json_text import JsonNode, read_tree
from antdsl.diagnostics import Report
from antdsl.scene.geometry.usd.errors import UsdError
from antdsl.scene.paths import PathRefused, Roots, read_user_file
from antdsl.source import Span

GLTF_ENDINGS, USD_ENDINGS, MESH_ENDINGS = ("glb", "gltf"), ("usd", "usda", "usdc", "usdz"), ("obj", "ply", "stl", "geo", "bgeo")
HOUDINI_ENDINGS = ("geo", "bgeo")
CLIP_ENDINGS = ("json", "clip")
DEFAULT_SAMPLE_RATE = 30.0  # samples per second of animations, if the file has no rate
_ROOT_PREFIX_PATTERN = re.compile("[A-Za-z][A-Za-z0-9_]{1,31}:")
_VARIABLE_PATTERN = re.compile(r"\$(?:\{([A-Za-z][A-Za-z0-9_]*)\}|([A-Za-z][A-Za-z0-9_]*))/(.*)", re.DOTALL)
# Formats of other programs that cannot be read, with alternatives.
_HELP_BY_CLOSED_FORMAT = {
    "bclip": (
        "the format is not published: convert the clip to text with Houdini's `clcp walk.bclip walk.clip`, or export glTF or USD"
    ),
    "sc": "the file is compressed: save it as .bgeo, .geo or .clip",
    "fbx": "the format is not published: export the body as glTF or USD, for example with Blender, which reads this format",
    "abc": "Alembic has no joints: export the body as glTF or USD",
    "blend": "export the body from Blender as glTF: File, Export, glTF 2.0",
    "dae": "export the body as glTF",
    "bvh": "import the file into the program that made the body, and export both together as glTF",
}


def get_file_ending(path: str) -> str:
    """Return the ending of a file's name in lower case, without its dot."""
    name = path.rsplit("/", 1)[-1]
    return name.rsplit(".", 1)[-1].lower() if "." in name else ""


@dataclass(slots=True)
class BodyFiles:
    """Access to the files of a definition. Problems are added to `report`.

    `folder`: the prefix for paths that do not name a root, such as `bodies/`.
    `path_by_text`: files that the user named on the command line, by their paths in the form that `roots` accepts.
    `cached_definitions`: definitions that were already read, by path and settings."""

    roots: Roots
    report: Report
    folder: str = ""
    path_by_text: dict[str, Path] = field(default_factory=dict)
    cached_definitions: dict[tuple[str, str, float, bool], Definition | None] = field(default_factory=dict)

    def to_root_path(self, path: str) -> str:
        """Return a path of the definition in the form that `roots` accepts."""
        return path if _ROOT_PREFIX_PATTERN.match(path) else self.folder + path

    def read_file(self, path: str, cap: int) -> bytes:
        """Return all bytes of a file. Raises PathRefused with the reason if it cannot be read."""
        return read_user_file(self.path_by_text[path], cap) if path in self.path_by_text else self.roots.read_file(path, cap)

    def report_refusal(self, refusal: PathRefused, place: Span | None) -> None:
        """Report that a file cannot be read, with the reason."""
        self.report.error(refusal.code, str(refusal), place, refusal.help)

    def is_closed_format(self, path: str, place: Span | None) -> bool:
        """Return whether a file has a proprietary format that antdsl cannot read. If so, report it and suggest an alternative."""
        kind = get_file_ending(path)
        if kind not in _HELP_BY_CLOSED_FORMAT:
            return False
        self.report.error(
            "wrong-kind", f"`{path[-80:]}` has a format that antdsl cannot read", place, _HELP_BY_CLOSED_FORMAT[kind]
        )
        return True

    def read_part(self, path: str, expected_part: str, place: Span | None) -> JsonNode | None:
        """Return the tree of a separate file, or None after an error. A `.clip` file is a text clip of Houdini; any other file is
        JSON.

        `expected_part`: what the file should contain, in words, such as `a rig`."""
        if self.is_closed_format(path, place):
            return None
        try:
            data = self.read_file(self.to_root_path(path), limits.MAX_BODY_JSON_BYTES)
        except PathRefused as error:
            self.report_refusal(error, place)
            return None
        name = self.display_path(path)
        root, report = read_clip_text(data, name) if get_file_ending(path) == "clip" else read_tree(data, name, expected_part)
        self.report.extend(report)
        return root

    def display_path(self, path: str) -> str:
        """Return the path of a file for use in messages."""
        full = self.to_root_path(path)
        beside = next(iter(self.path_by_text.values()), None)
        if full in self.path_by_text or beside is None or _ROOT_PREFIX_PATTERN.match(full):
            return str(self.path_by_text.get(full, full))
        return str(beside.parent / full)

    def read_body(
        self, path: str, place: Span | None, prim: str = "", rate: float = 0.0, pose: Rig | None = None
    ) -> Definition | None:
        """Return the definition in a glTF or USD file, or None after an error. Results are cached.

        `prim`: the USD prim to read, including everything below it.
        `rate`: samples per second of animations; 0 means the file's own rate.
        `pose`: a rig. If a glTF animation has no keys for a joint, the joint has its rest pose in this rig.
        """
        full = self.to_root_path(path)
        pose = pose if get_file_ending(path) in GLTF_ENDINGS else None
        plain = self.cached_definitions.get((full, prim, rate, False))
        posed = pose is not None and (plain is None or _has_different_rest_pose(plain.rig, pose))
        key = (full, prim, rate, posed)
        if key not in self.cached_definitions:
            self.cached_definitions[key] = self._read_body(path, place, prim, rate, pose)
        return self.cached_definitions[key]

    def _read_body(self, path: str, place: Span | None, prim: str, rate: float, pose: Rig | None) -> Definition | None:
        """Return the same as `read_body`, without the cache."""
        full, kind = self.to_root_path(path), get_file_ending(path)
        name = posixpath.basename(full.rpartition(":")[2]).rpartition(".")[0] or "body"
        try:
            if kind in USD_ENDINGS:
                definition, left_out = self._read_usd(full, prim or "/", name, rate)
                definition = replace(definition, length=0.0)  # to be measured
            else:
                data = self.read_file(full, limits.MAX_BODY_FILE_BYTES)
                definition, left_out = read_gltf(data, name, self._build_sibling_reader(full), rate or DEFAULT_SAMPLE_RATE, pose)
        except UsdError as error:
            self.report.error(error.code, str(error), place, error.help)
            return None
        except PathRefused as error:
            self.report_refusal(error, place)
            return None
        except BodyError as error:
            self.report.error(error.code, f"`{self.display_path(path)}` {error}", place, error.help)
            return None
        for sentence in left_out:
            self.report.warning("body-left-out", f"of `{self.display_path(path)}`: {sentence}", place)
        return definition

    def _build_sibling_reader(self, full_path: str) -> Callable[[str, int], bytes]:
        """Return a function that reads files by their paths relative to the folder of `full_path`."""
        folder = full_path[: full_path.rfind("/") + 1] or (
            f"{full_path.partition(':')[0]}:" if _ROOT_PREFIX_PATTERN.match(full_path) else ""
        )
        return lambda path, cap: self.read_file(folder + path, cap)

    def _read_usd(self, full_path: str, prim: str, name: str, rate: float) -> tuple[Definition, list[str]]:
        """Return the results of `read_usd`. If the user named a symbolic link on the command line, read its target."""
        from antdsl.bodies.files.usd_definition import read_usd

        roots, text = self.roots, full_path
        if full_path in self.path_by_text:
            target = self.path_by_text[full_path].resolve()
            roots, text = Roots(target.parent, self.roots.folder_by_name), target.name
        return read_usd(roots, text, prim, name, rate)

    def resolve_library(self, condensed_path: str, absolute: str) -> str:
        """Return the path of a shape library, for which a document gives two paths. Raises PathRefused if neither can be used.

        The condensed path (`$HIP/shapes.glb`, `$JOB/…`, or relative) is tried first. It must be below the definition's folder or
        a granted root. The absolute path is used only if a granted root contains it."""
        match = _VARIABLE_PATTERN.fullmatch(condensed_path)
        path = condensed_path
        if match:
            variable, rest = match[1] or match[2], match[3]
            path = rest if variable in ("HIP", "HIPFILE") else f"{variable}:{rest}"
        try:
            self.roots.measure_file_size(self.to_root_path(path))
            return path
        except PathRefused as first:
            granted = self._name_by_root(absolute)
            if granted is None:
                raise first from None
            self.roots.measure_file_size(granted)
            return granted

    def _name_by_root(self, absolute: str) -> str | None:
        """Return an absolute path as `ROOT:PATH`, or None if no root contains it."""
        full_path = os.path.normpath(absolute)
        for name, folder in (("", self.roots.folder), *sorted(self.roots.folder_by_name.items())):
            root = os.path.abspath(folder)
            if absolute and full_path.startswith(root + os.sep):
                below = Path(full_path).relative_to(root).as_posix()
                if name:
                    return f"{name}:{below}"
                if below.startswith(self.folder):
                    return below[len(self.folder) :]
        return None


def _has_different_rest_pose(first: Rig, second: Rig) -> bool:
    """Return whether the two rigs differ in the rest pose of a joint that they share."""
    known = {name: number for number, name in enumerate(second.names)}
    return any(
        (first.rest_matrices[k] != second.rest_matrices[known[name]]).any() for k, name in enumerate(first.names) if name in known
    )
