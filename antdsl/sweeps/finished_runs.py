"""Storage of finished runs in one small file per run, so that a stopped sweep can continue."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping
from hashlib import sha256
from pathlib import Path
from typing import Any

from antdsl import __version__, limits
from antdsl.atomic_write import create_folder_durably, is_link, write_atomically
from antdsl.safe_read import read_size_limited
from antdsl.sweeps.jobs import SweepJob

_MAX_RUN_FILE_BYTES = limits.MAX_TASK_ANSWER_BYTES + 64 * limits.KIB  # maximum size of the stored data of one run


class NotASweepFolderError(Exception):
    """Error for a folder that contains files which do not belong to a sweep."""


class FinishedRunStore:
    """The folder of a sweep. Its subfolder `runs/` has one file for each finished run."""

    def __init__(self, folder: Path) -> None:
        if folder.is_dir() and any(folder.iterdir()) and not (folder / "runs").is_dir():
            raise NotASweepFolderError(f"`{folder}` has other files")
        if is_link(folder / "runs"):
            raise NotASweepFolderError(f"`{folder / 'runs'}` is a link")
        self.folder = folder
        self.runs = folder / "runs"
        create_folder_durably(self.runs)

    def get_run_path(self, job: SweepJob) -> Path:
        """Return the path of the file that stores a run."""
        return self.runs / f"{job.key}.json"

    def read_measures(self, job: SweepJob) -> dict[str, Any] | None:
        """Return the stored measures of a finished run; None if its file is missing or damaged. Files of older versions, which
        have no hash, are accepted."""
        try:
            document = json.loads(read_size_limited(self.get_run_path(job), _MAX_RUN_FILE_BYTES))
        except (OSError, ValueError, RecursionError):
            return None
        fits = isinstance(document, dict) and document.get("key") == job.key and isinstance(document.get("measures"), dict)
        if not fits or document.pop("hash", None) not in (None, _hash_document(document)):
            return None
        measures: dict[str, Any] = document["measures"]
        return measures

    def count_other_runs(self, jobs: Iterable[SweepJob]) -> int:
        """Return how many finished runs in the folder belong to none of these jobs."""
        return len({path.stem for path in self.runs.glob("*.json")} - {job.key for job in jobs})

    def write_measures(self, job: SweepJob, measures: Mapping[str, Any]) -> None:
        """Write the measures of a finished run to its file, atomically."""
        document = describe_job(job) | {"key": job.key, "antdsl": __version__, "measures": measures}
        document["hash"] = _hash_document(document)
        write_atomically(self.get_run_path(job), (json.dumps(document, indent=1) + "\n").encode(), sync=False)


def _hash_document(document: Mapping[str, Any]) -> str:
    content = {name: value for name, value in document.items() if name != "hash"}
    return sha256(json.dumps(content, sort_keys=True).encode()).hexdigest()[:32]


def describe_job(job: SweepJob) -> dict[str, Any]:
    """Return a description of a run, as plain values by name."""
    return {"label": job.label, "scene": Path(job.scene).name, "set": dict(job.params), "seed": job.seed}
