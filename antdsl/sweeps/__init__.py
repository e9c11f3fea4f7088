"""Sweeps: many runs of scenes with varied values and seeds, with one table of results.

Other processes simulate the runs (`executors`). The results of finished runs are stored."""

from antdsl.sweeps.finished_runs import FinishedRunStore
from antdsl.sweeps.jobs import SceneVariation, SweepJob, build_jobs, make_variations
from antdsl.sweeps.measuring import JobOutcome, run_jobs
from antdsl.sweeps.stopping import SweepJobChooser
from antdsl.sweeps.table import MeasureStatistics, build_rows

__all__ = [
    "FinishedRunStore",
    "JobOutcome",
    "MeasureStatistics",
    "SceneVariation",
    "SweepJob",
    "SweepJobChooser",
    "build_jobs",
    "build_rows",
    "make_variations",
    "run_jobs",
]
