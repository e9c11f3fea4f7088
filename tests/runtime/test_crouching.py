"""Bodies that crouch: they lower themselves before a low ceiling, stand up after it, and where they do not fit it is a wall."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import stick_bodies
from meaning import OPTION_SETS, RunHistory, crowd, play

from antdsl.outputs.cache.pose_arrays import make_feet_arrays
from antdsl.runtime import MeshData, Options, World, bind, step
from antdsl.runtime.moving.clearance.bodies_inside import find_bodies_inside
from antdsl.runtime.moving.contacts.capsules import CapsuleCrowd
from antdsl.scene.setting import BodyCapsuleData

WORLD = """ant 2
world { surface ground; obstacle roof }
"""
NATIVE = Options(backend="native", threads=2, chunk=5)
Profile = tuple[tuple[float, float], ...]
FALLING: Profile = ((1_000, 1_900), (5_000, 1_250), (7_000, 1_250))  # x and height of a ceiling, mm


def person(lines: str = "crouch 60 %", steer: str = "vector(1, 0, 0)") -> str:
    return f"""species a {{
      height 1.7 m; radius 0.25 m; max_speed 1.3 m/s; response 0.2 s; {lines}
      on spawn {{ heading = vector(1, 0, 0) }}
      start s
      state s {{ steer {steer} }}
    }}"""


def band(points: Profile, half: float = 20_000.0) -> MeshData:
    """A sheet through points (x, y) that is straight along z."""
    corners = [(x, y, z) for x, y in points for z in (-half, half)]
    faces = [f for k in range(0, 2 * len(points) - 2, 2) for f in ((k, k + 1, k + 2), (k + 1, k + 3, k + 2))]
    return MeshData(np.array(corners, float), np.array(faces, np.int32))


def walk(
    text: str, roof: Profile, steps: int, half: float = 20_000.0, option_sets: Sequence[Options] = (Options(backend="numpy"),)
) -> tuple[RunHistory, np.ndarray, np.ndarray]:
    """People that walk below a roof: their positions [t, n, 3] and heights as shares [t, n], and the run."""
    positions: list[np.ndarray] = []
    shares: list[np.ndarray] = []

    def record(world: World) -> None:
        population = world.populations["a"]
        rows = population.get_rows_by_id()
        positions.append(population.position[rows].copy())
        shares.append(1 - population.now["~lowering"][rows])

    history = play(
        text, crowd(3, radius=600.0), steps=steps, world=WORLD, fps=24, each=record,
        surfaces={"ground": band(((-30_000, 0), (30_000, 0)))}, obstacles={"roof": band(roof, half)},
        option_sets=option_sets,
    )  # fmt: skip
    return history, np.array(positions)[-steps:], np.array(shares)[-steps:]


def roof_above(roof: Profile, x: np.ndarray) -> np.ndarray:
    return np.interp(x, *np.array(roof).T, left=np.inf, right=np.inf)


def test_bodies_lower_themselves_below_a_falling_ceiling_and_stand_up_after_it() -> None:
    _, positions, shares = walk(person(), FALLING, 220)
    x = positions[..., 0]
    assert x[-1].min() > 7_500, "all have passed"
    assert (1_700 * shares <= roof_above(FALLING, x) + 1).all(), "no head is above the ceiling"
    assert shares.min() == pytest.approx(1_250 / 1_700 / 1.02, abs=0.01)
    assert shares[0].min() == 1 and shares[-1].min() == 1
    assert np.abs(np.diff(shares, axis=0)).max() < 1.2 / 24 + 1e-6


def test_bodies_crouch_alike_on_all_backends() -> None:
    _, _, shares = walk(person(), FALLING, 40, option_sets=(*OPTION_SETS, NATIVE))
    assert shares[-1].min() < 0.97


def test_a_place_that_is_too_low_is_a_wall() -> None:
    _, positions, shares = walk(person("crouch 80 %"), FALLING, 150)
    x = positions[..., 0]
    limit = np.interp(1_700 * 0.8 * 1.02, (1_250, 1_900), (5_000, 1_000))
    assert limit - 600 < x[-1].min() and x.max() < limit, "they stop where the ceiling is as low as they can be"
    assert shares.min() > 0.8 - 1e-6


def test_without_crouch_nothing_changes() -> None:
    text = person("")
    history = play(
        text, crowd(3, radius=600.0), steps=5, world=WORLD, fps=24, surfaces={"ground": band(((-30_000, 0), (30_000, 0)))},
        obstacles={"roof": band(FALLING)}, option_sets=OPTION_SETS,
    )  # fmt: skip
    assert not {"~lowering", "crouch"} & history.world.plan.species["a"].registers.keys()


def test_they_walk_along_a_low_place_and_past_it() -> None:
    """A low sheet that ends at the side: with a push at an angle, bodies slide along its edge."""
    _, positions, shares = walk(person(steer="vector(1, 0, 0.8)"), ((1_500, 800), (4_000, 800)), 150, half=3_000.0)
    assert shares.min() > 0.95 and positions[-1, :, 2].min() > 3_000 and positions[-1, :, 0].min() > 2_000


def test_states_set_how_low_bodies_crouch() -> None:
    text = person("crouch 100 %").replace(
        "state s { steer vector(1, 0, 0) }",
        "state s { steer vector(1, 0, 0); when after 3 s -> low }; state low { enter { crouch = 60 % }; steer vector(1, 0, 0) }",
    )
    _, positions, shares = walk(text, FALLING, 240)
    assert shares[:70].min() > 0.99 and shares.min() < 0.75 and positions[-1, :, 0].min() > 7_000


def open_low_hall(folder: Path, capsules: Mapping[str, BodyCapsuleData] | None = None) -> World:
    """Two people that stand in a hall of 1.4 m."""
    (folder / "ground.obj").write_text("v -9 0 -9\nv -9 0 9\nv 9 0 -9\nv 9 0 9\nf 1 2 3\nf 2 4 3\n")
    (folder / "roof.obj").write_text("v -9 1.4 -9\nv -9 1.4 9\nv 9 1.4 -9\nv 9 1.4 9\nf 1 2 3\nf 2 4 3\n")
    (folder / "a.ant").write_text(WORLD + person(steer="halt()").replace("species a", "use steering\nspecies a", 1))
    (folder / "scene.yaml").write_text(
        "antdsl: 1\nunits: m\nup: y\nfps: 24\nworld: {ground: {mesh: ground.obj}, roof: {mesh: roof.obj}}\n"
        "crowd: [{species: a, from: a.ant, count: 2, body: person,"
        " place: {on: ground, around: [0, 0, 0], radius: 2 m, apart: 1 m}}]\n"
    )
    shot = stick_bodies.opened(folder / "scene.yaml")
    setting = shot.setting if capsules is None else replace(shot.setting, body_capsules=capsules)
    return bind(shot.plan, setting, Options(backend="numpy", feet=True))


def test_feet_bend_the_legs_of_bodies_that_crouch(tmp_path: Path) -> None:
    world = open_low_hall(tmp_path)
    lifts = []
    for _ in range(30):
        step(world)
        lifts.append(make_feet_arrays(world, "a", 1.0)["feet.a.rise"])
    assert lifts[0].min() > -150 and lifts[-1] == pytest.approx([-1_700 + 1_400 / 1.02] * 2, abs=30)


def test_trunks_of_bodies_that_crouch_are_lower(tmp_path: Path) -> None:
    """A chest at 1.25 m is in the ceiling, that of a body that crouches is not. Contacts lower it by no more than its radius."""
    world = open_low_hall(tmp_path, {"a": BodyCapsuleData(0.84, 0.84, 2.6, 0.0)})
    population, rows = world.populations["a"], np.arange(2)
    standing = CapsuleCrowd(world)
    assert find_bodies_inside(world, population, rows).all() and standing.middle[1] == pytest.approx([1_250] * 2, rel=1e-3)
    for _ in range(30):
        step(world)
    lowering, crouching = 1_700 * population.now["~lowering"], CapsuleCrowd(world)
    assert lowering == pytest.approx([1_700 - 1_400 / 1.02] * 2, rel=1e-3)
    assert not find_bodies_inside(world, population, rows).any()
    assert standing.middle[1] - crouching.middle[1] == pytest.approx(np.minimum(lowering, crouching.radius), rel=1e-5)
    population.now["~lowering"][0] = 0
    assert find_bodies_inside(world, population, rows).tolist() == [True, False]


def test_a_low_trunk_stays_above_the_ground(tmp_path: Path) -> None:
    world = open_low_hall(tmp_path)  # the trunk of the library's person is at 0.53 m
    population = world.populations["a"]
    population.now["~lowering"][:] = 0.4
    crowd_now = CapsuleCrowd(world)
    assert (crowd_now.middle[1] >= crowd_now.radius - 1e-3).all()
    assert not find_bodies_inside(world, population, np.arange(2)).any()
