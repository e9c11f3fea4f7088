"""Comparison of the runs of one `antdsl test` with golden runs. `--update` records new golden runs instead."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from antdsl.diagnostics import Report
from antdsl.specs.cases import SpecRun
from antdsl.specs.golden import golden_runs

GoldenKey = tuple[Path, tuple[tuple[str, str], ...]]


@dataclass(slots=True)
class GoldenComparison:
    """Compares the runs of one `antdsl test` with golden runs, or records new golden runs.

    - `update`: whether to record runs instead of comparing them. For each scene and each set of changed params, only the first
      seed is recorded.
    - `report`: problems with golden files. `files`: the contents of golden files, by path; None for a missing file."""

    update: bool = False
    report: Report = field(default_factory=Report)
    results: list[golden_runs.GoldenResult] = field(default_factory=list)
    files: dict[Path, golden_runs.GoldenFile | None] = field(default_factory=dict)
    recorder_by_key: dict[GoldenKey, tuple[SpecRun, golden_runs.GoldenRecorder]] = field(default_factory=dict)

    def make_watch(self, run: SpecRun, frame_count: int) -> golden_runs.GoldenFrameObserver | None:
        """Return an object that records or compares a run of about `frame_count` frames. Return None if the run is neither
        recorded nor compared."""
        scene = run.cases[0].scene
        changes = {change.name: "".join(change.value.span.text.split()) for change in run.cases[0].spec.changes}
        result = golden_runs.GoldenResult(scene, dict(sorted(changes.items())), run.seed)
        if self.update:
            key = (scene.resolve(), tuple(result.changes.items()))
            if key in self.recorder_by_key:
                return None
            self.results.append(result)
            self.recorder_by_key[key] = (run, golden_runs.GoldenRecorder(run, result, frame_count))
            return self.recorder_by_key[key][1]
        golden_file = self._read_golden(scene)
        golden = None if golden_file is None else _find_golden_run(golden_file, result)
        if golden_file is None or golden is None or not golden.frames:
            return None
        self.results.append(result)
        return golden_runs.GoldenComparer(run, result, golden, golden_file.made)

    def _read_golden(self, scene: Path) -> golden_runs.GoldenFile | None:
        path = golden_runs.find_golden_path(scene)
        if path not in self.files:
            self.files[path] = None
            try:
                self.files[path] = golden_runs.read_golden(path)
            except golden_runs.GoldenError as error:
                self.report.error("wrong-value", str(error), None, "record it again with `antdsl test … --update`")
        return self.files[path]

    def write_golden_files(self) -> None:
        """Write the recorded runs if `update` is set. Runs that failed their specs are not written. Other runs in a golden file
        are not changed."""
        new: dict[Path, list[golden_runs.GoldenRun]] = {}
        for run, recorder in self.recorder_by_key.values():
            if any(case.outcome == "failed" for case in run.cases):
                recorder.result.message = "not written, because its specs failed"
            elif recorder.golden_run is not None:
                new.setdefault(golden_runs.find_golden_path(run.cases[0].scene), []).append(recorder.golden_run)
                recorder.result.outcome = "written"
        for path, runs in new.items():
            self._merge_runs(path, runs)

    def _merge_runs(self, path: Path, runs: list[golden_runs.GoldenRun]) -> None:
        try:
            old = golden_runs.read_golden(path)
        except golden_runs.GoldenError:
            old = None  # damaged, which is a reason to rewrite it
        fresh = {(tuple(sorted(run.set.items())), run.seed) for run in runs}
        others = [] if old is None else [run for run in old.runs if (tuple(sorted(run.set.items())), run.seed) not in fresh]
        golden_runs.write_golden(path, [*others, *runs])


def _find_golden_run(golden_file: golden_runs.GoldenFile, result: golden_runs.GoldenResult) -> golden_runs.GoldenRun | None:
    return next((run for run in golden_file.runs if run.set == dict(result.changes) and run.seed == result.seed), None)
