"""Runs the specs of programs without a display, judges them frame by frame, and reports the results to people and build servers.

`cases` combines specs with scenes and seeds and decides which specs hold. `running` simulates each combination once for all its
specs. `judge` evaluates every frame with the evaluator of `measures`. `text_report` and `reports` write the results. `golden`
compares runs with recorded ones."""

from antdsl.specs.cases import SpecCase, SpecFailure, SpecRun, collect_cases
from antdsl.specs.running import RunContext, run_cases

__all__ = ["RunContext", "SpecCase", "SpecFailure", "SpecRun", "collect_cases", "run_cases"]
