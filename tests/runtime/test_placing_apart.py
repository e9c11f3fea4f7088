"""Where crowds begin no agent overlaps another, however they are placed; more agents move none of the others; and a place
without room for all says so with numbers."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import meshes
import numpy as np
import pytest
from sampling import sampled
from test_program import checked, complaints
from test_scene_files import PROGRAM as ANT
from test_scene_files import folder  # noqa: F401

from antdsl import passes, plan
from antdsl.cli.commands.new import build_ground_ply
from antdsl.ground.protocol import Footing
from antdsl.pipeline import RunChoices, Shot, open_scene
from antdsl.reload import migrate_world
from antdsl.runtime import Options, bind, step
from antdsl.runtime.binding import spacing
from antdsl.runtime.binding.spacing import OccupiedDiscs, PositionDrawer, StartPositionCandidates, spread_agents
from antdsl.runtime.binding.start_findings import find_crowding_warnings
from antdsl.runtime.world import World
from antdsl.scene.setting import CrowdData, MeshData, PaintedValues, PlacementData, SolidData, WorldSetting

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
PROGRAM = """ant 1
use steering
world { surface hill; surface plate; obstacle rock; map damp }
species ant { size uniform(3 mm, 5 mm); state go { steer wander() } }
species giant { size uniform(8 mm, 30 mm); state go { steer wander() } }
"""
BLOCK = PROGRAM.replace("surface hill;", "surface hill; solid block;")
_PLANS: dict[str, object] = {}


def world(*crowds: CrowdData, text: str = PROGRAM, options: Options | None = None, **setting_arguments: object) -> World:
    """Hills with a rock in the middle, a table above them, a block of soil and a map that is dense at the right."""
    if text not in _PLANS:
        program, report = checked(text)
        assert report.ok, complaints(report)
        _PLANS[text] = passes.optimise_plan(plan.lower(program)[0])
    hills = meshes.terrain(400.0, 24)
    default_setting: dict = dict(
        surfaces={"hill": MeshData(*hills), "plate": MeshData(*meshes.box((-40, 40, -40), (40, 44, 40)))},
        solids={"block": SolidData(MeshData(*meshes.box((90, -40, 90), (150, 30, 150))), 2.0)} if text == BLOCK else {},
        obstacles={"rock": MeshData(*meshes.ball(30.0))},
        maps={"damp": PaintedValues("hill", np.maximum(hills[0][:, 0], 0) / 200)},
        crowds=crowds,
        seed=4,
    )
    return bind(_PLANS[text], WorldSetting(**{**default_setting, **setting_arguments}), options or Options())  # type: ignore[arg-type]


def discs(bound_world: World) -> tuple[np.ndarray, np.ndarray]:
    return (
        np.concatenate([p.position for p in bound_world.populations.values()]),
        np.concatenate([p.now["radius"] for p in bound_world.populations.values()]).astype(np.float64),
    )


def overlapping(place: np.ndarray, radius: np.ndarray) -> np.ndarray:
    """Which agents overlap another, by trying each with all others."""
    overlaps = np.zeros(len(place), np.bool_)
    for k in range(len(place)):
        is_near = np.sqrt(((place - place[k]) ** 2).sum(axis=1)) < radius + radius[k]
        is_near[k] = False
        overlaps[k] = is_near.any()
    return overlaps


def by_id(bound_world: World, species: str = "ant") -> np.ndarray:
    population = bound_world.populations[species]
    return population.position[population.get_rows_by_id()]


# --- no agent in another --------------------------------------------------------------------------------------------------

DISC = PlacementData(surfaces=("hill",), disc_centre=(0.0, 0.0, 0.0), radius=90.0)
PLACEMENTS = {
    "disc": (CrowdData("ant", 500, DISC),),
    "surface": (CrowdData("ant", 900, PlacementData(surfaces=("hill",))),),
    "everywhere": (CrowdData("ant", 900),),
    "density": (CrowdData("ant", 900, PlacementData(surfaces=("hill",), density="damp")),),
    "density by area": (CrowdData("ant", 900, PlacementData(surfaces=("hill",), density="damp", is_by_area=True)),),
    "inside": (CrowdData("ant", 500, PlacementData(ray_origin=(0.0, 60.0, 0.0))),),
    "solid": (CrowdData("ant", 90, PlacementData(surfaces=("block",))),),
    "solid by area": (CrowdData("ant", 400, PlacementData(surfaces=("block",), is_by_area=True)),),
    "both sides": (CrowdData("ant", 400, PlacementData(surfaces=("plate",), is_by_area=True)),),
    "ball": (
        CrowdData("ant", 70, PlacementData(surfaces=("plate",), disc_centre=(40.0, 42.0, 0.0), radius=30.0, is_by_area=True)),
    ),
    "sizes": (CrowdData("giant", 22, DISC),),
    "lines and species": (
        CrowdData("ant", 120, DISC, 0),
        CrowdData("giant", 5, DISC, 1),
        CrowdData("ant", 80, PlacementData(surfaces=("hill",), disc_centre=(40.0, 0.0, 0.0), radius=80.0), 2),
        CrowdData("giant", 3, PlacementData(surfaces=("hill",), disc_centre=(0.0, 0.0, 50.0), radius=60.0), 3),
    ),
    "given points": (
        CrowdData("ant", 200, DISC, 0),
        CrowdData("giant", 3, PlacementData(points=np.array([[50.0, 0, 0], [0, 0, 60.0], [-50.0, 0, 0]])), 1),
    ),
}


@pytest.mark.parametrize("placement", PLACEMENTS)
def test_no_agent_begins_inside_another(placement: str) -> None:
    bound_world = world(*PLACEMENTS[placement], text=BLOCK if "solid" in placement else PROGRAM)
    assert len(bound_world) == sum(crowd.count for crowd in PLACEMENTS[placement]) and bound_world.overcrowded_lines == []
    place, radius = discs(bound_world)
    assert not overlapping(place, radius).any()
    for population in bound_world.populations.values():
        assert np.abs(bound_world.ground.position(population.footing) - population.position).max(initial=0.0) < 1e-9


SHOTS = [
    *("foraging/scene", "thesis/five_hundred", "thesis/tunnel_and_can", "tunnel/scene", "tunnel/led", "anthill/scene"),
    *("alarm/scene", "flocking/scene", "flow/scene", "minimal/scene", "moods/scene", "torture/scene", "worth/scene"),
    *("foraging_study/default", "foraging/many", "thesis/many", "tunnel/many"),
]


@pytest.mark.parametrize("shot", sampled(SHOTS, ("foraging/scene", "flocking/scene", "moods/scene", "torture/scene")))
def test_no_example_begins_with_agents_in_each_other(shot: str) -> None:
    opened, _ = open_scene(EXAMPLES / f"{shot}.yaml")
    assert opened is not None
    bound_world = bind(opened.plan, opened.setting)
    assert bound_world.overcrowded_lines == []
    place, radius = discs(bound_world)
    assert not overlapping(place, radius).any()


# --- the same places -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("count", [1, 64, 65, 170])
def test_more_agents_move_none_of_those_before(count: int) -> None:
    """Also where there is no room for all: 170 cover more of the disc than can be."""
    few, many = (world(CrowdData("ant", n, PlacementData(disc_centre=(100.0, 0, 0), radius=30.0))) for n in (count, 180))
    assert np.array_equal(by_id(few), by_id(many)[:count])


def test_a_later_line_moves_none_of_those_before() -> None:
    alone = world(PLACEMENTS["lines and species"][0])
    all_of_them = world(*PLACEMENTS["lines and species"])
    assert np.array_equal(by_id(alone), by_id(all_of_them)[:120])


@pytest.mark.parametrize(
    "options", [Options(threads=2, chunk=37), Options(shuffle_rows=5), Options(backend="reference", chunk=11)], ids=str
)
def test_places_are_the_same_whatever_threads_chunks_and_rows(options: Options) -> None:
    crowds = PLACEMENTS["lines and species"]
    one, other = world(*crowds), world(*crowds, options=options)
    for species in ("ant", "giant"):
        assert np.array_equal(by_id(one, species), by_id(other, species))


def test_given_points_are_used_even_inside_each_other() -> None:
    points = np.array([[50.0, 0, 0], [51.0, 0, 0], [52.0, 0, 3.0]])
    ants = CrowdData("ant", 300, PlacementData(surfaces=("hill",), disc_centre=(50.0, 0, 0), radius=60.0))
    bound_world = world(ants, CrowdData("giant", 3, PlacementData(points=points), 1))
    assert np.abs(by_id(bound_world, "giant")[:, [0, 2]] - points[:, [0, 2]]).max() < 1e-4 and bound_world.overcrowded_lines == []
    place, radius = discs(bound_world)
    assert np.flatnonzero(overlapping(place, radius)).tolist() == [300, 301, 302]


def test_a_radius_of_nothing_keeps_no_agent_away() -> None:
    text = PROGRAM.replace("size uniform(3 mm, 5 mm);", "radius 0 mm;")
    bound_world = world(CrowdData("ant", 3000, PlacementData(disc_centre=(100.0, 0, 0), radius=2.0)), text=text)
    assert bound_world.overcrowded_lines == [] and len(bound_world) == 3000


def test_who_joins_keeps_clear_of_those_who_walk() -> None:
    old = world(CrowdData("ant", 150, DISC))
    for _ in range(5):
        step(old)
    new, taken = migrate_world(old, old.plan, WorldSetting(**{**_fields(old.setting), "crowds": (CrowdData("ant", 250, DISC),)}))
    assert taken.added_counts == {"ant": 100}
    place, radius = discs(new)
    ids = new.populations["ant"].ids
    assert not overlapping(place, radius)[ids >= 150].any()


def _fields(setting: WorldSetting) -> dict:
    return {name: getattr(setting, name) for name in type(setting).__dataclass_fields__}


# --- no room -------------------------------------------------------------------------------------------------------------


def test_a_place_without_room_says_how_many_fit(folder: Path) -> None:  # noqa: F811
    shot, report = _opened(folder, "{on: ground, around: apple, radius: 20 mm}", 200)
    assert shot is not None and report.ok
    bound_world = bind(shot.plan, shot.setting)
    (diagnostic,) = find_crowding_warnings(shot.scene, bound_world).diagnostics
    (line,) = bound_world.overcrowded_lines
    place, radius = discs(bound_world)
    assert (line.count, line.radius) == (200, (2.0, 2.0)) and 45 < line.fitting_count < 60
    assert diagnostic.code == "no-room" and diagnostic.severity == "warning"
    assert diagnostic.span is not None and diagnostic.span.text == "{on: ground, around: apple, radius: 20 mm}"
    assert diagnostic.message == (
        f"only {line.fitting_count} of 200 `ant` have space at the start: with a radius of 2 mm "
        "all of them would cover 2,513 of 1,257 mm²"
    )
    assert diagnostic.help == "write `radius: 44 mm`, a smaller `count`, or a smaller `radius` in the program"
    # as many as it says do not meet each other
    free = _largest_first(place, radius)
    assert free >= line.fitting_count
    larger, _ = _opened(folder, "{on: ground, around: apple, radius: 44 mm}", 200)
    assert larger is not None and bind(larger.plan, larger.setting).overcrowded_lines == []


def _largest_first(place: np.ndarray, radius: np.ndarray) -> int:
    """How many of the agents, taken one after the other, meet none of those taken."""
    chosen: list[int] = []
    for k in range(len(place)):
        if all(np.linalg.norm(place[k] - place[j]) >= radius[k] + radius[j] for j in chosen):
            chosen.append(k)
    return len(chosen)


def _opened(folder: Path, place: str, count: int) -> tuple[Shot | None, object]:  # noqa: F811
    scene = f"""antdsl: 1
world:
  ground: {{mesh: ground.ply}}
  food: {{apple: {{at: [10, 0, 10], on: ground, load: 40, radius: 5 mm}}}}
  way: {{curve: way.json}}
crowd:
  - {{species: ant, from: ant.ant, count: {count}, place: {place}}}
"""
    (folder / "scene.yaml").write_text(scene)
    return open_scene(folder / "scene.yaml", RunChoices())


@pytest.mark.parametrize(("share", "all_fit"), [(0.2, True), (0.42, True), (0.5, False), (40.0, False)])
def test_tries_are_few_however_full_it_is(share: float, all_fit: bool) -> None:
    n, draw_count = 2000, [0]
    wide = 2.0 * np.sqrt(n / share)
    random = np.random.default_rng(1).random((n, 400, 2))

    def draw(ids: np.ndarray, tries: range) -> StartPositionCandidates:
        draw_count[0] += len(ids) * len(tries)
        u, v = np.concatenate([random[ids, k] for k in tries]).T
        away, angle = np.sqrt(u) * wide, 2 * np.pi * v
        place = np.stack([away * np.cos(angle), 0 * away, away * np.sin(angle)], axis=1)
        return StartPositionCandidates(Footing.create_unplaced(len(u)), place, np.zeros_like(place), np.ones(len(u), np.bool_))

    drawn, fits = spread_agents(OccupiedDiscs(), draw, np.arange(n), np.full(n, 2.0), 0)
    assert fits.all() == all_fit
    assert draw_count[0] <= 40 * n
    assert not overlapping(drawn.position[fits], np.full(fits.sum(), 2.0)).any()
    if share == 0.5:
        assert fits.mean() > 0.9


def test_pairs_are_few_where_thousands_want_one_place(monkeypatch: pytest.MonkeyPatch) -> None:
    """All pairs of agents that are drawn to one point are never counted."""
    find_overlaps, most = OccupiedDiscs.find_overlaps, [0]

    def counted(occupancy: OccupiedDiscs, *discs: np.ndarray) -> tuple:
        pairs = find_overlaps(occupancy, *discs)
        most[0] += len(pairs[0])
        return pairs

    monkeypatch.setattr(spacing.OccupiedDiscs, "find_overlaps", counted)
    n = 10_000

    def draw(ids: np.ndarray, tries: range) -> StartPositionCandidates:
        place = np.zeros((len(ids) * len(tries), 3))
        return StartPositionCandidates(Footing.create_unplaced(len(place)), place, place.copy(), np.ones(len(place), np.bool_))

    _, fits = spread_agents(OccupiedDiscs(), draw, np.arange(n), np.full(n, 2.0), 0)
    assert fits.tolist() == [True] + [False] * (n - 1)
    assert most[0] < 20 * n


BARE = "ant 1\nuse steering\nworld { surface floor }\nspecies ant { size 4 mm; state go { steer coast() } }\n"


@pytest.mark.parametrize(
    ("mesh", "place", "count", "area", "larger", "sides"),
    [
        (meshes.box((-20, -20, -20), (20, 20, 20)), PlacementData(surfaces=("floor",)), 120, 1600, False, True),  # its lid alone
        (meshes.box((-20, -20, -20), (20, 20, 20)), PlacementData(surfaces=("floor",)), 900, 1600, False, False),
        (meshes.grid(40.0, 4), PlacementData(surfaces=("floor",)), 120, 1600, False, False),
        (meshes.grid(40.0, 4), PlacementData(disc_centre=(0, 0, 0), radius=10.0), 40, 314, True, False),
        (meshes.grid(40.0, 4), PlacementData(disc_centre=(0, 0, 0), radius=10.0), 400, 314, False, False),  # the floor ends
        (meshes.grid(40.0, 4), PlacementData(disc_centre=(0, 0, 0), radius=10.0, is_by_area=True), 40, 314, True, False),
        (meshes.grid(40.0, 4), PlacementData(disc_centre=(20, 0, 0), radius=10.0), 30, 157, True, False),  # half beside it
    ],
)
def test_what_is_said_of_no_room_is_true(
    mesh: tuple, place: PlacementData, count: int, area: float, larger: bool, sides: bool
) -> None:
    setting_arguments = dict(text=BARE, surfaces={"floor": MeshData(*mesh)}, solids={}, obstacles={}, maps={})
    (line,) = world(CrowdData("ant", count, place), **setting_arguments).overcrowded_lines  # type: ignore[arg-type]
    assert line.available_area == pytest.approx(area, rel=0.05) and (
        line.sufficient_radius is not None,
        line.fits_available_area,
    ) == (larger, sides)
    if line.sufficient_radius is not None:
        assert (
            world(CrowdData("ant", count, replace(place, radius=line.sufficient_radius)), **setting_arguments).overcrowded_lines
            == []
        )  # type: ignore[arg-type]
    if sides:
        assert world(CrowdData("ant", count, replace(place, is_by_area=True)), **setting_arguments).overcrowded_lines == []  # type: ignore[arg-type]


@pytest.mark.parametrize("by", ["above", "area"])
def test_nothing_is_said_of_room_beside_all_surfaces(folder: Path, by: str) -> None:  # noqa: F811
    shot, _ = _opened(folder, f"{{on: ground, around: [900, 0, 0], radius: 5 mm, by: {by}}}", 200)
    assert shot is not None and find_crowding_warnings(shot.scene, bind(shot.plan, shot.setting)).diagnostics == []


def _square(wide: float, seed: int) -> PositionDrawer:
    """Draws places on a square."""

    def draw(ids: np.ndarray, tries: range) -> StartPositionCandidates:
        place = np.concatenate([np.random.default_rng((seed, k)).random((ids.max() + 1, 3))[ids] for k in tries]) * wide
        place[:, 1] = 0.0
        return StartPositionCandidates(
            Footing.create_unplaced(len(place)), place, np.zeros_like(place), np.ones(len(place), np.bool_)
        )

    return draw


@pytest.mark.parametrize("mixed", [False, True])
def test_large_ones_do_not_look_through_all_small_ones_below_them(mixed: bool, monkeypatch: pytest.MonkeyPatch) -> None:
    n, compared = 3000, [0]
    share = OccupiedDiscs._compute_distance_share

    def counted(occupancy: OccupiedDiscs, place: np.ndarray, radius: np.ndarray, entry: np.ndarray) -> np.ndarray:
        compared[0] += entry.size
        return share(occupancy, place, radius, entry)

    monkeypatch.setattr(OccupiedDiscs, "_compute_distance_share", counted)
    occupancy = OccupiedDiscs()
    small, large = np.full(n, 0.1), np.full(n, 200.0)
    first, then = (np.where(np.arange(n) % 2, large, small),) * 2 if mixed else (small, large)
    fits = spread_agents(occupancy, _square(200.0, 1), np.arange(n), first, 0)[1]
    later_fits = spread_agents(occupancy, _square(200.0, 2), np.arange(n), then, n)[1]
    assert fits[first < 1].mean() > 0.9
    assert later_fits[then > 1].sum() == 0 and compared[0] < 500 * n


@pytest.mark.parametrize("count", [20, 400, 3000])
def test_how_free_a_large_disc_is_among_small_ones_is_exact(count: int) -> None:
    draw = np.random.default_rng(count)
    small, wide = draw.random((count, 3)) * 100, 0.05 + 0.05 * draw.random(count)
    large, size = draw.random((200, 3)) * 100, 0.5 + 20 * draw.random(200)
    occupancy = OccupiedDiscs()
    occupancy.add_discs(small, wide, np.arange(count))
    occupancy.forget_removed_discs()
    away = np.sqrt(((large[:, None] - small[None]) ** 2).sum(axis=2))
    expected = np.minimum((away / ((size[:, None] + wide[None]) * 1.001)).min(axis=1), 1)
    assert occupancy.measure_free_distances(large, size, np.full(200, count)) == pytest.approx(expected, rel=1e-12)


# --- by area -------------------------------------------------------------------------------------------------------------


def sphere(**place: object) -> World:
    text = "ant 1\nuse steering\nworld { surface ball }\nspecies ant { size 2 mm; state go { steer wander() } }\n"
    crowd = CrowdData("ant", 2000, PlacementData(surfaces=("ball",), **place))  # type: ignore[arg-type]
    ball_mesh = MeshData(*meshes.ball(100.0, at=(20, 30, 40), rings=24))
    return world(crowd, text=text, surfaces={"ball": ball_mesh}, solids={}, obstacles={}, maps={})


def test_by_area_covers_every_side_alike_and_stands_outside() -> None:
    bound_world = sphere(is_by_area=True)
    ants = bound_world.populations["ant"]
    away = (ants.position - [20, 30, 40]) / 100
    assert (away * ants.read_vector("up")).sum(axis=1).min() > 0.98
    for axis in range(3):  # by Archimedes each coordinate of a point of a sphere is even
        assert np.abs(np.sort(away[:, axis]) - np.linspace(-1, 1, 2000)).max() < 0.08
    above = sphere().populations["ant"].position - [20, 30, 40]
    assert above[:, 1].min() > -5


def test_by_area_keeps_to_a_ball_about_a_place() -> None:
    bound_world = sphere(is_by_area=True, disc_centre=(20.0, -70.0, 40.0), radius=80.0)  # the lowest point
    away = np.linalg.norm(bound_world.populations["ant"].position - [20, -70, 40], axis=1)
    assert away.max() <= 80 and bound_world.overcrowded_lines == []
    # the part of a sphere within a distance of one of its points grows with the square of that
    assert np.abs(np.sort((away / 80) ** 2) - np.linspace(0, 1, 2000)).max() < 0.05
    assert bound_world.populations["ant"].read_vector("up")[:, 1].max() < 0


def test_by_area_finds_a_small_ball_on_large_faces() -> None:
    big = MeshData(*meshes.grid(100_000.0, 1))
    crowd = CrowdData("ant", 300, PlacementData(disc_centre=(900.0, 0.0, -400.0), radius=60.0, is_by_area=True))
    text = "ant 1\nuse steering\nworld { surface floor }\nspecies ant { state go { steer wander() } }\n"
    bound_world = world(crowd, text=text, surfaces={"floor": big}, solids={}, obstacles={}, maps={})
    assert bound_world.overcrowded_lines == []
    assert np.linalg.norm(bound_world.populations["ant"].position - [900, 0, -400], axis=1).max() <= 60


def test_a_solid_by_area_is_covered_on_all_sides() -> None:
    bound_world = world(*PLACEMENTS["solid by area"], text=BLOCK)
    ants = bound_world.populations["ant"]
    up = ants.read_vector("up")
    for axis in range(3):
        assert (up[:, axis] > 0.9).sum() > 30 and (up[:, axis] < -0.9).sum() > 30
    assert np.abs(bound_world.solids["block"].sample_distances(ants.position)).max() < 0.1


def test_a_density_goes_by_the_map_on_the_underside_too() -> None:
    ball = meshes.ball(100.0, rings=24)
    text = "ant 1\nuse steering\nworld { surface ball; map damp }\nspecies ant { size 2 mm; state go { steer wander() } }\n"
    crowd = CrowdData("ant", 1000, PlacementData(density="damp", is_by_area=True))
    damp = {"damp": PaintedValues("ball", np.where(ball[0][:, 1] < 0, 1.0, 0.0))}
    bound_world = world(crowd, text=text, surfaces={"ball": MeshData(*ball)}, solids={}, obstacles={}, maps=damp)
    assert bound_world.populations["ant"].position[:, 1].max() <= 8


@pytest.mark.parametrize(
    ("place", "words"),
    [
        ("{inside: apple, by: area}", "agents that start `inside` are placed along lines from there"),
        ("{on: ground, by: volume}", "`volume` is none of `above`, `area`"),
    ],
)
def test_what_cannot_be_by_area_is_reported(folder: Path, place: str, words: str) -> None:  # noqa: F811
    shot, report = _opened(folder, place, 5)
    assert shot is None and words in " ".join(d.message + (d.help or "") for d in report.errors)  # type: ignore[attr-defined]


def test_points_by_area_go_to_the_nearest_place(folder: Path) -> None:  # noqa: F811
    """Below a ball they stand on its underside, not on its top."""
    (folder / "ant.ant").write_text(ANT)
    (folder / "ground.ply").write_bytes(build_ground_ply(9))
    (folder / "points.json").write_text(json.dumps([[0, 5, 0], [20, 5, 20]]))
    shot, report = _opened(folder, "{on: ground, points: points.json, by: area}", 2)
    assert shot is not None, report
    bound_world = bind(shot.plan, shot.setting)
    assert np.abs(np.sort(bound_world.populations["ant"].position[:, 0]) - [0, 20]).max() < 5
    ball = sphere(is_by_area=True, points=np.array([[20.0, -80.0, 40.0]]))
    assert ball.populations["ant"].position[:, 1].max() < -65
