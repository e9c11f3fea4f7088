"""What it costs to measure steps, and how much of their time is reported for lines and layers.

`python tests/benchmarks/profiler.py` steps through 15,000 foraging ants twice in turns, once measured, and compares the bits."""

from __future__ import annotations

import argparse
import statistics
import sys
from pathlib import Path
from time import process_time

from antdsl.pipeline import open_scene
from antdsl.runtime import Options, bind, state_hash, step
from antdsl.runtime.profiling import StepMeter

FORAGING = Path(__file__).resolve().parents[2] / "examples" / "foraging"
BLOCKS = ("decide", "act", "blend", "births")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=60)
    parser.add_argument("--scene", type=Path, default=FORAGING / "many.yaml")
    arguments = parser.parse_args()
    shot, report = open_scene(arguments.scene)
    if shot is None:
        sys.exit("\n".join(d.message for d in report.errors))
    print("| threads | a step, ms of work | measured | of it | lines, of their phases | layers, of `blend` |")
    print("|---|---|---|---|---|---|")
    for threads in (1, 2):
        options = Options(threads=threads, wait_for_code=True)
        plain, watched = (bind(shot.plan, shot.setting, options) for _ in range(2))
        meter, alone, measured = StepMeter(None), [], []
        for number in range(arguments.steps + 8):
            began = process_time()
            step(plain)
            turn = process_time()
            if number == 8:  # kernels are loaded, and code is made
                meter = StepMeter(None)
            meter.begin_measuring(watched)
            step(watched)
            meter.record_steps(watched)
            if number >= 8:
                alone.append(1000 * (turn - began))
                measured.append(1000 * (process_time() - turn))
        if state_hash(plain) != state_hash(watched):
            sys.exit("a run that was measured is another one")
        profile = meter.profile()
        lines = sum(line.ms for line in profile.lines) / sum(profile.phases[name] for name in BLOCKS)
        layers = sum(layer.ms for layer in profile.layers) / profile.phases["blend"]
        one, other = statistics.median(alone), statistics.median(measured)
        print(f"| {threads} | {one:.1f} | {other:.1f} | {other / one:.3f} | {lines:.2f} | {layers:.2f} |")


if __name__ == "__main__":
    main()
