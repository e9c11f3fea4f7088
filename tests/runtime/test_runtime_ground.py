"""Agents on real ground: no agent leaves the surface or enters a stone, fields and rays work, both backends agree."""

from __future__ import annotations

import meshes
import numpy as np
import plans
import pytest

from antdsl.plan import ir
from antdsl.runtime import BindError, Options, bind, restore_checkpoint, state_hash, step, take_checkpoint
from antdsl.scene.setting import CrowdData, FieldStartData, FlowTarget, MeshData, PaintedValues, PlacementData, SpreadFlowData


def mesh(vertices_and_faces: meshes.Mesh, shift: float = 0.0) -> MeshData:
    return MeshData(vertices_and_faces[0] + np.array([shift, 0.0, shift]), vertices_and_faces[1])


def box(middle: tuple[float, float, float], half: float) -> meshes.Mesh:
    return meshes.box(*(tuple(m + sign * half for m in middle) for sign in (-1, 1)))  # type: ignore[arg-type]


def surfaces_plan(diffuse: float = 20.0, cell: float = 5.0) -> ir.Plan:
    """Ants that climb scent, turn from stones, follow a curve, and lay scent where they are."""
    t = plans.Text()
    h = t.vector("heading")
    ray = t("ray", *h, t("mul", t.snap("size"), 3.0), attrs=("stones",))
    near = t("obstacle.near", 6.0, attrs=("stones",))
    best = t("field.strongest", attrs=("trail", 16))
    slope = t("field.gradient", attrs=("trail",))
    ahead = t("field.ahead", 7.0, 0.5, attrs=("trail",))
    curve = t("curve.closest", attrs=("way",))
    rate = t("mul", 2.0, t("run", attrs=("dt",)))
    drift = t("flow.value", attrs=("drift",))
    act = plans.block(
        plans.store("hits", t("add", t.snap("hits"), t("number", t.get(ray, 0)))),
        plans.store("close", t("max", t.snap("close"), t("where", t.get(near, 0), t("sub", 6.0, t.get(near, 1)), 0.0))),
        plans.when(t("surface.touching", attrs=("ground",)), ir.Request("deposit", "trail", (rate,), None)),
        plans.when(t("surface.touching", attrs=("lid",)), plans.store("hits", t.b.add_number(-1000))),
        plans.store("smell", t("add", t("add", t("field.value", attrs=("trail",)), ahead), t("map.value", attrs=("damp",)))),
    )
    push = []
    for k, a in enumerate("xyz"):
        turn = t("where", t.get(ray, 0), t("mul", t.get(ray, 2 + k), 0.6), t("mul", t.get(near, 2 + k), 0.2))
        climb = t("mul", t("sub", t.get(best, 1 + k), t.snap(f"position.{a}")), 0.02)
        lead = t(
            "add",
            t("mul", t("add", t.get(curve, 4 + k), t.get(drift, k)), 0.1),
            t("mul", t("sub", t.get(curve, 1 + k), t.snap(f"position.{a}")), t("div", 0.2, t("add", 50.0, t.get(curve, 0)))),
        )
        uphill = t("max", -0.1, t("min", 0.1, t.get(slope, k)))
        noise = t("mul", t("sub", t.draw("n", k), 0.5), 0.2)
        push.append(
            plans.store(
                f"push.{a}",
                t("add", t("add", t("mul", h[k], 0.5), t("add", turn, climb)), t("add", t("add", lead, noise), uphill)),
            )
        )
    fields = {
        "trail": ir.FieldPlan(
            "trail", ("ground", "boulder"), t.b.add_number(cell), t.b.add_number(0.98), t.b.add_number(diffuse), "add", None, None
        )  # type: ignore[arg-type]
    }
    names = ("ground", "boulder")
    return plans.bare(
        act,
        "hits",
        "close",
        "smell",
        blend=plans.block(*push),
        fields=fields,
        thing_names_by_kind={"surface": names, "obstacle": ("stones",), "curve": ("way",), "flow": ("drift",), "map": ("damp",)},
    )


def surfaces_setting(count: int = 60, shift: float = 0.0, **setting_arguments):
    move = np.array([shift, 0.0, shift])

    from antdsl.runtime import WorldSetting

    ground = mesh(meshes.grid(200.0, 24, lambda x, z: 8 * np.sin(x / 25) * np.cos(z / 30)), shift)
    line = FlowTarget(np.array([[-90.0, 0, 0], [90, 0, 40]]) + move, np.zeros(2), is_line=True)
    default_setting = dict(
        seed=5,
        flows={"drift": SpreadFlowData("tangent", line, 60.0)},
        maps={"damp": PaintedValues("ground", np.abs(ground.vertices[:, 1]) / 8)},
        surfaces={"ground": ground, "boulder": mesh(box((-40.0, 2.0, 30.0), 14.0), shift)},
        obstacles={"stones": mesh(box((25.0, 0.0, 0.0), 12.0), shift)},
        curves={"way": np.array([[-90.0, 0, -60], [0, 0, -40], [90, 0, -60]]) + move},
        crowds=(
            CrowdData("ant", count, PlacementData(surfaces=("ground",), disc_centre=(20.0 + shift, 0.0, shift), radius=60.0)),
        ),
        field_start={"trail": (FieldStartData(0.5, (shift, 0.0, -60.0 + shift), 30.0),)},
    )
    return WorldSetting(**{**default_setting, **setting_arguments})


def off_surface(world) -> float:
    population = world.populations["ant"]
    return float(np.abs(world.ground.position(population.footing) - population.position).max())


def in_a_stone(world, shift: float = 0.0) -> int:
    away = np.abs(world.populations["ant"].position + world.origin - np.array([25.0 + shift, 0.0, shift]))
    return int(np.count_nonzero((away < 12.0 - 1e-3).all(axis=1)))


def test_two_hundred_steps_on_hills():
    world = bind(surfaces_plan(), surfaces_setting(), Options())
    assert in_a_stone(world) == 0
    walked_on: set[int] = set()
    for _ in range(200):
        step(world)
        assert off_surface(world) < 1e-9 and in_a_stone(world) == 0
        walked_on |= {int(m) for m in world.populations["ant"].footing.mesh}
    population = world.populations["ant"]
    now = population.now
    heading, up = population.read_vector("heading"), population.read_vector("up")
    assert np.abs((heading * up).sum(1)).max() < 1e-4 and np.abs((heading**2).sum(1) - 1).max() < 1e-5
    assert now["hits"].max() > 0 and now["close"].max() > 0 and now["hits"].min() >= 0
    assert world.fields["trail"].amounts.sum() > 50 and now["smell"].max() > 0
    assert len(walked_on) == 2, "some were on the boulder"
    assert world.faults.fault_count == 0 and world.motion.summarise()["standing"] < 0.3


@pytest.mark.parametrize(
    "options", [Options(chunk=7, shuffle_rows=4), Options(threads=2, chunk=11), Options(backend="reference")], ids=str
)
def test_the_same_hash_on_ground(options):
    def run(options: Options) -> list[str]:
        world = bind(surfaces_plan(), surfaces_setting(30), options)
        hashes = [state_hash(world)]
        for _ in range(10):
            step(world)
            hashes.append(state_hash(world))
        return hashes

    assert run(options) == run(Options())


def test_a_checkpoint_goes_on_to_the_same_hashes():
    world = bind(surfaces_plan(), surfaces_setting(30), Options())
    for _ in range(5):
        step(world)
    saved = take_checkpoint(world)
    other = bind(surfaces_plan(), surfaces_setting(30), Options(shuffle_rows=9))
    restore_checkpoint(other, saved)
    assert state_hash(other) == state_hash(world)
    for _ in range(6):
        step(world)
        step(other)
        assert state_hash(other) == state_hash(world)
    assert other.motion.summarise() == world.motion.summarise()


def test_far_from_the_origin_nothing_is_coarse():
    near = bind(surfaces_plan(), surfaces_setting(30), Options())
    far = bind(surfaces_plan(), surfaces_setting(30, shift=3e6), Options())
    for _ in range(20):
        step(near)
        step(far)
    assert far.origin.any() and off_surface(far) < 1e-9 and in_a_stone(far, 3e6) == 0
    far_positions = far.populations["ant"].position + far.origin - np.array([3e6, 0.0, 3e6])
    assert np.abs(far_positions - near.populations["ant"].position).max() < 1.0


@pytest.mark.parametrize(
    "diffuse, cell, code", [(1e4, 5.0, "unstable-field"), (0.0, 1e-3, "field-too-fine"), (0.0, 0.0, "field-setting")]
)
def test_a_field_that_cannot_be_bound_says_so(diffuse, cell, code):
    with pytest.raises(BindError) as caught:
        bind(surfaces_plan(diffuse, cell), surfaces_setting(5), Options())
    assert [d.code for d in caught.value.report.errors] == [code]


def test_more_agents_leave_the_first_as_they_were():
    few = bind(surfaces_plan(), surfaces_setting(40), Options())
    many = bind(surfaces_plan(), surfaces_setting(60), Options())
    for name, array in few.populations["ant"].now.items():
        assert np.array_equal(array, many.populations["ant"].now[name][:40]), name
