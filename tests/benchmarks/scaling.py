"""What a step of foraging ants costs by phase as the crowd grows, and the terms of `docs/scaling.md`.

`python tests/benchmarks/scaling.py` makes so many steps of each crowd, contacts off, one thread, in a separate process,
`--turns` times in turn, and prints the three tables of the page; with `--write` it puts them there. The million takes 3 GiB.
Terms: CPU ms = fixed + root * sqrt(agents) / 1000 + each * agents / 1,000,000 of each phase, none below 0, by least squares of
shares of a step (C. L. Lawson, R. J. Hanson, Solving Least Squares Problems, 1974, as SciPy has it) over all crowds but those
of `TEST_SIZES`."""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path
from statistics import fmean, median

from page_tables import markdown_table

PAGE = Path(__file__).resolve().parents[2] / "docs" / "scaling.md"
SIZES = (1_000, 4_000, 15_000, 40_000, 100_000, 250_000, 1_000_000)
TEST_SIZES = (40_000, 250_000)  # which the terms are held against
TABLE_SIZES = tuple(size for size in SIZES if size != 250_000)
PHASES = ("sense", "decide", "act", "blend", "move", "motion", "commit")
REST = "all else"
WARM, SECONDS, FEWEST, MOST = 11, 3.0, 5, 80  # steps before, and those that are measured


def of_one(agents: int) -> dict[str, float]:
    """Median CPU ms of a step of a crowd, by phase and `step`."""
    from antdsl.bench.cases import find_case
    from antdsl.bench.measuring import wait_for_code
    from antdsl.runtime import Options, bind, step

    shot = find_case("foraging").make_shot(agents)
    world = bind(shot.plan, shot.setting, Options(backend="native", threads=1))
    for _ in range(WARM - 2):
        step(world)
    wait_for_code(world)
    step(world)
    step(world)
    began, steps = time.process_time(), []
    while len(steps) < FEWEST or (time.process_time() - began < SECONDS and len(steps) < MOST):
        world.cpu_seconds.clear()
        start_time = time.process_time()
        step(world)
        total = (time.process_time() - start_time) * 1e3
        spent = {name: world.cpu_seconds.get(name, 0.0) * 1e3 for name in PHASES}
        steps.append({**spent, REST: total - sum(spent.values()), "step": total})
    return {name: median(each[name] for each in steps) for name in steps[0]}


def terms(costs_by_size: dict[int, dict[str, float]]) -> dict[str, tuple[float, float, float]]:
    """`fixed` (ms), `root` (µs) and `each` (ns) of all phases."""
    import numpy as np
    from scipy.optimize import nnls

    sizes = [size for size in costs_by_size if size not in TEST_SIZES]
    share = np.array([1 / costs_by_size[size]["step"] for size in sizes])
    basis = np.array([[1.0, size**0.5 / 1e3, size / 1e6] for size in sizes]) * share[:, None]
    fitted = {}
    for name in (*PHASES, REST):
        fixed, root, each = nnls(basis, np.array([costs_by_size[size][name] for size in sizes]) * share)[0]
        fitted[name] = (round(float(fixed), 2), round(float(root), 1), round(float(each), 1))
    return fitted


def predicted(fitted: dict[str, tuple[float, float, float]], agents: int) -> float:
    """CPU ms of a step."""
    return sum(fixed + root * agents**0.5 / 1e3 + each * agents / 1e6 for fixed, root, each in fitted.values())


def tables(costs_by_size: dict[int, dict[str, float]]) -> dict[str, str]:
    """The tables of the page by their marks."""
    fitted = terms(costs_by_size)
    by_phase = [[name, *(f"{costs_by_size[size][name]:#.3g}".rstrip(".") for size in TABLE_SIZES)] for name in (*PHASES, REST)]
    of_terms = [[name, *(f"{each:g}" for each in fitted[name])] for name in fitted]
    model = []
    for size, spent in costs_by_size.items():
        step, said = round(spent["step"], 2), round(predicted(fitted, size), 2)  # as they are shown
        model.append([f"{size:,}", f"{said:.2f}", f"{step:.2f}", f"{said / step:.2f}"])
    return {
        "phases": markdown_table(("phase", *(f"{size:,}" for size in TABLE_SIZES)), by_phase),
        "terms": markdown_table(("phase", "fixed, ms", "root, µs", "each, ns"), of_terms),
        "model": markdown_table(("agents", "predicted, ms", "measured, ms", "predicted / measured"), model),
    }


def main(arguments: Sequence[str] | None = None) -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--turns", type=int, default=2)
    parser.add_argument("--write", action="store_true", help="put the tables into the page")
    parser.add_argument("--one", type=int, help=argparse.SUPPRESS)
    options = parser.parse_args(arguments)
    if options.one:
        print(json.dumps(of_one(options.one)))
        return
    turns: dict[int, list[dict[str, float]]] = {size: [] for size in SIZES}
    for _ in range(options.turns):
        for size in SIZES:
            process = subprocess.run([sys.executable, __file__, "--one", str(size)], check=True, capture_output=True, text=True)
            turns[size].append(json.loads(process.stdout))
    costs_by_size = {
        size: {name: fmean(each[name] for each in size_turns) for name in size_turns[0]} for size, size_turns in turns.items()
    }
    for mark, table in tables(costs_by_size).items():
        print(table)
        if options.write:
            text = PAGE.read_text(encoding="utf-8")
            head, begin, rest = text.partition(f"<!-- {mark} -->\n")
            _, end, tail = rest.partition(f"<!-- end of {mark} -->")
            PAGE.write_text(f"{head}{begin}\n{table}\n{end}{tail}", encoding="utf-8")


if __name__ == "__main__":
    main()
