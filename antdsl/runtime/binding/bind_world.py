"""Binds a plan to a setting. Ground and ray scenes are made from meshes, and arrays from items and crowds. The result is a world
at its first frame."""

from __future__ import annotations

from collections.abc import Iterable
from functools import partial
from typing import TYPE_CHECKING

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
from antdsl.ground.solid import UnusableMeshReason, Volume
from antdsl.ground.solid_feelers import SolidProximityQueries
from antdsl.machine_code import llvm_compiler
from antdsl.numerics import stages
from antdsl.numerics.processor.float_environment import use_standard_floats
from antdsl.plan import ir
from antdsl.plan.traverse import collect_required_nodes
from antdsl.runtime.backends import BACKENDS
from antdsl.runtime.backends.numpy_backend import compute_uniform_values
from antdsl.runtime.binding.agent_placement import place_crowds
from antdsl.runtime.binding.binding_cache import BindingCache
from antdsl.runtime.faults import FaultLog
from antdsl.runtime.feet import feet_step
from antdsl.runtime.line_tables import reserve_line_ids
from antdsl.runtime.motion_measures import MotionMeasures
from antdsl.runtime.moving.moving_geometry import make_sampled_curve
from antdsl.runtime.periodic_world import make_periodic_world
from antdsl.runtime.world import AXES, Items, Options, World, make_empty_population
from antdsl.scene.setting import FlowData, MeshData, WorldSetting, compute_world_origin

if TYPE_CHECKING:
    from antdsl.runtime.notes.note_run import ActiveNotesRun


class BindError(ValueError):
    """Error: a plan and a setting do not match. `report`: the findings."""

    def __init__(self, report: Report) -> None:
        super().__init__("; ".join(d.message for d in report.errors))
        self.report = report


def _make_note_run(setting: WorldSetting) -> ActiveNotesRun | None:
    """Return the notes of a setting as `ActiveNotesRun`. None if it has no notes; then scene models are not imported."""
    if not setting.notes:
        return None
    from antdsl.runtime.notes.note_run import ActiveNotesRun

    return ActiveNotesRun.make_for_setting(setting)


@use_standard_floats()
def bind(
    plan: ir.Plan, setting: WorldSetting, options: Options | None = None, *, binding_cache: BindingCache | None = None
) -> World:
    """Return the world at `setting.first_frame`. Agents that exist at the start are placed, and have not moved yet.

    `plan`: an optimised and verified plan. `binding_cache`: retains data made from meshes for other worlds. Raises BindError with
    a report if plan and setting do not match."""
    world = bind_world_without_agents(plan, setting, options, binding_cache=binding_cache)
    stages.begin_stage("placing agents")
    with np.errstate(all="ignore"):
        place_crowds(world)
    stages.begin_stage("feet")
    feet_step.place_initial_feet(world)
    return world


@use_standard_floats()
def bind_world_without_agents(
    plan: ir.Plan,
    setting: WorldSetting,
    options: Options | None = None,
    *,
    binding_cache: BindingCache | None = None,
    origin: NDArray[np.float64] | None = None,
) -> World:
    """Return the same world as `bind`, but without agents.

    `origin` (mm): an origin to use for positions, for example another world's. Raises MachineCodeUnavailableError if no kernel
    runs."""
    llvm_compiler.require_llvm()
    options, binding_cache = options or Options(), binding_cache or BindingCache()
    origin = compute_world_origin(setting) if origin is None else origin
    up = np.asarray(setting.up, np.float64)
    meshes = {name: _translate_mesh(mesh, origin) for name, mesh in {**setting.surfaces, **setting.obstacles}.items()}
    solids = _make_solids(setting, origin, binding_cache)
    stages.begin_stage("ground")
    periodic, extended = make_periodic_world(setting, meshes, origin)
    surfaces = {name: extended[name] for name in setting.surfaces}
    ground = _make_ground(surfaces, solids, up, setting.motion.meshes, setting.uses_rays, binding_cache)
    world = World(
        plan=plan,
        setting=setting,
        options=options,
        up=up / np.sqrt((up[0] * up[0] + up[1] * up[1]) + up[2] * up[2]),
        origin=origin,
        frame=setting.first_frame,
        params={},
        populations={name: make_empty_population(species, ground) for name, species in plan.species.items()},
        items={name: _make_items(setting, items, origin) for name, items in plan.items.items()},
        fields={},
        vector_fields={},
        field_rates={},
        obstacles=_make_ray_scenes(extended, solids, binding_cache),
        curves={
            name: make_sampled_curve(setting.curves[name] - origin)
            for name in plan.list_things_of_kind("curve")
            if name in setting.curves
        },
        flows={},
        maps={},
        ground=ground,
        surface_index={name: k for k, name in enumerate(setting.surfaces)},
        solids=solids,
        backend=BACKENDS[options.backend](plan),
        faults=FaultLog(),
        motion=MotionMeasures(),
        crowd_lines=reserve_line_ids(setting),
        notes=_make_note_run(setting),
        periodic=periodic,
    )
    _set_default_params(world)
    stages.begin_stage("fields")
    _bind_fields(
        world, {**meshes, **{name: _translate_mesh(solid.mesh, origin) for name, solid in setting.solids.items()}}, binding_cache
    )
    _bind_flows(world, binding_cache)
    _bind_detail_levels(world, {name: extended[name] for name in setting.obstacles})
    return world


def set_param(world: World, name: str, value: float) -> None:
    """Set the param `name` from the next step on, without compiling anything. `value`: in base units (mm, s, g, rad)."""
    if name not in world.plan.params:
        raise KeyError(name)
    world.params[name] = np.float32(value)


def _translate_mesh(mesh: MeshData, origin: NDArray[np.float64]) -> MeshData:
    return MeshData(mesh.vertices - origin, mesh.faces) if origin.any() else mesh


def _make_solids(setting: WorldSetting, origin: NDArray[np.float64], binding_cache: BindingCache) -> dict[str, Volume]:
    """Return a volume for each solid. Raises BindError if the mesh of a solid is unsuitable."""
    if not setting.solids:
        return {}
    volumes: dict[str, Volume] = {}
    report = Report()
    for name, solid in setting.solids.items():
        mesh = _translate_mesh(solid.mesh, origin)
        volume = binding_cache.get_or_compute_deep_copy(
            "solid", (mesh, solid.voxel), partial(Volume.from_mesh, mesh.vertices, mesh.faces, solid.voxel)
        )
        if isinstance(volume, UnusableMeshReason):
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


def _make_ground(
    meshes: dict[str, MeshData],
    solids: dict[str, Volume],
    up: NDArray[np.float64],
    moving_names: Iterable[str],
    has_ray_starts: bool,
    binding_cache: BindingCache,
) -> Ground:
    """Return the ground of the agents: a plane, meshes, solids, or meshes and solids."""
    if not meshes and not solids:
        return PlaneGround(up)
    ground = _make_mesh_ground(meshes, moving_names, has_ray_starts, binding_cache)
    if ground is not None and not solids:
        return ground
    return CombinedGround(ground, solids, up / np.sqrt((up[0] * up[0] + up[1] * up[1]) + up[2] * up[2]))


def _make_mesh_ground(
    meshes: dict[str, MeshData], moving_names: Iterable[str], has_ray_starts: bool, binding_cache: BindingCache
) -> MeshGround | None:
    """Return the part of the ground that consists of meshes. None if the setting has no meshes."""
    surfaces = {name: (mesh.vertices, mesh.faces) for name, mesh in meshes.items()}
    moved = [name for name in moving_names if name in surfaces]
    if moved:
        make_ground = partial(MovingGround, surfaces, moved, has_ray_starts)
        return binding_cache.get_or_compute(
            "moving ground", (surfaces, moved, has_ray_starts), make_ground, copy_value=MovingGround.copy
        )
    if not surfaces:
        return None
    return binding_cache.get_or_compute("ground", (surfaces, has_ray_starts), partial(MeshGround, surfaces, has_ray_starts))


def _make_ray_scenes(meshes: dict[str, MeshData], solids: dict[str, Volume], binding_cache: BindingCache) -> dict[str, Obstacle]:
    """Return everything that rays can hit, by name: meshes, and solids in their current shape."""
    if not meshes and not solids:
        return {}
    scenes: dict[str, Obstacle] = {
        name: binding_cache.get_or_compute("rays", mesh, partial(RayScene, mesh.vertices, mesh.faces))
        for name, mesh in meshes.items()
    }
    return scenes | {name: SolidProximityQueries(volume) for name, volume in solids.items()}


def _make_items(setting: WorldSetting, plan: ir.ItemsPlan, origin: NDArray[np.float64]) -> Items:
    items = setting.items.get(plan.name, ())
    points = np.array([item.position for item in items], np.float64).reshape(-1, 3)
    position = (points if setting.period is None else setting.period.wrap_points(points)) - origin
    visible_values = {axis: position[:, k].astype(np.float32) for k, axis in enumerate(AXES)}
    visible_values["radius"] = np.array([item.radius for item in items], np.float32)
    amounts = {
        name: np.array([item.attributes.get(name, default) for item in items], np.float64)
        for name, default in plan.attributes.items()
    }
    visible_values |= {name: amount.astype(np.float32) for name, amount in amounts.items()}
    return Items(plan.name, tuple(item.name for item in items), position, amounts, visible_values)


def _set_default_params(world: World) -> None:
    """Set the params to the values in the scene, or to their defaults."""
    for name, param in world.plan.params.items():
        scene_value = world.setting.params.get(name)
        world.params[name] = np.float32(compute_run_value(world, param.default) if scene_value is None else scene_value)


def compute_run_value(world: World, node: ir.PlanNode) -> float:
    """Return the value of a node that is constant during a run."""
    return float(compute_uniform_values(world, collect_required_nodes((node,)))[node])


def set_flow(world: World, name: str, flow: FlowData) -> None:
    """Replace a flow from the next step on, without compiling anything. Raises BindError under the same conditions as `bind`."""
    if name not in world.plan.list_things_of_kind("flow"):
        raise KeyError(name)
    from antdsl.runtime.binding.bind_flows import bind_one_flow

    report = Report()
    bind_one_flow(world, name, flow, report)
    if not report.ok:
        raise BindError(report)


def _bind_flows(world: World, binding_cache: BindingCache) -> None:
    if not world.setting.flows and not world.setting.maps:
        return
    from antdsl.runtime.binding.bind_flows import bind_flows

    report = Report()
    bind_flows(world, report, binding_cache)
    if not report.ok:
        raise BindError(report)


def _bind_detail_levels(world: World, obstacles: dict[str, MeshData]) -> None:
    """Add levels of detail to the world if the scene requests them."""
    if world.setting.level_of_detail is None:
        return
    from antdsl.runtime.level_of_detail import DetailLevels

    world.detail_levels = DetailLevels(world.setting.level_of_detail, world.origin, obstacles)


def _bind_fields(world: World, meshes: dict[str, MeshData], binding_cache: BindingCache) -> None:
    if not world.plan.fields:
        return
    from antdsl.runtime.binding.bind_fields import bind_fields

    report = Report()
    bind_fields(world, meshes, compute_run_value, report, binding_cache)
    if not report.ok:
        raise BindError(report)
