"""Saves and restores the complete state of a world as named arrays, and hashes it. A run that continues from these arrays
gives identical results. The hash does not depend on row order, chunk size, thread count or backend. Different states have
different hashes."""

from __future__ import annotations

from collections.abc import Mapping
from hashlib import sha256
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.ground.protocol import Footing
from antdsl.numerics.records import select_by_prefix
from antdsl.numerics.row_hash import describe_columns
from antdsl.program.tables.columns import FIXED_COLUMN_BY_NAME
from antdsl.runtime.feet import feet_step
from antdsl.runtime.feet.feet_state import restore_feet
from antdsl.runtime.feet.wearers import find_sorted_ids
from antdsl.runtime.line_tables import collect_line_arrays, restore_line_tables
from antdsl.runtime.motion_measures import MotionMeasures
from antdsl.runtime.moving.moving_geometry import pose_geometry
from antdsl.runtime.world import Population, World, make_fixed_columns

STATE_HASH_VERSION = 2  # version of the hash method; hashes of other versions are not comparable
_HASHED_COLUMNS = tuple(name for name, column in FIXED_COLUMN_BY_NAME.items() if column.is_hashed)
_STORED_COLUMNS = ("ids", *(name for name, column in FIXED_COLUMN_BY_NAME.items() if name != "ids" and column.is_checkpointed))
NOTE_ARRAY_PREFIX = "notes."  # of the arrays that notes remember
Arrays = dict[str, NDArray[Any]]


class CheckpointError(ValueError):
    """Error for arrays that do not match the plan. The message names the first array that does not match."""


def take_checkpoint(world: World) -> Arrays:
    """Return copies of the arrays that form a world's state between two steps, by name."""
    arrays: Arrays = {"frame": np.array(world.frame, np.int64), "faults": np.array(world.faults.fault_count, np.int64)}
    arrays |= {f"param.{name}": np.array(value) for name, value in world.params.items()}
    for name, population in world.populations.items():
        arrays |= {f"species.{name}.{key}": array for key, array in _collect_population_arrays(population).items()}
        arrays[f"species.{name}.next_id"] = np.array(population.next_id, np.int64)
    for name, items in world.items.items():
        arrays |= {f"items.{name}.{attribute}": amounts for attribute, amounts in items.amounts.items()}
    for name, field in world.fields.items():
        arrays |= {f"field.{name}.{key}": array for key, array in field.added_cells.items()}
        arrays[f"field.{name}"] = field.amounts
    arrays |= {f"flow.{name}.{key}": array for name, flow in world.flows.items() for key, array in flow.get_state().items()}
    arrays |= {
        f"feet.{name}.{key}": array
        for name, feet in world.feet.items()
        for key, array in feet.sort_by_id().get_stored_arrays().items()
    }
    names = sorted(world.transitions)
    arrays["transitions.names"] = np.frombuffer("\n".join(names).encode(), np.uint8)
    arrays["transitions.counts"] = np.array([world.transitions[name] for name in names], np.int64)
    if world.detail_levels is not None:
        arrays["lod.counts"] = world.detail_levels.counts
    arrays |= collect_line_arrays(world)
    arrays |= (
        {} if world.notes is None else {f"{NOTE_ARRAY_PREFIX}{name}": array for name, array in world.notes.stored_arrays.items()}
    )
    arrays |= {f"motion.{name}": array for name, array in world.motion.collect_checkpoint_arrays().items()}
    arrays |= {
        f"solid.{name}.{key}": array for name, volume in world.solids.items() for key, array in volume.get_changes().items()
    }
    return {name: array.copy() for name, array in arrays.items()}


def restore_checkpoint(world: World, arrays: Mapping[str, NDArray[Any]]) -> None:
    """Restore a state into a world that is bound to the same plan and setting.

    Raises CheckpointError if the arrays do not match. The world is unusable after this error."""
    try:
        _restore_world(world, arrays)
        for population in world.populations.values():
            world.ground.position(population.footing)  # rejects invalid faces, which compiled code would not check
    except CheckpointError:
        raise
    # arrays from outside may fail in any of these ways
    except (ValueError, TypeError, IndexError, KeyError, OverflowError) as error:
        raise CheckpointError(f"the checkpoint is inconsistent ({type(error).__name__})") from error


def _restore_world(world: World, arrays: Mapping[str, NDArray[Any]]) -> None:
    """Restore a state. Raises exceptions of various types if the arrays do not match."""
    world.frame = int(_read_array_of_shape(arrays, "frame"))
    world.faults.fault_count = int(_read_array_of_shape(arrays, "faults"))
    for name in world.params:
        world.params[name] = np.float32(_read_array_of_shape(arrays, f"param.{name}"))
    for name, population in world.populations.items():
        _restore_population(population, arrays, f"species.{name}.")
    for name, items in world.items.items():
        for attribute, amounts in items.amounts.items():
            amounts[:] = _read_array_of_shape(arrays, f"items.{name}.{attribute}", amounts.shape)
        items.publish_amounts()
    for name, field in world.fields.items():
        if field.added_cells:
            field.restore_added_cells(
                _read_array_of_shape(arrays, f"field.{name}.keys"), _read_array_of_shape(arrays, f"field.{name}.places")
            )
        field.amounts[:] = _read_array_of_shape(arrays, f"field.{name}", field.amounts.shape)
    for name, volume in world.solids.items():
        solid_state = {key: _read_array_of_shape(arrays, f"solid.{name}.{key}") for key in volume.get_changes()}
        try:
            volume.restore_changes(solid_state)
        except ValueError as error:
            raise CheckpointError(f"`solid.{name}`: {error}") from None
    for name, flow in world.flows.items():
        state = flow.get_state()
        if state:
            flow.restore_state(
                {key: _read_array_of_shape(arrays, f"flow.{name}.{key}", like.shape).copy() for key, like in state.items()}
            )
    text = _read_array_of_shape(arrays, "transitions.names").astype(np.uint8).tobytes().decode()
    counts = _read_array_of_shape(arrays, "transitions.counts")
    world.transitions = dict(zip(text.split("\n") if text else [], (int(c) for c in counts), strict=True))
    restore_line_tables(world, arrays)
    if world.notes is not None:
        world.notes.restore_memory(select_by_prefix(arrays, NOTE_ARRAY_PREFIX))
    world.motion = MotionMeasures.from_arrays(select_by_prefix(arrays, "motion."))
    if world.detail_levels is not None:
        world.detail_levels.counts = _read_array_of_shape(arrays, "lod.counts", world.detail_levels.counts.shape).copy()
    world.grids.clear()
    world.trees.clear()
    world.clearances.clear()
    world.touching_agents = None
    pose_geometry(world, world.frame)
    _restore_feet(world, arrays)


def _restore_feet(world: World, arrays: Mapping[str, NDArray[Any]]) -> None:
    """Restore the state of the feet from a checkpoint. If it was written without feet, all agents start with their feet at
    rest."""
    if not world.feet:  # a world that was bound without agents
        feet_step.prepare_feet_of_bodies(world)
    restored_feet = {}
    for name, feet in world.feet.items():
        foot_arrays = select_by_prefix(arrays, f"feet.{name}.")
        if not foot_arrays:
            feet_step.place_initial_feet(world)
            return
        try:
            restored_feet[name] = restore_feet(foot_arrays, feet, find_sorted_ids(world, name))
        except ValueError as error:
            raise CheckpointError(f"`feet.{name}`: {error}") from None
    world.feet = restored_feet


def _collect_population_arrays(population: Population) -> Arrays:
    """Return the arrays that form the state of a species, by name."""
    arrays: Arrays = {name: population.columns[name] for name in _STORED_COLUMNS}
    arrays |= {f"footing.{name}": array for name, array in population.footing.columns.items()}
    arrays |= {f"event.{name}": flags for name, flags in population.events.items()}
    stored_names = (name for name, register in population.plan.registers.items() if register.role != "temp")
    return arrays | {f"register.{name}": population.now[name] for name in stored_names}


def _restore_population(population: Population, arrays: Mapping[str, NDArray[Any]], prefix: str) -> None:
    """Restore the agents of a species from the arrays with names that begin with `prefix`."""
    count = len(_read_array_of_shape(arrays, f"{prefix}ids"))
    now = _collect_population_arrays(population)
    taken = {}
    for key, like in now.items():
        array = _read_array_of_shape(arrays, prefix + key, (count, *like.shape[1:]))
        if array.dtype != like.dtype:
            raise CheckpointError(f"`{prefix}{key}` holds {array.dtype}, not {like.dtype}")
        taken[key] = array.copy()
    population.columns = make_fixed_columns(count, **{name: taken[name] for name in _STORED_COLUMNS})
    population.footing = Footing({name: taken[f"footing.{name}"] for name in population.footing.columns})
    population.events = {name: taken[f"event.{name}"] for name in population.events}
    population.raised_events = {name: np.zeros(count, np.bool_) for name in population.events}
    for name, register in population.plan.registers.items():
        shared = population.start[name] is population.now[name]
        old = population.now[name]
        population.now[name] = (
            np.full(count, register.initial_value, old.dtype) if register.role == "temp" else taken[f"register.{name}"]
        )
        population.start[name] = population.now[name] if shared else population.now[name].copy()
    population.cells.clear()
    population.next_id = int(_read_array_of_shape(arrays, f"{prefix}next_id"))
    population.version += 1


def _read_array_of_shape(arrays: Mapping[str, NDArray[Any]], name: str, shape: tuple[int, ...] | None = None) -> NDArray[Any]:
    """Return the array called `name`. Raises CheckpointError if it is missing or does not have the shape `shape`."""
    if name not in arrays:
        raise CheckpointError(f"`{name}` is missing")
    array = arrays[name]
    if shape is not None and array.shape != shape:
        raise CheckpointError(f"`{name}` has the shape {array.shape}, not {shape}")
    return array


def state_hash(world: World) -> str:
    """Return a hash of the state: the first 128 bits of a SHA-256 hash, in hexadecimal.

    The hash covers the agents of each species (`hash_rows`), items, fields, solids, flows, and the memory of notes."""
    digest, threads = sha256(), world.options.threads
    digest.update(np.int64(world.frame).tobytes())
    for name in sorted(world.populations):
        population = world.populations[name]
        digest.update(f"\0{name}\0{len(population)}".encode())
        digest.update(_compute_rows_hash(population, threads))
        digest.update(np.int64(population.next_id).tobytes())
    for name in sorted(world.items):
        for attribute, amounts in sorted(world.items[name].amounts.items()):
            digest.update(f"\0{name}\0{attribute}\0".encode() + amounts.tobytes())
    for name in sorted(world.fields):
        values = world.fields[name].amounts
        digest.update(f"\0{name}\0{len(values)}".encode() + world.fields[name].row_hasher.hash_rows(None, [values], threads))
    for name in sorted(world.solids):
        digest.update(f"\0{name}\0".encode() + world.solids[name].compute_digest())
    for name in sorted(world.flows):
        for key, array in sorted(world.flows[name].get_state().items()):
            digest.update(f"\0{name}\0{key}\0".encode() + array.tobytes())
    for name, array in sorted(world.notes.stored_arrays.items()) if world.notes is not None else ():
        digest.update(f"\0{name}\0".encode() + array.tobytes())
    return digest.hexdigest()[:32]


def _compute_rows_hash(population: Population, threads: int) -> bytes:
    """Return the hash of all arrays that form the state of a species' agents."""
    columns = [(name, population.columns[name]) for name in _HASHED_COLUMNS]
    columns += [(f"footing.{name}", array) for name, array in population.footing.columns.items()]
    columns += [(name, population.now[name]) for name in population.list_state_registers()]
    columns += [(f"event.{name}", flags) for name, flags in sorted(population.events.items())]
    names, arrays = zip(*columns, strict=True)
    return describe_columns(names, arrays) + population.row_hasher.hash_rows(population.ids, arrays, threads)
