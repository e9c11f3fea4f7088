"""The jobs of a sweep: one run for each scene, combination of values and seed. Each run has a key that identifies it."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from pydantic import TypeAdapter

from antdsl.diagnostics import Report
from antdsl.loading import SharedParsedFiles
from antdsl.outputs.cache.manifest import MANIFEST_FILE_NAME
from antdsl.outputs.cache_start import StartError, find_start_cache, hash_start_frame
from antdsl.pipeline import RunChoices, Shot, open_scene
from antdsl.safe_read import resolve_path
from antdsl.scene import Scene
from antdsl.scene.paths import record_request
from antdsl.scene.values import FrameRange
from antdsl.source_hash import hash_sources


@dataclass(frozen=True, slots=True)
class SceneVariation:
    """A scene with specific values, which is one line of the table of results. `params`: the values by name. `label`: the
    display name."""

    scene: Path
    params: Mapping[str, str]
    label: str


@dataclass(frozen=True, slots=True)
class SweepJob:
    """One run of a sweep, as plain values that can be sent to another process as JSON.

    `scene`: the path of the scene.
    `label`: the display name of its variation.
    `params`: values of params by name. `grants`: folders of granted roots by name.
    `frames`: the first and the last frame.
    `until`: the condition that ends the run; None to use the condition of the scene.
    `key`: an identifier, which contains a hash of everything that the result depends on."""

    scene: str
    label: str
    params: tuple[tuple[str, str], ...]
    seed: int
    frames: tuple[int, int]
    until: str | None
    grants: tuple[tuple[str, str], ...]
    key: str

    @property
    def name(self) -> str:
        """Return the display name of the run: its label and seed."""
        return f"{self.label}, seed {self.seed}"

    def make_document(self) -> dict[str, Any]:
        """Return the job as JSON values for another process."""
        return asdict(self)

    @classmethod
    def from_document(cls, document: Mapping[str, Any]) -> SweepJob:
        """Return the job from JSON values. This is the inverse of `SweepJob.make_document`."""
        return _JOB_ADAPTER.validate_python(document)

    def make_choices(self) -> RunChoices:
        """Return the choices of the user with which this run opens its scene."""
        grants = {name: Path(folder) for name, folder in self.grants}
        return RunChoices(grants, FrameRange(*self.frames), self.seed, dict(self.params), until=self.until)


_JOB_ADAPTER = TypeAdapter(SweepJob)


def make_variations(scenes: Iterable[Path], points: Iterable[Mapping[str, str]]) -> list[SceneVariation]:
    """Return one variation for each combination of a scene and a point. A point maps names to values."""
    scenes, points = list(scenes), list(points)
    stems = [scene.stem for scene in scenes]
    combinations = []
    for scene in scenes:
        several = len(scenes) > 1 or not any(points)
        head = [scene.stem if stems.count(scene.stem) == 1 else str(scene.with_suffix(""))] if several else []
        for params in points:
            ends = [name.rpartition(".")[2] for name in params]
            short_names = [end if ends.count(end) == 1 else name for end, name in zip(ends, params, strict=True)]
            words = [f"{name} {value}" for name, value in zip(short_names, params.values(), strict=True)]
            combinations.append(SceneVariation(scene, params, ", ".join(head + words)))
    return combinations


def build_jobs(
    variations: Iterable[SceneVariation],
    seeds: Iterable[int],
    *,
    frames: FrameRange | None,
    until: str | None,
    grants: Mapping[str, Path],
) -> tuple[list[SweepJob], Report]:
    """Return all runs of a sweep, and a report that lists each problem with a scene or value once. Runs are ordered by seed, so
    that a sweep that is stopped early has results for every variation."""
    report = Report()
    shots: list[tuple[SceneVariation, FrameRange, Scene, Mapping[str, str]]] = []
    parsed = SharedParsedFiles()
    for variation in variations:
        choices = RunChoices(grants, frames, None, variation.params, until=until)
        shot, findings = open_scene(variation.scene, choices, parsed=parsed, thorough=False)
        report.extend(findings)
        if shot is not None and findings.ok:
            try:
                shots.append((variation, shot.frames, shot.scene, {**shot.inputs, **find_start_hashes(shot)}))
            except StartError as error:
                report.extend(error.report)
    granted = tuple((name, str(folder)) for name, folder in grants.items())
    job_list = []
    for seed in seeds:
        for variation, job_frames, scene, inputs in shots:
            params = tuple(variation.params.items())
            key = _compute_key(scene, inputs, job_frames, seed)
            frame_range = (job_frames.first, job_frames.last)
            job_list.append(
                SweepJob(str(resolve_path(variation.scene)), variation.label, params, seed, frame_range, until, granted, key)
            )
    return job_list, report


def find_start_hashes(shot: Shot) -> Mapping[str, str]:
    """Return hashes of the start state that a scene reads from another cache, by name. The result is empty if the scene does not
    start from a cache.

    This also records that files of the other cache are read (`scene.paths.record_requested_paths`)."""
    folder = find_start_cache(shot)
    if folder is not None:
        record_request(folder / MANIFEST_FILE_NAME, shot.scene.roots.folder)
    return hash_start_frame(shot)


def compute_job_key(shot: Shot, seed: int, start: Mapping[str, str]) -> str:
    """Return a hash of everything that the measures of a run depend on. `start`: the result of `find_start_hashes`."""
    return _compute_key(shot.scene, {**shot.inputs, **start}, shot.frames, seed)


def _compute_key(scene: Scene, inputs: Mapping[str, str], frames: FrameRange, seed: int) -> str:
    """Return a hash of all inputs of a run, as 24 hexadecimal digits. `inputs`: hashes of further inputs by name."""
    hashes = {**inputs, "scene": scene.replace_values(seed=seed).compute_digest()}
    until = scene.model.until or ""
    key_fields = {"sources": hash_sources(), "inputs": hashes, "seed": seed, "frames": list(frames), "until": until}
    return hashlib.blake2b(json.dumps(key_fields, sort_keys=True).encode(), digest_size=12).hexdigest()
