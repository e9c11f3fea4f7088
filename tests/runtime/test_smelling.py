"""A field read ahead of the feet: where a straight way over the surface ends, against places computed by hand."""

from __future__ import annotations

from collections.abc import Sequence

import meshes
import numpy as np
from meaning import OPTION_SETS
from plan_text import plan_of

from antdsl.machine_code import llvm_compiler
from antdsl.passes import optimise_plan
from antdsl.runtime import CrowdData, MeshData, Options, PlacementData, World, WorldSetting, bind, state_hash, step
from antdsl.runtime.backends.native.programs import WorldFacts
from antdsl.runtime.moving import moving_geometry
from antdsl.scene.setting import GeometryMotion, SolidData
from antdsl.scene.staging.motion import MeshMotion

CELL = 2.0
NATIVE = Options(backend="native", chunk=8, threads=2, wait_for_code=True)
BOTH = OPTION_SETS[::2]
EVERY = (*OPTION_SETS, NATIVE) if llvm_compiler.is_available() else OPTION_SETS
Place = tuple[float, float, float]


def program(ahead: str, turn: str) -> str:
    return f"""species a {{
got = 0
state p {{ got = smell(scent, ahead: {ahead}, turn: {turn}) }}
}}"""


def world_of(on: str) -> str:
    kind = "solid" if on == "hill" else "surface"
    return f"ant 1\nworld {{ {kind} {on} }}\nfield scent on {on} {{ cell {CELL:g} mm }}\n"


def smelled(
    setting: WorldSetting,
    stands: Sequence[Place],
    faces: Sequence[Place],
    up: Place,
    ahead: str,
    turn: str = "0 deg",
    option_sets: Sequence[Options] = BOTH,
    start_steps: int = 0,
) -> tuple[list[float], World]:
    """What agents that stand there smell after some steps, and the world, in which cells hold their number from 1; the same in
    every way."""
    on = next(iter((*setting.surfaces, *setting.solids)))
    plan = optimise_plan(plan_of(program(ahead, turn), world_of(on)))
    smells, hashes = [], set()
    for options in option_sets:
        world = bind(plan, setting, options)
        for _ in range(start_steps):
            step(world)
        stand(world, np.array(stands, np.float64), np.array(faces, np.float64), np.array(up, np.float64))
        values = world.fields["scent"].amounts
        values[:] = np.arange(len(values)) + 1.0
        step(world)
        ants = world.populations["a"]
        smells.append(ants.now["got"][ants.get_rows_by_id()].tolist())
        hashes.add(state_hash(world))
    assert all(each == smells[0] for each in smells) and len(hashes) == 1
    return smells[0], world


def stand(world: World, points: np.ndarray, heading: np.ndarray, up: np.ndarray) -> None:
    """Put the agents, in order of ids, at the nearest points of the ground, on the side that `up` shows."""
    ants = world.populations["a"]
    rows = np.argsort(ants.get_rows_by_id())
    ground = world.ground
    points, heading = points[rows], heading[rows]
    footing, _ = ground.find_nearest(points)
    moved = ground.move(footing, np.zeros_like(points), heading, np.broadcast_to(up, points.shape), 4.0)
    ants.footing, ants.position, ants.normal = moved.footing, moved.position, moved.up.astype(np.float32, order="C")
    for name, vectors in (("position", moved.position), ("up", moved.up), ("heading", moved.heading)):
        for k, axis in enumerate("xyz"):
            for held in (ants.now, ants.start):
                held[f"{name}.{axis}"][:] = vectors[:, k]


def cell(world: World, place: Place, normal: Place) -> float:
    """What the cell at a place holds, of those that face that way: looked for among all cells."""
    cells = world.fields["scent"].cells
    near = np.abs(cells.position - np.array(place) + world.origin).max(axis=1)
    near[cells.normal @ np.array(normal) < 0.5] = np.inf
    at = int(near.argmin())
    assert near[at] <= 0.5 * CELL
    return at + 1.0


def setting(ground: meshes.Mesh, count: int, **setting_arguments: object) -> WorldSetting:
    crowds = (CrowdData("a", count, PlacementData(disc_centre=(0.0, 0.0, 0.0), radius=1.0)),)
    return WorldSetting(crowds=crowds, surfaces={"ground": MeshData(*ground)}, seed=4, **setting_arguments)  # type: ignore[arg-type]


def test_both_borders_of_a_strip_are_read_in_its_own_cells() -> None:
    """They lie where two cells meet, at 31 mm; of voxels there only those beyond one border touch the surface."""
    strip_setting = setting(meshes.grid(62.0, 7), 4)
    stands = [(0.4, 0, 27.3), (0.4, 0, -27.3), (27.3, 0, 8.4), (-27.3, 0, 8.4)]
    faces = [(1, 0, 0), (-1, 0, 0), (0, 0, -1), (0, 0, 1)]
    got, world = smelled(strip_setting, stands, faces, (0, 1, 0), "10 mm", "-90 deg")
    ends = [(0.4, 0, 30), (0.4, 0, -30), (30, 0, 8.4), (-30, 0, 8.4)]
    assert got == [cell(world, end, (0, 1, 0)) for end in ends]


def test_ahead_and_to_the_left_and_right_on_a_plane() -> None:
    """Up is y and they face x, so left is -z. The middles of cells lie at even numbers."""
    plane_setting = setting(meshes.grid(60.0, 7), 3)
    stands, faces = [(0.4, 0, 0.3), (8.4, 0, 8.0), (-20.0, 0, 4.4)], [(1, 0, 0), (0, 0, 1), (-1, 0, 0)]
    for turn, ends in (
        ("0 deg", [(10.4, 0, 0.3), (8.4, 0, 18), (-30, 0, 4.4)]),
        ("90 deg", [(0.4, 0, -9.7), (18.4, 0, 8), (-20, 0, 14.4)]),
        ("-30 deg", [(9.06, 0, 5.3), (3.4, 0, 16.66), (-28.66, 0, -0.6)]),
    ):
        got, world = smelled(plane_setting, stands, faces, (0, 1, 0), "10 mm", turn)
        assert got == [cell(world, end, (0, 1, 0)) for end in ends], turn


def test_over_the_edge_of_a_box_and_not_through_the_air() -> None:
    """2.5 mm before the edge and 8 mm ahead: 5.5 mm down the wall. At 45 degrees the way goes on as the edge unfolds."""
    box_setting = setting(meshes.box((-20, 0, -20), (20, 16, 20)), 2)
    stands, faces = [(17.5, 16, 0.0), (-6.0, 16, -17.0)], [(1, 0, 0), (0, 0, -1)]
    got, world = smelled(box_setting, stands, faces, (0, 1, 0), "8 mm")
    assert got == [cell(world, (20, 10.5, 0), (1, 0, 0)), cell(world, (-6, 11, -20), (0, 0, -1))]
    # 10 * sqrt(1/2) = 7.07: 2.5 to the edge, 4.57 down, and 7.07 to the left (-z); 3 of 7.07 to the edge, to -x for the other
    got, world = smelled(box_setting, stands, faces, (0, 1, 0), "10 mm", "45 deg", option_sets=EVERY)
    assert got == [cell(world, (20, 11.43, -7.07), (1, 0, 0)), cell(world, (-13.07, 11.93, -20), (0, 0, -1))]


def test_on_an_underside_and_round_to_the_upper_side() -> None:
    """Head down, facing x, left is +z. The plate is 3 mm thick: from 2 mm before its edge 2 + 3 + 3 mm lead to the upper side."""
    plate_setting = setting(meshes.box((-20, 10, -20), (20, 13, 20)), 2)
    stands, faces = [(0.2, 10, 0.2), (18.0, 10, 6.0)], [(1, 0, 0), (1, 0, 0)]
    got, world = smelled(plate_setting, stands, faces, (0, -1, 0), "8 mm")
    assert got == [cell(world, (8.2, 10, 0.2), (0, -1, 0)), cell(world, (17, 13, 6), (0, 1, 0))]
    got, world = smelled(plate_setting, stands, faces, (0, -1, 0), "8 mm", "90 deg")
    assert got == [cell(world, (0.2, 10, 8.2), (0, -1, 0)), cell(world, (18, 10, 14), (0, -1, 0))]


def test_a_way_ends_at_a_border() -> None:
    """3 mm before the border of a plate, 12 mm ahead, 60 degrees to the side: it ends 5.2 mm along, where it meets it."""
    plate_setting = setting(meshes.grid(40.0, 5), 1)
    for turn, z in (("60 deg", -5.196), ("-60 deg", 5.196), ("0 deg", 0.0)):
        got, world = smelled(plate_setting, [(17.0, 0, 0.0)], [(1, 0, 0)], (0, 1, 0), "12 mm", turn)
        assert got == [cell(world, (20, 0, z), (0, 1, 0))], turn


def test_on_a_solid_and_where_there_is_no_number() -> None:
    box = meshes.box((-20, 0, -20), (20, 16, 20))
    crowds = (CrowdData("a", 2, PlacementData(disc_centre=(0.0, 0.0, 0.0), radius=1.0)),)
    solid_setting = WorldSetting(crowds=crowds, solids={"hill": SolidData(MeshData(*box), 1.0)}, seed=4)
    stands, faces = [(0.0, 16, 0.0), (-8.0, 16, 4.0)], [(1, 0, 0), (0, 0, 1)]
    got, world = smelled(solid_setting, stands, faces, (0, 1, 0), "8 mm")
    assert got == [cell(world, (8, 16, 0), (0, 1, 0)), cell(world, (-8, 16, 12), (0, 1, 0))]
    got, world = smelled(solid_setting, stands, faces, (0, 1, 0), "8 mm / (got - got)")
    assert got == [cell(world, (0, 16, 0), (0, 1, 0)), cell(world, (-8, 16, 4), (0, 1, 0))]


def test_on_ground_that_has_moved_the_cells_go_along() -> None:
    """A plate that has been turned by a quarter about y: the cell ahead is the one that lay there at rest."""
    ground = meshes.grid(60.0, 7)
    poses = np.repeat(np.eye(3, 4)[None], 6, axis=0)
    poses[1:, :, :3] = np.array([[0, 0, 1], [0, 1, 0], [-1, 0, 0]])  # x goes to -z
    moves = GeometryMotion(meshes={"ground": MeshMotion.from_transforms(poses, len(ground[0]))})
    got, world = smelled(setting(ground, 1, motion=moves), [(0.2, 0, 0.2)], [(0, 0, -1)], (0, 1, 0), "10 mm", start_steps=2)
    assert got == [cell(world, (10, 0, 0), (0, 1, 0))]
    assert moving_geometry.get_moving_ground(world) is not None and WorldFacts.from_setting(world.setting) == WorldFacts(
        has_moving_ground=True, has_detail_levels=False
    )
