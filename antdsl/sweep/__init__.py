"""Many runs of scenes with varied values and seeds, and one resulting table. Runs are executed by other processes (`executors`).
Finished runs are stored."""

from antdsl.sweep.finished_runs import RunStore
from antdsl.sweep.jobs import Job, Variation, jobs, make_variations
from antdsl.sweep.measuring import Outcome, run_all
from antdsl.sweep.stopping import JobChooser
from antdsl.sweep.table import Row, rows

__all__ = ["Job", "JobChooser", "Outcome", "Row", "RunStore", "Variation", "jobs", "make_variations", "rows", "run_all"]
