"""The shots of a sequence as tasks. Each task simulates a scene into a separate cache."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from antdsl.bounded import real_path
from antdsl.executors import Task, TaskRefused, Worker, document_digest, refuse_task
from antdsl.outputs.cache.cache_writer import DifferentInputs, ForeignFolder, PathBlocked
from antdsl.outputs.cache.lock import FolderLocked
from antdsl.outputs.cache.manifest import relative_path
from antdsl.outputs.recording import NothingToResume, begin, record
from antdsl.outputs.starting import StartError, start_hash
from antdsl.pipeline import RunChoices, Shot, open_scene
from antdsl.runtime import BindError, FaultStop, LimitStop, Options
from antdsl.scene.values import FrameRange
from antdsl.shots.placing import Destination

KINDS = ("frames", "checkpoints")  # folders of a cache that have a file a frame
_REFUSALS = (
    *(BindError, StartError, ForeignFolder, PathBlocked, DifferentInputs, NothingToResume),
    *(FolderLocked, LimitStop, FaultStop),
)


def cache_task(shot: Shot, scene: Path, choices: RunChoices, options: Mapping[str, Any], to: Destination, name: str) -> Task:
    """Return a task that writes the cache of a shot to the folder `name` of a destination. Raises StartError if the shot cannot
    start.

    `options`: the fields of `Options` except threads, and `resume` and `force`.
    """
    scene = real_path(scene)
    document = {
        "scene": str(scene),
        "grants": {root: str(folder) for root, folder in choices.grants.items()},
        "frames": [shot.frames.first, shot.frames.last],
        "seed": choices.seed,
        "set": dict(choices.params),
        "inputs": document_digest({**shot.inputs, **start_hash(shot)}),
        "options": dict(options),
        "name": name,
        "way": relative_path(scene, Path(to.folder) / name),
    }
    return to.task(simulate_cache, document)


def simulate_cache(document: Mapping[str, Any], worker: Worker) -> dict[str, Any]:
    """Simulate a scene into a cache."""
    grants = {name: worker.local_path(folder) for name, folder in document["grants"].items()}
    choices = RunChoices(grants, FrameRange(*document["frames"]), document["seed"], document["set"])
    shot, report = open_scene(worker.local_path(document["scene"]), choices)
    if shot is None or not report.ok:
        raise TaskRefused("; ".join(problem.message for problem in report.errors))
    options = dict(document["options"])
    resume, force = options.pop("resume"), options.pop("force")
    to = Destination.of(document)
    place = to.place(worker, document["key"])
    with refuse_task(*_REFUSALS):
        if document_digest({**shot.inputs, **start_hash(shot)}) != document["inputs"]:
            raise TaskRefused("files that the scene reads have changed since the command began")
        recording = begin(shot, place / document["name"], Options(threads=worker.threads, **options), resume=resume, force=force)
        recording.scene_path = document["way"]
        worker.notes += recording.notes
        for _ in record(recording):
            worker.report_frame(recording.world.frame)
        worker.notes += recording.world.backend.messages()
    summary = {"frames": document["frames"][1] - document["frames"][0] + 1, "hash": recording.hash}
    return {**to.describe_files(worker, place, document["key"]), **summary}


def remove_other_frames(folder: Path, files: list[Any], name: str) -> None:
    """Remove frames and checkpoints of an earlier run from a cache that was fetched."""
    current_names = {str(file) for file, *_ in files}
    for kind in KINDS:
        for path in (folder / kind).glob("*.npz"):
            if f"{name}/{kind}/{path.name}" not in current_names:
                path.unlink()
