"""A shot as a job for any render farm. The input is a scene; the output is a list of steps with dependencies.

`build_shot_job` defines the commands of a shot and their dependencies. `build_job_template` writes them as an Open Job
Description template, `format_json_lines` as one line per command for any script. Every command may be stopped and restarted, and
then continues from existing results.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

MAX_TASKS = 1024  # values that a list of a parameter may have in a template
_FRAMES_PARAMETER = "Frames"  # the name of a task's frames
_PLACEHOLDER_PATTERN = re.compile("\0(\\w+)\0")  # no word of a command line has this character


@dataclass(frozen=True, slots=True)
class JobPath:
    """A path that may be different on another machine. `data_flow`: whether it is read (IN), written (OUT), or both (INOUT)."""

    name: str
    path: Path
    data_flow: Literal["IN", "OUT", "INOUT"]
    description: str


@dataclass(frozen=True, slots=True)
class JobStep:
    """A step of a job: one command, or one command per chunk of frames.

    `command`: its words. Placeholders (`_make_placeholder`) stand for paths and the chunk.
    `dependencies`: the names of the steps that must finish first.
    `chunk_ranges`: one range of frames per task; empty for a step with a single task.
    `grace_seconds`: the seconds between SIGTERM and SIGKILL when a task is stopped."""

    name: str
    description: str
    command: tuple[str, ...]
    dependencies: tuple[str, ...] = ()
    chunk_ranges: tuple[str, ...] = ()
    grace_seconds: int = 120

    def find_fixed_texts(self) -> list[str]:
        """Return the parts of the command that do not depend on the machine or on the chunk."""
        return [text for word in self.command for text in _PLACEHOLDER_PATTERN.split(word)[::2]]


@dataclass(frozen=True, slots=True)
class FarmJob:
    """A shot as a job for a render farm. `paths`: the paths that its commands use. `steps`: its steps, each after the steps on
    which it depends."""

    name: str
    paths: tuple[JobPath, ...]
    steps: tuple[JobStep, ...]


@dataclass(frozen=True, slots=True)
class ShotRequest:
    """A request for frames `first` to `last` of a scene, simulated and drawn.

    `frame_step`: every `frame_step`-th frame is drawn.
    `pictures_per_task`: the number of pictures that one task draws.
    `run_arguments`, `render_arguments`: extra arguments of `antdsl run` and `antdsl render`.
    `granted_roots`: the name and folder of each root that the scene may read."""

    scene: Path
    cache: Path
    pictures: Path
    first: int
    last: int
    frame_step: int = 1
    pictures_per_task: int = 10
    run_arguments: tuple[str, ...] = ()
    render_arguments: tuple[str, ...] = ()
    granted_roots: tuple[tuple[str, Path], ...] = ()
    makes_film: bool = True


def build_shot_job(shot: ShotRequest, name: str) -> FarmJob:
    """Return the job that simulates a shot and draws its frames. `name`: the name of the job."""
    project = JobPath("Project", shot.scene.parent, "IN", "The folder of the scene with everything below it")
    cache = JobPath("Cache", shot.cache, "INOUT", "The folder of the cache")
    pictures = JobPath("Pictures", shot.pictures, "INOUT", "The folder of the pictures")
    roots = tuple(
        JobPath(f"Root_{root}", path, "IN", f"The folder that the scene calls {root}") for root, path in shot.granted_roots
    )
    between = f"{shot.first}..{shot.last}"
    granted = [word for root, _ in shot.granted_roots for word in ("--root", f"{root}={_make_placeholder(f'Root_{root}')}")]
    scene, cache_word = f"{_make_placeholder('Project')}/{shot.scene.name}", _make_placeholder("Cache")
    draw = ("antdsl", "render", cache_word, "--out", _make_placeholder("Pictures"))
    look = (*(("--every", str(shot.frame_step)) if shot.frame_step > 1 else ()), *shot.render_arguments, "--resume")
    steps = [
        JobStep(
            "simulation",
            "Frames are simulated in order on one machine; a stopped run continues from its last checkpoint",
            ("antdsl", "run", scene, "--frames", between, "--out", cache_word, *granted, *shot.run_arguments, "--resume"),
        ),
        JobStep(
            "frames",
            "Pictures are drawn in chunks on any machine; existing complete pictures are not drawn again",
            (*draw, "--frames", _make_placeholder(_FRAMES_PARAMETER), "--shot", between, *look),
            ("simulation",),
            split_frames(shot.first, shot.last, shot.frame_step, shot.pictures_per_task),
            30,
        ),
    ]
    if shot.makes_film:
        film = (*draw, "--film", "--frames", between, *look)
        steps.append(JobStep("film", "The pictures become a film; missing pictures are drawn first", film, ("frames",), (), 30))
    return FarmJob(name, (project, *roots, cache, pictures), tuple(steps))


def split_frames(first: int, last: int, frame_step: int, count: int) -> tuple[str, ...]:
    """Return ranges of frames as texts `A..B`, with `count` pictures each; the last may have fewer.

    Each range begins with a frame that is drawn. `frame_step`: the number of frames from one picture to the next."""
    starts = range(first, last + 1, frame_step * count)
    return tuple(f"{start}..{min(start + frame_step * count - 1, last)}" for start in starts)


def _make_placeholder(name: str) -> str:
    """Return the placeholder that stands for a path or the chunk in the words of a command."""
    return f"\0{name}\0"


def _fill_placeholders(command: Sequence[str], values: Mapping[str, str]) -> list[str]:
    """Return the words of a command with its placeholders replaced by `values`."""
    return [_PLACEHOLDER_PATTERN.sub(lambda match: values[match[1]], word) for word in command]


def format_json_lines(job: FarmJob) -> str:
    """Return one JSON line per command. Commands come after those on which they depend. Paths are absolute paths on this
    machine.

    `name` and `step`: the names of the command and of its step.
    `command`: the words.
    `needs`: the names of the commands that must finish first.
    """
    paths = {place.name: str(place.path.resolve()) for place in job.paths}
    names = {step.name: [_format_command_name(step, frames) for frames in step.chunk_ranges or ("",)] for step in job.steps}
    lines = []
    for step in job.steps:
        needs = [name for earlier_step in step.dependencies for name in names[earlier_step]]
        for name, frames in zip(names[step.name], step.chunk_ranges or ("",), strict=True):
            command = _fill_placeholders(step.command, paths | {_FRAMES_PARAMETER: frames})
            entry = {"name": name, "step": step.name, "command": command, "needs": needs}
            lines.append(json.dumps(entry, ensure_ascii=False))
    return "".join(f"{line}\n" for line in lines)


def _format_command_name(step: JobStep, frames: str) -> str:
    return f"{step.name} {frames}" if frames else step.name


def build_job_template(job: FarmJob, folder: Path) -> dict[str, Any]:
    """Return an Open Job Description template, revision 2023-09, as JSON values without extensions.

    Source: https://github.com/OpenJobDescription/openjd-specifications/wiki/2023-09-Template-Schemas

    `folder`: the folder of the template file. Paths below it are written relative to it. The person who submits the job must
    give all other paths, because the specification forbids paths that lead out of that folder.
    """
    return {
        "specificationVersion": "jobtemplate-2023-09",
        "name": job.name,
        "parameterDefinitions": [_build_path_parameter(place, folder) for place in job.paths],
        "steps": [_build_step_template(job, step) for step in job.steps],
    }


def find_external_paths(job: FarmJob, folder: Path) -> list[JobPath]:
    """Return the paths outside `folder`, which the person who submits the job must give. `folder`: the folder of the template
    file."""
    return [place for place in job.paths if _find_path_below(place, folder) is None]


def _find_path_below(place: JobPath, folder: Path) -> str | None:
    """Return a path relative to `folder`, or None if it is not below `folder`."""
    path, start = place.path.resolve(), folder.resolve()
    return path.relative_to(start).as_posix() if path.is_relative_to(start) else None


def _build_path_parameter(place: JobPath, folder: Path) -> dict[str, Any]:
    """Return the parameter of a job template that declares a path."""
    parameter = {
        "name": place.name,
        "type": "PATH",
        "objectType": "DIRECTORY",
        "dataFlow": place.data_flow,
        "description": place.description,
    }
    below = _find_path_below(place, folder)
    return parameter if below is None else parameter | {"default": below}


def _build_step_template(job: FarmJob, step: JobStep) -> dict[str, Any]:
    """Return a step of a job in the form of a job template."""
    expressions = {place.name: f"{{{{Param.{place.name}}}}}" for place in job.paths}
    command, *rest = _fill_placeholders(
        step.command, expressions | {_FRAMES_PARAMETER: f"{{{{Task.Param.{_FRAMES_PARAMETER}}}}}"}
    )
    action = {
        "command": command,
        "args": rest,
        "cancelation": {"mode": "NOTIFY_THEN_TERMINATE", "notifyPeriodInSeconds": step.grace_seconds},
    }
    entry: dict[str, Any] = {"name": step.name, "description": step.description}
    if step.dependencies:
        entry["dependencies"] = [{"dependsOn": name} for name in step.dependencies]
    if step.chunk_ranges:
        tasks = {"name": _FRAMES_PARAMETER, "type": "STRING", "range": list(step.chunk_ranges)}
        entry["parameterSpace"] = {"taskParameterDefinitions": [tasks]}
    return entry | {"script": {"actions": {"onRun": action}}}
