"""A shot as a job for any render farm: a scene in, steps with dependencies out.

`shot_job` defines the commands of a shot and their dependencies. `open_job` writes them as a template of Open Job Description,
`json_lines` as lines for any script. Every command may be stopped and restarted: it continues from existing results."""

from antdsl.farm.json_lines import json_lines
from antdsl.farm.open_job import template
from antdsl.farm.shot_job import Arg, Job, Place, Shot, Step, shot_job

__all__ = ["Arg", "Job", "Place", "Shot", "Step", "json_lines", "shot_job", "template"]
