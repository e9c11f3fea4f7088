"""Simulations of scenes as tasks. Each task writes a separate cache."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from antdsl.executors import Task, TaskRejectedError, WorkerContext, hash_document, raise_as_task_rejected
from antdsl.outputs.cache.cache_writer import DifferentInputs, ForeignFolder, PathBlocked
from antdsl.outputs.cache.lock import FolderLocked
from antdsl.outputs.cache.manifest import find_relative_path
from antdsl.outputs.cache_start import StartError, hash_start_frame
from antdsl.outputs.recording import NothingToResume, begin_recording, record_frames
from antdsl.pipeline import RunChoices, Shot, open_scene
from antdsl.runtime import BindError, FaultStop, LimitStop, Options
from antdsl.safe_read import resolve_path
from antdsl.scene.values import FrameRange
from antdsl.shots.task_destination import Destination

FRAME_FOLDER_NAMES = ("frames", "checkpoints")  # folders of a cache with one file per frame
_REFUSED_ERRORS = (
    *(BindError, StartError, ForeignFolder, PathBlocked, DifferentInputs, NothingToResume),
    *(FolderLocked, LimitStop, FaultStop),
)


def make_cache_task(
    shot: Shot, scene: Path, choices: RunChoices, options: Mapping[str, Any], destination: Destination, name: str
) -> Task:
    """Return a task that simulates a shot into the folder `name` of a destination. Raises StartError if the shot cannot start.

    `options`: the fields of `Options` except threads, and also `resume` and `force`."""
    scene = resolve_path(scene)
    document = {
        "scene": str(scene),
        "grants": {root: str(folder) for root, folder in choices.grants.items()},
        "frames": [shot.frames.first, shot.frames.last],
        "seed": choices.seed,
        "set": dict(choices.params),
        "until": choices.until,
        "inputs": hash_document({**shot.inputs, **hash_start_frame(shot)}),
        "options": dict(options),
        "name": name,
        "way": find_relative_path(scene, Path(destination.folder) / name),
    }
    return destination.make_task(simulate_cache, document)


def simulate_cache(document: Mapping[str, Any], worker: WorkerContext) -> dict[str, Any]:
    """Simulate a scene into a cache, as the function of a task from `make_cache_task`. Return the task's answer."""
    grants = {name: worker.find_local_path(folder) for name, folder in document["grants"].items()}
    choices = RunChoices(grants, FrameRange(*document["frames"]), document["seed"], document["set"], until=document["until"])
    shot, report = open_scene(worker.find_local_path(document["scene"]), choices)
    if shot is None or not report.ok:
        raise TaskRejectedError("; ".join(problem.message for problem in report.errors))
    options = dict(document["options"])
    resume, force = options.pop("resume"), options.pop("force")
    to = Destination.from_document(document)
    place = to.choose_task_folder(worker, document["key"])
    with raise_as_task_rejected(*_REFUSED_ERRORS):
        if hash_document({**shot.inputs, **hash_start_frame(shot)}) != document["inputs"]:
            raise TaskRejectedError("files that the scene reads have changed since the command began")
        recording = begin_recording(
            shot, place / document["name"], Options(threads=worker.threads, **options), resume=resume, force=force
        )
        recording.scene_path = document["way"]
        worker.notes += recording.notes
        for _ in record_frames(recording):
            worker.report_frame(recording.world.frame)
        worker.notes += recording.world.backend.list_messages()
    summary = {"frames": recording.world.frame - document["frames"][0] + 1, "hash": recording.last_state_hash}
    return {**to.describe_files(worker, place, document["key"]), **summary}


def remove_other_frames(folder: Path, files: list[Any], name: str) -> None:
    """Remove the frames and checkpoints of an earlier run from a folder into which a cache was fetched. `files`: the files of
    the fetched cache."""
    current_names = {str(file) for file, *_ in files}
    for kind in FRAME_FOLDER_NAMES:
        for path in (folder / kind).glob("*.npz"):
            if f"{name}/{kind}/{path.name}" not in current_names:
                path.unlink()
