"""People who walk by `compute_clear_velocity` across a circle and head on in a corridor: until when all are there, and how near
two come.

`python tests/benchmarks/crossing.py circle 1000 400` has 1,000 on a circle go to its other side, for 400 s at most;
`corridor 200 120 --wide 5` has 200 in two flows in a corridor 5 m wide. Radius 0.2 m, 1.4 m/s, 24 steps a second."""

from __future__ import annotations

import argparse
import time
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from antdsl import passes, plan
from antdsl.program import check
from antdsl.runtime import CrowdData, MeshData, Options, PlacementData, World, WorldSetting, bind, step
from antdsl.source import Source
from antdsl.syntax import parse

Floats = NDArray[np.float64]

FPS = 24
SPACING = 700.0  # mm on the circle for each
STILL = 0.05  # of the greatest speed, as a mean over the last seconds: who is slower and not there is stuck
WITHIN, LATE = 500.0, 5 * FPS  # mm from a goal; steps

PERSON = """ant 1
{world}species person {{
  size      400 mm
  max_speed 1400 mm/s
  response  0.1 s
  goal = vector(0 mm, 0 mm, 0 mm)
  start go
  on spawn {{ goal = {goal} }}
  state go {{
    let off = {off}
    let way = rotate(unit(off), about: up, by: normal(0 deg, 1 deg)) * min(length(off) / 1 m, 1)
    steer match(clear_velocity(way * max_speed, within: {within:g} m, horizon: 2 s))
    {ends}
  }}
}}
"""


@dataclass(frozen=True, slots=True)
class Crossed:
    """`seconds` until all were there (inf: not all), the least distance of two at the end of any step (`nearest`, mm), how many
    are `left` at the end, and how many of them hardly moved over the last seconds (`stuck`); CPU milliseconds of a step."""

    seconds: float
    nearest: float
    stuck: int
    left: int
    cost: float


def world_of(text: str, positions: Floats, surface: tuple[Floats, NDArray[np.int32]] | None = None) -> World:
    file, report = parse(Source("crossing.ant", text))
    program, check_report = check([file], lambda name: None)
    assert report.ok and check_report.ok, [each.message for each in (*report.sort_by_place(), *check_report.sort_by_place())]
    crowd = CrowdData("person", len(positions), PlacementData(points=positions))
    surfaces = {} if surface is None else {"floor": MeshData(*surface)}
    setting = WorldSetting(crowds=(crowd,), surfaces=surfaces, fps=FPS)  # type: ignore[arg-type]
    return bind(passes.optimise_plan(plan.lower(program)[0]), setting, Options(threads=1))


def circle(agents: int, seconds: float, within: float = 6.0) -> Crossed:
    """All on a circle, with 0.7 m for each, go to its other side; they look `within` so many metres."""
    text = PERSON.format(within=within, world="", goal="-position", off="goal - position", ends="")
    angle, radius = 2 * np.pi * np.arange(agents) / agents, max(agents * SPACING / (2 * np.pi), 4000.0)
    positions = np.stack([radius * np.cos(angle), np.zeros(agents), radius * np.sin(angle)], axis=1)
    return crossed(world_of(text, positions), -positions, seconds)


def corridor(agents: int, seconds: float, wide: float, long: float = 24_000.0) -> Crossed:
    """Half of them from either end of a corridor (mm), in rows, to the other end, where they are gone. Its borders stop feet,
    so bodies may lean over them by half of their width."""
    text = PERSON.format(
        within=6.0,
        world="world { surface floor }\n",
        goal="vector(if dot(position, vector(1, 0, 0)) < 0 mm then 1 mm else -1 mm, 0 mm, 0 mm)",
        off="goal * 10000",
        ends=f"when dot(position, unit(goal)) > {long / 2:g} mm -> go {{ die }}",
    )
    half, row = agents // 2, max(int(wide // SPACING), 1)
    k = np.arange(half)
    across = (k % row - (row - 1) / 2) * SPACING
    back = long / 2 + (k // row) * SPACING
    one = np.stack([-back, np.zeros(half), across], axis=1)
    positions = np.concatenate([one, one * [-1, 1, -1] + [0, 0, 0.11 * SPACING]])
    end = float(back.max()) + SPACING
    line, side = np.linspace(-end, end, 2 * int(end // 2000) + 2), np.array([-wide / 2, wide / 2])
    vertices = np.stack([np.repeat(line, 2), np.zeros(2 * len(line)), np.tile(side, len(line))], axis=1)
    a = 2 * np.arange(len(line) - 1)
    faces = np.concatenate([np.stack([a, a + 1, a + 3], axis=1), np.stack([a, a + 3, a + 2], axis=1)]).astype(np.int32)
    return crossed(world_of(text, positions, (vertices, faces)), None, seconds)


def crossed(world: World, goal: Floats | None, seconds: float) -> Crossed:
    """Run until all are within half a metre of a goal, in order of ids, or, with none, until all are gone."""
    people, nearest, start_time = world.populations["person"], np.inf, time.process_time()
    frame, left = 0, len(people)
    trail: list[tuple[NDArray[np.int64], Floats]] = []
    while frame < FPS * seconds:
        step(world)
        frame += 1
        order = people.get_rows_by_id()
        place, ids = people.position[order] + world.origin, people.ids[order]
        trail = [*trail[-LATE:], (ids, place)]
        if len(place) > 1:
            nearest = min(nearest, float(cKDTree(place).query(place, 2)[0][:, 1].min()))
        away = np.ones(len(place), np.bool_) if goal is None else np.linalg.norm(place - goal, axis=1) > WITHIN
        left = int(away.sum())
        if not left:
            break
    cost = 1000 * (time.process_time() - start_time) / frame
    if not left:
        return Crossed(frame / FPS, nearest, 0, 0, cost)
    ids, place = trail[-1]
    start_positions = dict(zip(trail[0][0].tolist(), trail[0][1], strict=True))
    distances = np.array(
        [np.linalg.norm(position - start_positions[one]) for one, position in zip(ids.tolist(), place, strict=True)]
    )
    stuck = int((away & (distances < STILL * 1400 * (len(trail) - 1) / FPS)).sum())
    return Crossed(np.inf, nearest, stuck, left, cost)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("where", choices=("circle", "corridor"))
    parser.add_argument("agents", type=int)
    parser.add_argument("seconds", type=float)
    parser.add_argument("--wide", type=float, default=5.0, help="metres")
    parser.add_argument("--within", type=float, default=6.0, help="metres, on the circle")
    options = parser.parse_args()
    if options.where == "circle":
        result = circle(options.agents, options.seconds, options.within)
    else:
        result = corridor(options.agents, options.seconds, options.wide * 1000)
    print(
        f"{options.where}, {options.agents}: all there after {result.seconds:.1f} s, "
        f"{result.left} not, {result.stuck} of these stuck"
    )
    print(f"least distance {result.nearest / 1000:.2f} m of 0.40 m, {result.cost:.1f} ms a step")


if __name__ == "__main__":
    main()
