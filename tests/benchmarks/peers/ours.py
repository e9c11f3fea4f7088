"""A case of `antdsl bench` on one thread: `ours.py CASE BACKEND AGENTS STEPS`. A case with counted neighbours starts again
for each turn, as the other programs do; any other case continues."""

from __future__ import annotations

import json
import sys
import warnings
from time import process_time

from antdsl.bench.cases import BENCH_CASES
from antdsl.bench.measuring import WARM_UP_STEPS, count_mean_neighbours, wait_for_code
from antdsl.runtime import Options, World, bind, step


def main() -> None:
    """Take a turn for each line of the standard input."""
    warnings.simplefilter("ignore")
    name, backend, agents, steps = sys.argv[1], sys.argv[2], int(sys.argv[3]), int(sys.argv[4])
    case = BENCH_CASES[name]
    shot = case.make(agents)
    world: World | None = None
    for _ in sys.stdin:
        if world is None or case.sight_radius_mm:
            world = bind(shot.plan, shot.setting, Options(backend=backend, threads=1))
            step(world)
            wait_for_code(world)
            for _ in range(WARM_UP_STEPS):
                step(world)
        start = process_time()
        for _ in range(steps):
            step(world)
        spent = (process_time() - start) / steps
        print(
            json.dumps(
                {
                    "step": spent,
                    "neighbours": count_mean_neighbours(world, case.sight_radius_mm) if case.sight_radius_mm else None,
                }
            ),
            flush=True,
        )


if __name__ == "__main__":
    main()
