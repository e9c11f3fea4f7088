"""What a run must show: the specs of programs run headless, judged frame by frame, and told to people and build servers."""

from antdsl.specs.cases import Case, Failure, Run, cases
from antdsl.specs.running import Work, run_cases

__all__ = ["Case", "Failure", "Run", "Work", "cases", "run_cases"]
