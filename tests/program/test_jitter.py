"""Random turns of the library, and the warning about draws that make a path depend on the frame rate."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
import pytest
from test_program import checked, complaints

from antdsl import passes, plan
from antdsl.runtime import Options, bind, step
from antdsl.scene.setting import CrowdData, MeshData, PlacementData, WorldSetting

PROGRAM = """ant 1
use steering
world { surface ground }
behaviour spin() -> angle { keep turn = 0 deg then turn + normal(0 deg, 3 deg); turn }
species a { size 1 mm; max_speed 10 mm/s; response 0.001 s; draws = 0 deg
  start s
  state s { %s }
  layers { state } }
"""
WALK = "steer match(rotate(heading, about: up, by: %s) * 10 mm/s)"
HALF = 1000.0


def walk(turn: str, fps: int, agents: int = 1500) -> float:
    """The root mean square displacement of a crowd in 4 seconds, in mm."""
    program, _ = checked(PROGRAM % (WALK % turn))
    floor = np.array([(x, 0.0, z) for x in (-HALF, HALF) for z in (-HALF, HALF)]), np.array([[0, 1, 3], [0, 3, 2]])
    crowd = CrowdData("a", agents, PlacementData(points=np.zeros((agents, 3))))
    setting = WorldSetting(fps=Fraction(fps), seed=3, surfaces={"ground": MeshData(*floor)}, crowds=(crowd,))
    world = bind(passes.optimise_plan(plan.lower(program)[0]), setting, Options())
    start = world.populations["a"].position.copy()
    for _ in range(4 * fps):
        step(world)
    return float(np.sqrt(((world.populations["a"].position - start) ** 2).sum(axis=1).mean()))


def test_walks_with_jitter_are_as_long_at_any_frame_rate() -> None:
    displacements = [walk("jitter(78.4 deg)", fps) for fps in (12, 24, 48)]
    assert max(displacements) / min(displacements) < 1.06 and min(displacements) > 22  # a standard error of about 1.3 % each
    drawn = [walk("normal(0 deg, 16 deg)", fps) for fps in (12, 48)]
    assert drawn[0] / drawn[1] > 1.4


@pytest.mark.parametrize(
    ("line", "help"),
    [
        ("steer rotate(heading, about: up, by: normal(0 deg, 16 deg))", "write `jitter(78.4 deg)`, which is equal"),
        ("steer rotate(heading, about: up, by: uniform(-0.1 rad, 0.1 rad))", "write `jitter(0.283 rad)`, which is equal"),
        ("steer heading + vector(uniform(-1, 1), 0, 0)", "write `wander()`"),
        ("let off = normal(5 deg, 2 deg); face rotate(heading, about: up, by: off)", "write `wander()`"),
        (
            "steer rotate(heading, about: up, by: spin()) * 0.5 + rotate(heading, about: up, by: spin())",
            "write `jitter(14.7 deg)`",
        ),
        ("draws = normal(0 deg, 3 deg); steer rotate(heading, about: up, by: draws)", "write `jitter(14.7 deg)`"),
    ],
)
def test_draws_in_steering_are_reported(line: str, help: str) -> None:
    _, report = checked(PROGRAM % line)
    warnings = [each for each in report.sort_by_place() if each.code == "draw-in-steering"]
    assert len(warnings) == 1 and all(help in str(each.help) for each in warnings), complaints(report)


@pytest.mark.parametrize(
    "line",
    [
        "steer wander(); face steady(heading)",
        "steer hesitate(amble(heading))",
        "steer set_off(heading)",
        "steer rotate(heading, about: up, by: jitter(20 deg))",
        "steer rotate(heading, about: up, by: normal(0 deg, 9 deg) * sqrt(dt / 1 s))",
        "keep side = pick(-1, 1) then side; steer rotate(heading, about: up, by: side * 30 deg)",
        "steer rotate(heading, about: up, by: draws); enter { draws = normal(0 deg, 9 deg) }",
    ],
)
def test_draws_that_do_not_depend_on_the_frame_rate_are_not_reported(line: str) -> None:
    _, report = checked(PROGRAM % line)
    assert [each.code for each in report.sort_by_place() if each.code == "draw-in-steering"] == [], complaints(report)
