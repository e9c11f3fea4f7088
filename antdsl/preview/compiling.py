"""Opens one scene repeatedly. Parts that have not changed are not read, parsed or computed again."""

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
from antdsl.preview.speculative import PrecompiledShot
from antdsl.reload import Migration, take_over
from antdsl.runtime import BindError, BindingCache, World
from antdsl.scene.paths import RequestedPaths, record_sought, reopen
from antdsl.source import Source


@dataclass(eq=False)
class Compiler:
    """Compiles the file of one scene. `instead`: texts that replace files, such as unsaved edits."""

    scene: Path
    instead: dict[Path, str] = field(default_factory=dict)
    built: BindingCache = field(default_factory=BindingCache)
    _parsed: ParsedFileCache = field(default_factory=dict)
    _files: RequestedPaths = field(default_factory=dict)  # that the last shot was made of
    _tried: RequestedPaths = field(default_factory=dict)  # the last requested ones, also those that do not exist
    _foreseen: PrecompiledShot | None = None

    def precompile(self, choices: RunChoices | None = None) -> None:
        """Compile the shot ahead of time, for an `open` that soon follows. `open` then checks whether the files are unchanged."""
        self._foreseen = None
        choices = choices or RunChoices()
        shot, report = self.open(choices)
        if shot is not None and report.ok:
            self._foreseen = PrecompiledShot(shot, report, choices, dict(self.instead), dict(self._parsed))

    def open(self, choices: RunChoices | None = None) -> tuple[Shot | None, Report]:
        """Return the shot of the current files, or None if they have errors, and the findings."""
        self._forget_changed()
        foreseen, self._foreseen = self._foreseen, None
        if foreseen is not None and foreseen.is_current(choices or RunChoices(), self.instead, self._parsed):
            return foreseen.shot, foreseen.report
        with _without_garbage_collection(), record_sought() as sought_files:
            shot, report = open_scene(self.scene, choices, parsed=self._parsed, thorough=False)
        self._tried = sought_files
        if shot is not None:
            self._files = self._tried
        return shot, report

    def take_over(self, world: World, shot: Shot) -> tuple[World | None, Migration, Report]:
        """Return a world of `shot` that continues from `world`, or None with errors in the report."""
        with _without_garbage_collection():
            try:
                new_world, migration = take_over(world, shot.plan, shot.setting, self.built)
            except BindError as why:
                return None, Migration(), why.report
        self.built.drop_unused()
        return new_world, migration, Report()

    def files(self) -> RequestedPaths:
        """Return all files of the last shot and of later attempts; some may not exist yet.

        Each has the root below which no link is followed."""
        roots_by_path: RequestedPaths = {self.scene: None, **self._files, **self._tried}
        for path in map(Path, self._parsed):
            roots_by_path.setdefault(path, path.parent)
        return roots_by_path

    def open_file(self, path: Path) -> int:
        """Return a handle on one of the files from `files`; the caller closes it. Raises OSError if it is missing or not a
        regular file."""
        return reopen(path, self.files().get(path, path.parent))

    def _forget_changed(self) -> None:
        for path, text in self.instead.items():
            known = self._parsed.get(str(path))
            if known is None or known[0].source.text != text:
                self._parsed[str(path)] = syntax.parse(Source(str(path) if known is None else known[0].source.path, text))
        for place in [place for place in self._parsed if Path(place) not in self.instead]:
            source, _ = syntax.read(place)
            if source is None or source.text != self._parsed[place][0].source.text:
                del self._parsed[place]


@contextmanager
def _without_garbage_collection() -> Iterator[None]:
    """Pause garbage collection. Compiling creates tens of thousands of small live objects, and scanning them takes as long as
    creating them."""
    was = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if was:
            gc.enable()
