"""`antdsl edit CACHE --edits edits.yaml`: changes a finished cache. Its frames stay as they are, and readers apply the edits."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import typer

from antdsl.cli.destinations import choose_default_path, protect_inputs, require_writable_folder
from antdsl.cli.exits import explain_cache_errors, report_failures
from antdsl.cli.printing.messages import print_note

if TYPE_CHECKING:
    from antdsl.outputs.cache.cache_reader import Cache
    from antdsl.outputs.edits.edited_cache import LoadedEdits


@report_failures("the edit stopped")
def edit(
    cache: Path = typer.Argument(..., help="A folder that `antdsl run` wrote."),
    edits: Path = typer.Option(
        None, "--edits", metavar="FILE", help="A file of edits. They replace those that the cache has; its frames stay unchanged."
    ),
    to: Path = typer.Option(
        None,
        "--to",
        "--out",
        metavar="DIR",
        help="Write the edited frames as a new cache into this folder; CACHE stays as it is.",
    ),
    remove: bool = typer.Option(False, "--remove", help="Take the edits of the cache away."),
    smooth: str = typer.Option(
        None,
        "--smooth",
        metavar="orient:N",
        help="Write a new cache with orientations replaced by means over N frames, centred on each frame. [default folder: "
        "CACHE_edited next to the old one]",
    ),
    force: bool = typer.Option(False, "--force", help="Write even into a folder that has other files."),
    quiet: bool = typer.Option(False, "--quiet", "-q", help="Print problems only."),
) -> None:
    """Change agents of a finished cache, reversibly, or write the changed frames as a new cache."""
    if (edits is not None) + remove + (smooth is not None) > 1 or (remove and to is not None):
        raise typer.BadParameter("use one of `--edits`, `--remove` and `--smooth`", param_hint="--edits")
    if edits is None and not remove and smooth is None and to is None:
        raise typer.BadParameter("name a file of edits, or use `--remove`, `--smooth` or `--to`", param_hint="--edits")
    width = None if smooth is None else _parse_smoothing_width(smooth)
    if remove:
        _remove_edits(cache, quiet)
        return
    folder = to if to is not None or smooth is None else choose_default_path(cache.parent, f"{cache.resolve().name}_edited")
    if folder is not None:
        require_writable_folder(folder, "--to")
    with explain_cache_errors(cache):
        if folder is None:
            count, note = _store_edits(cache, edits)
        else:
            count = _write_view(_open_view(cache, edits, width), cache, folder, force)
            words, are = ("frame", "is") if count == 1 else ("frames", "are")
            note = f"{words}, {'edited' if width is None else f'orientations smoothed over {width}'}, {are} in {folder}"
    if not quiet:
        print_note(f"{count} {note}")


def _open_view(folder: Path, edits: Path | None, width: int | None) -> Cache:
    """Return the cache with the edits of a file, with smooth orientations, or with its own edits."""
    from antdsl.outputs.edits.edited_cache import open_edited_cache, smooth_cache

    if width is not None:
        return smooth_cache(open_edited_cache(folder), width)
    if edits is None:
        return open_edited_cache(folder)
    return _load_edits(folder, edits).view


def _load_edits(folder: Path, edits: Path) -> LoadedEdits:
    """Return the edits of a file for a cache. The command ends if they have errors."""
    from antdsl.cli.printing.reports import exit_on_errors
    from antdsl.outputs.cache.cache_reader import open_cache
    from antdsl.outputs.edits.edited_cache import load_edits
    from antdsl.outputs.edits.side_effects import describe_side_effects

    loaded, report = load_edits(open_cache(folder), edits)
    exit_on_errors(report)
    assert loaded is not None, "it has no errors"
    for words in describe_side_effects(loaded.view):
        print_note(f"warning: {words}", to_stderr=True)
    return loaded


def _store_edits(folder: Path, edits: Path) -> tuple[int, str]:
    """Store the edits of a file with a cache. Return their number, and a note on where they are."""
    from antdsl.outputs.edits.stored_edits import store_edits

    loaded = _load_edits(folder, edits)
    store_edits(folder, loaded.entry, loaded.arrays)
    count = len(loaded.edits.edits)
    words, them = ("edit is", "it") if count == 1 else ("edits are", "them")
    return count, f"{words} applied when {folder} is read; `antdsl edit {folder} --remove` takes {them} away"


def _write_view(view: Cache, cache: Path, folder: Path, force: bool) -> int:
    """Write the frames of a view of a cache into a folder. Return their number."""
    from antdsl.outputs.cache.cache_reader import CACHE_ENTRY_NAMES
    from antdsl.outputs.edits.stored_edits import write_cache

    with protect_inputs({}, {"--to": (folder, CACHE_ENTRY_NAMES)}) as inputs:
        inputs += [*view.find_source_files(), *(cache / name for name in CACHE_ENTRY_NAMES)]
    return sum(1 for _ in write_cache(view, folder, force=force))


def _remove_edits(cache: Path, quiet: bool) -> None:
    from antdsl.outputs.edits.stored_edits import store_edits

    with explain_cache_errors(cache):
        had_edits = store_edits(cache, None)
    if not quiet:
        print_note(f"{cache} has its own frames again" if had_edits else f"{cache} has no edits")


def _parse_smoothing_width(text: str) -> int:
    """Return the number of frames over which `orient:9` smooths."""
    from antdsl.outputs.edits.verbs.finishing import MAX_SMOOTHING_FRAMES, MIN_SMOOTHING_FRAMES

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
