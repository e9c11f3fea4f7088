"""Many runs of scenes: values and seeds to vary in, one table out. Runs go to other processes (`executors`); the finished ones
stay."""

from antdsl.sweep.finished_runs import Keeper
from antdsl.sweep.jobs import Job, Variation, jobs, variations
from antdsl.sweep.running import Outcome, run_all
from antdsl.sweep.stopping import Chooser
from antdsl.sweep.table import Row, rows

__all__ = ["Chooser", "Job", "Keeper", "Outcome", "Row", "Variation", "jobs", "rows", "run_all", "variations"]
