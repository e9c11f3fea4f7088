"""A job as JSON lines, one per command, for farms and scripts that support no other format."""

from __future__ import annotations

import json

from antdsl.farm.shot_job import Job, Step, command_words


def json_lines(job: Job) -> str:
    """Return a line for each command, in a valid execution order: `name`, `step`, `command` as words, and `needs`, the names of
    the commands that must finish first. Paths are absolute paths of this machine."""
    paths = {place.name: str(place.path.resolve()) for place in job.paths}
    names = {step.name: [_name(step, frames) for frames in step.chunks or ("",)] for step in job.steps}
    lines = []
    for step in job.steps:
        needs = [name for earlier_step in step.needs for name in names[earlier_step]]
        for frames in step.chunks or ("",):
            entry = {
                "name": _name(step, frames),
                "step": step.name,
                "command": command_words(step.command, frames, paths),
                "needs": needs,
            }
            lines.append(json.dumps(entry, ensure_ascii=False))
    return "".join(f"{line}\n" for line in lines)


def _name(step: Step, frames: str) -> str:
    return f"{step.name} {frames}" if frames else step.name
