"""`antdsl info CACHE`: prints the contents of a cache, and the inputs from which it was made."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from antdsl.cli.exits import CommandError, ExitCode, explain_cache_errors
from antdsl.cli.printing.messages import print_result

if TYPE_CHECKING:
    from antdsl.outputs.cache.cache_reader import Cache
    from antdsl.outputs.cache.manifest import MeshEntry


def run_info_command(
    cache: Path = typer.Argument(..., help="A folder that `antdsl run` wrote."),
    verify: bool = typer.Option(False, "--verify", help="Read all files, and compare them with their hashes."),
) -> None:
    """Describe a cache: its contents, and the inputs that it was made from."""
    from antdsl.diagnostics.model import replace_unprintable
    from antdsl.outputs.edits.edited_cache import EditedCache, open_edited_cache

    with explain_cache_errors():
        opened_cache = open_edited_cache(cache)
    for line in describe_cache(opened_cache):
        print_result(replace_unprintable(line))  # the manifest may come from an untrusted source
    if verify:
        _verify_cache(opened_cache.original if isinstance(opened_cache, EditedCache) else opened_cache)


def describe_cache(cache: Cache) -> list[str]:
    """Return lines of text that describe a cache."""
    from antdsl.outputs.cache.field_strengths import list_program_fields
    from antdsl.outputs.edits.edited_cache import EditedCache
    from antdsl.outputs.provenance import make_resume_command
    from antdsl.scene.geometry.import_notes import MeshImport, format_import_report

    manifest, frames, hashes = cache.manifest, cache.frames(), cache.read_state_hashes()
    frame_count = manifest.last - manifest.first + 1
    inside = [frame for frame in frames if manifest.first <= frame <= manifest.last]
    lines = [
        f"scene        {manifest.scene} (antdsl {manifest.antdsl}, seed {manifest.seed})",
        f"frames       {len(inside)} of {frame_count}: {manifest.first}..{manifest.last} at {_format_fps(manifest.fps)} fps"
        + (f", preroll {manifest.preroll}" if manifest.preroll else "")
        + (f", {manifest.substeps} substeps" if manifest.substeps > 1 else ""),
        f"units        {manifest.units}, {manifest.up} up",
        f"attributes   {' '.join(manifest.attributes)}",
    ]
    if any(manifest.origin):
        lines.insert(3, f"origin       {' '.join(f'{x:.15g}' for x in manifest.origin)} {manifest.units}")
    lines += _describe_agents(cache, inside)
    for species in manifest.species:
        for machine in species.machines:
            lines.append(f"states       {species.name}.{machine.name}: {' '.join(state.name for state in machine.states)}")
        if species.clips:
            clip_names = (clip.name + (f" on {clip.on}" if clip.on else "") for clip in species.clips)
            lines.append(f"clips        {species.name}: {', '.join(clip_names)}")
        if species.definition is not None and species.definition < len(manifest.bodies):
            lines.append(f"body         {species.name}: {manifest.bodies[species.definition].name}")
        if species.bodies:
            lines.append(f"bodies       {species.name}: {', '.join(f'{each.body} × {each.weight:g}' for each in species.bodies)}")
    cells = {field.name: f"cells of {field.cell:g} {manifest.units}" for field in manifest.fields}
    for name, parts in list_program_fields(manifest).items():
        lines.append(f"field        {name}, {'vectors, ' if len(parts) > 1 else ''}{cells[parts[0]]}")
    lines += [f"items        {items.name}: {' '.join(items.names)}" for items in manifest.items]
    for mesh in manifest.meshes:
        lines.append(f"mesh         {mesh.name} ({mesh.kind}){_describe_patches(mesh, manifest.units)}")
        if mesh.imported is not None:
            lines += [f"  {line}" for line in format_import_report(MeshImport(**mesh.imported.model_dump()), manifest.units)]
    lines += [f"note         {text}" for text in manifest.notes]
    checkpoints = cache.checkpoints()
    lines.append(f"checkpoints  {' '.join(map(str, checkpoints)) if checkpoints else 'none'}")
    if inside and inside[-1] in hashes:
        lines.append(f"state hash   {hashes[inside[-1]]} (frame {inside[-1]})")
    lines.append(
        f"complete     {'yes' if len(inside) == frame_count else f'no; continue with: {make_resume_command(cache.folder)}'}"
    )
    if isinstance(cache, EditedCache):
        lines.append("edits        applied as frames are read; `antdsl edit CACHE --remove` removes them")
    if manifest.made_with is not None:
        lines.append("made with")
        lines += [f"  {name:<10} {value or 'none'}" for name, value in manifest.made_with.model_dump().items()]
    lines.append("made from")
    lines += [f"  {value}  {name}" for name, value in manifest.inputs.items()]
    return lines


def _describe_agents(cache: Cache, frames: list[int]) -> list[str]:
    """Return a line with the number of agents in the first and the last frame; [] if these frames cannot be read."""
    from antdsl.outputs.cache.cache_reader import CacheError

    try:
        counts = [
            (len(arrays["id"]), frame)
            for frame in frames[:1] + frames[1:][-1:]
            if "id" in (arrays := cache.frame(frame, frozenset(["id"])))
        ]
    except CacheError:
        return []
    return [f"agents       {', '.join(f'{count:,} in frame {frame}' for count, frame in counts)}"] if counts else []


def _describe_patches(mesh: MeshEntry, units: str) -> str:
    """Return a note about a surface that was made from height samples; "" for any other mesh.

    The note gives the largest distance between the triangles of the surface and the bilinear surface through the samples."""
    if mesh.deviation is None:
        return ""
    return f", samples of heights: at most {mesh.deviation:.3g} {units} off the bilinear surface through them"


def _format_fps(text: str) -> str:
    numerator, denominator = text.split("/")
    return numerator if denominator == "1" else text


def _verify_cache(cache: Cache) -> None:
    """Compare every frame and checkpoint with its stored hash. Missing frames count as damage."""
    from antdsl.outputs.cache.cache_reader import STATIC_FILE_NAME
    from antdsl.outputs.cache.hashes import HASHES_FILE_NAME
    from antdsl.outputs.provenance import make_resume_command

    lines, frames, checkpoints = cache.lines(), cache.frames(), cache.checkpoints()
    first, last = cache.manifest.first, cache.manifest.last
    bad, next_frame = [], first
    strays = [
        f"frame {frame} is outside this cache, which has {first} to {last}" for frame in frames if not first <= frame <= last
    ]
    strays += cache.describe_stray_files()
    for frame in sorted({*frames, *lines}):
        if not first <= frame <= last:
            bad += [] if frame in frames else [f"`{HASHES_FILE_NAME}` lists frame {frame}, which is outside this cache"]
            continue
        if frame > next_frame:
            bad.append(
                f"frame {next_frame} is missing" if frame == next_frame + 1 else f"frames {next_frame} to {frame - 1} are missing"
            )
        next_frame = max(next_frame, frame + 1)
        damage = cache.find_frame_damage(frame, lines.get(frame))
        bad += _find_read_errors(partial(cache.frame, frame)) if damage is None else [damage]
    for frame in checkpoints:
        damage = cache.find_checkpoint_damage(frame, lines.get(frame))
        bad += [] if damage is None else [damage]
    damage = cache.find_static_damage()
    bad += [] if damage is None else [damage]
    if bad or strays:
        overflow_note = [f"… and {len(bad) - 50} more"] if len(bad) > 50 else []
        words = "\n".join(
            [*(f"error: {damage}" for damage in bad[:50]), *overflow_note, *(f"error: {damage}" for damage in strays[:50])]
        )
        advice = [f"to recompute damaged frames: {make_resume_command(cache.folder)}"] if bad else []
        advice += ["move away files that do not belong to this cache"] if strays else []
        raise CommandError(ExitCode.FINDINGS, words, "\n".join(advice))
    unknown = [] if cache.manifest.static else [f"`{STATIC_FILE_NAME}`"]
    points = [str(frame) for frame in checkpoints if not lines[frame].checkpoint]
    unknown += [f"checkpoint{'s' if len(points) > 1 else ''} {' '.join(points)}"] if points else []
    count = len(checkpoints) - len(points)
    print_result(f"verified     {len(frames)} frames, {count} checkpoint{'' if count == 1 else 's'}")
    if unknown:
        print_result(f"not checked  {', '.join(unknown)}: readable, but written by a version without hashes for them")


def _find_read_errors(read: Callable[[], object]) -> list[str]:
    """Return the reason why `read` raises an error, as a list of lines. The list is empty if it succeeds."""
    from antdsl.outputs.cache.cache_reader import CacheError

    try:
        read()
    except CacheError as error:
        return [str(error)]
    return []
