"""Binds a plan to a setting: meshes become ground and ray scenes; items and crowds become arrays. The result is a world at its
first frame."""

from __future__ import annotations

from collections.abc import Iterable
from functools import partial

import numpy as np
from numpy.typing import NDArray

from antdsl.casting.obstacle import Obstacle
from antdsl.casting.rays import RayScene
from antdsl.diagnostics import Report
from antdsl.ground.combined import CombinedGround
from antdsl.ground.mesh.surface import MeshGround
from antdsl.ground.moving import MovingGround
from antdsl.ground.plane import PlaneGround
from antdsl.ground.protocol import Ground
from antdsl.ground.solid import UnusableMesh, Volume
from antdsl.ground.solid_feelers import SolidFeelers
from antdsl.machine_code import machine
from antdsl.numerics import stages
from antdsl.numerics.float_environment import standard_floats
from antdsl.plan import ir
from antdsl.plan.traverse import required_nodes
from antdsl.runtime.backends import BACKENDS
from antdsl.runtime.backends.numpy_backend import uniform_values
from antdsl.runtime.binding.placing import populate
from antdsl.runtime.binding.reuse import BindingCache
from antdsl.runtime.faults import FaultLog
from antdsl.runtime.feet import walking
from antdsl.runtime.motion_measures import MotionMeasures
from antdsl.runtime.moving.moving_geometry import make_curve
from antdsl.runtime.world import AXES, Items, Options, World, empty_population
from antdsl.scene.setting import FlowData, MeshData, WorldSetting, world_origin


class BindError(ValueError):
    """Error for a plan and a setting that do not match; `report` lists the findings."""

    def __init__(self, report: Report) -> None:
        super().__init__("; ".join(d.message for d in report.errors))
        self.report = report


@standard_floats()
def bind(plan: ir.Plan, setting: WorldSetting, options: Options | None = None, *, built: BindingCache | None = None) -> World:
    """Return the world at `setting.first_frame`, with all agents born and none moved.

    `plan`: an optimised and verified plan. `built`: a cache for data made from meshes, for use in other worlds. Raises
        BindError with a report if plan and setting do not match."""
    world = bind_empty(plan, setting, options, built=built)
    stages.begin("placing agents")
    with np.errstate(all="ignore"):
        populate(world)
    stages.begin("feet")
    walking.begin_feet(world)
    return world


@standard_floats()
def bind_empty(
    plan: ir.Plan,
    setting: WorldSetting,
    options: Options | None = None,
    *,
    built: BindingCache | None = None,
    origin: NDArray[np.float64] | None = None,
) -> World:
    """Return a world as `bind` does, but without agents.

    `origin` (mm): an existing origin that positions are relative to. Raises MachineCodeUnavailable if no kernel can run."""
    machine.require()
    options, built = options or Options(), built or BindingCache()
    origin = world_origin(setting) if origin is None else origin
    up = np.asarray(setting.up, np.float64)
    meshes = {name: _moved_mesh(mesh, origin) for name, mesh in {**setting.surfaces, **setting.obstacles}.items()}
    solids = _solids(setting, origin, built)
    surfaces = {name: meshes[name] for name in setting.surfaces}
    stages.begin("ground")
    ground = _ground(surfaces, solids, up, setting.moves.meshes, setting.by_rays, built)
    world = World(
        plan=plan,
        setting=setting,
        options=options,
        up=up / np.sqrt((up[0] * up[0] + up[1] * up[1]) + up[2] * up[2]),
        origin=origin,
        frame=setting.first_frame,
        params={},
        populations={name: empty_population(species, ground) for name, species in plan.species.items()},
        items={name: _items(setting, items, origin) for name, items in plan.items.items()},
        fields={},
        field_rates={},
        obstacles=_make_ray_scenes(meshes, solids, built),
        curves={name: make_curve(setting.curves[name] - origin) for name in plan.of_kind("curve") if name in setting.curves},
        flows={},
        maps={},
        ground=ground,
        surface_index={name: k for k, name in enumerate(setting.surfaces)},
        solids=solids,
        backend=BACKENDS[options.backend](plan),
        faults=FaultLog(),
        motion=MotionMeasures(),
    )
    _params(world)
    stages.begin("fields")
    _fields(world, {**meshes, **{name: _moved_mesh(solid.mesh, origin) for name, solid in setting.solids.items()}}, built)
    _flows(world, built)
    _detail(world, {name: meshes[name] for name in setting.obstacles})
    return world


def set_param(world: World, name: str, value: float) -> None:
    """Change a param from the next step on, without compilation. `value` is in base units."""
    if name not in world.plan.params:
        raise KeyError(name)
    world.params[name] = np.float32(value)


def _moved_mesh(mesh: MeshData, origin: NDArray[np.float64]) -> MeshData:
    return MeshData(mesh.vertices - origin, mesh.faces) if origin.any() else mesh


def _solids(setting: WorldSetting, origin: NDArray[np.float64], built: BindingCache) -> dict[str, Volume]:
    """Return a volume for each solid. Raises BindError if the mesh of a solid is unsuitable."""
    if not setting.solids:
        return {}
    volumes: dict[str, Volume] = {}
    report = Report()
    for name, solid in setting.solids.items():
        mesh = _moved_mesh(solid.mesh, origin)
        volume = built.get_or_make_deep(
            "solid", (mesh, solid.voxel), partial(Volume.from_mesh, mesh.vertices, mesh.faces, solid.voxel)
        )
        if isinstance(volume, UnusableMesh):
            report.error(
                "bad-mesh",
                f"the mesh of the solid `{name}` cannot be dug: {volume.message}",
                setting.spans.get(name),
                volume.help,
            )
        else:
            volumes[name] = volume
    if not report.ok:
        raise BindError(report)
    return volumes


def _ground(
    meshes: dict[str, MeshData],
    solids: dict[str, Volume],
    up: NDArray[np.float64],
    moving: Iterable[str],
    by_rays: bool,
    built: BindingCache,
) -> Ground:
    """Return the ground of agents: a plane, meshes, solids, or meshes with solids."""
    if not meshes and not solids:
        return PlaneGround(up)
    ground = _meshes(meshes, moving, by_rays, built)
    if ground is not None and not solids:
        return ground
    return CombinedGround(ground, solids, up / np.sqrt((up[0] * up[0] + up[1] * up[1]) + up[2] * up[2]))


def _meshes(meshes: dict[str, MeshData], moving: Iterable[str], by_rays: bool, built: BindingCache) -> MeshGround | None:
    """Return the part of the ground that consists of meshes, or None if there are none."""
    surfaces = {name: (mesh.vertices, mesh.faces) for name, mesh in meshes.items()}
    moved = [name for name in moving if name in surfaces]
    if moved:
        make_ground = partial(MovingGround, surfaces, moved, by_rays)
        return built.get_or_make("moving ground", (surfaces, moved, by_rays), make_ground, copied=MovingGround.copy)
    if not surfaces:
        return None
    return built.get_or_make("ground", (surfaces, by_rays), partial(MeshGround, surfaces, by_rays))


def _make_ray_scenes(meshes: dict[str, MeshData], solids: dict[str, Volume], built: BindingCache) -> dict[str, Obstacle]:
    """Return the targets of raycasts, by name: meshes, and solids in their current state."""
    if not meshes and not solids:
        return {}
    scenes: dict[str, Obstacle] = {
        name: built.get_or_make("rays", mesh, partial(RayScene, mesh.vertices, mesh.faces)) for name, mesh in meshes.items()
    }
    return scenes | {name: SolidFeelers(volume) for name, volume in solids.items()}


def _items(setting: WorldSetting, plan: ir.ItemsPlan, origin: NDArray[np.float64]) -> Items:
    items = setting.items.get(plan.name, ())
    position = np.array([item.position for item in items], np.float64).reshape(-1, 3) - origin
    visible_values = {axis: position[:, k].astype(np.float32) for k, axis in enumerate(AXES)}
    visible_values["radius"] = np.array([item.radius for item in items], np.float32)
    amounts = {
        name: np.array([item.attributes.get(name, default) for item in items], np.float64)
        for name, default in plan.attributes.items()
    }
    visible_values |= {name: amount.astype(np.float32) for name, amount in amounts.items()}
    return Items(plan.name, tuple(item.name for item in items), position, amounts, visible_values)


def _params(world: World) -> None:
    """Set params to the scene's values, or else to their defaults."""
    for name, param in world.plan.params.items():
        scene_value = world.setting.params.get(name)
        world.params[name] = np.float32(run_value(world, param.default) if scene_value is None else scene_value)


def run_value(world: World, node: ir.PlanNode) -> float:
    """Return the value of a node that is constant during a run."""
    return float(uniform_values(world, required_nodes((node,)))[node])


def set_flow(world: World, name: str, flow: FlowData) -> None:
    """Replace a flow from the next step on, without compilation. Raises BindError as `bind` does."""
    if name not in world.plan.of_kind("flow"):
        raise KeyError(name)
    from antdsl.runtime.binding.bind_flows import bind_flow

    report = Report()
    bind_flow(world, name, flow, report)
    if not report.ok:
        raise BindError(report)


def _flows(world: World, built: BindingCache) -> None:
    if not world.setting.flows and not world.setting.maps:
        return
    from antdsl.runtime.binding.bind_flows import bind_flows

    report = Report()
    bind_flows(world, report, built)
    if not report.ok:
        raise BindError(report)


def _detail(world: World, obstacles: dict[str, MeshData]) -> None:
    """Add levels of detail if the scene requests them."""
    if world.setting.detail is None:
        return
    from antdsl.runtime.lod import DetailLevels

    world.detail = DetailLevels(world.setting.detail, world.origin, obstacles)


def _fields(world: World, meshes: dict[str, MeshData], built: BindingCache) -> None:
    if not world.plan.fields:
        return
    from antdsl.runtime.binding.bind_fields import bind_fields

    report = Report()
    bind_fields(world, meshes, run_value, report, built)
    if not report.ok:
        raise BindError(report)
