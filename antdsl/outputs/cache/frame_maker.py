"""Converts one frame of a world to the arrays of a cache, in scene units.

Rows are agents, sorted by species name and then by id."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.fields.growing import GrowingCells
from antdsl.fields.pheromone import PheromoneField
from antdsl.numerics.periodic_box import PeriodicBox
from antdsl.outputs.cache import frame_loops
from antdsl.outputs.cache.agent_arrays import AgentArrayBuilder
from antdsl.outputs.cache.event_arrays import make_event_arrays
from antdsl.outputs.cache.manifest import (
    CAMERA_PARTS,
    AnyCameraEntry,
    BodyEntry,
    ClipEntry,
    FeelersEntry,
    FieldEntry,
    ImportEntry,
    ItemsEntry,
    LineEntry,
    Look,
    MachineEntry,
    Manifest,
    MeshEntry,
    SpeciesEntry,
    StateEntry,
    WornBodyEntry,
    make_camera_array_name,
)
from antdsl.outputs.cache.manifest_parts import FollowEntry, LampEntry, PeriodEntry
from antdsl.outputs.cache.pose_arrays import (
    list_playing_machines,
    list_wearable_layers,
    make_clip_arrays,
    make_display_arrays,
    make_feet_arrays,
)
from antdsl.outputs.cache.scene_positions import find_scene_origin, to_scene_positions
from antdsl.outputs.cache.solid_pieces import PieceMaker, make_start_arrays
from antdsl.outputs.flow_arrows import make_flow_arrows
from antdsl.plan.registers import find_pair_values
from antdsl.program.model import Program, TypeKind
from antdsl.runtime.checkpoints import STATE_HASH_VERSION
from antdsl.runtime.lifecycle import list_event_names
from antdsl.runtime.moving.moving_geometry import compute_vertices, measure_ground_velocity
from antdsl.runtime.world import Population, World
from antdsl.scene.camera_models import DEFAULT_CAMERA_NAME
from antdsl.scene.setting import WorldSetting

Arrays = dict[str, NDArray[Any]]


class FrameMaker:
    """Converter of a world to the arrays of a frame.

    `attributes`: the names of the arrays in the scene's `output`. Names that are not built in are names of registers. `events`:
    the kinds of events that frames contain."""

    def __init__(
        self,
        world: World,
        program: Program,
        attributes: tuple[str, ...],
        pieces: PieceMaker | None = None,
        events: tuple[str, ...] = (),
    ) -> None:
        self.piece_maker, self.events = pieces, events
        self.scale = 1.0 / world.setting.unit_mm
        pairs = {name: find_pair_values(population.plan.registers) for name, population in world.populations.items()}
        self.pair_names = {name: {each: slots[each] for each in attributes if each in slots} for name, slots in pairs.items()}
        only = {each for slots in self.pair_names.values() for each in slots} - _list_plain_numbers(program)
        names = tuple(each for each in attributes if each not in only)
        self.attributes = names if len(world.populations) == 1 or "species" in names else (*names, "species")
        self.factors = {
            (species.name, a.name): self.scale ** float(a.type.dimension.length)
            for species in program.species.values()
            for a in species.attributes
            if a.type.kind is TypeKind.NUMBER
        }
        self.agents = AgentArrayBuilder(self.scale, self.factors, self.pair_names)

    def frame(self, world: World) -> Arrays:
        """Return all arrays for the world's current frame."""
        arrays: Arrays = {"frame": np.array(world.frame, np.int64)}
        arrays |= self.agents.build_arrays(world, self.attributes)
        for name, population in sorted(world.populations.items()):
            arrays |= make_clip_arrays(population, world.options.threads)
            arrays |= make_display_arrays(population, world.setting)
            arrays |= self._make_pair_arrays(population, population.get_rows_by_id())
            for key in world.setting.list_body_keys(name):
                arrays |= make_feet_arrays(world, key, self.scale)
        for name, field in world.fields.items():
            arrays[f"field.{name}.cells"], arrays[f"field.{name}.values"] = _find_nonzero_cells(np.asarray(field.amounts))
            if "places" in field.added_cells:
                arrays[f"field.{name}.added"] = to_scene_positions(field.added_cells["places"][:, :3], self.scale)
        for name, items in world.items.items():
            for attribute, amount in items.amounts.items():
                arrays[f"items.{name}.{attribute}"] = amount.copy()
        arrays |= self._make_moving_arrays(world)
        if world.periodic is not None:
            vectors = [each.read_vector("unwrapped")[each.get_rows_by_id()] for _, each in sorted(world.populations.items())]
            arrays["unwrapped"] = np.concatenate([np.empty((0, 3)), *vectors]).astype(np.float32) * np.float32(self.scale)
        arrays |= make_event_arrays(world, self.events, self.scale)
        return arrays if self.piece_maker is None else arrays | self.piece_maker.frame(world)

    def _make_pair_arrays(self, population: Population, rows: NDArray[np.intp]) -> Arrays:
        """Return the values that belong to pairs of agents: the ids of both agents, and the value."""
        arrays: Arrays = {}
        for name, slots in self.pair_names[population.name].items():
            who, value = (np.stack([population.now[each[part]][rows] for each in slots], axis=1) for part in (0, 1))
            order = np.argsort(who, axis=1, kind="stable")
            who, value = (np.take_along_axis(each, order, axis=1) for each in (who, value))
            is_known = who >= 0
            factor = np.float32(self.factors.get((population.name, name), 1.0))
            of = f"pairs.{population.name}.{name}"
            arrays[f"{of}.id"] = np.broadcast_to(population.ids[rows, None], who.shape)[is_known]
            arrays[f"{of}.other"], arrays[f"{of}.value"] = who[is_known], value[is_known] * factor
        return arrays

    def _make_moving_arrays(self, world: World) -> Arrays:
        """Return the positions of moving meshes and items in this frame, and the velocity of the ground at each agent."""
        moves = world.setting.motion
        arrays: Arrays = {}
        for name in moves.meshes:
            arrays[f"mesh.{name}.vertices"] = to_scene_positions(compute_vertices(world, name, world.frame), self.scale)
        for name, positions in moves.items.items():
            arrays[f"items.{name}.P"] = ((moves.find_positions(positions, world.frame) - world.origin) * self.scale).astype(
                np.float32
            )
        speeds = [(each, measure_ground_velocity(world, each)) for _, each in sorted(world.populations.items())]
        parts = [speed[each.get_rows_by_id()] for each, speed in speeds if speed is not None]
        if parts and len(parts) == len(speeds):
            arrays["v_ground"] = (np.concatenate(parts) * self.scale).astype(np.float32)
        return arrays


def _find_nonzero_cells(values: NDArray[np.float64]) -> tuple[NDArray[np.int32], NDArray[np.float32]]:
    """Return the indices of the cells of a field that are not 0, and their values."""
    cells, strength = np.empty(len(values) + 1, np.int32), np.empty(len(values) + 1, np.float32)
    count = frame_loops.compress_nonzero_cells(values, cells, strength)
    return cells[:count], strength[:count]


def _list_plain_numbers(program: Program) -> set[str]:
    """Return the names of numbers that have one value per agent in at least one species."""
    return {a.name for species in program.species.values() for a in species.attributes if a.pair_species is None}


def make_static_arrays(world: World, setting: WorldSetting) -> Arrays:
    """Return the arrays of `static.npz`, in scene units, relative to the world's origin.

    These are meshes, positions of field cells, and flows as arrows."""
    scale = 1.0 / setting.unit_mm
    arrays: Arrays = {}
    for name, mesh in {**setting.surfaces, **setting.obstacles}.items():
        arrays[f"mesh.{name}.vertices"] = (mesh.vertices - world.origin) * scale
        arrays[f"mesh.{name}.faces"] = mesh.faces
    arrays |= make_start_arrays(world, scale)
    for name, camera in setting.cameras.items():
        if camera.is_moving:
            parts = ((camera.at - world.origin) * scale, (camera.look_at - world.origin) * scale, camera.up, camera.focal)
            arrays |= {make_camera_array_name(name, part): each for part, each in zip(CAMERA_PARTS, parts, strict=True)}
    for name, field in world.fields.items():
        arrays[f"field.{name}.P"] = to_scene_positions(_find_start_positions(field), scale)
    return arrays | make_flow_arrows(world, scale)


def _find_start_positions(field: PheromoneField) -> NDArray[np.float64]:
    """Return the positions (n, 3) in mm of the cells that a field has before the first step."""
    cells = field.cells
    return cells.position[: cells.initial_count] if isinstance(cells, GrowingCells) else cells.position


def make_manifest(
    world: World,
    setting: WorldSetting,
    *,
    version: str,
    scene: str,
    scene_path: str | None,
    inputs: Mapping[str, str],
    units: str,
    up: str,
    first: int,
    last: int,
    preroll: int,
    checkpoint: int,
    attributes: tuple[str, ...],
    definitions: tuple[BodyEntry, ...],
    definition_by_species: Mapping[str, tuple[WornBodyEntry, ...]],
    feelers: Mapping[str, tuple[FeelersEntry, ...]],
    cameras: Mapping[str, AnyCameraEntry],
    looks: Mapping[str, Look | Mapping[str, Look]],
) -> Manifest:
    """Return the manifest of a run that begins with this world.

    `looks`: the looks for pictures that the scene sets, by the name of a mesh or of items. For items with different looks, the
    value is a mapping by item name."""
    scale, kinds = 1.0 / setting.unit_mm, {name: kind for kind, names in world.plan.thing_names_by_kind.items() for name in names}
    return Manifest(
        antdsl=version,
        state_hash=STATE_HASH_VERSION,
        scene=scene,
        scene_path=scene_path,
        inputs=dict(inputs),
        units=units,  # type: ignore[arg-type]
        up=up,  # type: ignore[arg-type]
        origin=find_scene_origin(world),
        fps=f"{setting.fps.numerator}/{setting.fps.denominator}",
        first=first,
        last=last,
        preroll=preroll,
        substeps=setting.substeps,
        seed=setting.seed,
        checkpoint=checkpoint,
        attributes=attributes,
        species=tuple(
            _make_species_entry(world.populations[name], setting, definition_by_species.get(name, ()), feelers.get(name, ()))
            for name in sorted(world.populations)
        ),
        bodies=definitions,
        meshes=tuple(
            _make_mesh_entry(setting, name, kinds[name], looks)
            for name in (*setting.surfaces, *setting.obstacles, *setting.solids)
        ),
        fields=tuple(FieldEntry(name=name, cell=float(field.cells.cell) * scale) for name, field in world.fields.items()),
        items=tuple(
            ItemsEntry(
                name=name,
                names=tuple(item.name for item in items),
                position=tuple(_scale_point(np.subtract(item.position, world.origin), scale) for item in items),
                radius=tuple(item.radius * scale for item in items),
                attributes=tuple(world.items[name].amounts) if name in world.items else (),
                moves=name in setting.motion.items,
                looks=_list_item_looks(looks.get(name), [item.name for item in items]),
                lamp=next((LampEntry(power=item.power, colour=item.colour) for item in items if item.power is not None), None),
            )
            for name, items in setting.items.items()
        ),
        lines=tuple(
            LineEntry(name=crowd.name, species=crowd.species, ranges=line.ranges)
            for crowd, line in zip(setting.crowds, world.crowd_lines, strict=True)
            if crowd.name
        ),
        events=list_event_names(world),
        camera=None if isinstance(default := cameras.get(DEFAULT_CAMERA_NAME), FollowEntry) else default,
        cameras=dict(cameras),
        period=None if world.periodic is None else _make_period_entry(world.periodic.box, scale),
    )


def _make_period_entry(box: PeriodicBox, scale: float) -> PeriodEntry:
    """Return the manifest's entry for the box (mm) of a periodic world."""
    return PeriodEntry(low=_scale_point(np.array(box.low), scale), widths=_scale_point(np.array(box.widths), scale))


def _scale_point(point: NDArray[np.float64], scale: float) -> tuple[float, float, float]:
    """Return a point (mm) in scene units."""
    x, y, z = (point * scale).tolist()
    return x, y, z


def _make_mesh_entry(setting: WorldSetting, name: str, kind: str, looks: Mapping[str, Look | Mapping[str, Look]]) -> MeshEntry:
    """Return the manifest's entry for the mesh `name`. `kind`: the kind of thing that the mesh is."""
    off, look = setting.deviations.get(name), looks.get(name)
    deviation = None if off is None else off / setting.unit_mm
    moves = name in setting.motion.meshes
    report = setting.imports.get(name)
    return MeshEntry(
        name=name,
        kind=kind,
        moves=moves,
        deviation=deviation,
        look=look if isinstance(look, str) else None,
        imported=None if report is None else ImportEntry(**asdict(report)),
    )


def _list_item_looks(looks: Look | Mapping[str, Look] | None, names: list[str]) -> tuple[Look | None, ...]:
    """Return the look of each item in pictures, in the order of `names`. Empty if the scene sets no looks."""
    if not looks:
        return ()
    return tuple(looks if isinstance(looks, str) else looks.get(name) for name in names)


def _make_species_entry(
    population: Population, setting: WorldSetting, bodies: tuple[WornBodyEntry, ...], feelers: tuple[FeelersEntry, ...]
) -> SpeciesEntry:
    """Return the manifest's entry for a species."""
    machines = tuple(
        MachineEntry(
            name=machine.name,
            states=tuple(
                StateEntry(name=name, label=label, colour=colour)
                for name, label, colour in zip(machine.states, machine.state_labels, machine.colours, strict=True)
            ),
        )
        for machine in population.plan.machines
    )
    return SpeciesEntry(
        name=population.name,
        body=bodies[0].body if len(bodies) == 1 else None,
        definition=bodies[0].definition if len(bodies) == 1 else None,
        bodies=bodies if len(bodies) > 1 else (),
        clips=tuple(ClipEntry(**asdict(clip)) for clip in population.plan.clips),
        playing=tuple(list_playing_machines(population)),
        wears=list_wearable_layers(population, setting),
        channels=population.plan.channels,
        looks=population.plan.look_groups,
        feelers=feelers,
        machines=machines,
    )
