"""A job in a process of its own: its memory and its start-up are nobody else's."""

from __future__ import annotations

import json
import subprocess

from antdsl.bench.costs import Job, Measured
from antdsl.child_processes import module_command, module_environment


class Failed(Exception):
    """The process ended without a result; the message is what it said last."""


def measured(job: Job) -> Measured:
    """What the process finds out. Raises Failed."""
    command = module_command("antdsl.bench", json.dumps(job.as_json()))
    done = subprocess.run(command, capture_output=True, text=True, env=module_environment())
    if done.returncode:
        raise Failed((done.stderr.strip() or f"the process ended with {done.returncode}").splitlines()[-1])
    return Measured.from_json(json.loads(done.stdout.splitlines()[-1]))
