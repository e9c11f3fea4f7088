"""A shot as a job of a render farm: a scene in, steps with their dependencies out, to be run by whatever farm there is.

`shot_job` says which commands make a shot and which wait for which; `open_job` writes that as a template of Open Job
Description, `json_lines` as lines that any script can read. Every command of a job may be ended and begun again: it goes on with
what is there."""

from antdsl.farm.json_lines import json_lines
from antdsl.farm.open_job import template
from antdsl.farm.shot_job import Arg, Job, Place, Shot, Step, shot_job

__all__ = ["Arg", "Job", "Place", "Shot", "Step", "json_lines", "shot_job", "template"]
