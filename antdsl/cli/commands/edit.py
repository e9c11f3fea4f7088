"""`antdsl edit CACHE --edits edits.yaml`: changes a finished cache. The stored frames do not change; edits are applied when
frames are read."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import typer

from antdsl.cli.destinations import choose_default_path, protect_inputs, require_writable_folder
from antdsl.cli.exits import CommandError, ExitCode, explain_cache_errors, report_failures
from antdsl.cli.printing.messages import print_note

if TYPE_CHECKING:
    from antdsl.outputs.cache.cache_reader import Cache
    from antdsl.outputs.edits.edited_cache import LoadedEdits

_SceneAndRoots = tuple[Path | None, tuple[str, ...]]  # the scene, and the roots that it may read


@report_failures("the edit stopped")
def run_edit_command(
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
    remove: bool = typer.Option(False, "--remove", help="Remove the edits of the cache."),
    settle: bool = typer.Option(
        False, "--settle", help="Simulate agents again that the edits of --edits make overlap, or leave without a neighbour."
    ),
    scene: Path = typer.Option(None, "--scene", metavar="FILE", help="For --settle: the scene, if it is not near the cache."),
    root: list[str] = typer.Option([], "--root", metavar="NAME=DIR", help="For --settle: grant the scene a folder of assets."),
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
    if settle and edits is None:
        raise typer.BadParameter("`--settle` needs a file of edits, `--edits edits.yaml`", param_hint="--settle")
    if (scene is not None or root) and not settle:
        raise typer.BadParameter("`--scene` and `--root` have no effect without `--settle`", param_hint="--settle")
    if edits is None and not remove and smooth is None and to is None:
        raise typer.BadParameter("name a file of edits, or use `--remove`, `--smooth` or `--to`", param_hint="--edits")
    resimulation = (scene, tuple(root)) if settle else None
    width = None if smooth is None else _parse_smoothing_width(smooth)
    if remove:
        _remove_edits(cache, quiet)
        return
    folder = to if to is not None or smooth is None else choose_default_path(cache.parent, f"{cache.resolve().name}_edited")
    if folder is not None:
        require_writable_folder(folder, "--to")
    with explain_cache_errors(cache):
        if folder is None:
            count, note = _store_edits(cache, edits, resimulation)
        else:
            count = _write_view(_open_view(cache, edits, width, resimulation), cache, folder, force)
            words, are = ("frame", "is") if count == 1 else ("frames", "are")
            note = f"{words}, {'edited' if width is None else f'orientations smoothed over {width}'}, {are} in {folder}"
    if not quiet:
        print_note(f"{count} {note}")


def _open_view(folder: Path, edits: Path | None, width: int | None, resimulation: _SceneAndRoots | None) -> Cache:
    """Return a view of the cache with the edits of a file, with smoothed orientations, or with the stored edits.

    `edits`: the file of edits, if any. `width`: the number of frames over which orientations are smoothed, if any.
    `resimulation`: the scene and roots for simulating affected agents again; None to leave this out."""
    from antdsl.outputs.edits.edited_cache import open_edited_cache, smooth_cache

    if width is not None:
        return smooth_cache(open_edited_cache(folder), width)
    if edits is None:
        return open_edited_cache(folder)
    return _load_edits(folder, edits, resimulation).view


def _load_edits(folder: Path, edits: Path, resimulation: _SceneAndRoots | None) -> LoadedEdits:
    """Return the edits of a file for a cache. Errors in the edits end the command. `resimulation`: the scene and roots for
    simulating affected agents again, or None to skip this."""
    from antdsl.cli.printing.reports import exit_on_errors
    from antdsl.outputs.cache.cache_reader import open_cache
    from antdsl.outputs.edits.edited_cache import load_edits
    from antdsl.outputs.edits.side_effects import describe_side_effects

    loaded, report = load_edits(open_cache(folder), edits)
    exit_on_errors(report)
    assert loaded is not None, "it has no errors"
    if resimulation is not None:
        loaded = _resimulate_edits(loaded, *resimulation)
    for words in describe_side_effects(loaded.view):
        print_note(f"warning: {words}", to_stderr=True)
    return loaded


def _resimulate_edits(loaded: LoadedEdits, scene: Path | None, roots: tuple[str, ...]) -> LoadedEdits:
    """Simulate again the agents that edits affect, and return the edits with the result. Print the number of these agents."""
    from antdsl.cli.arguments import parse_grants
    from antdsl.cli.printing.reports import exit_on_errors, print_report
    from antdsl.explain import ExplainError
    from antdsl.numerics.processor.host import count_available_cores
    from antdsl.runtime import BindError
    from antdsl.settling.resimulation import NOTHING_TO_SETTLE, SettlingError, settle_cache

    try:
        settlement = settle_cache(loaded.view, scene, parse_grants(list(roots)), count_available_cores())
    except BindError as why:
        exit_on_errors(why.report)
        raise CommandError(ExitCode.FINDINGS) from None
    except (SettlingError, ExplainError) as why:
        if isinstance(why, ExplainError) and why.report is not None:
            print_report(why.report, to_stderr=True)
        code = ExitCode.USAGE if isinstance(why, ExplainError) and why.usage else ExitCode.FINDINGS
        raise CommandError(code, f"error: {why}", f"help: {why.help}" if why.help else "") from None
    print_note(NOTHING_TO_SETTLE if settlement is None else settlement.describe_result())
    return loaded if settlement is None else loaded.add_settled(settlement.frames)


def _store_edits(folder: Path, edits: Path, resimulation: _SceneAndRoots | None) -> tuple[int, str]:
    """Store the edits of a file with a cache. Return the number of edits, and a sentence that says how they are applied and
    removed."""
    from antdsl.outputs.edits.stored_edits import store_edits

    loaded = _load_edits(folder, edits, resimulation)
    store_edits(folder, loaded.entry, loaded.inputs.arrays)
    count = len(loaded.edits.edits)
    words, them = ("edit is", "it") if count == 1 else ("edits are", "them")
    return count, f"{words} applied when {folder} is read; `antdsl edit {folder} --remove` removes {them}"


def _write_view(view: Cache, cache: Path, folder: Path, force: bool) -> int:
    """Write the frames of a view to a new cache in `folder`. Return the number of frames."""
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
    """Return the number of frames in a smoothing option such as `orient:9`."""
    from antdsl.outputs.edits.verbs.smoothing import MAX_SMOOTHING_FRAMES, MIN_SMOOTHING_FRAMES

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
