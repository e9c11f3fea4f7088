"""A world at one frame to the arrays of a cache: one row an agent, species after species by name, by id within each; scene
units."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.outputs.manifest import (
    CameraEntry,
    FieldEntry,
    ItemsEntry,
    MachineEntry,
    Manifest,
    MeshEntry,
    SpeciesEntry,
    StateEntry,
)
from antdsl.program.model import Dim, Kind, Program
from antdsl.runtime.world import Population, World
from antdsl.scene.setting import Setting

Arrays = dict[str, NDArray[Any]]
_PLAIN = {"P", "v", "orient", "id", "pscale", "Cd", "state", "species", "age", "group"}


class FrameMaker:
    """Turns a world into the arrays of a frame. `attributes` are names of the scene's `output`; others than the usual are
    registers."""

    def __init__(self, world: World, program: Program, attributes: tuple[str, ...]) -> None:
        self.scale = 1.0 / world.setting.unit_mm
        self.attributes = attributes if len(world.populations) == 1 or "species" in attributes else (*attributes, "species")
        self.colours = {name: _colours(p) for name, p in world.populations.items()}
        self.factors = {
            (species.name, a.name): self.scale ** _length_power(a.type.dim)
            for species in program.species.values()
            for a in species.attributes
            if a.type.kind is Kind.NUMBER
        }

    def frame(self, world: World) -> Arrays:
        """All arrays of the frame that the world stands at."""
        arrays: Arrays = {"frame": np.array(world.frame, np.int64)}
        rows = {name: world.populations[name].in_id_order() for name in sorted(world.populations)}
        for attribute in self.attributes:
            parts = [self._attribute(world, attribute, number, name, rows[name]) for number, name in enumerate(rows)]
            arrays[attribute] = np.concatenate(parts)
        for name, field in world.fields.items():
            values = np.asarray(field.values)
            cells = np.flatnonzero(values)
            arrays[f"field.{name}.cells"] = cells.astype(np.int32)
            arrays[f"field.{name}.values"] = values[cells].astype(np.float32)
        for name, items in world.items.items():
            for attribute, amount in items.amounts.items():
                arrays[f"items.{name}.{attribute}"] = amount.copy()
        return arrays

    def _attribute(self, world: World, attribute: str, number: int, name: str, rows: NDArray[np.intp]) -> NDArray[Any]:
        population = world.populations[name]
        if attribute == "P":
            return ((population.position[rows] + world.origin) * self.scale).astype(np.float32)
        if attribute == "v":
            return _vector(population, "velocity", rows) * np.float32(self.scale)
        if attribute == "orient":
            return orientation(_vector(population, "heading", rows), _vector(population, "up", rows))
        if attribute == "id":
            return population.ids[rows]
        if attribute == "pscale":
            return _register(population, "size", rows) * np.float32(self.scale)
        if attribute == "Cd":
            return (
                self.colours[name][_states(population, rows)] if population.plan.machines else np.ones((len(rows), 3), np.float32)
            )
        if attribute == "state":
            return _states(population, rows).astype(np.int16)
        if attribute == "species":
            return np.full(len(rows), number, np.int16)
        if attribute == "age":
            return ((world.frame - population.born[rows]) * world.dt).astype(np.float32)
        if attribute not in population.plan.registers:
            return np.full(len(rows), np.nan, np.float32)
        return _register(population, attribute, rows) * np.float32(self.factors.get((name, attribute), 1.0))


def orientation(heading: NDArray[np.float32], up: NDArray[np.float32]) -> NDArray[np.float32]:
    """Quaternions (n, 4) x, y, z, w that turn +x to the heading and +y to the part of `up` across it. (n, 3) float32 each."""
    x = _unit(heading.astype(np.float64), np.array([1.0, 0.0, 0.0]))
    z = np.cross(x, up.astype(np.float64))
    z = _unit(z, np.cross(x, np.array([0.36, 0.48, 0.8])))
    z /= np.maximum(np.linalg.norm(z, axis=1, keepdims=True), 1e-30)
    y = np.cross(z, x)
    # the largest of the four parts is found first, so that nothing is divided by something small (Shepperd 1978)
    trace = x[:, 0] + y[:, 1] + z[:, 2]
    four = np.stack([x[:, 0] * 2 - trace, y[:, 1] * 2 - trace, z[:, 2] * 2 - trace, trace], axis=1)
    which = four.argmax(axis=1)
    mixed = np.empty((len(x), 4, 4))
    mixed[:, 0] = np.stack([1 + four[:, 0], x[:, 1] + y[:, 0], x[:, 2] + z[:, 0], y[:, 2] - z[:, 1]], axis=1)
    mixed[:, 1] = np.stack([x[:, 1] + y[:, 0], 1 + four[:, 1], y[:, 2] + z[:, 1], z[:, 0] - x[:, 2]], axis=1)
    mixed[:, 2] = np.stack([x[:, 2] + z[:, 0], y[:, 2] + z[:, 1], 1 + four[:, 2], x[:, 1] - y[:, 0]], axis=1)
    mixed[:, 3] = np.stack([y[:, 2] - z[:, 1], z[:, 0] - x[:, 2], x[:, 1] - y[:, 0], 1 + trace], axis=1)
    chosen = mixed[np.arange(len(x)), which]
    chosen /= np.maximum(np.linalg.norm(chosen, axis=1, keepdims=True), 1e-30)
    return chosen.astype(np.float32)


def static_arrays(world: World, setting: Setting) -> Arrays:
    """What stands still: meshes and the places of field cells, in scene units."""
    scale = 1.0 / setting.unit_mm
    arrays: Arrays = {}
    for name, mesh in {**setting.surfaces, **setting.obstacles}.items():
        arrays[f"mesh.{name}.vertices"] = mesh.vertices * scale
        arrays[f"mesh.{name}.faces"] = mesh.faces
    for name, field in world.fields.items():
        arrays[f"field.{name}.P"] = ((np.asarray(field.cells.position) + world.origin) * scale).astype(np.float32)
    return arrays


def describe(
    world: World,
    setting: Setting,
    *,
    version: str,
    scene: str,
    inputs: Mapping[str, str],
    units: str,
    up: str,
    first: int,
    last: int,
    preroll: int,
    checkpoint: int,
    attributes: tuple[str, ...],
    bodies: Mapping[str, str],
    camera: CameraEntry | None,
) -> Manifest:
    """The manifest of a run that begins with this world."""
    scale = 1.0 / setting.unit_mm
    return Manifest(
        antdsl=version,
        scene=scene,
        inputs=dict(inputs),
        units=units,  # type: ignore[arg-type]
        up=up,  # type: ignore[arg-type]
        fps=f"{setting.fps.numerator}/{setting.fps.denominator}",
        first=first,
        last=last,
        preroll=preroll,
        substeps=setting.substeps,
        seed=setting.seed,
        checkpoint=checkpoint,
        attributes=attributes,
        species=tuple(_species(world.populations[name], bodies.get(name)) for name in sorted(world.populations)),
        meshes=(
            *(MeshEntry(name=name, kind="surface") for name in setting.surfaces),
            *(MeshEntry(name=name, kind="obstacle") for name in setting.obstacles),
        ),
        fields=tuple(FieldEntry(name=name, cell=float(field.cells.cell) * scale) for name, field in world.fields.items()),
        items=tuple(
            ItemsEntry(
                name=name,
                names=tuple(item.name for item in items),
                position=tuple((x * scale, y * scale, z * scale) for x, y, z in (item.position for item in items)),
                radius=tuple(item.radius * scale for item in items),
                attributes=tuple(world.items[name].amounts) if name in world.items else (),
            )
            for name, items in setting.items.items()
        ),
        camera=camera,
    )


def _species(population: Population, body: str | None) -> SpeciesEntry:
    machines = tuple(
        MachineEntry(
            name=machine.name,
            states=tuple(
                StateEntry(name=name, label=label, colour=colour)
                for name, label, colour in zip(machine.states, machine.labels, machine.colours, strict=True)
            ),
        )
        for machine in population.plan.machines
    )
    return SpeciesEntry(name=population.name, body=body, machines=machines)


def _colours(population: Population) -> NDArray[np.float32]:
    machines = population.plan.machines
    return np.array(machines[0].colours if machines else ((1.0, 1.0, 1.0),), np.float32)


def _states(population: Population, rows: NDArray[np.intp]) -> NDArray[np.int32]:
    machines = population.plan.machines
    return population.now[f"{machines[0].name}.state"][rows] if machines else np.zeros(len(rows), np.int32)


def _register(population: Population, name: str, rows: NDArray[np.intp]) -> NDArray[np.float32]:
    return population.now[name][rows].astype(np.float32)


def _vector(population: Population, name: str, rows: NDArray[np.intp]) -> NDArray[np.float32]:
    return np.stack([population.now[f"{name}.{axis}"][rows] for axis in "xyz"], axis=1).astype(np.float32)


def _unit(vectors: NDArray[np.float64], otherwise: NDArray[np.float64]) -> NDArray[np.float64]:
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    return np.where(length > 1e-12, vectors / np.maximum(length, 1e-30), otherwise)


def _length_power(dim: Dim) -> float:
    return float(dim.length)
