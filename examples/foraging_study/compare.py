"""Prints what a sweep of this study found beside what the thesis says: `python …/compare.py SWEEP/sweep.json`.

Medians over seeds; what was not finished counts as later than everything."""

from __future__ import annotations

import json
import math
import sys
from pathlib import Path

APPLE, DONUT = "empty.food.apple.load", "empty.food.donut.load"
LAST = 5000
PUBLISHED = {  # frames at which apple and donut were finished; None: not told, infinite: not by the last frame
    "default": (1121, 3261),
    "reward_0": (None, math.inf),
    "no_decay": (None, math.inf),
    "reward_50": (None, 3831),
    "ants_100": (None, math.inf),
    "fields": (None, 2571),
    "separation_first": (1491, None),
}
OURS = ("nearest_source",)  # not of the thesis
RATIOS = (  # what is divided by the same of the default run
    ("fields", DONUT, 2571 / 3261),
    ("reward_50", DONUT, 3831 / 3261),
    ("separation_first", APPLE, 1491 / 1121),
)


def medians(path: Path) -> dict[tuple[str, str], float]:
    """The median of each run of the study and measure; infinite where more than half never got there."""
    table = json.loads(path.read_text(encoding="utf-8"))["table"]
    wanted = [row for row in table if row["measure"] in (APPLE, DONUT)]
    return {(row["label"], row["measure"]): math.inf if row["median"] is None else row["median"] for row in wanted}


def by_seed(path: Path, label: str, measure: str) -> dict[int, float]:
    """The frame for each seed."""
    runs = [run for run in json.loads(path.read_text(encoding="utf-8"))["runs"] if run["label"] == label]
    return {run["seed"]: math.inf if (v := run["measures"].get(measure)) is None else v for run in runs}


def relations(found: dict[tuple[str, str], float]) -> list[tuple[str, bool]]:
    """What the thesis says about orders, and whether the medians say so too."""
    donut = {label: found[label, DONUT] for label in PUBLISHED if (label, DONUT) in found}
    apple = {label: found[label, APPLE] for label in PUBLISHED if (label, APPLE) in found}
    return [
        ("donut: fields < default", donut["fields"] < donut["default"]),
        ("donut: default < reward 50", donut["default"] < donut["reward_50"]),
        ("donut: reward 50 finished", donut["reward_50"] <= LAST),
        ("apple: default < separation first", apple["default"] < apple["separation_first"]),
        ("donut: reward 0 not finished", donut["reward_0"] > LAST),
        ("donut: no decay not finished", donut["no_decay"] > LAST),
        ("donut: 100 ants not finished", donut["ants_100"] > LAST),
        ("apple: 100 ants finished", apple["ants_100"] <= LAST),
    ]


def shown(frame: float | None) -> str:
    return "–" if frame is None else "not finished" if math.isinf(frame) else f"{frame:.0f}"


def main(path: Path) -> int:
    """Print the tables; 1 when a relation does not hold."""
    found = medians(path)
    print(f"{'':18}{'apple':>14}{'published':>14}{'donut':>14}{'published':>14}")
    for label in (*PUBLISHED, *OURS):
        here = [shown(found.get((label, measure))) for measure in (APPLE, DONUT)]
        apple, donut = (shown(frame) for frame in PUBLISHED.get(label, (None, None)))
        print(f"{label:18}{here[0]:>14}{apple:>14}{here[1]:>14}{donut:>14}")
    print(f"\n{'divided by default':34}{'here':>8}{'published':>11}{'seeds that agree':>18}")
    for label, measure, published in RATIOS:
        ratio = found[label, measure] / found["default", measure]
        mine, base = by_seed(path, label, measure), by_seed(path, "default", measure)
        both = sorted(set(mine) & set(base))
        agree = sum((mine[seed] < base[seed]) == (published < 1) for seed in both)
        name = f"{label}, {measure.split('.')[2]}"
        print(f"{name:34}{ratio:8.3f}{published:11.3f}{f'{agree} of {len(both)}':>18}")
    print()
    holding = relations(found)
    for words, holds in holding:
        print(f"{'holds' if holds else 'FAILS':7}{words}")
    return 0 if all(holds for _, holds in holding) else 1


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1])))
