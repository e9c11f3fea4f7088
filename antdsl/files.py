"""Lists of the files that paths select, and the texts of checked files."""

from __future__ import annotations

import os
from collections.abc import Iterable, Iterator
from glob import glob, has_magic
from pathlib import Path

from antdsl import limits
from antdsl.diagnostics import Report
from antdsl.loading import ParsedFileCache, display_path
from antdsl.safe_read import read_first_bytes, resolve_path
from antdsl.scene.document import decode_source
from antdsl.scene.paths import PathRefused, read_user_file
from antdsl.source import Source

SKIPPED_FOLDERS = frozenset(["node_modules", "__pycache__", "out", "build", "dist", "_data"])


def find_files(paths: Iterable[Path], *, lists_outer_links: bool = False) -> tuple[list[Path], Report]:
    """Return the programs and scenes that paths select, and a report.

    A path selects a file, the matches of a pattern such as `shots/**/*.ant`, or all programs and scenes of a folder. Hidden
    folders, linked folders, and links to files outside the folder are skipped.

    `lists_outer_links`: whether to return links to files outside the folder, for a caller that reports them."""
    matches: dict[Path, None] = {}
    report = Report()
    for path in _expand_patterns(paths, report):
        if not path.is_dir():
            if path.suffix in (".ant", ".yaml", ".yml"):
                matches[path] = None
            else:
                report.error(
                    "no-such-file", f"`{display_path(path)}` is neither a program (.ant), a scene (.yaml) nor a folder", None
                )
            continue
        for folder, inner, files in os.walk(path, followlinks=False):
            inner[:] = sorted(name for name in inner if not name.startswith(".") and name not in SKIPPED_FOLDERS)
            for name in sorted(files):
                file = Path(folder, name)
                if not lists_outer_links and file.is_symlink() and not resolve_path(file).is_relative_to(resolve_path(path)):
                    continue  # a stranger's folder must not choose which other files are read
                if name.endswith(".ant") or (name.endswith((".yaml", ".yml")) and _is_scene(file)):
                    matches[file] = None
    return list(matches), report


def _expand_patterns(paths: Iterable[Path], report: Report) -> Iterator[Path]:
    """Yield the paths, with each pattern replaced by its matches. A path that exists is never treated as a pattern."""
    for path in paths:
        if path.exists() or not has_magic(str(path)):
            yield path
            continue
        matches = [Path(name) for name in sorted(glob(str(path), recursive=True))]
        readable_paths = [each for each in matches if each.is_dir() or each.suffix in (".ant", ".yaml", ".yml")]
        if not readable_paths:
            report.error("no-such-file", f"`{path}` matches no program (.ant), scene (.yaml) or folder", None)
        yield from readable_paths


def load_sources(files: Iterable[Path], parsed_files: ParsedFileCache) -> list[Source]:
    """Return the texts of all checked files that can be read: programs (as they were parsed) and scenes."""
    texts = [file.source for file, _ in parsed_files.values() if not file.source.path.startswith("<")]
    for path in files:
        if path.suffix != ".ant":
            try:
                source, report = decode_source(read_user_file(path, limits.MAX_SCENE_BYTES), str(path))
            except PathRefused:
                continue
            texts += [source] if report.ok else []
    return texts


def _is_scene(path: Path) -> bool:
    """Return whether a YAML file begins like a scene, because folders may also contain other YAML files."""
    try:
        lines = read_first_bytes(path, 4096).removeprefix(b"\xef\xbb\xbf").splitlines()
    except OSError:
        return False
    first = next((line for line in lines if line.strip() and not line.lstrip().startswith(b"#")), b"")
    return first.startswith(b"antdsl:")
