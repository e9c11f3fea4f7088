"""Many runs of scenes with varied values and seeds, and one resulting table. Runs are executed by other processes (`executors`).
Finished runs are stored."""

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
