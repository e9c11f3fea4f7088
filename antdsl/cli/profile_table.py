"""What a run spent its time on, as tables for a terminal: phases, layers, the dearest lines."""

from __future__ import annotations

from collections.abc import Iterable

from rich.console import Console
from rich.table import Table
from rich.text import Text

from antdsl.runtime.profiling import Profile

MOST = 10  # lines that are told


def show(profile: Profile, *, lines: bool) -> None:
    """Print a profile. `lines` is false where the backend measures phases only."""
    console = Console(highlight=False, soft_wrap=True)
    if not profile.frames:
        console.print("nothing to tell of: no frame was simulated after the first")
        return
    frames = "1 frame" if profile.frames == 1 else f"{profile.frames:,} frames"
    console.print(f"{profile.total:.2f} ms a frame, over {frames}")
    whole = profile.total
    phases = sorted(profile.phases.items(), key=lambda each: -each[1])
    _table(console, "phase", ((name, "", ms) for name, ms in phases), whole)
    if not lines:
        console.print("layers and lines are told for the backend `numpy`")
        return
    layers = sorted(profile.layers, key=lambda each: -each.ms)
    _table(console, "layer", ((each.span.text, each.species, each.ms) for each in layers), whole)
    dearest = profile.lines[:MOST]
    _table(console, "line", ((each.text, f"{each.file}:{each.line}", each.ms) for each in dearest), whole)


def _table(console: Console, what: str, rows: Iterable[tuple[str, str, float]], whole: float) -> None:
    """What there is of a kind, with its milliseconds and its share of the whole frame."""
    rows = list(rows)
    if not rows:
        return
    named = any(where for _, where, _ in rows)
    table = Table(box=None, pad_edge=False, header_style="")
    table.add_column("ms", justify="right", no_wrap=True, min_width=6)
    table.add_column("%", justify="right", no_wrap=True, min_width=3)
    if named:
        table.add_column("of" if what == "layer" else "in", no_wrap=True)
    table.add_column(what, no_wrap=True, overflow="ellipsis")
    for text, where, ms in rows:
        cells = [f"{ms:.2f}", f"{100 * ms / max(whole, 1e-12):.0f}", *([where] if named else []), text]
        table.add_row(*map(Text, cells))
    console.print()
    console.print(table)
