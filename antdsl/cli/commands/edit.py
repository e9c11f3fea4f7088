"""`antdsl edit CACHE --smooth orient:9`: writes a changed copy of a cache."""

from __future__ import annotations

from pathlib import Path

import typer

from antdsl.cli.destinations import choose_default_path, protect_inputs, require_writable_folder
from antdsl.cli.exits import explain_cache_errors, report_failures
from antdsl.cli.printing.messages import print_note


@report_failures("the edit stopped")
def edit(
    cache: Path = typer.Argument(..., help="A folder that `antdsl run` wrote."),
    smooth: str = typer.Option(
        ...,
        "--smooth",
        metavar="orient:N",
        help="Replace orientations by means over N frames, centred on each frame; positions stay unchanged.",
    ),
    out: Path = typer.Option(
        None, "--out", metavar="DIR", help="Folder of the new cache. [default: CACHE_edited beside the old one]"
    ),
    force: bool = typer.Option(False, "--force", help="Write even into a folder that has other files."),
    quiet: bool = typer.Option(False, "--quiet", "-q", help="Print problems only."),
) -> None:
    """Write a copy of a cache with its orientations smoothed over time."""
    from antdsl.outputs.cache.cache_reader import CACHE_ENTRY_NAMES, open_cache
    from antdsl.outputs.orientation_smoothing import smooth_orientations

    width = _parse_smoothing_width(smooth)
    folder = out if out is not None else choose_default_path(cache.parent, f"{cache.resolve().name}_edited")
    require_writable_folder(folder, "--out")
    with explain_cache_errors(cache):
        with protect_inputs({}, {"--out": (folder, CACHE_ENTRY_NAMES)}) as inputs:
            read = open_cache(cache)
            inputs += [*read.find_source_files(), *(cache / name for name in CACHE_ENTRY_NAMES)]
        count = sum(1 for _ in smooth_orientations(read, folder, width, force=force))
    if not quiet:
        print_note(f"{count} frames, orientations smoothed over {width}, are in {folder}")


def _parse_smoothing_width(text: str) -> int:
    """Return the number of frames over which `orient:9` smooths."""
    from antdsl.outputs.orientation_smoothing import MAX_SMOOTHING_FRAMES, MIN_SMOOTHING_FRAMES

    name, _, number = text.partition(":")
    if name != "orient":
        raise typer.BadParameter(f"`{text}`: only orientations can be smoothed; write `orient:9`", param_hint="--smooth")
    if not (
        number.isascii()
        and number.isdigit()
        and len(number) < 4
        and int(number) % 2
        and MIN_SMOOTHING_FRAMES <= int(number) <= MAX_SMOOTHING_FRAMES
    ):
        words = (
            f"`{text}` needs an odd number of frames from {MIN_SMOOTHING_FRAMES} to {MAX_SMOOTHING_FRAMES}; `orient:9` "
            f"uses four before and four after"
        )
        raise typer.BadParameter(words, param_hint="--smooth")
    return int(number)
