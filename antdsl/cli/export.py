"""`antdsl export CACHE --to FILE`: a cache for other programs, as USD."""

from __future__ import annotations

from pathlib import Path

import typer

from antdsl.cli.destinations import file_to_write, keeping_inputs
from antdsl.cli.exits import Exit, Stop


def export(
    cache: Path = typer.Argument(..., help="A folder that `antdsl run` wrote."),
    to: Path = typer.Option(..., "--to", metavar="FILE", help="Where to: a .usdc (small), .usda (text) or .usd file."),
    frames: str = typer.Option(None, "--frames", metavar="A..B", help="Which frames. [default: all]", show_default=False),
    quiet: bool = typer.Option(False, "--quiet", "-q", help="Print nothing but problems."),
) -> None:
    """Write a cache as a USD file: agents as instances, meshes, items, camera. Needs the extra [usd]."""
    from antdsl.cli.arguments import frame_range
    from antdsl.outputs.cache.cache_reader import CacheError, open_cache
    from antdsl.outputs.cache.manifest import ManifestError
    from antdsl.outputs.gallery import Gallery, NoPicture
    from antdsl.outputs.usd_export import SUFFIXES, export_usd
    from antdsl.scene.geometry.usd import UsdError

    if to.suffix.lower() not in SUFFIXES:
        raise typer.BadParameter(f"`{to.name}` is none of {', '.join(SUFFIXES)}", param_hint="--to")
    file_to_write(to, "--to")
    between = frame_range(frames)
    try:
        with keeping_inputs({"--to": to}) as inputs:
            gallery = Gallery(open_cache(cache))
            inputs += gallery.cache.made_from()
        there = [f for f in gallery.cache.frames() if between is None or between.first <= f <= between.last]
        if not there:
            raise Stop(Exit.INPUT_OUTPUT, "error: the cache has none of these frames", "`antdsl info CACHE` says which it has")
        export_usd(gallery, there, to)
    except ManifestError as why:
        raise Stop(Exit.INPUT_OUTPUT, f"error: {why}", "name the folder that `antdsl run` printed") from None
    except CacheError as why:
        raise Stop(Exit.INPUT_OUTPUT, f"error: {why}", "`antdsl run SCENE --resume` writes damaged frames again") from None
    except NoPicture as why:
        raise Stop(Exit.FINDINGS, f"error: {why}", "add it to `output: {attributes: …}` of the scene and run again") from None
    except UsdError as why:
        raise Stop(Exit.FINDINGS, f"error: {why}", why.help or "") from None
    if not quiet:
        typer.echo(f"{to}: frames {there[0]}..{there[-1]}, {len(gallery.manifest.species)} species")
