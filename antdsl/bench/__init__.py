"""How long steps take, what they are made of, and how that compares: cases in, costs and ratios out.

`cases` names what is measured and `scaling` makes a scene of it with so many agents. `measuring` takes a case through set-up and
steps in this process, several backends and the bound written by hand in turn; `processes` does so in a process of its own, where
memory and start-up are nobody else's. `ratios` holds the statistics, `counting` what can be counted exactly, `tables` the words
for a page. Nothing here changes a result."""

from antdsl.bench.cases import CASES, Case
from antdsl.bench.costs import Cost, Job, Measured, measured
from antdsl.bench.ratios import Ratio, in_turn, interval

__all__ = ["CASES", "Case", "Cost", "Job", "Measured", "Ratio", "in_turn", "interval", "measured"]
