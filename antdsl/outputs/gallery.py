"""Converts frames of a cache to pictures: meshes, agents in the colours of their states, items and scent.

The size of an item shows how much of its amount is left."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from antdsl.bodies.agents.definition import BodyError
from antdsl.bodies.agents.driving import PoseAdjustments
from antdsl.bodies.body import rotate_vectors
from antdsl.bodies.posed_body import PosedBody
from antdsl.numerics.records import select_record_rows
from antdsl.outputs.agent_paths import AgentPaths, PathWindow, match_agents
from antdsl.outputs.cache.cache_reader import Arrays, Cache, CacheError
from antdsl.outputs.cache.dug_solids import DugSolids
from antdsl.outputs.cache.field_strengths import FieldReader, list_program_fields
from antdsl.outputs.cache.frame_agents import find_species_rows, get_agent_ids
from antdsl.outputs.cache.manifest import MeshEntry, SpeciesEntry
from antdsl.outputs.cache.pose_arrays import read_all_machine_clips, read_driven_pose, read_feet, read_layer_masks
from antdsl.outputs.cache_bodies import CacheBodies
from antdsl.outputs.cut_plane import CutPlane
from antdsl.outputs.edits.frame_rows import SPECIES_PER_KEY
from antdsl.outputs.feelers import compute_feeler_rays
from antdsl.outputs.flow_arrows import read_flow_arrows
from antdsl.outputs.pictures.camera import to_tuple
from antdsl.outputs.pictures.light import encode_srgb_values
from antdsl.outputs.pictures.model import Crowd, FlowArrows, Item, LegendRow, Picture, Solid, Trail
from antdsl.outputs.pictures.seam_images import add_seam_images
from antdsl.outputs.pictures.trail_colours import estimate_full_strength
from antdsl.scene.looks import (
    INVISIBLE_LOOK,
    KIND_BY_LOOK,
    LAMP_SHAPE,
    choose_drawn_shape,
    compute_remaining_share,
    find_kind_by_name,
)
from antdsl.scene.thing_models import UP_VECTORS

REQUIRED_ATTRIBUTES = ("P", "orient", "pscale")
# colours of the fields, in their order
_FIELD_COLOURS = ((0.68, 0.10, 0.46), (0.05, 0.46, 0.62), (0.80, 0.40, 0.05), (0.30, 0.22, 0.66))
_FLOW_COLOURS = ((250, 246, 226), (60, 214, 255), (255, 150, 60), (190, 140, 255))  # colours of the flows, in their order
_OUTLINE_DIRECTIONS, _MAX_FITTED_FRAMES = 96, 48  # directions for the outermost agents, and frames examined to fit a camera
_MAX_STRENGTH_FRAMES = 8  # frames examined to find the strongest value of a field


class PictureUnavailable(Exception):
    """Error for a cache that cannot be drawn. The message is a complete explanation."""


@contextmanager
def _body_problems(species: SpeciesEntry) -> Iterator[None]:
    """Raise PictureUnavailable instead of BodyError if a body of the species is damaged."""
    try:
        yield
    except BodyError as error:
        raise PictureUnavailable(f"the body of `{species.name}` in the cache {error}") from None


class Gallery:
    """Builder of the pictures of one cache. A picture does not depend on earlier pictures. Positions are relative to `origin`
    (scene units).

    `window`: the time span of the agents' paths in pictures; None for no paths. `shows_states`: whether agents have the colours
    of their states instead of the natural colours of their bodies. `blurred`: whether pictures also contain the agents' positions
    in the next frame, for motion blur. `full`: by field, the strength that is drawn with the strongest colour.

    Raises PictureUnavailable if the cache lacks data for pictures, or a field that `full` names."""

    def __init__(
        self,
        cache: Cache,
        cut: CutPlane | None = None,
        window: PathWindow | None = None,
        *,
        shows_states: bool = False,
        has_motion_blur: bool = False,
        full_strengths: Mapping[str, float] | None = None,
    ) -> None:
        self.cache, self.manifest, self._cut_plane = cache, cache.manifest, cut
        self.origin = np.array(cache.manifest.origin)
        if cut is not None:
            cut = self._cut_plane = replace(cut, at=cut.at - float(self.origin[cut.axis]))
        missing = [name for name in REQUIRED_ATTRIBUTES if name not in self.manifest.attributes]
        if missing:
            raise PictureUnavailable(f"the cache has no attribute `{missing[0]}`, which pictures need")
        strange = [name for name in full_strengths or () if name not in list_program_fields(self.manifest)]
        if strange:
            raise PictureUnavailable(f"the cache has no field `{strange[0]}`")
        self._has_motion_blur, self._requested_strengths = has_motion_blur, dict(full_strengths or {})
        self.shows_states = shows_states
        self.light = self.manifest.light
        above, below = self.manifest.fps.split("/")
        self.dt = int(below) / int(above)
        self._agent_paths = None if window is None else AgentPaths(cache, self.dt, window)
        self.static = cache.read_static()
        self._undug_solids = tuple(self._make_solid(m) for m in self.manifest.meshes if not m.row.is_dug and m.look != "none")
        self._dug_solids = DugSolids(cache, self.static, cut)
        self.flows = tuple(
            FlowArrows(name, place, displacement, _FLOW_COLOURS[number % len(_FLOW_COLOURS)])
            for number, (name, (place, displacement)) in enumerate(read_flow_arrows(self.static).items())
        )
        self.bodies = CacheBodies(self.manifest, self.static)
        self._first_frame: Arrays | None = None
        self._computed_strengths: dict[str, float] | None = None
        self._field_reader = FieldReader(self.manifest, self.static)

    def make_picture(self, frame: int, *, agents: frozenset[int] = frozenset()) -> Picture:
        """Return the picture of one frame. `agents`: keys (`make_agent_keys`) of the agents to which overlays of ids, velocities
        and paths are limited; empty for all."""
        arrays = self.cache.frame(frame)
        if self._first_frame is None:
            frames = self.cache.frames()
            self._first_frame = self.cache.frame(frames[0]) if frames else arrays
        crowds, legend = self._make_crowds(frame, arrays, agents)
        whole = Picture(
            solids=(*self._make_solids(arrays), *self._make_dug_solids(frame)),
            crowds=add_seam_images(crowds, self.manifest.periodic_box),
            items=self._make_items(arrays),
            trails=self._make_trails(arrays),
            flows=self.flows,
            up=UP_VECTORS[self.manifest.up],
            legend=legend,
            frame=frame,
            light=self.light,
            grain=self._measure_grain(self._first_frame),
        )
        return whole if self._cut_plane is None else self._cut_plane.cut_picture(whole)

    def find_outline_points(self, frames: Sequence[int]) -> NDArray[np.float64]:
        """Return points (n, 3) around all agents of the frames. A camera that shows these points shows all agents.

        The points are the outermost agents in many directions, plus a margin for their bodies. Only a sample of the frames is
        examined."""
        turn = np.arange(_OUTLINE_DIRECTIONS) * (np.pi * (3.0 - np.sqrt(5.0)))  # a spiral that covers the sphere evenly
        height = 1.0 - 2.0 * (np.arange(_OUTLINE_DIRECTIONS) + 0.5) / _OUTLINE_DIRECTIONS
        flat = np.sqrt(1.0 - height * height)
        directions = np.stack([flat * np.cos(turn), height, flat * np.sin(turn)])
        points = [np.empty((0, 3))]
        for k in sorted({round(k) for k in np.linspace(0, len(frames) - 1, min(len(frames), _MAX_FITTED_FRAMES))}):
            arrays = self.cache.frame(frames[k])
            place = np.asarray(arrays["P"], np.float64)
            scale = np.asarray(arrays["pscale"], np.float64) * self._compute_body_reaches(arrays)
            is_finite = np.isfinite(place).all(axis=1) & np.isfinite(scale)
            place, scale = place[is_finite], scale[is_finite]
            if len(place):
                outermost = (place @ directions + scale[:, None]).argmax(axis=0)
                points.append(place[outermost] + directions.T * scale[outermost, None])
        return np.concatenate(points)

    def _compute_body_reaches(self, arrays: Arrays) -> NDArray[np.float64] | float:
        """Return how far the body of each agent extends from its position, in body lengths. At least 1.

        Only species with an agent definition may extend farther."""
        reach = np.ones(len(self.manifest.species))
        for number, species in enumerate(self.manifest.species):
            with _body_problems(species):
                reach[number] = self.bodies.reach(number)
        if "species" not in arrays or not len(reach):
            return float(reach.max(initial=1.0))
        return reach[np.clip(np.asarray(arrays["species"], np.int64), 0, len(reach) - 1)]

    def _make_dug_solids(self, frame: int) -> tuple[Solid, ...]:
        """Return the solids as dug at a frame."""
        looks = {mesh.name: mesh.look for mesh in self.manifest.meshes if mesh.look is not None}
        return tuple(
            solid if solid.name not in looks else replace(solid, kind=KIND_BY_LOOK[str(looks[solid.name])])
            for solid in self._dug_solids.at(frame)
            if looks.get(solid.name) != INVISIBLE_LOOK
        )

    def _make_solids(self, arrays: Arrays) -> tuple[Solid, ...]:
        """Return the meshes that are not dug. Moving meshes are at their positions in the frame."""
        moved = {mesh.name: f"mesh.{mesh.name}.vertices" for mesh in self.manifest.meshes if mesh.moves}
        return tuple(
            replace(solid, vertices=np.asarray(arrays[moved[solid.name]], np.float64))
            if moved.get(solid.name) in arrays
            else solid
            for solid in self._undug_solids
        )

    def _make_solid(self, mesh: MeshEntry) -> Solid:
        """Return a mesh of the manifest at its start position."""
        name = mesh.name
        vertices = np.asarray(self.static[f"mesh.{name}.vertices"], np.float64)
        faces = np.asarray(self.static[f"mesh.{name}.faces"], np.int32)
        return Solid(name, vertices, faces, KIND_BY_LOOK[mesh.look] if mesh.look else find_kind_by_name(name) or mesh.row.look)

    def _make_crowds(self, frame: int, arrays: Arrays, agents: frozenset[int]) -> tuple[tuple[Crowd, ...], tuple[LegendRow, ...]]:
        """Return the crowds of a frame, and the rows of the legend. `agents`: keys of the agents with overlays."""
        crowds: list[Crowd] = []
        legend: list[LegendRow] = []
        next_arrays = self.cache.frame(frame + 1) if self._has_motion_blur and frame + 1 in self.cache.frames() else None
        for number, species in enumerate(self.manifest.species):
            rows = find_species_rows(arrays, number)
            later = () if next_arrays is None else self._species_crowds(number, frame + 1, next_arrays)
            for which, crowd in enumerate(self._species_crowds(number, frame, arrays)):
                if later:
                    crowd = replace(crowd, next_crowd=match_agents(crowd, later[which]))
                dressed = self._split_by_layers(crowd, number, which, arrays)
                parts = (part for each in dressed for part in _split_selected(each, number, agents))
                crowds += [self._add_lines(part, species, number, frame) for part in parts]
            if species.machines and "state" in arrays:
                counts = np.bincount(np.asarray(arrays["state"])[rows], minlength=len(species.machines[0].states))
                legend += [
                    LegendRow(
                        state.label or state.name,
                        _convert_colour_to_bytes(state.colour) if self.shows_states else None,
                        int(n),
                        species.name,
                    )
                    for state, n in zip(species.machines[0].states, counts, strict=False)
                ]
        return tuple(crowds), tuple(legend)

    def _species_crowds(self, number: int, frame: int, arrays: Arrays) -> tuple[Crowd, ...]:
        """Return the agents of a species in the poses that they have in the frame, as one crowd per body.

        Agents without a clip play the idle clip."""
        species, rows = self.manifest.species[number], find_species_rows(arrays, number)
        ids, keys = get_agent_ids(arrays)[rows], self.bodies.keys(number)
        count, plays = len(rows), read_all_machine_clips(species, arrays, len(rows)) or ()
        driven, numbers = read_driven_pose(species, arrays, ids, self.manifest.seed), self.bodies.numbers(number, ids)
        crowds = []
        for which, key in enumerate(keys):
            body = self.load_body(number, 0, which)
            own = np.arange(count) if len(keys) == 1 else np.flatnonzero(numbers == which)
            subset, own_driven = rows[own], select_record_rows(driven, own) if len(keys) > 1 else driven
            colour, is_marked = self._choose_colours(species, arrays, subset, body, own_driven)
            crowds.append(
                Crowd(
                    species=species.name,
                    position=np.asarray(arrays["P"], np.float64)[subset],
                    orient=np.asarray(arrays["orient"], np.float64)[subset],
                    scale=np.asarray(arrays["pscale"], np.float64)[subset],
                    colour=colour,
                    is_marked=is_marked,
                    ids=ids[own],
                    velocity=np.asarray(arrays["v"], np.float64)[subset] if "v" in arrays else None,
                    body=body,
                    machine_clips=(
                        *body.build_idle_clips(ids[own], frame * self.dt),
                        *(select_record_rows(plays, own) if len(keys) > 1 else plays),
                    ),
                    feet=read_feet(key, arrays, len(own), 0 if body.leg_solver is None else body.leg_solver.leg_count),
                    driven_pose=own_driven,
                    body_key=key,
                )
            )
        return tuple(crowds)

    def _choose_colours(
        self, species: SpeciesEntry, arrays: Arrays, rows: NDArray[np.intp], body: PosedBody, driven_pose: PoseAdjustments
    ) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
        """Return the display colours (n, 3) of agents, and a mask of the agents with a colour from a state or an edit (n,).

        Without `shows_states`, agents have the natural colour of the body. A colour that differs from that of the agent's state
        was set by an edit, and is retained."""
        natural = encode_srgb_values(body.compute_natural_colours(driven_pose, len(rows)))
        if "Cd" not in arrays:
            return natural, np.zeros(len(rows), np.bool_)
        stored = np.asarray(arrays["Cd"], np.float32)[rows]
        if self.shows_states:
            return stored.astype(np.float64), np.ones(len(rows), np.bool_)
        states = species.machines[0].states if species.machines and "state" in arrays else ()
        palette = np.array([state.colour for state in states] or [(1.0, 1.0, 1.0)], np.float32)
        number = np.clip(np.asarray(arrays["state"])[rows], 0, len(palette) - 1) if states else np.zeros(len(rows), np.int64)
        is_edited = (stored != palette[number]).any(axis=1)
        return np.where(is_edited[:, None], stored, natural), is_edited

    def _split_by_layers(self, crowd: Crowd, number: int, body_index: int, arrays: Arrays) -> list[Crowd]:
        """Return one crowd for each set of layers that agents of the crowd wear. `body_index`: the index of the crowd's body."""
        rows = find_species_rows(arrays, number)
        masks = read_layer_masks(self.manifest.species[number], arrays, len(rows))
        if len(crowd.position) != len(rows):
            masks = masks[self.bodies.numbers(number, get_agent_ids(arrays)[rows]) == body_index]
        sets = [int(mask) for mask in np.unique(masks)] or [0]
        if len(sets) == 1:
            return [replace(crowd, body=self.load_body(number, sets[0], body_index))]
        parts = ((mask, np.flatnonzero(masks == np.uint64(mask))) for mask in sets)
        return [replace(crowd.select_rows(rows), body=self.load_body(number, mask, body_index)) for mask, rows in parts]

    def load_body(self, number: int, mask: int = 0, body_index: int = 0) -> PosedBody:
        """Return a body of species `number` with the layers of a mask, from the cache or the library.

        `body_index`: its index among the bodies of the species."""
        with _body_problems(self.manifest.species[number]):
            return self.bodies.body(number, mask, body_index)

    def _add_lines(self, crowd: Crowd, species: SpeciesEntry, number: int, frame: int) -> Crowd:
        """Return the crowd with the paths and feelers of its agents, if they are to be displayed."""
        if crowd.ids is not None and self._agent_paths is not None:
            crowd = replace(crowd, paths=self._agent_paths.get_paths(frame, number, np.asarray(crowd.ids, np.int64)))
        if not species.feelers or crowd.ids is None or not len(crowd.position):
            return crowd
        ahead, up = (
            rotate_vectors(crowd.orient, np.tile(axis, (len(crowd.position), 1))) for axis in ((1.0, 0.0, 0.0), (0.0, 1.0, 0.0))
        )
        lines = [compute_feeler_rays(entry, crowd.position, ahead, up, crowd.scale) for entry in species.feelers]
        return replace(crowd, feelers=np.concatenate(lines))

    def _make_items(self, arrays: Arrays) -> tuple[Item, ...]:
        """Return the items of a frame."""
        items = []
        for group in self.manifest.items:
            moved = arrays.get(f"items.{group.name}.P") if group.moves else None
            positions = group.position if moved is None else [to_tuple(place) for place in moved]
            for number, (name, position, radius) in enumerate(zip(group.names, positions, group.radius, strict=True)):
                look = group.looks[number] if number < len(group.looks) else None
                power, colour = (None, None) if group.lamp is None else (group.lamp.power, group.lamp.colour)
                shape = choose_drawn_shape(group.name, name, look) if group.lamp is None else LAMP_SHAPE
                left = self._compute_remaining_share(group.name, group.attributes, number, arrays)
                items.append(Item(name, position, radius, left, shape, None if look == INVISIBLE_LOOK else look, power, colour))
        return tuple(items)

    def _compute_remaining_share(self, group: str, attributes: tuple[str, ...], number: int, arrays: Arrays) -> float:
        """Return the fraction (0..1) that an item has left of its amount in the first frame."""
        start = self._first_frame or {}
        keys = (f"items.{group}.{attribute}" for attribute in attributes)
        return compute_remaining_share(
            (float(start[key][number]), float(arrays[key][number])) for key in keys if key in start and key in arrays
        )

    def _make_trails(self, arrays: Arrays) -> tuple[Trail, ...]:
        """Return the fields of a frame as trails."""
        trails = []
        for number, field in self._field_reader.read_frame(arrays):
            full = self._requested_strengths.get(field.name) or self._find_full_strengths().get(field.name) or None
            colour = _FIELD_COLOURS[number % len(_FIELD_COLOURS)]
            trails.append(Trail(field.name, field.positions, field.strengths, field.cell, colour, full))
        return tuple(trails)

    def _find_full_strengths(self) -> dict[str, float]:
        """Return, for each field, the strength that is drawn with the strongest colour.

        It is the same in all frames of the cache, so that scent can be compared between frames."""
        if self._computed_strengths is None:
            frames, self._computed_strengths = self.cache.frames(), {}
            chosen = (
                {frames[round(k * (len(frames) - 1) / (_MAX_STRENGTH_FRAMES - 1))] for k in range(_MAX_STRENGTH_FRAMES)}
                if frames
                else set()
            )
            for frame in sorted(chosen):
                try:
                    arrays = self.cache.frame(frame)
                except CacheError:  # a damaged frame does not prevent drawing others
                    continue
                for _, field in self._field_reader.read_frame(arrays):
                    strength = estimate_full_strength(field.strengths)
                    self._computed_strengths[field.name] = max(self._computed_strengths.get(field.name, 0.0), strength)
        return self._computed_strengths

    def _measure_grain(self, first: Arrays) -> float | None:
        """Return the reference length for the ground's grain: the median body length in the first frame. Later births do not
        change it."""
        lengths = np.asarray(first["pscale"], np.float64)
        lengths = lengths[np.isfinite(lengths) & (lengths > 0)]
        return float(np.median(lengths)) if len(lengths) else None


def choose_coordinate_format(gallery: Gallery) -> str:
    """Return a `%` format for coordinates relative to the scene's zero, with all digits of float32.

    If the cache has an origin, it has the digits of float64 (a millionth of a millimetre at 1000 km)."""
    return "%.15g" if gallery.origin.any() else "%.9g"


def _split_selected(crowd: Crowd, species: int, selected_keys: frozenset[int]) -> list[Crowd]:
    """Return a crowd split into the agents with these keys and all others. The others lose their ids and velocities, so overlays
    omit them."""
    if not selected_keys or crowd.ids is None:
        return [crowd]
    chosen = np.isin(np.asarray(crowd.ids, np.int64) * SPECIES_PER_KEY + species, sorted(selected_keys))
    selected, others = crowd.select_rows(chosen), crowd.select_rows(~chosen)
    return [selected, replace(others, ids=None, velocity=None)]


def _convert_colour_to_bytes(colour: tuple[float, float, float]) -> tuple[int, int, int]:
    r, g, b = (round(255 * min(max(part, 0.0), 1.0)) for part in colour)
    return r, g, b
