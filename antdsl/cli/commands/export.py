"""`antdsl export CACHE --to FILE`: converts a cache for other programs: USD, glTF, points, tables, arrays or meshes."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from antdsl.atomic_write import create_folder_durably, sync_files
from antdsl.cli.destinations import protect_inputs, require_writable_file, require_writable_folder
from antdsl.cli.exits import CommandError, ExitCode, explain_cache_errors, report_failures
from antdsl.cli.printing.messages import print_note
from antdsl.cli.scheduler import NO_TLS_OPTION, SCHEDULER_OPTION, TLS_OPTION, require_scheduler, run_cache_tasks

if TYPE_CHECKING:
    from antdsl.outputs.cache.cache_reader import Cache


def _explain_missing_export(path: Path) -> str:
    """Return a text that says why files with this suffix cannot be exported, and which suffix to use instead."""
    from antdsl.outputs.exports import ALTERNATIVE_ADVICE, EXPORT_FORMATS

    if str(path) == "-":
        return "an export needs a file: its ending selects the format, and some formats have several files"
    if path.suffix.lower() in ALTERNATIVE_ADVICE:
        advice = ALTERNATIVE_ADVICE[path.suffix.lower()]
        return f"`{path.suffix}` is not supported: write {advice} (docs/exports.md#what-is-not-written)"
    return f"`{path.name}` is none of {', '.join(ending for each in EXPORT_FORMATS for ending in each.extensions)}"


def _describe_unknown_ids(cache: Cache, frames: Sequence[int], chosen: frozenset[int]) -> str | None:
    """Return a note about selected agents that exist in no frame, or None if all exist. An id that several species use is only
    missing if none of these species has an agent with it."""
    from antdsl.outputs.cache.frame_agents import IDENTITY_ARRAYS, make_agent_keys
    from antdsl.outputs.edits.frame_rows import SPECIES_PER_KEY

    existing: set[int] = set()
    for frame in frames:
        arrays = cache.frame(frame, IDENTITY_ARRAYS)
        existing |= chosen & set(make_agent_keys(arrays).tolist()) if "id" in arrays else chosen
    ids, missing = ({key // SPECIES_PER_KEY for key in keys} for keys in (chosen, chosen - existing))
    missing -= {key // SPECIES_PER_KEY for key in existing}
    if not missing:
        return None
    if len(missing) == len(ids):
        return f"no agent of these frames has {'the id' if len(ids) == 1 else 'an id such as'} {min(missing)}; nothing is written"
    return f"no agent of these frames has {len(missing):,} of the ids, such as {min(missing)}"


@report_failures("the export stopped")
def run_export_command(
    cache: Path = typer.Argument(..., help="A folder that `antdsl run` wrote."),
    to: Path = typer.Option(
        ...,
        "--to",
        metavar="FILE",
        help="Output file: .usdc (small), .usda (text), .usd, .glb, .gltf, .geo, .csv, .npz, .ply or .obj; "
        "`####`: the frame number.",
    ),
    form: str = typer.Option(
        None,
        "--as",
        metavar="WORD",
        help="USD: instances, xforms, meshes; .csv: keyframes, events; .npz: arrays, poses, volume, events; .ply: meshes, solids",
    ),
    ids: str = typer.Option(None, "--ids", metavar="3,8..12", help="Export only these agents, or `guards.3..9`. [default: all]"),
    frames: str = typer.Option(None, "--frames", metavar="A..B", help="Frames to export. [default: all]"),
    skeletons: int = typer.Option(
        None,
        "--skeletons",
        metavar="N",
        min=0,
        max=100_000,
        help="USD: species of up to N agents get one skeleton per agent, others instances of a pose bank. [default: 200]",
    ),
    shutter: str = typer.Option(
        None, "--shutter", metavar="A..B", help="USD: add samples around each frame, from A to B, for motion blur."
    ),
    samples: int = typer.Option(None, "--samples", metavar="N", min=2, max=33, help="Number of such samples. [default: 3]"),
    chunk: int = typer.Option(
        None, "--chunk", metavar="N", min=1, max=100_000, help="USD: number of frames per file of values. [default: one file]"
    ),
    target: str = typer.Option(
        None,
        "--for",
        metavar="PROGRAM",
        help="USD: write for blender, houdini or usdview. Agents with skeletons are copies for Blender, else instances. "
        "[default: blender]",
    ),
    close: bool = typer.Option(None, "--close", help="USD: write bodies in close-up quality."),
    tolerance: str = typer.Option(
        None,
        "--tolerance",
        metavar="PERCENT",
        help="glTF: largest distance of a joint from its pose, in percent of the body's length; 0% writes all keys. "
        "[default: 0.5%]",
    ),
    show: str = typer.Option(
        None, "--show", metavar="states", help="USD, glTF, meshes: the colours of states. [default: natural colours of bodies]"
    ),
    scheduler: str = SCHEDULER_OPTION,
    tls: Path = TLS_OPTION,
    no_tls: bool = NO_TLS_OPTION,
    quiet: bool = typer.Option(False, "--quiet", "-q", help="Print only problems."),
) -> None:
    """Write a cache for other programs: USD (needs the extra [usd]), glTF, points for Houdini, tables, arrays, meshes."""
    from antdsl.cli.arguments import parse_frame_range, parse_shutter, parse_tolerance, require_agents
    from antdsl.outputs.edits.edited_cache import open_edited_cache
    from antdsl.outputs.exports import EXPORT_FORMATS, AgentSubset, find_export
    from antdsl.outputs.gallery import Gallery
    from antdsl.outputs.numbered_files import ExportUnavailable
    from antdsl.outputs.usd.stage import DEFAULT_TARGET, POSES_INSTANCES_BY_TARGET
    from antdsl.scene.geometry.usd import UsdError
    from antdsl.shots.exports import make_export_tasks

    require_scheduler(scheduler, tls, no_tls)
    export = find_export(to)
    if export is None:
        raise typer.BadParameter(_explain_missing_export(to), param_hint="--to")
    word = form if form is not None else next(iter(export.forms))
    if word not in export.forms:
        raise typer.BadParameter(
            f"`{to.name}` cannot be written as `{word}`; available: {', '.join(export.forms)}", param_hint="--as"
        )
    for part in export.forbidden_strings:
        if part in to.name:
            raise typer.BadParameter(f"a `{to.suffix}` file cannot have `{part}` in its name", param_hint="--to")
    if word not in export.per_frame_forms and "####" in to.name:
        words = f"`{to.name}` as `{word}` is one file with all frames: remove `####`"
        raise typer.BadParameter(words, param_hint="--to")
    frame_range = parse_frame_range(frames)
    all_options = {
        "skeletons": skeletons,
        "shutter": parse_shutter(shutter),
        "samples": samples,
        "chunk": chunk,
        "target": target,
        "close": close,
        "tolerance": parse_tolerance(tolerance),
    }
    set_options = {name: value for name, value in all_options.items() if value is not None}
    for name in sorted(set_options.keys() - export.list_option_names(word)):
        forms = [
            f"`{each.extensions[0]}` as `{w}`" for each in EXPORT_FORMATS for w in each.forms if name in each.list_option_names(w)
        ]
        raise typer.BadParameter(
            f"`{to.name}` as `{word}` does not support this option; {', '.join(forms)} does",
            param_hint="--for" if name == "target" else f"--{name}",
        )
    if target is not None and target not in POSES_INSTANCES_BY_TARGET:
        raise typer.BadParameter(f"`{target}` is none of {', '.join(POSES_INSTANCES_BY_TARGET)}", param_hint="--for")
    if show not in (None, "states"):
        raise typer.BadParameter(f"cannot show `{show}`: write `states`", param_hint="--show")
    if show is not None and word not in export.coloured_forms:
        raise typer.BadParameter(f"`{to.name}` as `{word}` has no colours: leave `--show` out", param_hint="--show")
    if "samples" in set_options and "shutter" not in set_options:
        raise typer.BadParameter("state the range of the samples: `--shutter -0.25..0.25`", param_hint="--samples")
    if scheduler and word not in export.per_frame_forms:
        spread = ", ".join(f"`{each.extensions[0]}`" for each in EXPORT_FORMATS if each.per_frame_forms)
        message = f"`{to.name}` as `{word}` is one file, which is written here; {spread} have a file for each frame"
        raise typer.BadParameter(message, param_hint="--scheduler")
    options = (export.options[word](**set_options),) if word in export.options else ()
    if word in export.per_frame_forms or not to.absolute().parent.is_dir():
        require_writable_folder(to.parent, "--to")
    else:
        require_writable_file(to, "--to")
    try:
        with explain_cache_errors(cache, "this recomputes damaged frames"):
            opened_cache = open_edited_cache(cache)
            cache_frames = [f for f in opened_cache.frames() if frame_range is None or frame_range.first <= f <= frame_range.last]
            chosen = None if ids is None else frozenset(require_agents(ids, opened_cache.manifest, "--ids"))
            if not cache_frames:
                advice = "`antdsl info CACHE` lists its frames"
                raise CommandError(ExitCode.INPUT_OUTPUT, "error: the cache has none of these frames", advice)
            paths = export.paths(word, to, cache_frames)
            if word in export.per_frame_forms:
                require_writable_folder(to.parent, "--to", *(path.name for path in paths))
                with protect_inputs({}, {"--to": (to.parent, [path.name for path in paths])}) as inputs:
                    inputs += opened_cache.find_source_files()
            else:
                with protect_inputs({"--to": to}) as inputs:
                    inputs += opened_cache.find_source_files()
            subset = opened_cache if chosen is None else AgentSubset.of(opened_cache, chosen)
            gallery = Gallery(subset, shows_states=show is not None)
            create_folder_durably(to.parent)
            notes: Sequence[str] | None
            if scheduler:
                where = scheduler, tls, no_tls
                task_answers = run_cache_tasks(
                    where,
                    cache,
                    to.parent,
                    lambda real_cache, place: make_export_tasks(
                        real_cache, to.name, word, chosen, cache_frames, place, shows_states=show is not None
                    ),
                )
                notes = tuple(dict.fromkeys(note for answered in task_answers for note in answered.notes))
            else:
                notes = export.forms[word](gallery, cache_frames, to, *options)
            if word in export.per_frame_forms:
                sync_files(paths)
            unknown = None if chosen is None else _describe_unknown_ids(opened_cache, cache_frames, chosen)
            notes = [*(notes or ()), *([] if unknown is None else [unknown])]
    except (UsdError, ExportUnavailable) as error:
        raise CommandError(ExitCode.FINDINGS, f"error: {error}", error.help or "") from None
    if not quiet:
        files = f"{paths[0]} .. {paths[-1].name}" if len(paths) > 1 else str(paths[0])
        print_note(f"{files}: frames {cache_frames[0]}..{cache_frames[-1]}, {len(gallery.manifest.species)} species")
        for note in notes or ():
            print_note(f"note: {note}")
        if "target" in export.list_option_names(word):
            others = " and ".join(f"`--for {each}`" for each in POSES_INSTANCES_BY_TARGET if each != (target or DEFAULT_TARGET))
            print_note(f"written for {target or DEFAULT_TARGET}; {others} write for other programs")
