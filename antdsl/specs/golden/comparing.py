"""The golden runs of one `antdsl test`: which run is compared with which, and what `--update` rewrites."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from antdsl.diagnostics import Report
from antdsl.specs.cases import Run
from antdsl.specs.golden import recorded

GoldenKey = tuple[Path, tuple[tuple[str, str], ...]]


@dataclass(slots=True)
class GoldenComparison:
    """`update`: the first seed of each scene and each set of changed params becomes a golden run. Otherwise the stored run is
    compared. Problems of a file are in `report`."""

    update: bool = False
    report: Report = field(default_factory=Report)
    results: list[recorded.GoldenResult] = field(default_factory=list)
    files: dict[Path, recorded.Golden | None] = field(default_factory=dict)
    recorders: dict[GoldenKey, tuple[Run, recorded.GoldenRecorder]] = field(default_factory=dict)

    def watch(self, run: Run, frames: int) -> recorded.GoldenWatch | None:
        """Return the recorder or comparer for a run of about `frames` frames; None if it is neither recorded nor compared."""
        scene = run.cases[0].scene
        changes = {change.name: "".join(change.value.span.text.split()) for change in run.cases[0].spec.changes}
        result = recorded.GoldenResult(scene, dict(sorted(changes.items())), run.seed)
        if self.update:
            key = (scene.resolve(), tuple(result.changes.items()))
            if key in self.recorders:
                return None
            self.results.append(result)
            self.recorders[key] = (run, recorded.GoldenRecorder(run, result, frames))
            return self.recorders[key][1]
        golden_file = self._read_golden(scene)
        golden = None if golden_file is None else _find_golden_run(golden_file, result)
        if golden_file is None or golden is None or not golden.frames:
            return None
        self.results.append(result)
        return recorded.GoldenComparer(run, result, golden, golden_file.made)

    def _read_golden(self, scene: Path) -> recorded.Golden | None:
        path = recorded.golden_path(scene)
        if path not in self.files:
            self.files[path] = None
            try:
                self.files[path] = recorded.read_golden(path)
            except recorded.GoldenError as why:
                self.report.error("wrong-value", str(why), None, "record it again with `antdsl test … --update`")
        return self.files[path]

    def write(self) -> None:
        """With `update`, write what was recorded. A run that failed its specs does not become golden. Other runs of a file
        stay."""
        new: dict[Path, list[recorded.GoldenRun]] = {}
        for run, recorder in self.recorders.values():
            if any(case.outcome == "failed" for case in run.cases):
                recorder.result.words = "not written: its specs failed"
            elif recorder.made is not None:
                new.setdefault(recorded.golden_path(run.cases[0].scene), []).append(recorder.made)
                recorder.result.outcome = "written"
        for path, runs in new.items():
            self._merge(path, runs)

    def _merge(self, path: Path, runs: list[recorded.GoldenRun]) -> None:
        try:
            old = recorded.read_golden(path)
        except recorded.GoldenError:
            old = None  # damaged: the reason to rewrite it
        fresh = {(tuple(sorted(run.set.items())), run.seed) for run in runs}
        others = [] if old is None else [run for run in old.runs if (tuple(sorted(run.set.items())), run.seed) not in fresh]
        recorded.write_golden(path, [*others, *runs])


def _find_golden_run(golden_file: recorded.Golden, result: recorded.GoldenResult) -> recorded.GoldenRun | None:
    return next((run for run in golden_file.runs if run.set == dict(result.changes) and run.seed == result.seed), None)
