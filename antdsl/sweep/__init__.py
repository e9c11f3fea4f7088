"""Many runs of scenes: values and seeds to vary in, one table out. Runs go to processes of their own; the finished ones stay."""

from antdsl.sweep.finished_runs import Keeper
from antdsl.sweep.jobs import Job, Variation, jobs, variations
from antdsl.sweep.table import Row, rows
from antdsl.sweep.workers import Outcome, run_all

__all__ = ["Job", "Keeper", "Outcome", "Row", "Variation", "jobs", "rows", "run_all", "variations"]
