"""Prints the shares on the short arm that a sweep of this example found: `python …/study.py SWEEP/sweep.json`.

A share is that of those who pass the gate of arm 1 among all who pass either gate, in the last quarter of a run."""

from __future__ import annotations

import json
import statistics
import sys
from pathlib import Path

SHORT, LONG = "left.gates.short.passed", "left.gates.long.passed"


def shares(path: Path) -> dict[str, dict[int, float]]:
    """By scene and seed; runs in which nobody passed are left out."""
    found: dict[str, dict[int, float]] = {}
    for run in json.loads(path.read_text(encoding="utf-8"))["runs"]:
        short, long = run["measures"][SHORT], run["measures"][LONG]
        if short + long > 0:
            found.setdefault(run["label"], {})[run["seed"]] = short / (short + long)
    return found


def main(path: Path) -> int:
    """Print a line for each scene."""
    print(f"{'':12}{'median':>8}{'least':>8}{'most':>8}{'above 2/3':>12}{'below 1/3':>12}")
    for label, by_seed in shares(path).items():
        found = list(by_seed.values())
        above, below = (f"{sum(which(s) for s in found)} of {len(found)}" for which in (lambda s: s > 2 / 3, lambda s: s < 1 / 3))
        print(f"{label:12}{statistics.median(found):8.3f}{min(found):8.3f}{max(found):8.3f}{above:>12}{below:>12}")
        print(" " * 12 + " ".join(f"{by_seed[seed]:.2f}" for seed in sorted(by_seed)))
    return 0


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1])))
