"""`antdsl info CACHE`: what is in a cache, and what it was made from."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import typer

from antdsl.cli.exits import Exit, Stop

if TYPE_CHECKING:
    from antdsl.outputs.cache import Cache


def info(
    cache: Path = typer.Argument(..., help="A folder that `antdsl run` wrote."),
    verify: bool = typer.Option(False, "--verify", help="Read every frame and compare its checksums."),
) -> None:
    """Say what is in a cache and what it was made from."""
    from antdsl.outputs.cache import open_cache
    from antdsl.outputs.manifest import ManifestError

    try:
        found = open_cache(cache)
    except ManifestError as why:
        raise Stop(Exit.INPUT_OUTPUT, f"error: {why}", "name the folder that `antdsl run` printed") from None
    for line in describe(found):
        typer.echo(line)
    if verify:
        _verify(found)


def describe(cache: Cache) -> list[str]:
    """The lines that tell about a cache."""
    manifest, frames, hashes = cache.manifest, cache.frames(), cache.hashes()
    wanted = manifest.last - manifest.first + 1
    inside = [frame for frame in frames if manifest.first <= frame <= manifest.last]
    lines = [
        f"scene        {manifest.scene} (antdsl {manifest.antdsl}, seed {manifest.seed})",
        f"frames       {len(inside)} of {wanted}: {manifest.first}..{manifest.last} at {_fps(manifest.fps)} fps"
        + (f", preroll {manifest.preroll}" if manifest.preroll else "")
        + (f", {manifest.substeps} substeps" if manifest.substeps > 1 else ""),
        f"units        {manifest.units}, {manifest.up} up",
        f"attributes   {' '.join(manifest.attributes)}",
    ]
    for species in manifest.species:
        for machine in species.machines:
            lines.append(f"states       {species.name}.{machine.name}: {' '.join(state.name for state in machine.states)}")
    lines += [f"field        {field.name}, cells of {field.cell:g} {manifest.units}" for field in manifest.fields]
    lines += [f"items        {items.name}: {' '.join(items.names)}" for items in manifest.items]
    lines += [f"mesh         {mesh.name} ({mesh.kind})" for mesh in manifest.meshes]
    checkpoints = cache.checkpoints()
    lines.append(f"checkpoints  {' '.join(map(str, checkpoints)) if checkpoints else 'none'}")
    if inside and inside[-1] in hashes:
        lines.append(f"state hash   {hashes[inside[-1]]} (frame {inside[-1]})")
    lines.append(f"complete     {'yes' if len(inside) == wanted else 'no: `antdsl run SCENE --resume` goes on'}")
    lines.append("made from")
    lines += [f"  {value}  {name}" for name, value in manifest.inputs.items()]
    return lines


def _fps(text: str) -> str:
    above, below = text.split("/")
    return above if below == "1" else text


def _verify(cache: Cache) -> None:
    from antdsl.outputs.cache import CacheError

    bad = []
    for frame in cache.frames():
        try:
            cache.frame(frame)
        except CacheError as why:
            bad.append(str(why))
    if bad:
        raise Stop(Exit.FINDINGS, "\n".join(f"error: {why}" for why in bad[:50]), "`antdsl run SCENE --resume` writes them again")
    typer.echo(f"verified     {len(cache.frames())} frames")
