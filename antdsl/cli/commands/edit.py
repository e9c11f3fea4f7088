"""`antdsl edit CACHE --smooth orient:9`: changes a cache after the run, into a separate cache."""

from __future__ import annotations

from pathlib import Path

import typer

from antdsl.cli.destinations import default_path, protect_inputs, require_writable_folder
from antdsl.cli.exits import CommandError, ExitCode, report_failures
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
        None,
        "--out",
        metavar="DIR",
        help="Folder of the new cache. [default: CACHE_edited beside the old one]",
        show_default=False,
    ),
    force: bool = typer.Option(False, "--force", help="Write even into a folder that has other files."),
    quiet: bool = typer.Option(False, "--quiet", "-q", help="Print problems only."),
) -> None:
    """Write a copy of a cache with its orientations smoothed over time."""
    from antdsl.outputs.cache.cache_reader import NAMES, CacheError, open_cache
    from antdsl.outputs.cache.cache_writer import ForeignFolder, PathBlocked
    from antdsl.outputs.cache.lock import FolderLocked
    from antdsl.outputs.cache.manifest import ManifestError
    from antdsl.outputs.editing import NotEditable, smooth_orientations
    from antdsl.outputs.provenance import resume_command

    width = _parse_width(smooth)
    folder = out if out is not None else default_path(cache.parent, f"{cache.resolve().name}_edited")
    require_writable_folder(folder, "--out")
    try:
        with protect_inputs({}, {"--out": (folder, NAMES)}) as inputs:
            read = open_cache(cache)
            inputs += [*read.source_files(), *(cache / name for name in NAMES)]
        count = sum(1 for _ in smooth_orientations(read, folder, width, force=force))
    except ManifestError as why:
        raise CommandError(ExitCode.INPUT_OUTPUT, f"error: {why}", "name the folder that `antdsl run` printed") from None
    except CacheError as why:
        raise CommandError(
            ExitCode.INPUT_OUTPUT, f"error: {why}", f"to compute damaged frames again: {resume_command(cache)}"
        ) from None
    except NotEditable as why:
        raise CommandError(
            ExitCode.FINDINGS, f"error: {why}", "add it to `output: {attributes: …}` of the scene and run again"
        ) from None
    except ForeignFolder as why:
        words = "name another folder with `--out`, or write into it anyway with `--force`"
        raise CommandError(ExitCode.INPUT_OUTPUT, f"error: {why}", words) from None
    except PathBlocked as why:
        raise CommandError(ExitCode.INPUT_OUTPUT, f"error: {why}", "move it away, or name another folder with `--out`") from None
    except FolderLocked as why:
        raise CommandError(ExitCode.INPUT_OUTPUT, f"error: {why}", "wait for it, or name another folder with `--out`") from None
    if not quiet:
        print_note(f"{count} frames, orientations smoothed over {width}, are in {folder}")


def _parse_width(text: str) -> int:
    """Over how many frames `orient:9` smooths."""
    from antdsl.outputs.editing import LEAST, MOST

    name, _, number = text.partition(":")
    if name != "orient":
        raise typer.BadParameter(f"`{text}`: only orientations can be smoothed; write `orient:9`", param_hint="--smooth")
    if not (number.isascii() and number.isdigit() and len(number) < 4 and int(number) % 2 and LEAST <= int(number) <= MOST):
        words = f"`{text}` needs an odd number of frames from {LEAST} to {MOST}; `orient:9` uses four before and four after"
        raise typer.BadParameter(words, param_hint="--smooth")
    return int(number)
