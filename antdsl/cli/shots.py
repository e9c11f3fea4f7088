"""Simulation of several scenes, or of one scene on a cluster. Each scene is one task, which writes its own cache."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from antdsl.cli.destinations import choose_default_path, protect_inputs, require_writable_folder
from antdsl.cli.exits import CommandError, ExitCode
from antdsl.cli.memory_demand import require_available_memory
from antdsl.cli.printing.messages import print_note
from antdsl.cli.scheduler import SchedulerAddress, choose_stop_exit_code, open_engine, raise_on_sigterm
from antdsl.numerics.processor.host import count_available_cores

if TYPE_CHECKING:
    from antdsl.executors import Task
    from antdsl.pipeline import RunChoices


def run_shots(
    scenes: Sequence[Path],
    choices: RunChoices,
    out: Path | None,
    options: Mapping[str, Any],
    threads: int,
    scheduler: SchedulerAddress,
    is_quiet: bool,
    ignore_memory_limit: bool,
) -> None:
    """Simulate scenes in parallel.

    `out`: the folder for all caches.
    `options`: see `shots.caches.make_cache_task`.
    `threads`: threads per scene; 0 divides the cores among the scenes.
    `scheduler`: the scheduler, its certificates, and whether it may be used without certificates.
    `ignore_memory_limit`: whether to start even if the runs need too much memory.
    """
    from antdsl.cli.printing.reports import exit_on_errors
    from antdsl.diagnostics import Report
    from antdsl.executors import WorkersLostError, run_tasks
    from antdsl.outputs.cache.cache_reader import CACHE_ENTRY_NAMES
    from antdsl.outputs.cache.cache_writer import ForeignFolder, PathBlocked, prepare_folder
    from antdsl.outputs.cache_start import StartError
    from antdsl.pipeline import open_scene
    from antdsl.scene.paths import record_requested_paths
    from antdsl.shots.caches import make_cache_task, remove_other_frames
    from antdsl.shots.task_destination import mark_folder
    from antdsl.sweeps.jobs import find_start_hashes

    folders = _choose_cache_folders(scenes, out)
    for folder in folders:
        require_writable_folder(folder, "--out")
    shots, report = [], Report()
    with record_requested_paths() as read:
        for scene, folder in zip(scenes, folders, strict=True):
            with protect_inputs({}, {"--out": (folder, CACHE_ENTRY_NAMES)}) as inputs:
                inputs.append(scene)
                shot, findings = open_scene(scene, choices)
                report.extend(findings)
                try:
                    if shot is not None:
                        find_start_hashes(shot)
                except StartError as error:
                    report.extend(error.report)
            shots.append(shot)
    exit_on_errors(report)
    processes = min(count_available_cores(), len(scenes))
    per = threads or max(1, count_available_cores() // processes)
    if not ignore_memory_limit and not scheduler[0]:  # machines of a cluster have their own memory
        require_available_memory([shot for shot in shots if shot is not None], processes)
    files = [path for path in read if path.is_file()]
    failure_count = 0
    print_warning = partial(print_note, to_stderr=True)
    try:
        with ExitStack() as stack:
            stack.enter_context(raise_on_sigterm())
            try:
                for folder in folders:
                    prepare_folder(folder, force=options["force"])
            except (ForeignFolder, PathBlocked) as error:
                raise CommandError(
                    ExitCode.INPUT_OUTPUT, f"error: {error}", "name another folder with `--out`, or add `--force`"
                ) from None
            parents = {folder.parent: stack.enter_context(mark_folder(folder.parent)) for folder in dict.fromkeys(folders)}
            tasks = []
            for shot, scene, folder in zip(shots, scenes, folders, strict=True):
                assert shot is not None
                tasks.append(make_cache_task(shot, scene, choices, options, parents[folder.parent], folder.name))
            engine = stack.enter_context(open_engine(scheduler, processes, per, files))
            where_to = {each.key: folder for each, folder in zip(tasks, folders, strict=True)}

            def find_parent_folder(task: Task) -> Path:
                return where_to[task.key].parent

            for answered in run_tasks(tasks, engine, report_note=print_warning, choose_folder=find_parent_folder):
                folder = where_to[answered.task.key]
                for note in answered.notes:
                    print_warning(f"{folder.name}: {note}")
                if answered.answer is None:
                    failure_count += 1
                    print_warning(f"failed: {answered.task.document['scene']}: {answered.problem}")
                    continue
                if answered.answer["files"]:
                    remove_other_frames(folder, answered.answer["files"], folder.name)
                if not is_quiet:
                    print_note(f"{answered.answer['frames']} frames; the cache is in {folder}")
    except KeyboardInterrupt as error:
        raise CommandError(choose_stop_exit_code(error), "stopped", "continue with the same command and `--resume`") from None
    except WorkersLostError as error:
        raise CommandError(ExitCode.INPUT_OUTPUT, f"error: {error}", "continue with the same command and `--resume`") from None
    if failure_count:
        raise CommandError(ExitCode.FINDINGS, f"error: {failure_count} of {len(scenes)} scenes failed")


def _choose_cache_folders(scenes: Sequence[Path], parent_folder: Path | None) -> list[Path]:
    """Return the folder of each scene's cache."""
    is_single = len(scenes) == 1 and parent_folder is not None
    folders = [
        parent_folder
        if is_single and parent_folder
        else choose_default_path(parent_folder, scene.stem)
        if parent_folder
        else choose_default_path(scene.resolve().parent, "out", scene.stem)
        for scene in scenes
    ]
    twice = [folder for number, folder in enumerate(folders) if folder in folders[:number]]
    if twice:
        raise typer.BadParameter(f"two scenes have the same folder `{twice[0]}`; run them separately", param_hint="SCENE")
    return folders
