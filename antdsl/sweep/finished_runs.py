"""Stores finished runs, one small file per run, so that a stopped sweep can continue."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from hashlib import sha256
from pathlib import Path
from typing import Any

from antdsl import __version__, limits
from antdsl.bounded import read_bounded
from antdsl.sweep.jobs import Job
from antdsl.whole import is_link, make_folder, write_atomically

_BYTES = limits.MAX_TASK_ANSWER_BYTES + 64 * limits.KIB  # of the stored data of one run


class NoSweepFolder(Exception):
    """Error for a folder that contains files that do not belong to a sweep."""


class RunStore:
    """The folder of a sweep: `runs/` has a file for each finished run."""

    def __init__(self, folder: Path) -> None:
        if folder.is_dir() and any(folder.iterdir()) and not (folder / "runs").is_dir():
            raise NoSweepFolder(f"`{folder}` has other files")
        if is_link(folder / "runs"):
            raise NoSweepFolder(f"`{folder / 'runs'}` is a link")
        self.folder = folder
        self.runs = folder / "runs"
        make_folder(self.runs)

    def path(self, job: Job) -> Path:
        """Return the path of a run's file."""
        return self.runs / f"{job.key}.json"

    def read_measures(self, job: Job) -> dict[str, Any] | None:
        """Return the measures of an earlier finished run. Return None if there is none or its file is damaged. Files of older
        versions, which have no hash, are accepted."""
        try:
            document = json.loads(read_bounded(self.path(job), _BYTES))
        except (OSError, ValueError, RecursionError):
            return None
        fits = isinstance(document, dict) and document.get("key") == job.key and isinstance(document.get("measures"), dict)
        if not fits or document.pop("hash", None) not in (None, _document_hash(document)):
            return None
        measures: dict[str, Any] = document["measures"]
        return measures

    def count_other_runs(self, jobs: Iterable[Job]) -> int:
        """Return the number of finished runs that belong to none of these jobs."""
        return len({path.stem for path in self.runs.glob("*.json")} - {job.key for job in jobs})

    def write_measures(self, job: Job, measures: Mapping[str, Any]) -> None:
        """Write a run's measures atomically."""
        document = describe_job(job) | {"key": job.key, "antdsl": __version__, "measures": measures}
        document["hash"] = _document_hash(document)
        write_atomically(self.path(job), (json.dumps(document, indent=1) + "\n").encode(), sync=False)


def _document_hash(document: Mapping[str, Any]) -> str:
    content = {name: value for name, value in document.items() if name != "hash"}
    return sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:32]


def describe_job(job: Job) -> dict[str, Any]:
    """Return a description of a run as plain values."""
    return {"label": job.label, "scene": Path(job.scene).name, "set": dict(job.params), "seed": job.seed}
