"""Standing bodies: upright on slopes, steep ground as a wall, steps of stairs; on all backends with the same bits."""

from __future__ import annotations

import numpy as np
import pytest
from meaning import OPTION_SETS, RunHistory, crowd, play

from antdsl.runtime import MeshData, Options, World

WORLD = """ant 2
world { surface ground }
"""
NATIVE = Options(backend="native", threads=2, chunk=5)
ALL_OPTIONS = (*OPTION_SETS, NATIVE)


def person(lines: str = "", steer: str = "heading") -> str:
    """A species of people of 1.7 m that walk along +x unless `steer` says something else."""
    return f"""species a {{
      height 1.7 m; max_speed 1.3 m/s; response 0.2 s; {lines}
      on spawn {{ heading = vector(1, 0, 0) }}
      start s
      state s {{ steer {steer} }}
    }}"""


def profile(*points: tuple[float, float], half: float = 20_000.0) -> MeshData:
    """A ground that is straight along z, through points (x, y) in mm."""
    corners = [(x, y, z) for x, y in points for z in (-half, half)]
    faces = [f for k in range(0, 2 * len(points) - 2, 2) for f in ((k, k + 1, k + 2), (k + 1, k + 3, k + 2))]
    return MeshData(np.array(corners, float), np.array(faces, np.int32))


def slope(degrees: float) -> MeshData:
    rise = np.tan(np.radians(degrees))
    return profile((-30_000, -30_000 * rise), (30_000, 30_000 * rise))


def tilts(world: World) -> np.ndarray:
    """Angles (degrees) of bodies from the vertical."""
    return np.degrees(np.arccos(np.clip(world.populations["a"].read_vector("up")[:, 1].astype(float), -1, 1)))


def run(text: str, ground: MeshData, steps: int = 24, count: int = 5, **options: object) -> RunHistory:
    return play(
        text, crowd(count, radius=2000.0), steps=steps, world=WORLD, fps=24, surfaces={"ground": ground}, option_sets=ALL_OPTIONS,
        **options,  # type: ignore[arg-type]
    )  # fmt: skip


@pytest.mark.parametrize("degrees", [5, 20, 35])
def test_people_stand_vertically_on_a_slope(degrees: float) -> None:
    angles: list[float] = []
    history = run(person(), slope(degrees), each=lambda world: angles.append(float(tilts(world).max())))
    assert len(angles) == 24 and max(angles) < 0.01
    assert np.ptp(history.every("position.x")) > 0.7 * 1300 * np.cos(np.radians(degrees))  # they walk


@pytest.mark.parametrize(("share", "expected"), [("0 %", 20.0), ("25 %", 15.0), ("50 %", 10.0), ("100 %", 0.0)])
def test_upright_is_a_share_of_the_angle_to_the_vertical(share: str, expected: float) -> None:
    history = run(person(f"upright {share}"), slope(20), steps=6)
    assert tilts(history.world) == pytest.approx([expected] * 5, abs=0.01)
    for name in ("up", "heading"):
        assert np.linalg.norm(history.world.populations["a"].read_vector(name), axis=1) == pytest.approx([1] * 5, abs=1e-5)
    population = history.world.populations["a"]
    assert (population.read_vector("up") * population.read_vector("heading")).sum(axis=1) == pytest.approx([0] * 5, abs=1e-5)


def test_a_state_changes_how_bodies_stand_within_their_turn_limit() -> None:
    text = person("max_turn 60 deg/s").replace(
        "state s { steer heading }",
        "state s { steer heading; when after 0.5 s -> crawl { upright = 0 % } }; state crawl { steer heading }",
    )
    angles: list[float] = []
    run(text, slope(20), steps=40, each=lambda world: angles.append(float(tilts(world).max())))
    changes = np.abs(np.diff(angles))
    assert angles[8] < 0.01 and angles[-1] == pytest.approx(20, abs=0.01)
    assert changes.max() < 60 / 24 * 1.01


def test_a_crawling_species_stands_along_the_normal_unless_it_says_otherwise() -> None:
    text = "species a { size 4 mm; start s; state s { steer heading } }"
    history = run(text, slope(20), steps=2)
    assert tilts(history.world) == pytest.approx([20] * 5, abs=0.01)
    assert not {"upright", "max_slope", "height"} & history.world.plan.species["a"].registers.keys()
    history = run(text.replace("size 4 mm", "size 4 mm; upright 100 %"), slope(20), steps=2)
    assert tilts(history.world) == pytest.approx([0] * 5, abs=0.01)


HILL = ((-30_000.0, 0.0), (4_000.0, 0.0), (8_000.0, 4_000.0), (30_000.0, 4_000.0))  # 45 degrees


def test_ground_steeper_than_the_limit_is_a_wall() -> None:
    history = run(person(), profile(*HILL), steps=150)
    population = history.world.populations["a"]
    assert population.position[:, 1].max() < 60  # mm: a part of a step
    assert population.position[:, 0].min() > 3_000  # they came to the foot of the hill


@pytest.mark.parametrize("limit", ["none", "50 deg"])
def test_a_higher_limit_or_none_lets_them_climb(limit: str) -> None:
    history = run(person(f"max_slope {limit}"), profile(*HILL), steps=150)
    assert history.world.populations["a"].position[:, 1].min() > 300


def test_people_slide_along_ground_that_is_too_steep() -> None:
    history = run(person(steer="unit(vector(1, 0, 1))"), profile(*HILL), steps=240)
    late = np.array(history.at("velocity.z", -1))
    assert history.world.populations["a"].position[:, 1].max() < 60
    assert late.min() > 500  # mm/s: they go on, along the hill


def stairs(high: float, count: int = 3, tread: float = 1_000.0) -> MeshData:
    points = [(-30_000.0, 0.0)]
    for k in range(count):
        x = 4_000.0 + k * tread
        points += [(x, k * high), (x, (k + 1) * high)]
    return profile(*points, (30_000.0, count * high))


@pytest.mark.parametrize("steer", ["heading", "vector(1, 0, 0)"])
def test_steps_up_to_a_quarter_of_the_height_are_climbed_and_higher_ones_are_walls(steer: str) -> None:
    angles: list[float] = []
    history = run(person(steer=steer), stairs(400), steps=220, each=lambda world: angles.append(float(tilts(world).max())))
    assert history.world.populations["a"].position[:, 1].min() > 1_199 and max(angles) < 0.01
    assert run(person(steer=steer), stairs(600), steps=150).world.populations["a"].position[:, 1].max() < 60


def test_people_walk_down_steps_but_not_off_a_cliff() -> None:
    down = profile((-30_000.0, 400.0), (4_000.0, 400.0), (4_000.0, 0.0), (30_000.0, 0.0))
    assert run(person(), down, steps=150).world.populations["a"].position[:, 1].max() < 1
    cliff = profile((-30_000.0, 4_000.0), (4_000.0, 4_000.0), (4_000.0, 0.0), (30_000.0, 0.0))
    assert run(person(), cliff, steps=150).world.populations["a"].position[:, 1].min() > 3_900


def test_an_empty_crowd_has_a_posture() -> None:
    assert run(person(), slope(20), steps=2, count=0).world.populations["a"].position.shape == (0, 3)
