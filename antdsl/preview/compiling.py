"""A compiler that opens one scene repeatedly. It does not read, parse or compute unchanged parts again."""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

from antdsl import syntax
from antdsl.diagnostics import Report
from antdsl.loading import ParsedFileCache
from antdsl.pipeline import RunChoices, Shot, open_scene
from antdsl.preview.precompiled_shot import PrecompiledShot
from antdsl.reload import Migration, migrate_world
from antdsl.runtime import BindError, BindingCache, World
from antdsl.scene.paths import RequestedPaths, record_requested_paths, reopen_file
from antdsl.source import Source


@dataclass(eq=False)
class SceneCompiler:
    """Compiles the scene file `scene`. `replacement_texts`: texts, such as unsaved edits, to use instead of the contents of
    files."""

    scene: Path
    replacement_texts: dict[Path, str] = field(default_factory=dict)
    binding_cache: BindingCache = field(default_factory=BindingCache)
    _parsed_files: ParsedFileCache = field(default_factory=dict)
    _files: RequestedPaths = field(default_factory=dict)  # the files from which the last shot was made
    _attempted_files: RequestedPaths = field(default_factory=dict)  # the last requested files, including those that do not exist
    _precompiled: PrecompiledShot | None = None

    def precompile(self, choices: RunChoices | None = None) -> None:
        """Compile the shot in advance, so that a later call of `open` is fast. `open` uses the result only if no file has
        changed."""
        self._precompiled = None
        choices = choices or RunChoices()
        shot, report = self.open(choices)
        if shot is not None and report.ok:
            self._precompiled = PrecompiledShot(shot, report, choices, dict(self.replacement_texts), dict(self._parsed_files))

    def open(self, choices: RunChoices | None = None) -> tuple[Shot | None, Report]:
        """Return the shot of the current files, and a report. The shot is None if the files have errors."""
        self._drop_changed_files()
        foreseen, self._precompiled = self._precompiled, None
        if foreseen is not None and foreseen.is_current(choices or RunChoices(), self.replacement_texts, self._parsed_files):
            return foreseen.shot, foreseen.report
        with _pause_garbage_collection(), record_requested_paths() as sought_files:
            shot, report = open_scene(self.scene, choices, parsed=self._parsed_files, thorough=False)
        self._attempted_files = sought_files
        if shot is not None:
            self._files = self._attempted_files
        return shot, report

    def migrate_world(self, world: World, shot: Shot) -> tuple[World | None, Migration, Report]:
        """Return a world of `shot` that continues from `world`, what the migration did, and a report. The world is None if there
        are errors."""
        with _pause_garbage_collection():
            try:
                new_world, migration = migrate_world(world, shot.plan, shot.setting, self.binding_cache)
            except BindError as why:
                return None, Migration(), why.report
        self.binding_cache.drop_unused_values()
        return new_world, migration, Report()

    def get_watched_files(self) -> RequestedPaths:
        """Return all files that the last shot and later attempts to compile have requested, including missing files.

        Each file is listed with its granted root. Links below a root are not followed."""
        roots_by_path: RequestedPaths = {self.scene: None, **self._files, **self._attempted_files}
        for path in map(Path, self._parsed_files):
            roots_by_path.setdefault(path, path.parent)
        return roots_by_path

    def open_file(self, path: Path) -> int:
        """Return a file handle on one of the files from `get_watched_files`. The caller must close it. Raises OSError if the
        file is missing or not a regular file."""
        return reopen_file(path, self.get_watched_files().get(path, path.parent))

    def _drop_changed_files(self) -> None:
        for path, text in self.replacement_texts.items():
            known = self._parsed_files.get(str(path))
            if known is None or known[0].source.text != text:
                self._parsed_files[str(path)] = syntax.parse(Source(str(path) if known is None else known[0].source.path, text))
        for place in [place for place in self._parsed_files if Path(place) not in self.replacement_texts]:
            source, _ = syntax.read_program_file(place)
            if source is None or source.text != self._parsed_files[place][0].source.text:
                del self._parsed_files[place]


@contextmanager
def _pause_garbage_collection() -> Iterator[None]:
    """Pause garbage collection within the context. Compilation creates tens of thousands of small live objects, and scanning
    these takes as long as creating them."""
    was = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was:
            gc.enable()
