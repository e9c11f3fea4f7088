"""`antdsl jobs SCENE --to FILE`: writes a shot as a job for a render farm."""

from __future__ import annotations

import json
import math
import shlex
from pathlib import Path
from typing import TYPE_CHECKING

import typer

from antdsl.cli.destinations import choose_default_path, is_standard_output, protect_inputs, require_writable_file, write_result
from antdsl.cli.exits import CommandError, ExitCode
from antdsl.cli.printing.messages import print_note

if TYPE_CHECKING:
    from antdsl.farm import FarmJob

TEMPLATE_FILE_SUFFIXES, JSON_LINES_SUFFIXES = (".yaml", ".yml", ".json"), (".jsonl",)
# Options of `antdsl render` that a job writes itself, and the alternatives.
RESERVED_RENDER_OPTIONS = {
    "frames": "use the option of the job: `antdsl jobs … --frames A..B`",
    "every": "use the option of the job: `antdsl jobs … --every N`",
    "out": "write `antdsl jobs … --pictures DIR`",
    "shot": "omit it: the job adds it",
    "resume": "omit it: the job adds it",
    "film": "omit it: the job makes a film unless you add `--no-film`",
    "sheet": "omit it: a job draws single pictures",
}


def run_jobs_command(
    scene: Path = typer.Argument(..., help="A scene.yaml."),
    to: Path = typer.Option(
        ...,
        "--to",
        metavar="FILE",
        help="Output file: .yaml or .json for a template of Open Job Description, .jsonl for one command per line.",
    ),
    frames: str = typer.Option(None, "--frames", metavar="A..B", help="Frame range; overrides the scene."),
    chunk: int = typer.Option(10, "--chunk", metavar="N", min=1, max=1_000_000, help="Pictures per task."),
    every: int = typer.Option(1, "--every", metavar="N", min=1, max=1_000_000, help="Draw only every Nth frame."),
    seed: int = typer.Option(None, "--seed", min=0, max=2**64 - 1, help="Seed; overrides the scene."),
    set_: list[str] = typer.Option([], "--set", metavar="NAME=VALUE", help="Value of a param, such as forager.smell=50mm"),
    root: list[str] = typer.Option([], "--root", metavar="NAME=DIR", help="Grant the scene a folder of assets outside its own."),
    render: str = typer.Option("", "--render", metavar="'WORDS'", help="Options for pictures: '--camera eye --width 1920'."),
    out: Path = typer.Option(None, "--out", metavar="DIR", help="Folder of the cache. [default: out/SCENE next to the scene]"),
    pictures: Path = typer.Option(
        None, "--pictures", metavar="DIR", help="Folder of the pictures. [default: pictures in the cache]"
    ),
    film: bool = typer.Option(True, "--film/--no-film", help="Make a film of the pictures at the end; needs the extra [video]."),
    quiet: bool = typer.Option(False, "--quiet", "-q", help="Print only problems."),
) -> None:
    """Write a shot as a job for a render farm: simulation, then frames in chunks, then the film."""
    import sys

    from antdsl.cli.arguments import parse_frame_range, parse_grants, parse_pairs, require_scene
    from antdsl.cli.printing.reports import exit_on_errors
    from antdsl.farm import ShotRequest, build_job_template, build_shot_job, format_json_lines
    from antdsl.pipeline import RunChoices, open_scene

    require_scene(scene)
    if to.suffix not in (*TEMPLATE_FILE_SUFFIXES, *JSON_LINES_SUFFIXES):
        raise typer.BadParameter(
            f"`{to.name}` is none of {', '.join((*TEMPLATE_FILE_SUFFIXES, *JSON_LINES_SUFFIXES))}", param_hint="--to"
        )
    require_writable_file(to, "--to")
    look = _parse_render_words(render)
    granted, param_values = parse_grants(root), parse_pairs(set_, "--set")
    with protect_inputs({"--to": to}) as inputs:
        inputs.append(scene)
        opened, report = open_scene(scene, RunChoices(granted, parse_frame_range(frames), seed, param_values), thorough=False)
    exit_on_errors(report)
    assert opened is not None
    cache = out if out is not None else choose_default_path(scene.resolve().parent, "out", scene.stem)
    seeded = () if seed is None else ("--seed", str(seed))
    shot = ShotRequest(
        scene=scene.resolve(),
        cache=cache,
        pictures=pictures if pictures is not None else choose_default_path(cache, "pictures", flag="--pictures"),
        first=opened.frames.first,
        last=opened.frames.last,
        frame_step=every,
        pictures_per_task=chunk,
        run_arguments=(*seeded, *(word for name, value in param_values.items() for word in ("--set", f"{name}={value}"))),
        render_arguments=look,
        granted_roots=tuple(granted.items()),
        makes_film=film,
    )
    job = build_shot_job(shot, scene.resolve().stem)
    if to.suffix in JSON_LINES_SUFFIXES:
        write_result(to, format_json_lines(job).encode(), sys.stdout)
    else:
        _require_template(job, shot.frame_step, opened.frames.last - opened.frames.first + 1)
        write_result(to, _format_template(build_job_template(job, to.resolve().parent), to.suffix), sys.stdout)
    if not quiet and not is_standard_output(to):
        _print_summary(job, to)


def _parse_render_words(text: str) -> tuple[str, ...]:
    """Return the words of `--render` as extra arguments of `antdsl render`, after they pass the checks of that command."""
    from antdsl.cli.commands.render import run_render_command

    # depending on its version, typer has click as a dependency or a part of it
    wrong_use: tuple[type[BaseException], ...] = typer.BadParameter.__bases__
    advice = "`antdsl render --help` lists its options"
    app = typer.Typer(add_completion=False, pretty_exceptions_enable=False, rich_markup_mode=None)
    app.command()(run_render_command)
    try:
        words = tuple(shlex.split(text))
        context = typer.main.get_command(app).make_context("render", ["CACHE", *words])
    except ValueError:
        raise typer.BadParameter(f"`{text}` has a quote that is not closed", param_hint="--render") from None
    except typer.Exit:  # raised by `--help`
        raise typer.BadParameter(f"`{text}` draws nothing; {advice}", param_hint="--render") from None
    except wrong_use as error:
        raise CommandError(ExitCode.USAGE, f"error: `--render`: {getattr(error, 'message', error)}", advice) from None
    for name, replacement in RESERVED_RENDER_OPTIONS.items():
        source = context.get_parameter_source(name)
        if source is not None and source.name == "COMMANDLINE":
            raise typer.BadParameter(f"`--{name}` does not affect how pictures look; {replacement}", param_hint="--render")
    return words


def _require_template(job: FarmJob, frame_step: int, frames: int) -> None:
    """Raise CommandError if a job cannot become a template, because it has too many tasks or a text with `{{`. `frames`: the
    number of frames of the shot."""
    from antdsl.farm import MAX_TASKS

    tasks = max(len(step.chunk_ranges) for step in job.steps)
    if tasks > MAX_TASKS:
        chunk_size = math.ceil(math.ceil(frames / frame_step) / MAX_TASKS)
        words = f"error: {tasks:,} tasks are more than a template may list ({MAX_TASKS:,})"
        raise CommandError(ExitCode.USAGE, words, f"write `--chunk {chunk_size}`, or export lines: `--to job.jsonl`")
    for text in (text for step in job.steps for text in step.find_fixed_texts()):
        if "{{" in text:
            words = f"error: `{text}` has `{{{{`, which marks parameters in a template"
            raise CommandError(ExitCode.USAGE, words, "rename it, or export lines: `--to job.jsonl`")


def _format_template(document: dict[str, object], suffix: str) -> bytes:
    if suffix == ".json":
        return (json.dumps(document, indent=1, ensure_ascii=False) + "\n").encode()
    import yaml

    return yaml.safe_dump(document, sort_keys=False, allow_unicode=True, width=120).encode()


def _print_summary(job: FarmJob, target: Path) -> None:
    from antdsl.farm import find_external_paths

    counts = [f"{step.name} ({len(step.chunk_ranges)} tasks)" if step.chunk_ranges else step.name for step in job.steps]
    print_note(f"{target}: {', '.join(counts)}")
    missing = find_external_paths(job, target.resolve().parent) if target.suffix in TEMPLATE_FILE_SUFFIXES else []
    if missing:
        print_note("these are not below it, so name them when you submit the job:")
        for place in missing:
            print_note(f"  {place.name}={place.path.resolve()}")
