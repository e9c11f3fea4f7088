"""Tables of the time of a run for the terminal: phases, layers, and the most expensive lines.

Numbers fit into 80 columns; longer text is cut at its end."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from pathlib import Path

from rich.console import Console
from rich.table import Table
from rich.text import Text

from antdsl.cli.printing.messages import print_note
from antdsl.runtime.profiling import StepProfile

MAX_LISTED_LINES = 10  # maximum number of reported lines
_FIGURE_CHARACTERS, _SHARE_CHARACTERS = 8, 3  # characters of a number, and of a share
_MAX_LOCATION_CHARACTERS = 28  # maximum number of characters of a file and a line
_MIN_TEXT_CHARACTERS = 12  # minimum number of displayed characters of a text, even on a narrow terminal


def print_profile(profile: StepProfile, *, show_lines: bool) -> None:
    """Print a profile. `show_lines`: whether to print layers and lines; false if the backend measures only phases."""
    console = Console(highlight=False, soft_wrap=True)
    with console.capture() as capture:
        _print_tables(console, profile, show_lines)
    print_note(capture.get(), newline=False)


def _print_tables(console: Console, profile: StepProfile, show_lines: bool) -> None:
    if not profile.frames:
        console.print("nothing to report: no frame was simulated after the first")
        return
    frames = "1 frame" if profile.frames == 1 else f"{profile.frames:,} frames"
    worked = sum(profile.cpu_ms.values())
    console.print(f"{profile.total_ms:.2f} ms a frame, {worked:.2f} ms of processors, over {frames}{_describe_backend(profile)}")
    total = profile.total_ms
    phases = sorted(profile.phases.items(), key=lambda entry: -entry[1])
    _print_table(console, "phase", ((name, "", ms) for name, ms in phases), total, profile.cpu_ms)
    if not show_lines:
        console.print("layers and lines are measured only on the backends `native` and `numpy`")
        return
    layers = sorted(profile.layers, key=lambda entry: -entry.ms)
    _print_table(console, "layer", ((each.span.text, each.species, each.ms) for each in layers), total)
    dearest = profile.lines[:MAX_LISTED_LINES]
    _print_table(console, "line", ((each.text, f"{_shorten_path(each.file)}:{each.line}", each.ms) for each in dearest), total)


def _describe_backend(profile: StepProfile) -> str:
    """Return words to append to a heading: the backend that ran the lines, and the frames that are left out."""
    if len(profile.frames_by_backend) < 2:
        return "".join(f", by {name}" for name in profile.frames_by_backend)
    return f", by machine code; left out: {profile.frames_by_backend['NumPy']:,} by NumPy before"


def _shorten_path(file: str) -> str:
    """Return the last two components of a file's path, so that space remains for numbers."""
    return "/".join(Path(file).parts[-2:])


def _print_table(
    console: Console,
    row_kind: str,
    rows: Iterable[tuple[str, str, float]],
    total: float,
    cpu_milliseconds: Mapping[str, float] | None = None,
) -> None:
    """Print the rows of one kind. Each row has a name, details and milliseconds.

    `row_kind`: the kind, for the heading. `total`: milliseconds that count as 100 %. `cpu_milliseconds`: CPU milliseconds by row
    name, or None."""
    rows = list(rows)
    if not rows:
        return
    place = min(_MAX_LOCATION_CHARACTERS, max(len(where) for _, where, _ in rows))
    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0), header_style="")
    figures = [
        ("ms", _FIGURE_CHARACTERS),
        *([("cpu ms", _FIGURE_CHARACTERS)] if cpu_milliseconds is not None else []),
        ("%", _SHARE_CHARACTERS),
    ]
    for title, width in figures:
        table.add_column(title, justify="right", no_wrap=True, width=width)
    if place:
        table.add_column("of" if row_kind == "layer" else "in", no_wrap=True, width=place)
    text_width = console.width - sum(width + 2 for _, width in figures) - (place + 2 if place else 0)
    table.add_column(row_kind, no_wrap=True, max_width=max(text_width, _MIN_TEXT_CHARACTERS))
    for text, where, ms in rows:
        cells = [f"{ms:.2f}", *([f"{cpu_milliseconds.get(text, 0.0):.2f}"] if cpu_milliseconds is not None else [])]
        cells.append(f"{100 * ms / max(total, 1e-12):.0f}")
        table.add_row(
            *map(
                Text,
                [
                    *cells,
                    *([_shorten_text(where, place)] if place else []),
                    _shorten_text(text, max(text_width, _MIN_TEXT_CHARACTERS)),
                ],
            )
        )
    console.print()
    console.print(table)


def _shorten_text(text: str, max_characters: int) -> str:
    return text if len(text) <= max_characters else text[: max_characters - 1] + "…"
