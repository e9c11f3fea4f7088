"""Specs: tests of programs' behaviour. They are run without a display and judged frame by frame, and the results are reported.

`cases` combines specs with scenes and seeds and decides which specs hold. `running` simulates each combination once for all its
specs. `judge` evaluates every frame with the evaluator of `measures`. `text_report` and `reports` format the results. `golden`
compares runs with recorded ones."""

from antdsl.specs.cases import SpecCase, SpecFailure, SpecRun, collect_cases
from antdsl.specs.running import RunContext, run_cases

__all__ = ["RunContext", "SpecCase", "SpecFailure", "SpecRun", "collect_cases", "run_cases"]
