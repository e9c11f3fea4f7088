"""Flows and maps on surfaces: what agents read of them, that it leads them where it should, on both backends alike."""

from __future__ import annotations

from dataclasses import replace

import meshes
import numpy as np
import pytest
from test_program import checked, complaints

from antdsl import passes, plan
from antdsl.fields.face_points import FaceLattice, count_edge_pieces_by_length, weld_points
from antdsl.plan.ir import Plan
from antdsl.runtime import BindError, Options, bind, restore_checkpoint, set_flow, state_hash, step, take_checkpoint
from antdsl.runtime.world import World
from antdsl.scene.setting import (
    BorderFlowData,
    CrowdData,
    FlowData,
    FlowTarget,
    ItemData,
    MeshData,
    PaintedValues,
    PlacementData,
    SolidData,
    SolvedFlowData,
    SpreadFlowData,
    WorldSetting,
)
from antdsl.scene.staging.motion import GeometryMotion, MeshMotion

PROGRAM = """ant 1
use steering
world {{ surface ground; obstacle rock; flow drift; map damp; items nest }}
species ant {{
  param pull = 1 in -1 .. 1
  radius {radius}
  felt = 0
  wet = 0
  on spawn {{ velocity = vector(0 mm/s, 0 mm/s, 0 mm/s); heading = vector(0, 0, 1) }}
  state s {{ steer {steer}; felt = length(drift); wet = damp }}
}}
"""
GOAL = FlowTarget(np.array([[150.0, 0.0, 0.0]]), np.array([10.0]))
LINE = FlowTarget(np.array([[-150.0, 0, -40.0], [0, 0, 40.0], [150.0, 0, -40.0]]), np.zeros(3), is_line=True)


def compiled(steer: str = "along(drift, weight: pull)", radius: str = "size / 2") -> Plan:
    program, report = checked(PROGRAM.format(steer=steer, radius=radius))
    assert report.ok, complaints(report)
    lowered, report = plan.lower(program)
    assert complaints(report) == []
    return passes.optimise_plan(lowered)


def world(
    flow: FlowData | None = None,
    cells: int = 8,
    steer: str = "along(drift, weight: pull)",
    options: Options | None = None,
    radius: str = "size / 2",
    **changes: object,
) -> World:
    """Ants at the left end of a floor 400 mm wide."""
    floor = meshes.grid(400.0, cells)
    defaults: dict = dict(
        surfaces={"ground": MeshData(*floor)},
        items={"nest": (ItemData("home", (150.0, 0, 0), 10.0),)},
        flows={"drift": flow or SpreadFlowData("toward", GOAL)},
        maps={"damp": PaintedValues("ground", (floor[0][:, 0] + 200) / 400)},
        crowds=(CrowdData("ant", 30, PlacementData(disc_centre=(-150.0, 0, 0), radius=30.0)),),
    )
    return bind(compiled(steer, radius), WorldSetting(**{**defaults, **changes}), options or Options())


def read(built: World, *points: tuple[float, float]) -> np.ndarray:
    """The flow at places of the floor."""
    positions = np.array([(x, 0.0, z) for x, z in points])
    up = np.tile([0.0, 1.0, 0.0], (len(positions), 1))
    footing, result = built.ground.place_points(positions, built.up)
    assert result.all()
    return np.stack(built.flows["drift"].sample(built.ground.meshes, footing, positions, up), axis=1).astype(float)


def away(built: World, x: float, z: float) -> np.ndarray:
    place = built.populations["ant"].position + built.origin
    return np.hypot(place[:, 0] - x, place[:, 2] - z)


def run(built: World, steps: int) -> np.ndarray:
    """Places (steps, agents, 3) in the order of ids."""
    positions = []
    for _ in range(steps):
        step(built)
        ants = built.populations["ant"]
        positions.append(ants.position[ants.get_rows_by_id()] + built.origin)
    return np.array(positions)


# --- points on triangles ---------------------------------------------------------------------------------------------


def test_linear_values_are_interpolated_exactly() -> None:
    rng = np.random.default_rng(1)
    cuts = np.array([1, 2, 8, 64, 1])
    lattice = FaceLattice.from_edge_pieces(cuts)
    b1, b2 = lattice.compute_slot_weights()
    face = lattice.get_face_by_slot()
    value = 3 * b1 - 7 * b2 + face
    requested = rng.integers(0, 5, 2000)
    u, v = rng.random(2000), rng.random(2000)
    u, v = np.where(u + v > 1, 1 - u, u), np.where(u + v > 1, 1 - v, v)
    u[:10], v[:10] = [0, 1, 0, 0.5, 0.5, 1, 0, 0, 0.25, 0.75], [0, 0, 1, 0.5, 0, 0, 1, 0, 0.75, 0.25]
    slots, weights = lattice.find_slots(requested, u, v)
    assert np.abs(weights.sum(axis=0) - 1).max() < 1e-12 and weights.min() > -1e-9
    assert (face[slots] == requested).all()
    assert np.abs((value[slots] * weights).sum(axis=0) - (3 * u - 7 * v + requested)).max() < 1e-12
    small, owner = lattice.compute_triangles()
    assert np.bincount(owner).tolist() == (cuts * cuts).tolist()
    corners = np.stack([b1, b2], axis=1)[small]
    (ax, ay), (bx, by) = ((corners[:, k] - corners[:, 0]).T for k in (1, 2))
    area = ax * by - ay * bx
    assert np.allclose(area, 1 / (cuts[owner] ** 2))  # wound alike, of one size: they fill the face


def test_edges_are_cut_as_small_as_requested_and_points_at_one_place_are_one() -> None:
    assert count_edge_pieces_by_length(np.array([0.0, 1.0, 10.0, 33.0]), 8.0).tolist() == [1, 1, 2, 8]
    point, count = weld_points(np.array([[0, 0, 0], [1, 0, 0], [1 + 1e-12, 0, 0], [1, 0, 0]], float), np.array([0, 0, 0, 1]))
    assert count == 3 and point[1] == point[2] != point[3]


# --- about a target --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("cells", [1, 40])
def test_a_curve_flow_points_along_the_curve_and_falls_off(cells: int) -> None:
    built = world(SpreadFlowData("tangent", LINE, 40.0), cells)
    along = np.array([150.0, 0, 80.0]) / 170
    for offset, strength in ((0, 1.0), (10, 1 - 3 / 16 + 2 / 64), (20, 0.5), (30, 3 / 16 - 2 / 64), (41, 0.0)):
        side = np.array([-along[2], 0, along[0]]) * offset
        result = read(built, (-75 + side[0], side[2]))[0]
        assert np.abs(result - along * strength).max() < 0.03, (offset, result)
    assert (read(built, (-75, 0), (75, 0))[:, 1] == 0).all()
    assert read(built, (75, 0))[0, 2] < -0.4  # it turns with the curve


def test_gather_adds_a_component_towards_the_curve() -> None:
    straight = FlowTarget(np.array([[-200.0, 0, 0], [200.0, 0, 0]]), np.zeros(2), is_line=True)
    built = world(SpreadFlowData("tangent", straight, 60.0, "none", gather=1.0), 1)
    result = read(built, (0, 0), (0, 30), (0, -59))
    half = np.sqrt(0.5)
    assert np.abs(result - [[1, 0, 0], [2 / np.sqrt(5), 0, -1 / np.sqrt(5)], [half, 0, half]]).max() < 0.05
    positions = run(built, 160)
    assert np.abs(positions[-1, :, 2]).max() < 4 < np.abs(positions[0, :, 2]).max()


def test_toward_and_away_of_points_and_curves_and_their_falloff() -> None:
    two = FlowTarget(np.array([[-100.0, 0, 0], [100.0, 0, 0]]), np.zeros(2))
    built = world(SpreadFlowData("toward", two, 50.0, "linear"), 1)
    result = read(built, (-125, 0), (75, 0), (100, 25), (0, 0))
    assert np.abs(result - [[0.5, 0, 0], [0.5, 0, 0], [0, 0, -0.5], [0, 0, 0]]).max() < 0.03
    built = world(SpreadFlowData("away", two, 50.0, "none", -0.5), 1)  # turned round, half as strong
    assert np.abs(read(built, (-125, 0))[0] - [0.5, 0, 0]).max() < 1e-6
    built = world(SpreadFlowData("away", LINE), 20)
    assert np.abs(np.linalg.norm(read(built, (20, 90), (0, -150)), axis=1) - 1).max() < 0.01
    assert read(built, (0, 90))[0, 2] > 0.95


def test_agents_follow_a_flow_scaled_by_a_param() -> None:
    built = world(
        SpreadFlowData("tangent", LINE, 60.0), crowds=(CrowdData("ant", 1, PlacementData(points=np.array([[-140.0, 0, -34]]))),)
    )
    positions = run(built, 240)[:, 0]
    assert np.linalg.norm(positions[-1] - [150, 0, -40]) < 70 and positions[:, 2].max() > 20  # it went along the bend
    for pull, moved in ((-1.0, -1), (0.0, 0)):
        built = world(params={"ant.pull": pull})
        previous = away(built, 150, 0).mean()
        run(built, 30)
        assert np.sign(round(previous - away(built, 150, 0).mean(), 3)) == moved


def test_spread_flows_work_without_a_surface() -> None:
    text = "ant 1\nuse steering\nworld { flow drift }\nspecies ant { state s { steer along(drift) } }\n"
    lowered, report = plan.lower(checked(text)[0])
    assert complaints(report) == []
    crowd = CrowdData("ant", 5, PlacementData(disc_centre=(-20.0, 0, 0), radius=5.0))
    built = bind(lowered, WorldSetting(flows={"drift": SpreadFlowData("toward", GOAL)}, crowds=(crowd,)))
    previous = away(built, 150, 0)
    run(built, 24)
    assert (away(built, 150, 0) < previous - 15).all()


def test_flows_cover_solids() -> None:
    text = (
        "ant 1\nuse steering\nworld { surface ground; solid hill; flow drift }\nspecies ant { state s { steer along(drift) } }\n"
    )
    lowered, report = plan.lower(checked(text)[0])
    assert complaints(report) == []
    hill = SolidData(MeshData(*meshes.box((-60, -10, -60), (60, 25, 60))), 3.0)
    crowd = CrowdData("ant", 5, PlacementData(points=np.array([[-40.0, 50, 5.0 * k] for k in range(5)])))
    floor = {"ground": MeshData(*meshes.grid(400.0, 4))}
    flow = SpreadFlowData("toward", FlowTarget(np.array([[150.0, 10, 0]]), np.zeros(1)))
    built = bind(lowered, WorldSetting(surfaces=floor, solids={"hill": hill}, flows={"drift": flow}, crowds=(crowd,)))
    positions = run(built, 260)
    assert (np.abs(positions[40, :, 1] - 25) < 1).all() and (
        positions[40, :, 0] > -10
    ).all()  # over its top, and down on the ground
    assert (away(built, 150, 0) < 30).mean() > 0.7


def test_solved_flows_avoid_solids_until_they_are_dug() -> None:
    text = (
        "ant 1\nuse steering\nworld { surface ground; solid hill; flow drift }\nspecies ant { state s { steer along(drift) } }\n"
    )
    lowered, report = plan.lower(checked(text)[0])
    assert complaints(report) == []
    hill = SolidData(MeshData(*meshes.box((-40, -10, -150), (40, 25, 80))), 4.0)
    crowd = CrowdData("ant", 3, PlacementData(points=np.array([[-150.0, 50, 5.0 * k] for k in range(3)])))
    floor = {"ground": MeshData(*meshes.grid(400.0, 40))}
    flow = SolvedFlowData(GOAL, interval=0.25)

    def start_world() -> World:
        return bind(lowered, WorldSetting(surfaces=floor, solids={"hill": hill}, flows={"drift": flow}, crowds=(crowd,)))

    def ahead(built: World) -> float:
        return float(read(built, (-60, 0))[0, 0])

    built = start_world()
    solved = built.flows["drift"].axis1_components
    run(built, 7)
    assert built.flows["drift"].axis1_components is solved, "nothing was dug, so nothing is solved anew"
    assert ahead(built) < 0.6 and np.abs(read(built, (0, 0))).max() == 0, "round it; under it leads no way"
    x = np.linspace(-44, 44, 40)
    built.solids["hill"].carve_balls(np.stack([x, 0 * x, 0 * x], axis=1), np.full(40, 30.0), np.arange(40))
    assert ahead(built) < 0.6, "not before it is time to look"
    cached = take_checkpoint(built)
    positions = run(built, 6)
    assert ahead(built) > 0.95 and read(built, (0, 0))[0, 0] > 0.9
    again = start_world()
    restore_checkpoint(again, cached)
    assert np.array_equal(run(again, 6), positions) and np.array_equal(
        again.flows["drift"].axis1_components, built.flows["drift"].axis1_components
    )
    assert (away(again, 150, 0) > 100).all()
    run(again, 260)
    assert (away(again, 150, 0) < 20).all(), "through it: the way round is too long for that time"


# --- borders ---------------------------------------------------------------------------------------------------------


def test_a_flow_at_the_border_keeps_them_in() -> None:
    crowd = (CrowdData("ant", 60, PlacementData(disc_centre=(0, 0, 0), radius=150.0)),)

    def nearest(steer: str) -> float:
        positions = run(world(BorderFlowData(("ground",), 40.0), 10, steer, crowds=crowd, seed=4), 480)
        return float(200 - np.abs(positions[240:, :, [0, 2]]).max())

    assert nearest("wander()") < 0.01  # without it they go to the very border
    assert nearest("along(drift) * 2 + wander() * 0.5") > 5


def test_border_flows_point_inward_near_the_border_only() -> None:
    for cells in (1, 30):
        built = world(BorderFlowData(("ground",), 40.0), cells)
        result = read(built, (-199.99, 0), (-180, 30), (199.99, 0), (0, 150), (0, 199.99))
        expected = [[1, 0, 0], [0.5, 0, 0], [-1, 0, 0], [0, 0, 0], [0, 0, -1]]
        assert np.abs(result - expected).max() < 0.08, result


# --- painted ---------------------------------------------------------------------------------------------------------


def test_painted_vectors_are_tangential_with_unchanged_length() -> None:
    hills = meshes.terrain(400.0, 30)
    combed = np.tile([0.6, 0.0, 0.0], (len(hills[0]), 1))
    built = world(
        PaintedValues("ground", combed),
        surfaces={"ground": MeshData(*hills)},
        maps={"damp": PaintedValues("ground", hills[0][:, 1])},
    )
    run(built, 5)
    ants = built.populations["ant"]
    place, up = ants.position, np.tile([0.0, 1.0, 0.0], (len(ants), 1))
    result = np.stack(built.flows["drift"].sample(built.ground.meshes, ants.footing, place, up), axis=1).astype(float)
    assert np.abs((result * built.ground.normal(ants.footing)).sum(axis=1)).max() < 1e-6
    assert np.abs(np.linalg.norm(result, axis=1) - 0.6).max() < 1e-6 and (result[:, 0] > 0.5).all()
    height = built.maps["damp"].sample(built.ground.meshes, ants.footing)
    assert np.abs(height - place[:, 1]).max() < 1e-4  # what is linear on each face is read exactly


def test_faces_may_be_painted_and_other_surfaces_have_nothing() -> None:
    floor, plate = meshes.grid(400.0, 2), meshes.box((-220, 0, -20), (-201, 5, 20))
    values = np.zeros((8, 3))
    values[:, 2] = np.linspace(0.1, 0.8, 8)
    surfaces = {"plate": MeshData(*plate), "ground": MeshData(*floor)}
    built = world(
        PaintedValues("ground", values, is_per_face=True), surfaces=surfaces, maps={"damp": PaintedValues("plate", np.ones(8))}
    )
    on_floor, _ = built.ground.place_points(np.array([[-150.0, 0, -120], [-210, 9, 0]]), built.up)
    result = built.flows["drift"].sample(built.ground.meshes, on_floor, np.zeros((2, 3)), np.zeros((2, 3)))[2]
    assert result[0] in np.float32(values[:, 2]) and result[1] == 0
    assert built.maps["damp"].sample(built.ground.meshes, on_floor).tolist() == [0, 1]


def test_a_map_is_a_density_for_placing() -> None:
    """Of agents that take no room: others keep each other from where it is densest."""
    crowd = (CrowdData("ant", 4000, PlacementData(surfaces=("ground",), density="damp")),)
    for cells in (1, 16):  # painted from nothing at the left to 1 at the right
        built = world(cells=cells, radius="0 mm", crowds=crowd)
        x = np.sort(built.populations["ant"].position[:, 0])
        share = ((x + 200) / 400) ** 2
        assert np.abs(share - (np.arange(4000) + 0.5) / 4000).max() < 0.03  # Kolmogorov's bound at one in a thousand
        z = np.sort(built.populations["ant"].position[:, 2])
        assert np.abs((z + 200) / 400 - (np.arange(4000) + 0.5) / 4000).max() < 0.03
    few = world(radius="0 mm", crowds=(replace(crowd[0], count=100),))
    many = world(radius="0 mm", crowds=(replace(crowd[0], count=300),))
    assert np.array_equal(few.populations["ant"].position, many.populations["ant"].position[:100])


# --- solved ----------------------------------------------------------------------------------------------------------

STONE = {"rock": MeshData(*meshes.ball(40.0))}


@pytest.mark.parametrize("cells", [1, 25])
def test_paths_without_obstacles_are_straight(cells: int) -> None:
    built = world(SolvedFlowData(GOAL, cell=6.0), cells)
    points = [(x, z) for x in range(-180, 100, 31) for z in range(-180, 181, 45)]
    result = read(built, *points)
    path = np.array([[150 - x, 0, -z] for x, z in points], float)
    cosine = (result * path).sum(axis=1) / np.linalg.norm(path, axis=1)
    assert np.degrees(np.arccos(np.clip(cosine, -1, 1))).max() < 6


def test_agents_get_round_a_wall_to_the_nest_where_a_flow_straight_to_it_ends() -> None:
    wall = {"rock": MeshData(*meshes.box((-3, -10, -60), (3, 20, 60)))}  # thinner than the floor's triangles
    built = world(SolvedFlowData(GOAL, clearance=8.0), 20, obstacles=wall)
    start_state = take_checkpoint(built)
    positions = run(built, 400)
    assert (away(built, 150, 0) < 20).all()
    crossing = np.abs(positions[:, :, 0]).argmin(axis=0)
    assert (np.abs(positions[crossing, np.arange(30), 2]) > 60).all()
    restore_checkpoint(built, start_state)
    set_flow(built, "drift", SpreadFlowData("toward", GOAL))
    run(built, 400)
    assert (away(built, 150, 0) > 100).mean() > 0.8


def test_paths_avoid_expensive_areas() -> None:
    ridge = meshes.grid(400.0, 50, lambda x, z: 20 * np.exp(-((x / 25) ** 2) - (np.maximum(z - 60, 0) / 25) ** 2))
    surfaces = {"ground": MeshData(*ridge)}
    damp = np.where((np.abs(ridge[0][:, 0]) < 40) & (ridge[0][:, 2] < 60), 1.0, 0.0)

    maps = {"damp": PaintedValues("ground", damp)}
    crowd = (CrowdData("ant", 1, PlacementData(points=np.array([[-150.0, 0, 0]]))),)
    built = world(surfaces=surfaces, maps=maps, crowds=crowd)
    start_state = take_checkpoint(built)

    def crossing(flow: SolvedFlowData) -> float:
        restore_checkpoint(built, start_state)
        set_flow(built, "drift", flow)
        positions = run(built, 420)[:, 0]
        assert np.linalg.norm(positions[-1, [0, 2]] - [150, 0]) < 20
        return float(positions[np.abs(positions[:, 0]).argmin(), 2])

    assert crossing(SolvedFlowData(GOAL)) < 60
    assert crossing(SolvedFlowData(GOAL, slope=6.0)) > 80
    assert crossing(SolvedFlowData(GOAL, maps={"damp": 5.0})) > 55
    assert crossing(SolvedFlowData(GOAL, slope=6.0, maps={"damp": -4.0})) < 60


def test_curves_can_be_goals_and_unreachable_points_have_no_flow() -> None:
    built = world(SolvedFlowData(LINE), 20, obstacles={"rock": MeshData(*meshes.box((100, -5, 100), (160, 5, 160)))})
    result = read(built, (0, 150), (-150, -150), (130, 130))
    assert result[0, 2] < -0.9 and result[1, 2] > 0.7
    assert np.abs(result[2]).max() == 0  # in the rock


def test_paths_cross_between_stacked_surfaces() -> None:
    mound = meshes.ball(60.0, (150.0, -30.0, 0.0))
    surfaces = {"ground": MeshData(*meshes.grid(400.0, 40)), "mound": MeshData(*mound)}
    top = FlowTarget(np.array([[150.0, 30.0, 0.0]]), np.array([5.0]))
    built = world(SolvedFlowData(top), surfaces=surfaces, maps={"damp": PaintedValues("mound", np.ones(len(mound[0])))})
    run(built, 420)
    ants = built.populations["ant"]
    assert (ants.footing.mesh == 1).mean() > 0.9 and (ants.position[:, 1] > 20).mean() > 0.8


# --- a crowd that counts ---------------------------------------------------------------------------------------------

CROWDED = SolvedFlowData(GOAL, crowding=4.0, interval=0.25, cell=12.0)


def test_paths_avoid_crowds() -> None:
    blocked = np.array([[x, 0.0, z] for x in range(-60, 61, 4) for z in range(-60, 61, 4)])
    crowd = (CrowdData("ant", len(blocked), PlacementData(points=blocked)),)
    built = world(CROWDED, steer="halt()", crowds=crowd)
    previous = read(built, (-100, 30))[0]
    run(built, 1)
    following = read(built, (-100, 30))[0]
    assert previous[2] < 0 and following[2] > 0.3, (previous, following)


@pytest.mark.parametrize(
    "options", [Options(backend="reference"), Options(chunk=7, shuffle_rows=3), Options(threads=2, chunk=9)], ids=str
)
def test_the_same_hash_at_every_frame(options: Options) -> None:
    def hashes(options: Options) -> list[str]:
        built = world(CROWDED, 6, options=options, obstacles=STONE)
        result = []
        for _ in range(9):
            step(built)
            result.append(state_hash(built))
        return result

    assert hashes(options) == hashes(Options())


def test_checkpoints_between_crowd_updates_continue_equally() -> None:
    built = world(CROWDED, 6)
    run(built, 9)  # the crowd was last looked at three frames ago
    other = world(CROWDED, 6, options=Options(shuffle_rows=5))
    restore_checkpoint(other, take_checkpoint(built))
    assert state_hash(other) == state_hash(built)
    for _ in range(8):
        step(built)
        step(other)
        assert state_hash(other) == state_hash(built)


# --- what moves ------------------------------------------------------------------------------------------------------


def test_flows_follow_moving_targets() -> None:
    path = np.linspace([150.0, 0, 0], [-150.0, 0, 150.0], 120)[:, None]
    goal = replace(GOAL, name="nest", item_index=0)
    for flow in (SpreadFlowData("toward", goal), SolvedFlowData(goal, interval=0.5)):
        built = world(flow, motion=GeometryMotion(items={"nest": path}))
        assert read(built, (0, 150))[0, 0] > 0.4
        run(built, 119)
        assert read(built, (0, 150))[0, 0] < -0.9
        assert (away(built, -150, 150) < 125).all()  # 150 off at first, and led the other way before


def test_paths_avoid_moving_obstacles() -> None:
    stone = meshes.ball(45.0)
    displacement = np.zeros((30, len(stone[0]), 3))
    displacement[10:, :, 2] = 150  # in one go, at frame 10
    moves = GeometryMotion(meshes={"rock": MeshMotion.from_positions(stone[0] + displacement)})
    built = world(
        SolvedFlowData(GOAL, clearance=10.0, interval=0.5), 30, obstacles={"rock": MeshData(*stone)}, motion=moves, steer="halt()"
    )
    assert abs(read(built, (-60, 4))[0, 2]) > 0.5
    run(built, 10)
    assert abs(read(built, (-60, 4))[0, 2]) > 0.5  # not looked at since
    run(built, 3)
    assert abs(read(built, (-60, 4))[0, 2]) < 0.2
    other = world(
        SolvedFlowData(GOAL, clearance=10.0, interval=0.5), 30, obstacles={"rock": MeshData(*stone)}, motion=moves, steer="halt()"
    )
    restore_checkpoint(other, take_checkpoint(built))
    assert state_hash(other) == state_hash(built)
    assert np.array_equal(read(other, (-60, 4)), read(built, (-60, 4)))
    for each in (built, other):
        run(each, 12)
    assert state_hash(other) == state_hash(built)


def test_painted_vectors_rotate_with_their_ground() -> None:
    floor = meshes.grid(400.0, 8)
    angle = np.radians(np.arange(31) * 3.0)
    turned = np.stack(
        [
            np.stack([x * np.cos(a) + z * np.sin(a), y, z * np.cos(a) - x * np.sin(a)], axis=1)
            for a in angle
            for x, y, z in [floor[0].T]
        ]
    )
    built = world(
        PaintedValues("ground", np.tile([0.5, 0, 0], (len(floor[0]), 1))),
        motion=GeometryMotion(meshes={"ground": MeshMotion.from_positions(turned)}),
        steer="halt()",
    )
    run(built, 30)
    assert np.abs(read(built, (0, 0), (50, 50)) - [0, 0, -0.5]).max() < 1e-6


# --- while it runs ---------------------------------------------------------------------------------------------------


def test_reload_replaces_a_flow() -> None:
    built = world()
    run(built, 20)
    previous_distances = away(built, 150, 0)
    set_flow(built, "drift", SpreadFlowData("away", GOAL))
    run(built, 40)
    assert (away(built, 150, 0) > previous_distances).all()
    with pytest.raises(KeyError):
        set_flow(built, "drifft", SpreadFlowData("away", GOAL))
    with pytest.raises(BindError) as caught:
        set_flow(built, "drift", SpreadFlowData("away", GOAL, 100.0, cell=1e-3))
    assert [d.code for d in caught.value.report.errors] == ["flow-too-fine"]


def test_flows_and_maps_are_values_in_expressions() -> None:
    built = world(
        SpreadFlowData("toward", GOAL, strength=0.5), steer="if damp > 0.5 then drift * 2 else mix(drift, heading, damp)"
    )
    run(built, 3)
    ants = built.populations["ant"].now
    x = built.populations["ant"].position[:, 0]
    assert np.abs(ants["felt"] - 0.5).max() < 0.01 and np.abs(ants["wet"] - (x + 200) / 400).max() < 0.01
