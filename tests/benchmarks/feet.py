"""The tables of docs/feet.md: how still feet stand and how near to the ground, and what they cost.

`python tests/benchmarks/feet.py` measures stick bodies on five grounds; `--cost` 15,000 ants of six legs in the foraging example,
as CPU time of one thread in one run, feet beside the rest of the step."""

from __future__ import annotations

import argparse
import sys
import tempfile
from copy import deepcopy
from dataclasses import replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import stick_bodies

from antdsl.bodies.agents.leg_chains import build_legs_data
from antdsl.bodies.files.reading import read_definition
from antdsl.runtime import Options, bind, step
from antdsl.runtime.feet.feet_state import NO_GROUND_NUMBER

GROUNDS = (
    ("flat", 6, 24.0), ("hill", 6, 24.0), ("overhang", 6, 24.0), ("can", 6, 24.0), ("tunnel", 6, 24.0),
    ("hill", 8, 14.0), ("hill", 4, 12.0), ("hill", 2, 8.0),
)  # fmt: skip
FRAMES, BODIES = 120, 40


def row(ground: str, legs: int, speed: float) -> str:
    with tempfile.TemporaryDirectory() as folder:
        shot = stick_bodies.opened(stick_bodies.write_scene(Path(folder), legs, ground, speed=speed, count=BODIES))
    world = bind(shot.plan, shot.setting, Options(backend="numpy", feet=True))
    leg = float(world.legs_by_species["walker"].legs.length.min()) * stick_bodies.SIZE
    slid = off = cycles = 0.0
    standing = hung = far = lifted = 0
    for _ in range(FRAMES):
        previous_feet = deepcopy(world.feet["walker"])
        step(world)
        feet = world.feet["walker"]
        both, moved = previous_feet.is_standing & feet.is_standing, feet.shown - previous_feet.shown
        slid = max(slid, float(np.sqrt((moved * moved).sum(axis=0))[both].max(initial=0)))
        away = world.ground.find_nearest(np.ascontiguousarray(feet.shown[:, feet.is_standing].T))[1]
        off, far = max(off, float(away.max())), far + int((away > 1e-3 * leg).sum())
        standing, hung = (
            standing + int(feet.is_standing.sum()),
            hung + int(((feet.on == NO_GROUND_NUMBER) & (feet.swing >= 1)).sum()),
        )
        lifted += int((previous_feet.is_standing & ~feet.is_standing).sum())
        turned = ((feet.phase - previous_feet.phase) % 1.0)[~previous_feet.is_standing.all(axis=1)]
        cycles = max(cycles, float(turned.max(initial=0)))
    share = 100 * hung / (standing + hung)
    cells = (ground, legs, f"{standing:,}", f"{lifted:,}", f"{slid / leg:.0e}", f"{off / leg:.0e}", far, f"{share:.2f} %")
    return f"| {' | '.join(map(str, cells))} | {cycles:.2f} |"


def cost(count: int) -> str:
    import foraging_shots

    with tempfile.TemporaryDirectory() as folder:
        body, _ = read_definition(stick_bodies.write_body(Path(folder), 6))
    assert body is not None
    setting = foraging_shots.setting(count=count, radius=70 * (count / 500) ** 0.5)
    setting = replace(setting, legs={"forager": build_legs_data(body)}, contacts="off")
    world = bind(foraging_shots.shot().plan, setting, Options(backend="numpy", feet=True))
    for _ in range(12):
        step(world)
    world.cpu_seconds.clear()
    for _ in range(12):
        step(world)
    feet = world.cpu_seconds["feet"] + world.cpu_seconds["strides"]
    rest = sum(world.cpu_seconds.values()) - feet
    return (
        f"{count:,} ants: feet {feet / 12 * 1e3:.0f} ms, the rest of the step {rest / 12 * 1e3:.0f} ms, ratio {feet / rest:.1f}"
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--cost", type=int, nargs="?", const=15_000, default=0, help="ants of which the cost is measured")
    options = parser.parse_args()
    if options.cost:
        print(cost(options.cost))
        return
    print(
        "| ground | legs | feet that stand | lifts | moved, of a leg | off the surface, of a leg | float or sink | hang |", end=""
    )
    print(" cycles a frame |")
    print("|---|---|---|---|---|---|---|---|---|")
    for each in GROUNDS:
        print(row(*each), flush=True)


if __name__ == "__main__":
    main()
