"""A job in a process of its own: its memory and its start-up are nobody else's."""

from __future__ import annotations

import json
import os
import subprocess
import sys
from pathlib import Path

from antdsl.bench.costs import Job, Measured


class Failed(Exception):
    """The process ended without a result; the message is what it said last."""


def measured(job: Job) -> Measured:
    """What the process finds out. Raises Failed."""
    words = [sys.executable, "-m", "antdsl.bench", json.dumps(job.as_json())]
    around = Path(__file__).resolve().parents[2]
    env = dict(os.environ)
    if around.name not in ("site-packages", "dist-packages"):  # a checkout: the child is to take the package from it, too
        env["PYTHONPATH"] = os.pathsep.join([str(around), *filter(None, [env.get("PYTHONPATH")])])
    done = subprocess.run(words, capture_output=True, text=True, env=env)
    if done.returncode:
        raise Failed((done.stderr.strip() or f"the process ended with {done.returncode}").splitlines()[-1])
    return Measured.from_json(json.loads(done.stdout.splitlines()[-1]))
