"""Display of the progress of a run: on a terminal, a bar with frames per second and states; elsewhere, a plain line now and
then."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

from antdsl.cli.printing.messages import print_note, treat_output_as_notes
from antdsl.numerics import stages
from antdsl.outputs.recording import Recording
from antdsl.outputs.summary import count_states

_LINE_INTERVAL_SECONDS = 5.0  # interval between plain lines
_BAR_CHARACTER = "█"


class ProgressDisplay:
    """A progress display that shows nothing. It is the base class of the other displays."""

    def __init__(self, recording: Recording) -> None:
        self.recording = recording
        self.start_seconds = time.perf_counter()
        self.written_frames = 0

    def show_preroll(self, label: str, frame: int) -> None:
        """Display that a preroll frame was simulated."""

    def show_frame(self) -> None:
        """Display that a frame was written."""
        self.written_frames += 1

    def compute_frame_rate(self) -> float:
        """Return the average number of frames per second since the start of the run."""
        return self.written_frames / max(time.perf_counter() - self.start_seconds, 1e-6)

    def describe_states(self) -> str:
        """Return the states that have agents, each with the number of agents: `search 312 · carry 45`."""
        return " · ".join(f"{name.split('.', 1)[1]} {count:,}" for name, count in count_states(self.recording).items() if count)


class LineProgress(ProgressDisplay):
    """A progress display that prints plain lines, always including one for the first and one for the last frame."""

    def __init__(self, recording: Recording) -> None:
        super().__init__(recording)
        self.last_line_seconds = 0.0

    def show_preroll(self, label: str, frame: int) -> None:
        self._print_line(f"preroll {frame}")

    def show_frame(self) -> None:
        super().show_frame()
        last = self.recording.shot.frames.last
        self._print_line(
            f"frame {self.recording.frame} of {last}, {self.compute_frame_rate():.1f} fps, {self.describe_states()}",
            self.recording.frame == last,
        )

    def _print_line(self, line: str, force: bool = False) -> None:
        seconds = time.perf_counter()
        if force or seconds - self.last_line_seconds > _LINE_INTERVAL_SECONDS:
            self.last_line_seconds = seconds
            print_note(line)


class BarProgress(ProgressDisplay):
    """A progress display on one line that is updated in place."""

    def __init__(self, recording: Recording, bar: Any, task: Any) -> None:
        super().__init__(recording)
        self.bar, self.task = bar, task
        self.last_drawn_seconds = 0.0

    def show_preroll(self, label: str, frame: int) -> None:
        self.bar.update(self.task, advance=1, words=f"preroll {frame}")

    def show_frame(self) -> None:
        super().show_frame()
        seconds = time.perf_counter()
        complete = self.recording.is_complete
        if seconds - self.last_drawn_seconds > 0.2 or complete:
            self.last_drawn_seconds = seconds
            self.bar.update(
                self.task, words=f"frame {self.recording.frame} · {self.compute_frame_rate():.1f} fps · {self.describe_states()}"
            )
        self.bar.advance(self.task)


@contextmanager
def show_set_up(is_quiet: bool) -> Iterator[None]:
    """Display the stages of a set-up while the context is active: on a terminal on a temporary line, elsewhere as plain lines."""
    if is_quiet:
        yield
    elif can_draw_bar():
        from rich.progress import Progress, TextColumn

        with treat_output_as_notes(), Progress(TextColumn("set up: {task.fields[words]}"), transient=True) as bar:
            task = bar.add_task("", total=None, words="")
            with stages.report_stages_to(lambda words: bar.update(task, words=words)):
                yield
    else:
        with stages.report_stages_to(_make_stage_printer()):
            yield


def _make_stage_printer() -> Callable[[str], None]:
    last_report = time.perf_counter()

    def print_stage(words: str) -> None:
        nonlocal last_report
        if (seconds := time.perf_counter()) - last_report > _LINE_INTERVAL_SECONDS:
            last_report = seconds
            print_note(f"set up: {words}")

    return print_stage


@contextmanager
def show_progress(recording: Recording, is_quiet: bool) -> Iterator[ProgressDisplay]:
    """Yield a progress display that suits the output stream. When the context ends, print the folder of the cache."""
    frames, preroll = recording.shot.frames, recording.shot.scene.model.preroll
    if recording.resumed_from is not None and not is_quiet:
        print_note(f"continues after frame {recording.resumed_from}")
    if is_quiet:
        yield ProgressDisplay(recording)
        return
    if can_draw_bar():
        from rich.progress import BarColumn, MofNCompleteColumn, Progress, TextColumn, TimeRemainingColumn

        start = frames.first - 1 - preroll if recording.resumed_from is None else recording.resumed_from
        columns = (BarColumn(24), MofNCompleteColumn(), TimeRemainingColumn(), TextColumn("{task.fields[words]}"))
        with treat_output_as_notes(), Progress(*columns) as bar:
            yield BarProgress(recording, bar, bar.add_task("", total=frames.last - start, words=""))
    else:
        yield LineProgress(recording)
    if recording.is_complete:
        _print_summary(recording)


def can_draw_bar() -> bool:
    """Return whether the output stream can show a bar."""
    if not sys.stdout.isatty():
        return False
    try:
        _BAR_CHARACTER.encode(sys.stdout.encoding or "ascii")
    except (UnicodeEncodeError, LookupError):
        return False
    return True


def _format_milliseconds(seconds_by_part: Mapping[str, float], steps: int) -> str:
    """Return a text with the milliseconds per step of each part, longest first. Negligible parts are left out."""
    shares = sorted(((value / max(steps, 1), name) for name, value in seconds_by_part.items()), reverse=True)
    return ", ".join(f"{name} {1000 * share:.1f}" for share, name in shares if share > 5e-5)


def _print_summary(recording: Recording) -> None:
    """Print the number of agents, the run time and the cache folder. With `--profile`, also print the time that each part of the
    run took."""
    simulated = sum(recording.seconds.get(part, 0.0) for part in ("first_step", "preroll", "step", "hand_over"))
    bind = recording.seconds.get("bind", 0.0)
    print_note(f"{len(recording.world):,} agents; set up in {bind:.1f} s, simulated in {simulated:.1f} s")
    if recording.step_meter is not None:
        spent = {**recording.seconds, **recording.world.timings}
        first_step = spent.pop("first_step", 0.0)
        for part in ("bind", "preroll"):
            spent.pop(part, None)
        parts, hand_over_parts, parallel_parts = (
            _format_milliseconds(each, recording.steps) for each in (spent, recording.frame_seconds, recording.writer_seconds)
        )
        print_note(f"milliseconds a frame, after a first step of {first_step:.1f} s: {parts or 'none'}")
        print_note(f"of `hand_over`: {hand_over_parts or 'none'}; meanwhile, behind the simulation: {parallel_parts or 'none'}")
    if recording.world.detail_levels is not None:
        levels = recording.world.detail_levels.summarise_counts(recording.world)["mean"]
        print_note(
            f"level of detail, agents on the average: {', '.join(f'{name} {count:,.0f}' for name, count in levels.items())}"
        )
    if recording.world.faults.fault_count:
        print_note(f"{recording.world.faults.fault_count} faults: values that are not numbers")
    print_note(f"the cache is in {recording.folder}")
