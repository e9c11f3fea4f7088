"""Walking over triangles beside sticking by two rays a step, on the same crowds: time, surface error, who is lost.

`python tests/benchmarks/sticking.py` prints the table of docs/scene.md; `--agents` and `--steps` change how long it takes."""

from __future__ import annotations

import argparse
import statistics
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from torture_long import SHAPES, Walked, long_walk  # lies beside the tests

SCENES = ("ground", "torus", "plate", "can")


def row(name: str, how: str, walked: Walked) -> str:
    """One line of the table, in Markdown."""
    milliseconds = 1000 * statistics.median(walked.seconds)
    return (
        f"| {name} | {how} | {milliseconds:.1f} | {walked.measures.away:.1e} | {walked.missed} | {walked.through} | "
        f"{walked.measures.jump:.2f} |"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--agents", type=int, default=5000)
    parser.add_argument("--steps", type=int, default=500)
    options = parser.parse_args()
    print("| shape | `stick` | ms a step | surface error, bodies | met no surface | through a wall | longest step, mm |")
    print("|---|---|---|---|---|---|---|")
    for name in SCENES:
        for how in ("triangles", "rays"):
            mesh = SHAPES.SHAPES[name]()
            long_walk(name, mesh, 10, 2, how == "rays")  # whatever is compiled is compiled now
            print(row(name, how, long_walk(name, mesh, options.agents, options.steps, how == "rays")), flush=True)


if __name__ == "__main__":
    main()
