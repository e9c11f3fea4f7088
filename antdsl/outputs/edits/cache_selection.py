"""Applies selectors to the agents of a cache.

Names, shares and `without` depend only on ids, so they have the same result in all frames. Positions and states depend on the
frame."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from antdsl.outputs.cache.cache_reader import Arrays, Cache, read_camera
from antdsl.outputs.cache.frame_agents import LongArray, make_agent_keys
from antdsl.outputs.cache.manifest import MachineEntry, Manifest, SpeciesEntry
from antdsl.outputs.cache.manifest_parts import CameraEntry, FollowEntry
from antdsl.outputs.edits.frame_rows import SPECIES_PER_KEY
from antdsl.runtime.sensing.sensed_camera import CameraInFrame
from antdsl.scene.crowds.line_ids import CrowdLineIds
from antdsl.scene.notes.selection import SelectableAgents, SelectableFrame, StateColumn, select_rows
from antdsl.scene.notes.selectors import AnySelector, SelectorNames, needs_frame
from antdsl.scene.thing_models import UNIT_MM


@dataclass(frozen=True, eq=False)
class Selection:
    """The agents of a cache that a selector selects.

    `frame`: the frame from which positions and states are read. `last`: if it is later, an agent is selected if it meets the
    conditions in any frame from `frame` to `last`."""

    selector: AnySelector
    cache: Cache
    frame: int
    last: int = -(2**63)

    def find(self, keys: LongArray) -> NDArray[np.bool_]:
        """Return a mask of the agents `keys` (`make_agent_keys`) that the selector selects."""
        if needs_frame(self.selector):
            return np.isin(keys, self._keys_of_frame)
        return select_agents(
            self.selector, {"id": keys // SPECIES_PER_KEY, "species": keys % SPECIES_PER_KEY}, self.cache.manifest
        )

    @cached_property
    def _keys_of_frame(self) -> LongArray:
        """Return the keys of the agents that the selector selects in its frames."""
        cameras = {name: read_camera(self.cache, name) for name in list_cameras(self.cache.manifest)}
        later = [number for number in self.cache.frames() if self.frame <= number <= self.last]
        selected_keys = []
        for number in later or [self.frame]:
            arrays, views = self.cache.frame(number), {name: CameraInFrame(camera, number) for name, camera in cameras.items()}
            selected_keys.append(make_agent_keys(arrays)[select_agents(self.selector, arrays, self.cache.manifest, views)])
        return np.unique(np.concatenate(selected_keys))


def list_cameras(manifest: Manifest) -> frozenset[str]:
    """Return the names of the cameras that selectors may use: those that do not follow an agent."""
    return frozenset(name for name, camera in manifest.named_cameras.items() if isinstance(camera, CameraEntry))


def list_selector_names(manifest: Manifest) -> SelectorNames:
    """Return the names that selectors of a cache may use."""
    states = [
        name
        for species in manifest.species
        for _, machine in _list_stored_machines(species, manifest)
        for state in machine.states
        for name in (state.name, f"{machine.name}.{state.name}")
    ]
    return SelectorNames(
        lines={line.name: sum(count for _, count in line.ranges) for line in manifest.lines},
        species=frozenset(species.name for species in manifest.species),
        items=frozenset(name for group in manifest.items for name in (group.name, *group.names)),
        states=frozenset(states),
        cameras=list_cameras(manifest),
        late_cameras={
            name: camera.follow if isinstance(camera, FollowEntry) else ""
            for name, camera in manifest.named_cameras.items()
            if not isinstance(camera, CameraEntry)
        },
    )


def _list_stored_machines(species: SpeciesEntry, manifest: Manifest) -> list[tuple[str, MachineEntry]]:
    """Return the machines of a species with states that frames contain, as (name of the array, machine)."""
    names = ("state", *(f"{machine.name}.state" for machine in species.machines[1:]))
    return [(name, m) for name, m in zip(names, species.machines, strict=False) if name in manifest.attributes]


def select_agents(
    selector: AnySelector, arrays: Arrays, manifest: Manifest, cameras: Mapping[str, CameraInFrame] | None = None
) -> NDArray[np.bool_]:
    """Return a mask of the agents of a frame that a selector selects. `cameras`: the cameras in this frame, by name."""
    keys, unit_mm = make_agent_keys(arrays), UNIT_MM[manifest.units]
    position = (np.asarray(arrays["P"], np.float64) + manifest.origin) * unit_mm if "P" in arrays else np.zeros((len(keys), 3))
    rows = {entry.name: np.flatnonzero(keys % SPECIES_PER_KEY == number) for number, entry in enumerate(manifest.species)}
    frame = SelectableFrame(
        {
            entry.name: SelectableAgents(
                keys[rows[entry.name]] // SPECIES_PER_KEY,
                position[rows[entry.name]],
                {
                    machine.name: StateColumn(arrays[name][rows[entry.name]], tuple(state.name for state in machine.states))
                    for name, machine in _list_stored_machines(entry, manifest)
                    if name in arrays
                },
            )
            for entry in manifest.species
        },
        {line.name: CrowdLineIds(line.species, line.ranges) for line in manifest.lines},
        find_item_points(arrays, manifest, unit_mm),
        manifest.seed,
        unit_mm,
        cameras or {},
    )
    is_selected = np.zeros(len(keys), np.bool_)
    for name, mask in select_rows(selector, frame).items():
        is_selected[rows[name]] = mask
    return is_selected


def find_item_points(arrays: Arrays, manifest: Manifest, unit_mm: float) -> dict[str, NDArray[np.float64]]:
    """Return the positions of items in a frame (scene mm), by names of items and of groups."""
    points: dict[str, NDArray[np.float64]] = {}
    for group in manifest.items:
        moved = arrays.get(f"items.{group.name}.P") if group.moves else None
        positions = np.array(group.position if moved is None else moved, np.float64).reshape(-1, 3)
        points[group.name] = (positions + manifest.origin) * unit_mm
        points |= {name: points[group.name][k : k + 1] for k, name in enumerate(group.names)}
    return points
