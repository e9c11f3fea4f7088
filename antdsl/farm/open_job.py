"""A job as a template of Open Job Description, revision 2023-09, without any extension of it:
https://github.com/OpenJobDescription/openjd-specifications/wiki/2023-09-Template-Schemas."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from antdsl.farm.shot_job import CHUNK, Job, JobPath, Step, command_words

MOST_TASKS = 1024  # values that a list of a parameter may have


def job_template(job: Job, folder: Path) -> dict[str, Any]:
    """Return the template, as JSON values. `folder`: where its file will lie. Places below it are relative to it. The submitter
    of the job must name others, as the specification lets no template lead out of its folder."""
    return {
        "specificationVersion": "jobtemplate-2023-09",
        "name": job.name,
        "parameterDefinitions": [_path_parameter(place, folder) for place in job.paths],
        "steps": [_step_template(step) for step in job.steps],
    }


def paths_to_name(job: Job, folder: Path) -> list[JobPath]:
    """Return the places that the submitter of the job must name."""
    return [place for place in job.paths if _path_below(place, folder) is None]


def _path_below(place: JobPath, folder: Path) -> str | None:
    path, start = place.path.resolve(), folder.resolve()
    return path.relative_to(start).as_posix() if path.is_relative_to(start) else None


def _path_parameter(place: JobPath, folder: Path) -> dict[str, Any]:
    parameter = {
        "name": place.name,
        "type": "PATH",
        "objectType": "DIRECTORY",
        "dataFlow": place.flow,
        "description": place.description,
    }
    below = _path_below(place, folder)
    return parameter if below is None else parameter | {"default": below}


def _step_template(step: Step) -> dict[str, Any]:
    command, *rest = command_words(step.command, f"{{{{Task.Param.{CHUNK}}}}}", _PathExpressions())
    action = {
        "command": command,
        "args": rest,
        "cancelation": {"mode": "NOTIFY_THEN_TERMINATE", "notifyPeriodInSeconds": step.grace},
    }
    entry: dict[str, Any] = {"name": step.name, "description": step.description}
    if step.needs:
        entry["dependencies"] = [{"dependsOn": name} for name in step.needs]
    if step.chunks:
        tasks = {"name": CHUNK, "type": "STRING", "range": list(step.chunks)}
        entry["parameterSpace"] = {"taskParameterDefinitions": [tasks]}
    return entry | {"script": {"actions": {"onRun": action}}}


class _PathExpressions(dict[str, str]):
    """Maps each place to the expression for its path, which a farm substitutes."""

    def __missing__(self, name: str) -> str:
        return f"{{{{Param.{name}}}}}"
