"""What a step of some cases is made of, counted exactly, compared with the budgets in `counts.json`.

`python tests/benchmarks/counts.py` prints what differs and exits with 1 if a count is more than 1.1 times the recorded one, so
that splitting a module breaks nothing. `--record` records the counts again: say why in the commit. `--print` prints them.
Compiled kernels are turned off. Without a compiler the native backend is left out, and nothing can be recorded."""

from __future__ import annotations

import argparse
import json
from collections.abc import Mapping, Sequence
from pathlib import Path

RECORDED = Path(__file__).with_suffix(".json")
COUNTED = (
    ("foraging", 500),
    ("boids", 500),
    ("cluster", 500),
    ("node", 500),
    ("moods", 200),
    ("flocking", 400),
    ("tunnel", None),
)
Counts = dict[str, dict[str, int]]
BUDGET = 1.1  # of the recorded count


def counted(cases: Sequence[str] = ()) -> Counts:
    """Counts by case, of all without any, in this process."""
    from antdsl.bench.cases import case_of
    from antdsl.bench.counting import counts_of
    from antdsl.machine_code import machine
    from antdsl.runtime.backends import BACKENDS

    left_out = {"reference"}  # its speed does not matter
    if not machine.is_available():
        left_out.add("native")  # which would run what NumPy runs
    counts_by_case = {}
    for name, agents in ((name, agents) for name, agents in COUNTED if not cases or name in cases):
        shot = case_of(name).make(agents)
        for backend in BACKENDS:
            if backend not in left_out:
                counts_by_case[f"{name} {agents or ''} {backend}".replace("  ", " ")] = counts_of(
                    shot.plan, shot.setting, backend
                )
    return counts_by_case


def grown(counts_by_case: Mapping[str, Mapping[str, int]], recorded: Mapping[str, Mapping[str, int]]) -> list[str]:
    """Lines about counts that exceed their budget, or are not recorded."""
    lines = []
    for case, counts in counts_by_case.items():
        for name, number in counts.items():
            recorded_number = recorded.get(case, {}).get(name)
            if recorded_number is None:
                lines.append(f"{case}: {name} is {number:,} and not recorded")
            elif number > BUDGET * recorded_number:
                lines.append(
                    f"{case}: {name} is {number:,}, {number / max(recorded_number, 1):.3f} times the {recorded_number:,} recorded"
                )
    return lines


def main() -> None:
    """Compare, print or record."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("cases", nargs="*", help="names of cases; all without any")
    parser.add_argument("--record", action="store_true")
    parser.add_argument("--print", action="store_true")
    options = parser.parse_args()
    if options.record and options.cases:
        parser.error("--record takes all cases")
    if options.record:
        from antdsl.machine_code import machine

        if why := machine.unavailable():
            raise SystemExit(f"--record takes all backends: {why}")
    counts_by_case = counted(options.cases)
    if options.print or options.record:
        text = json.dumps(counts_by_case, indent=2, sort_keys=True) + "\n"
        print(text, end="") if options.print else RECORDED.write_text(text, encoding="utf-8")
        return
    recorded = json.loads(RECORDED.read_text(encoding="utf-8"))
    for case, counts in counts_by_case.items():
        for name, number in counts.items():
            if number < (recorded_number := recorded.get(case, {}).get(name, 0)):
                print(f"{case}: {name} is {number:,}, less than the {recorded_number:,} recorded")
    if lines := grown(counts_by_case, recorded):
        raise SystemExit("\n".join([*lines, "where that is meant: python tests/benchmarks/counts.py --record"]))


if __name__ == "__main__":
    main()
