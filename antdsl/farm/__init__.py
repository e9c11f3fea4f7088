"""A shot as a job for any render farm: a scene in, steps with dependencies out.

`shot_job` defines the commands of a shot and their dependencies. `open_job` writes them as a template of Open Job Description,
`json_lines` as lines for any script. Every command may be stopped and restarted: it continues from existing results."""

from antdsl.farm.json_lines import json_lines
from antdsl.farm.open_job import job_template
from antdsl.farm.shot_job import Job, JobPath, PathArgument, Shot, Step, shot_job

__all__ = ["Job", "JobPath", "PathArgument", "Shot", "Step", "job_template", "json_lines", "shot_job"]
