"""Whether a path leads to the target of a flow: what agents read of it on every backend, and what is reported of a crowd."""

from __future__ import annotations

import numpy as np
import pytest
from commands import run as command
from compilers import need_llvmlite
from meshes import ball, box, grid
from test_program import checked, complaints

from antdsl import passes, plan
from antdsl.runtime import Options, World, bind, restore_checkpoint, state_hash, step, take_checkpoint
from antdsl.runtime.backends.native.native_backend import NativeBackend
from antdsl.runtime.binding.start_findings import count_agents_with_path
from antdsl.scene.setting import (
    BorderFlowData,
    CrowdData,
    FlowData,
    FlowTarget,
    ItemData,
    MeshData,
    PlacementData,
    SolidData,
    SolvedFlowData,
    SpreadFlowData,
    WorldSetting,
)

PROGRAM = """ant 1
use steering
world { surface ground; surface isle; obstacle rock; flow drift; items nest }
species ant {
  leads = 2
  on spawn { velocity = vector(0 mm/s, 0 mm/s, 0 mm/s); heading = vector(0, 0, 1) }
  state s { steer along(drift); leads = if reachable(drift) then 1 else 0 }
}
species bird { state s { steer halt() } }
"""
GOAL = FlowTarget(np.array([[0.0, 0.0, 0.0]]), np.array([10.0]))
INSIDE, OUTSIDE = (0.0, 0.0, 20.0), (-150.0, 0.0, 0.0)


def joined(*parts: tuple[np.ndarray, np.ndarray]) -> MeshData:
    """Meshes as one."""
    first = np.cumsum([0, *(len(vertices) for vertices, _ in parts)])
    return MeshData(
        np.concatenate([vertices for vertices, _ in parts]),
        np.concatenate([faces + at for (_, faces), at in zip(parts, first[:-1], strict=True)]),
    )


def walls(opening: float = 0.0) -> MeshData:
    """Four walls about the origin, 160 mm wide, with an opening of this width in one of them."""
    sides = [box((-86, -10, -86), (86, 20, -80)), box((-86, -10, 80), (86, 20, 86)), box((80, -10, -86), (86, 20, 86))]
    for low, high in ((-86.0, -opening / 2), (opening / 2, 86.0)):
        sides.append(box((-86, -10, low), (-80, 20, high)))
    return joined(*sides)


def compiled(text: str = PROGRAM) -> plan.ir.Plan:
    program, report = checked(text)
    assert report.ok, complaints(report)
    lowered, report = plan.lower(program)
    assert complaints(report) == []
    return passes.optimise_plan(lowered)


def world(
    flow: FlowData | None = None, *, opening: float = 0.0, options: Options | None = None, count: int = 9, **changes: object
) -> World:
    """Ants inside of the walls and outside, as many each."""
    crowds = [CrowdData("ant", count, PlacementData(disc_centre=at, radius=15.0)) for at in (INSIDE, OUTSIDE)]
    defaults: dict = dict(
        surfaces={"ground": MeshData(*grid(400.0, 40))},
        obstacles={"rock": walls(opening)},
        items={"nest": (ItemData("home", (0.0, 0, 0), 10.0),)},
        flows={"drift": flow or SolvedFlowData(GOAL)},
        crowds=tuple(crowds) if count else (),
    )
    return bind(compiled(), WorldSetting(**{**defaults, **changes}), options or Options())


def leads(new_world: World) -> np.ndarray:
    """What agents read in a step, in the order of ids: nine inside, then nine outside."""
    step(new_world)
    ants = new_world.populations["ant"]
    return ants.now["leads"][ants.get_rows_by_id()]


BACKENDS = [
    Options(backend="reference"),
    Options(backend="numpy"),
    Options(backend="numpy", chunk=4, shuffle_rows=5),
    Options(backend="native", wait_for_code=True),
]


@pytest.mark.parametrize("options", BACKENDS, ids=str)
def test_a_closed_wall_cuts_off_those_outside_on_every_backend(options: Options) -> None:
    if options.backend == "native":
        need_llvmlite()
    new_world = world(options=options)
    assert count_agents_with_path(new_world, "ant", "drift") == 9
    assert leads(new_world).tolist() == [1] * 9 + [0] * 9
    assert isinstance(new_world.backend, NativeBackend) == (options.backend == "native")


@pytest.mark.parametrize("options", BACKENDS, ids=str)
def test_without_agents_nothing_is_computed(options: Options) -> None:
    if options.backend == "native":
        need_llvmlite()
    new_world = world(options=options, count=0)
    assert count_agents_with_path(new_world, "ant", "drift") == 0 and len(leads(new_world)) == 0


def test_backends_agree_to_the_bit() -> None:
    need_llvmlite()
    hashes = []
    for options in BACKENDS:
        new_world = world(options=options, opening=30.0)
        for _ in range(5):
            step(new_world)
        hashes.append(state_hash(new_world))
    assert len(set(hashes)) == 1


def test_unreachable_agents_do_not_pass_the_wall() -> None:
    new_world = world()
    for _ in range(150):
        step(new_world)
    place = new_world.populations["ant"].position + new_world.origin
    inside = (np.abs(place[:, [0, 2]]) < 83).all(axis=1)
    assert inside.sum() == 9
    assert np.hypot(place[:, 0] - OUTSIDE[0], place[:, 2] - OUTSIDE[2])[~inside].max() < 30, "they have no direction"


@pytest.mark.parametrize(("opening", "clearance", "reached"), [(40.0, 0.0, 18), (40.0, 60.0, 18), (0.0, 60.0, 9)])
def test_an_opening_makes_the_inside_reachable(opening: float, clearance: float, reached: int) -> None:
    """`clearance` makes a path dear, and closes none."""
    assert count_agents_with_path(world(SolvedFlowData(GOAL, clearance=clearance), opening=opening), "ant", "drift") == reached


def test_islands_and_targets_off_the_ground() -> None:
    vertices, faces = grid(100.0, 10)
    isle = MeshData(vertices + np.array([600.0, 0.0, 0.0]), faces)
    surfaces = {"ground": MeshData(*grid(400.0, 40)), "isle": isle}
    far_target = FlowTarget(np.array([[600.0, 0, 0]]), np.array([10.0]))
    island_setting = dict(surfaces=surfaces, obstacles={"rock": MeshData(*ball(5.0, (180, 0, 180)))})
    assert count_agents_with_path(world(SolvedFlowData(far_target), **island_setting), "ant", "drift") == 0, "on another island"
    assert count_agents_with_path(world(SolvedFlowData(GOAL), **island_setting), "ant", "drift") == 18
    assert count_agents_with_path(world(SolvedFlowData(GOAL, surfaces=("isle",)), **island_setting), "ant", "drift") == 0, (
        "they stand on no face of the flow"
    )
    off = FlowTarget(np.array([[-400.0, 0, 0]]), np.array([1.0]))
    assert count_agents_with_path(world(SolvedFlowData(off)), "ant", "drift") == 9, "the ground nearest to it is its goal"


@pytest.mark.parametrize(
    ("flow", "reached"),
    [
        (SpreadFlowData("toward", GOAL, radius=60.0), 9),
        (SpreadFlowData("away", GOAL, radius=60.0), 9),
        (SpreadFlowData("toward", GOAL), 18),
        (BorderFlowData(("ground",), 90.0), 9),
    ],
    ids=["toward", "away", "everywhere", "border"],
)
def test_other_flows_are_reachable_where_nonzero(flow: FlowData, reached: int) -> None:
    new_world = world(flow)
    assert count_agents_with_path(new_world, "ant", "drift") == reached
    assert leads(new_world).sum() == reached


def test_digging_opens_a_path_that_checkpoints_store() -> None:
    """The ground below a hill is cut off until it is dug free; the flow looks again when it is due."""
    text = PROGRAM.replace("obstacle rock", "solid hill").replace("surface isle; ", "")
    hill = SolidData(MeshData(*box((-250, -10, -40), (250, 25, 40))), 5.0)
    crowd = CrowdData("ant", 4, PlacementData(points=np.array([[10.0 * k, 0, -150.0] for k in range(4)])))
    goal = FlowTarget(np.array([[0.0, 0.0, 150.0]]), np.array([10.0]))
    lowered = compiled(text)

    def start_world() -> World:
        flows = {"drift": SolvedFlowData(goal, interval=0.25)}
        setting = WorldSetting(
            surfaces={"ground": MeshData(*grid(400.0, 40))}, solids={"hill": hill}, flows=flows, crowds=(crowd,)
        )
        return bind(lowered, setting, Options(backend="numpy"))

    new_world = start_world()
    assert leads(new_world).tolist() == [0] * 4
    z = np.linspace(-45, 45, 40)
    new_world.solids["hill"].carve_balls(np.stack([0 * z, 0 * z, z], axis=1), np.full(40, 30.0), np.arange(40))
    assert leads(new_world).tolist() == [0] * 4, "not before it is time to look"
    for _ in range(8):
        flags = leads(new_world)
    assert flags.tolist() == [1] * 4
    again = start_world()
    restore_checkpoint(again, take_checkpoint(new_world))
    assert state_hash(again) == state_hash(new_world)
    assert leads(again).tolist() == leads(new_world).tolist() == [1] * 4


WALKER = """ant 1
use steering
world { surface ground; obstacle rock; flow drift }
species walker { state s { steer along(drift) } }
species bird { state s { steer halt() } }
spec "all get there" on "scene.yaml" { for 0.2 s; each walker { always: reachable(drift) } }
"""
SCENE = """antdsl: 1
frames: 1..2
world:
  ground: {mesh: ground.obj}
  rock: {mesh: rock.obj}
  drift: {solved: [0, 0, 0]}
crowd:
  - {species: walker, from: walker.ant, count: COUNT, place: {on: ground, around: [-150, 0, 0], radius: 30 mm}}
  - {species: bird, from: walker.ant, count: 3, place: {on: ground, around: [150, 0, 0], radius: 30 mm}}
"""


def obj(mesh: MeshData) -> str:
    lines = ["v {} {} {}".format(*vertex) for vertex in mesh.vertices.tolist()]
    return "\n".join(lines + ["f {} {} {}".format(*(face + 1)) for face in mesh.faces]) + "\n"


def test_runs_report_unreachable_agents_and_specs_count_them(tmp_path) -> None:  # type: ignore[no-untyped-def]
    (tmp_path / "walker.ant").write_text(WALKER)
    (tmp_path / "ground.obj").write_text(obj(MeshData(*grid(400.0, 40))))
    (tmp_path / "rock.obj").write_text(obj(walls()))
    (tmp_path / "scene.yaml").write_text(SCENE.replace("COUNT", "7"))
    result = command("run", "scene.yaml", "-q", cwd=tmp_path)
    assert result.returncode == 0
    assert "warning[unreachable-target]: 7 of 7 `walker` have no path to the target of `drift`" in result.stderr
    assert "scene.yaml:6:19" in result.stderr and "`bird`" not in result.stderr and "when not reachable(drift)" in result.stderr
    aware = WALKER.replace(
        "steer along(drift) }", "steer along(drift); when not reachable(drift) -> idle }; state idle { steer halt() }"
    )
    (tmp_path / "walker.ant").write_text(aware.replace("walker { ", "walker { start s; ", 1))
    result = command("run", "scene.yaml", "-q", cwd=tmp_path)
    assert "warning[unreachable-target]" in result.stderr and "ignore[unreachable-target] WHY" in result.stderr
    assert "when not" not in result.stderr
    (tmp_path / "walker.ant").write_text(WALKER)
    result = command("test", "walker.ant", "--no-keep", cwd=tmp_path)
    assert result.returncode == 1 and "reachable(drift)" in result.stdout
    (tmp_path / "scene.yaml").write_text(SCENE.replace("COUNT", "0"))
    result = command("run", "scene.yaml", "-q", cwd=tmp_path)
    assert result.returncode == 0 and "unreachable" not in result.stderr, result.stderr
    (tmp_path / "scene.yaml").write_text(SCENE.replace("COUNT", "7"))
    (tmp_path / "rock.obj").write_text(obj(walls(60.0)))
    result = command("run", "scene.yaml", "-q", cwd=tmp_path)
    assert result.returncode == 0 and "unreachable" not in result.stderr, result.stderr
    assert command("test", "walker.ant", "--no-keep", cwd=tmp_path).returncode == 0
    scene = SCENE.replace("COUNT", "7")
    (tmp_path / "scene.yaml").write_text(scene.replace("drift: {solved: [0, 0, 0]}", "drift: {solved: [900, 30, 0]}"))
    result = command("run", "scene.yaml", "-q", cwd=tmp_path)
    assert result.returncode == 0 and "scene.yaml:6:3" in result.stderr, result.stderr
    assert "the target of `drift` is 700.6 mm away from the ground" in result.stderr
