"""What a run must show: the specs of programs run headless, judged frame by frame, and told to people and build servers.

`cases` says which specs run on which scenes and seeds; `running` simulates each combination once for all its specs and has
`judge` look at every frame: `queries` asks agents and items, `aggregates` the wholes. `cases` decides what holds, too;
`text_report` and `reports` say it. `golden` holds runs against recorded ones."""

from antdsl.specs.cases import Case, Failure, Run, collect_cases
from antdsl.specs.running import Work, run_cases

__all__ = ["Case", "Failure", "Run", "Work", "collect_cases", "run_cases"]
