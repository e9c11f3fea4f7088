"""From a saved edit to the first frame of the new program: what is compiled, what is taken over and one step, in milliseconds.

`python tests/benchmarks/reload.py` prints the median over edits of a copy of 15,000 foraging ants; `--edits` says how many."""

from __future__ import annotations

import argparse
import shutil
import statistics
import sys
import tempfile
from pathlib import Path
from time import perf_counter, process_time

from antdsl.preview import Session

FORAGING = Path(__file__).resolve().parents[2] / "examples" / "foraging"
EDITS = (
    ("30 mm/s", "36 mm/s"),
    ("when scent > faint ", "when scent > 2 * faint "),
    ("wander(swing: swing)", "wander(swing: 0.9 * swing)"),
    ("state set_out", "state turn"),
    ("zeal   = uniform(0.5, 1.5)", "zeal   = uniform(0.6, 1.6)\n  weight = 3 mg"),
    ("separate(radius: 1.2 * size", "separate(radius: 1.4 * size"),
)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--edits", type=int, default=24)
    parser.add_argument("--scene", default="many.yaml")
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        place = Path(folder, "foraging")
        shutil.copytree(FORAGING, place)
        session, report = Session.open(place / asked.scene)
        if session is None:
            sys.exit("\n".join(d.message for d in report.errors))
        program = place / "forager.ant"
        text = program.read_text()
        for _ in range(3):
            session.step()
        session.reload()
        wall, busy = [], []
        for number in range(asked.edits):
            old, new = EDITS[number // 2 % len(EDITS)]
            edited = text.replace(old, new).replace("-> set_out", "-> turn") if new == "state turn" else text.replace(old, new)
            program.write_text(text if number % 2 else edited)
            started, used = perf_counter(), process_time()
            outcome = session.reload()
            session.step()
            wall.append(1000 * (perf_counter() - started))
            busy.append(1000 * (process_time() - used))
            if not outcome.ok or outcome.line == "nothing has changed":
                sys.exit(f"the edit to `{new}` was not taken: {[d.message for d in outcome.report.errors]}")
            session.step()
    print("| agents | edits | median, ms | worst, ms | of it at work, median, ms |")
    print("|---|---|---|---|---|")
    print(
        f"| {len(session.world):,} | {len(wall)} | {statistics.median(wall):.0f} | {max(wall):.0f} | "
        f"{statistics.median(busy):.0f} |"
    )


if __name__ == "__main__":
    main()
