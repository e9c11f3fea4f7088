"""Measurements of steps: how long they take, which operations they consist of, and ratios between backends.

`cases` names the measured cases, and `scaling` builds a scene of a case with a given number of agents. `measuring` runs the
set-up and steps of a case in this process: several backends and the hand-written bound in turn. `processes` does so in a separate
process, which shares its memory and start-up with nothing else. `ratios` holds the statistics, `counting` the exact counts,
`tables` the texts for a page. Nothing here changes a result."""

from antdsl.bench.cases import CASES, Case
from antdsl.bench.costs import Cost, Job, Measured, measured
from antdsl.bench.ratios import Ratio, in_turn, interval

__all__ = ["CASES", "Case", "Cost", "Job", "Measured", "Ratio", "in_turn", "interval", "measured"]
