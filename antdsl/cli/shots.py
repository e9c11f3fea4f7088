"""Several scenes, or one on a cluster: each is simulated into a separate cache, as tasks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from contextlib import AbstractContextManager, ExitStack, nullcontext
from pathlib import Path
from typing import TYPE_CHECKING, Any

import typer

from antdsl.cli.destinations import default_place, folder_to_write, keeping_inputs
from antdsl.cli.exits import Exit, Stop
from antdsl.cli.memory_demand import demand_memory
from antdsl.cli.printing.messages import say
from antdsl.cli.scheduler import cluster, code_of, stoppable
from antdsl.numerics.host import cores

if TYPE_CHECKING:
    from antdsl.executors import Executors, Task
    from antdsl.pipeline import Choices

Where = tuple[str | None, Path | None, bool]


def run_shots(
    scenes: Sequence[Path],
    choices: Choices,
    out: Path | None,
    options: Mapping[str, Any],
    threads: int,
    where: Where,
    quiet: bool,
    any_memory: bool,
) -> None:
    """Simulate scenes in parallel. `out`: the folder for all caches. `options`: as in `shots.caches.task`. `where`: the
    scheduler, its certificates, and whether it may run without them. `any_memory`: start however much memory they need.
    `threads`: of each scene, 0 to share out the cores."""
    from antdsl.cli.printing.reports import demand
    from antdsl.diagnostics import Report
    from antdsl.executors import Lost, Processes
    from antdsl.outputs.cache.cache_reader import NAMES
    from antdsl.outputs.cache.cache_writer import ForeignFolder, InTheWay, prepare_folder
    from antdsl.outputs.starting import StartError
    from antdsl.pipeline import open_scene
    from antdsl.scene.paths import sought
    from antdsl.shots.caches import task, without_others
    from antdsl.shots.placing import destination, fetched
    from antdsl.sweep.jobs import beginning

    folders = _folders(scenes, out)
    for folder in folders:
        folder_to_write(folder, "--out")
    shots, report = [], Report()
    with sought() as read:
        for scene, folder in zip(scenes, folders, strict=True):
            with keeping_inputs({}, {"--out": (folder, NAMES)}) as inputs:
                inputs.append(scene)
                shot, findings = open_scene(scene, choices)
                report.extend(findings)
                try:
                    if shot is not None:
                        beginning(shot)
                except StartError as why:
                    report.extend(why.report)
            shots.append(shot)
    demand(report)
    processes = min(cores(), len(scenes))
    per = threads or max(1, cores() // processes)
    scheduler, tls, no_tls = where
    if not any_memory and not scheduler:  # a cluster's machines have memory of their own
        demand_memory([shot for shot in shots if shot is not None], processes)
    files = [path for path in read if path.is_file()]
    running: AbstractContextManager[Executors] = nullcontext(Processes(processes, per))
    if scheduler:
        running = cluster(scheduler, tls, no_tls, processes, per, files)
    failed = 0
    try:
        with ExitStack() as stack:
            stack.enter_context(stoppable())
            try:
                for folder in folders:
                    prepare_folder(folder, force=options["force"])
            except (ForeignFolder, InTheWay) as why:
                raise Stop(Exit.INPUT_OUTPUT, f"error: {why}", "name another folder with `--out`, or add `--force`") from None
            parents = {folder.parent: stack.enter_context(destination(folder.parent)) for folder in dict.fromkeys(folders)}
            tasks = []
            for shot, scene, folder in zip(shots, scenes, folders, strict=True):
                assert shot is not None
                tasks.append(task(shot, scene, choices, options, parents[folder.parent], folder.name))
            executors = stack.enter_context(running)
            where_to = {each.key: folder for each, folder in zip(tasks, folders, strict=True)}

            def parent(each: Task) -> Path:
                return where_to[each.key].parent

            for answered in fetched(tasks, executors, parent, noted=lambda words: say(words, err=True)):
                folder = where_to[answered.task.key]
                for note in answered.notes:
                    say(f"{folder.name}: {note}", err=True)
                if answered.answer is None:
                    failed += 1
                    say(f"failed: {answered.task.document['scene']}: {answered.problem}", err=True)
                    continue
                if answered.answer["files"]:
                    without_others(folder, answered.answer["files"], folder.name)
                if not quiet:
                    say(f"{answered.answer['frames']} frames; the cache is in {folder}")
    except KeyboardInterrupt as why:
        raise Stop(code_of(why), "stopped", "go on with the same command and `--resume`") from None
    except Lost as why:
        raise Stop(Exit.INPUT_OUTPUT, f"error: {why}", "go on with the same command and `--resume`") from None
    if failed:
        raise Stop(Exit.FINDINGS, f"error: {failed} of {len(scenes)} scenes failed")


def _folders(scenes: Sequence[Path], out: Path | None) -> list[Path]:
    """The folder of each cache."""
    one = len(scenes) == 1 and out is not None
    folders = [
        out
        if one and out
        else default_place(out, scene.stem)
        if out
        else default_place(scene.resolve().parent, "out", scene.stem)
        for scene in scenes
    ]
    twice = [folder for number, folder in enumerate(folders) if folder in folders[:number]]
    if twice:
        raise typer.BadParameter(f"two scenes would be put into `{twice[0]}`; run them apart", param_hint="SCENE")
    return folders
