"""Many runs of scenes with varied values and seeds, and one resulting table. Runs are executed by other processes (`executors`).
Finished runs are stored."""

from antdsl.sweeps.finished_runs import RunStore
from antdsl.sweeps.jobs import SweepJob, Variation, build_jobs, make_variations
from antdsl.sweeps.measuring import JobOutcome, run_jobs
from antdsl.sweeps.stopping import JobChooser
from antdsl.sweeps.table import Row, build_rows

__all__ = [
    "JobChooser",
    "JobOutcome",
    "Row",
    "RunStore",
    "SweepJob",
    "Variation",
    "build_jobs",
    "build_rows",
    "make_variations",
    "run_jobs",
]
