"""`antdsl run SCENE…`: simulates scenes into caches."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from antdsl.cli.arguments import UNTIL_OPTION
from antdsl.cli.destinations import (
    choose_default_path,
    protect_inputs,
    redirect_messages,
    require_writable_file,
    require_writable_folder,
    write_result,
)
from antdsl.cli.exits import CommandError, ExitCode, explain_cache_errors, report_failures
from antdsl.cli.memory_demand import ANY_MEMORY_OPTION, require_available_memory
from antdsl.cli.printing.messages import print_note
from antdsl.cli.scheduler import NO_TLS_OPTION, SCHEDULER_OPTION, TLS_OPTION, require_scheduler
from antdsl.cli.shots import run_shots
from antdsl.numerics.processor.host import count_available_cores

if TYPE_CHECKING:
    from antdsl.outputs.recording import Recording
    from antdsl.pipeline import RunChoices, Shot
    from antdsl.runtime import Options


class BackendName(StrEnum):
    """The backends that `--backend` accepts."""

    numpy = "numpy"
    native = "native"
    reference = "reference"


class FaultReaction(StrEnum):
    """The values of `--on-fault`: what happens when an agent has a fault."""

    stop = "stop"
    quarantine = "quarantine"


def run_run_command(
    scenes: list[Path] = typer.Argument(
        ..., metavar="SCENE…", help="A scene (.yaml); several scenes run in parallel, each independently."
    ),
    frames: str = typer.Option(None, "--frames", metavar="A..B", help="Frame range; overrides the scene."),
    seed: int = typer.Option(None, "--seed", min=0, max=2**64 - 1, help="Seed; overrides the scene."),
    set_: list[str] = typer.Option([], "--set", metavar="NAME=VALUE", help="Value of a param, such as forager.smell=50mm"),
    until: str = UNTIL_OPTION,
    out: Path = typer.Option(
        None,
        "--out",
        metavar="DIR",
        help="Folder of the cache; several scenes get one folder each. [default: out/SCENE next to the scene]",
    ),
    root: list[str] = typer.Option([], "--root", metavar="NAME=DIR", help="Grant the scene a folder of assets outside its own."),
    threads: int = typer.Option(
        0,
        "--threads",
        min=0,
        max=256,
        help="Threads for rays, kernels and NumPy's chunks; 0: all available cores. Does not change results.",
    ),
    chunk: int = typer.Option(16_384, "--chunk", min=1, max=10_000_000, help="Agents per chunk. Does not change results."),
    summary: Path = typer.Option(None, "--summary", metavar="FILE", help="Write counts, timings and measures as JSON."),
    resume: bool = typer.Option(False, "--resume", help="Continue the cache of a run that was stopped."),
    force: bool = typer.Option(False, "--force", help="Write even into a folder that has other files."),
    any_memory: bool = ANY_MEMORY_OPTION,
    backend: BackendName = typer.Option(
        BackendName.native,
        "--backend",
        help="`native`: machine code once it is ready; `numpy`: no machine code; `reference`: one agent at a time, slow but "
        "simple. Does not change results.",
    ),
    shuffle: int = typer.Option(
        None, "--shuffle-rows", metavar="N", min=0, help="Store agents in a random row order. Does not change results."
    ),
    on_fault: FaultReaction = typer.Option(
        FaultReaction.stop, "--on-fault", help="Reaction to an agent with a value that is not a number."
    ),
    profile: bool = typer.Option(
        False, "--profile", help="Report the time of phases, layers and lines at the end. Does not change results."
    ),
    scheduler: str = SCHEDULER_OPTION,
    tls: Path = TLS_OPTION,
    no_tls: bool = NO_TLS_OPTION,
    quiet: bool = typer.Option(False, "--quiet", "-q", help="Print only problems."),
) -> None:
    """Simulate scenes and write their caches."""
    from antdsl.cli.arguments import parse_frame_range, parse_grants, parse_pairs, parse_until, require_scene
    from antdsl.cli.printing.reports import exit_on_errors
    from antdsl.outputs.cache.cache_reader import CACHE_ENTRY_NAMES
    from antdsl.pipeline import RunChoices, open_scene

    require_scheduler(scheduler, tls, no_tls)
    for scene in scenes:
        require_scene(scene)
    choices = RunChoices(
        parse_grants(root), parse_frame_range(frames), seed, parse_pairs(set_, "--set"), until=parse_until(until)
    )
    if scheduler or len(scenes) > 1:
        if summary is not None or profile:
            flag = "--summary" if summary is not None else "--profile"
            raise typer.BadParameter("this option is only for a single scene that runs on this machine", param_hint=flag)
        words: dict[str, object] = {"backend": backend.value, "chunk": chunk, "shuffle_rows": shuffle, "on_fault": on_fault.value}
        words |= {"resume": resume, "force": force}
        run_shots(scenes, choices, out, words, threads, (scheduler, tls, no_tls), quiet, any_memory)
        return
    (scene,) = scenes
    require_writable_file(summary, "--summary")
    folder = out if out is not None else choose_default_path(scene.resolve().parent, "out", scene.stem)
    if scene.is_file():  # otherwise there is no folder next to the scene
        require_writable_folder(folder, "--out")
    resume_command = _build_resume_command(scene, out, frames, seed, set_, until, root, summary, any_memory)
    files, folders = {"--summary": summary}, {"--out": (folder, CACHE_ENTRY_NAMES)}
    with _handle_stop_in_set_up(resume_command), protect_inputs(files, folders) as inputs:
        inputs.append(scene)
        shot, report = open_scene(scene, choices, thorough=False)
    exit_on_errors(report)
    if shot is None:
        raise CommandError(ExitCode.FINDINGS)
    if not any_memory:
        require_available_memory([shot])
    from antdsl.runtime import Options

    options = Options(
        backend=backend.value, chunk=chunk, threads=choose_threads(threads, quiet), shuffle_rows=shuffle, on_fault=on_fault.value
    )
    writing = report_failures("cannot write the cache", f"continue with: {resume_command}")
    with (
        writing,
        _handle_stop_in_set_up(resume_command),
        protect_inputs(files, folders),
    ):  # also another cache from which the scene starts
        recording = _begin_recording(shot, folder, options, choices, resume, force, quiet)
    with redirect_messages(summary) as output:
        if profile:
            from antdsl.runtime.profiling import StepMeter

            recording.step_meter = StepMeter(None)
        _record_to_end(recording, quiet, resume_command)
        if summary is not None:
            from antdsl.outputs.summary import encode_summary

            with report_failures("the cache is complete; cannot write its summary", f"continue with: {resume_command}"):
                write_result(summary, encode_summary(recording), output)
        if recording.step_meter is not None:
            from antdsl.cli.printing.profile_table import print_profile

            print_profile(recording.step_meter.profile(), show_lines=options.backend != "reference")


def choose_threads(requested_threads: int, quiet: bool = False) -> int:
    """Return the number of threads to use: `requested_threads`, limited to the number of usable cores. 0 means all usable cores.

    Unless `quiet`, print a message if the number is reduced. More threads would only wait for each other, and libraries would
    print warnings."""
    core_count = count_available_cores()
    if requested_threads > core_count and not quiet:
        print_note(
            f"`--threads {requested_threads}`: this process may use {core_count} core{'s' * (core_count > 1)} here, "
            f"so {core_count} at a time",
            to_stderr=True,
        )
    return min(requested_threads or core_count, core_count)


def _build_resume_command(
    scene: Path,
    folder: Path | None,
    frames: str | None,
    seed: int | None,
    set_: list[str],
    until: str | None,
    root: list[str],
    summary: Path | None,
    any_memory: bool,
) -> str:
    """Return a command line that continues a run. It repeats all arguments that affect results."""
    import shlex

    words = ["antdsl", "run", str(scene)]
    flag_values: dict[str, Sequence[object]] = {
        "--frames": [frames], "--seed": [seed], "--set": set_, "--until": [until],
        "--root": root, "--out": [folder], "--summary": [summary],
    }  # fmt: skip
    for flag, values in flag_values.items():
        for value in values:
            if value is not None:
                words += [flag, str(value)]
    return shlex.join([*words, *["--any-memory"] * any_memory, "--resume"])


@contextmanager
def _handle_stop_in_set_up(resume_command: str) -> Iterator[None]:
    """While the context is active, let SIGTERM end the command with the exit code of a stopped run. During set-up there is no
    frame to store."""
    import signal

    def raise_stop(number: int, frame: object) -> None:
        raise CommandError(ExitCode.TERMINATED, "stopped before the first frame", f"begin with: {resume_command}")

    previous_handler = signal.signal(signal.SIGTERM, raise_stop)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, previous_handler)


def _begin_recording(
    shot: Shot, folder: Path, options: Options, choices: RunChoices, resume: bool, force: bool, quiet: bool
) -> Recording:
    from antdsl.cli.printing.progress import show_set_up
    from antdsl.cli.printing.reports import exit_on_errors, print_report
    from antdsl.outputs.cache_start import StartError
    from antdsl.outputs.recording import begin_recording
    from antdsl.runtime import BindError
    from antdsl.runtime.binding.start_findings import find_start_warnings

    try:
        with explain_cache_errors(), show_set_up(quiet):
            recording = begin_recording(shot, folder, options, resume=resume, force=force)
        if recording.resumed_from is None and shot.scene.model.start is None:
            print_report(find_start_warnings(shot.scene, recording.world), to_stderr=True)
        for note in recording.notes:
            print_note(note, to_stderr=True)
        return recording
    except (BindError, StartError) as error:
        exit_on_errors(error.report)
        raise CommandError(ExitCode.FINDINGS) from None


def _record_to_end(recording: Recording, quiet: bool, resume_command: str) -> None:
    """Run to the last frame. After Ctrl-C or SIGTERM, finish the current frame and stop."""
    import signal

    from antdsl.cli.printing.progress import show_progress
    from antdsl.cli.printing.reports import print_report
    from antdsl.outputs.recording import record_frames
    from antdsl.runtime import FaultStop, LimitStop
    from antdsl.runtime.notes.target_findings import report_missed_targets

    code = ExitCode.INTERRUPTED

    def ask_to_stop(number: int, frame: object) -> None:
        nonlocal code
        if number == signal.SIGTERM:  # farms send it several times, to the group and to the process
            code = ExitCode.TERMINATED
        elif recording.stop_requested:
            raise KeyboardInterrupt
        recording.stop_requested = True

    previous_handlers = {number: signal.signal(number, ask_to_stop) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        failures = report_failures("cannot write the cache", f"continue with: {resume_command}")
        with explain_cache_errors(), failures, show_progress(recording, quiet) as watch:
            for _ in record_frames(recording, watch.show_preroll):
                watch.show_frame()
    except LimitStop as error:
        words = f"correct the program; the earlier frames are in {recording.folder}"
        raise CommandError(ExitCode.INPUT_OUTPUT, f"error: {error}", words) from None
    except FaultStop as error:
        raise CommandError(
            ExitCode.FINDINGS,
            f"error: {error}",
            "correct the program, or continue without such agents: `--on-fault quarantine`\n"
            f"the frames before are in {recording.folder}",
        ) from None
    finally:
        for number, handler in previous_handlers.items():
            signal.signal(number, handler)
        for note in recording.world.backend.list_messages():
            print_note(note, to_stderr=True)
        print_report(report_missed_targets(recording.shot.scene, recording.world), to_stderr=True)
    if recording.stop_requested and not recording.is_complete:
        if recording.frame is None:
            raise CommandError(code, "stopped before the first frame", f"begin with: {resume_command}")
        raise CommandError(
            code, f"stopped after frame {recording.frame}, which has a checkpoint", f"continue with: {resume_command}"
        )
