"""Measurements of steps: how long they take, which operations they consist of, and ratios between backends.

`cases` names the measured cases, and `scaling` builds a scene of a case with a given number of agents. `measuring` runs the
set-up and steps of a case in this process: several backends and the hand-written bound in turn. `processes` does so in a separate
process, which shares its memory and start-up with nothing else. `ratios` holds the statistics, `counting` the exact counts,
`tables` the texts for a page. Nothing here changes a result."""

from antdsl.bench.cases import CASES, Case
from antdsl.bench.costs import Cost, Job, Measurement, measure_in_process
from antdsl.bench.ratios import Ratio, bootstrap_interval, measure_in_turn

__all__ = ["CASES", "Case", "Cost", "Job", "Measurement", "Ratio", "bootstrap_interval", "measure_in_process", "measure_in_turn"]
