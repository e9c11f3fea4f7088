"""The table of arrays against what is stored, hashed, checkpointed, saved and in packets."""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np
import pytest
import stick_bodies
from foraging_shots import world as foraging_world

from antdsl.numerics.records import join_record_rows, match_ids, select_record_rows
from antdsl.outputs.cache.agent_arrays import VALUE_WRITERS
from antdsl.outputs.cache.event_arrays import EVENT_ARRAY_MAKERS
from antdsl.outputs.cache.frame_agents import ALWAYS_SAVED_ARRAYS, list_special_arrays
from antdsl.outputs.cache.frame_maker import FrameMaker
from antdsl.outputs.cache.pose_arrays import PlacedFeet
from antdsl.outputs.cache.solid_pieces import PieceMaker
from antdsl.pipeline import RunChoices, open_scene
from antdsl.preview import agent_columns
from antdsl.program.tables.columns import (
    AGENT_COLUMNS,
    COLUMN_BY_ATTRIBUTE,
    DEFAULT_ATTRIBUTE_NAMES,
    FEET_COLUMNS,
    FIXED_COLUMN_BY_NAME,
    FRAME_COLUMNS,
    REGISTER_COLUMN_BY_NAME,
    Column,
)
from antdsl.runtime import Options, World, bind, state_hash, step, take_checkpoint
from antdsl.runtime.feet.feet_state import FeetState

ROOT = Path(__file__).resolve().parents[2]


def fits(name: str, array: np.ndarray, column: Column) -> bool:
    """Whether an array of a frame is as a row says."""
    pattern = re.sub("[A-Z]{2,}", r"[^.]+", column.frame_name.replace(".", r"\."))
    sizes = array.shape if column.row_kind == "frame" else array.shape[1:]
    same = [isinstance(size, str) or size == real for size, real in zip(column.shape, sizes, strict=False)]
    return (
        re.fullmatch(pattern, name) is not None
        and array.dtype == np.dtype(column.frame_type)
        and len(sizes) == len(column.shape)
        and all(same)
    )


@pytest.mark.parametrize("name", ["foraging", "tunnel", "roaches", "walker"])
def test_frames_have_arrays_of_the_table(name: str, tmp_path: Path) -> None:
    path = ROOT / "examples" / name / "scene.yaml"
    shot, report = open_scene(path if name != "walker" else stick_bodies.write_scene(tmp_path, 6, "hill", count=4), RunChoices())
    assert shot is not None, report
    world = bind(shot.plan, shot.setting, Options(backend="numpy", feet=name == "walker"))
    world.dug_balls, world.emissions = {}, []
    numbers = tuple(each.name for species in shot.program.species.values() for each in species.attributes if each.name == "load")
    maker = FrameMaker(world, shot.program, (*COLUMN_BY_ATTRIBUTE, *numbers), PieceMaker(1, 1, 1.0), tuple(EVENT_ARRAY_MAKERS))
    array_names: set[str] = set()
    for _ in range(3):
        step(world)
        for array_name, array in maker.frame(world).items():
            rows = [column for column in FRAME_COLUMNS if fits(array_name, array, column)]
            assert rows or array_name in numbers, f"{array_name} {array.dtype} {array.shape} has no row"
            array_names.update(column.frame_name for column in rows)
    assert array_names.issuperset({"frame", *COLUMN_BY_ATTRIBUTE, "events.emit.event", "events.contact.depth"})
    assert name != "walker" or "feet.SPECIES.tilt" in array_names
    assert name != "tunnel" or "mesh.SOLID.bricks" in array_names


def forager(world: World) -> dict[str, np.ndarray]:
    return {
        key.removeprefix("species.forager."): each for key, each in take_checkpoint(world).items() if key.startswith("species.")
    }


def test_fixed_arrays_are_in_checkpoints_and_in_the_hash_as_the_table_says() -> None:
    world = foraging_world(Options(backend="numpy"), count=20)
    population, stored, initial_hash = world.populations["forager"], forager(world), state_hash(world)
    assert list(population.columns) == list(FIXED_COLUMN_BY_NAME)
    for name, column in FIXED_COLUMN_BY_NAME.items():
        array = population.columns[name]
        assert array.dtype == np.dtype(column.type) and array.shape == (20, *column.shape), name
        assert (name in stored) == column.is_checkpointed, name
        if name != "ids":
            population.columns[name] = array.copy()
            population.columns[name][3] = array[3] == 0 if array.dtype == np.bool_ else array[3] + 1
            assert (state_hash(world) != initial_hash) == column.is_hashed, name
            population.columns[name] = array
    assert state_hash(world) == initial_hash


def test_registers_of_the_table_are_those_of_a_plan() -> None:
    registers = foraging_world(Options(backend="numpy"), count=2).populations["forager"].plan.registers
    missing = [name for column in REGISTER_COLUMN_BY_NAME.values() for name in column.registers if name not in registers]
    assert not missing


def test_each_derived_array_has_a_function() -> None:
    derived = {column.name for column in AGENT_COLUMNS if column.kind == "derived"}
    requested = {column.name for column in COLUMN_BY_ATTRIBUTE.values() if column.kind == "derived"}
    assert requested == set(VALUE_WRITERS)
    assert {column.name for column in AGENT_COLUMNS if column.kind == "derived" and column.packet} == set(
        agent_columns.VALUE_FUNCTIONS
    )
    assert derived - requested - set(agent_columns.VALUE_FUNCTIONS) == {"frame", *ALWAYS_SAVED_ARRAYS}


def test_defaults_and_own_attributes_of_formats() -> None:
    assert DEFAULT_ATTRIBUTE_NAMES == ("P", "v", "orient", "id", "pscale", "Cd", "state")
    assert list_special_arrays("csv") == {"P", "orient", "pscale", "id", "species"} and list_special_arrays(
        "usd"
    ) == list_special_arrays("geo")


def test_packets_have_the_shown_arrays_with_the_types_of_the_table() -> None:
    population = foraging_world(Options(backend="numpy"), count=20).populations["forager"]
    columns = [column for column in AGENT_COLUMNS if column.packet]
    arrays = agent_columns.make_packet_arrays(population, columns)
    assert {f"{name} {array.dtype.str[1:]}" for name, array in arrays.items()} == {column.packet for column in columns}
    assert all(array.shape == (20, *column.shape) for array, column in zip(arrays.values(), columns, strict=True))
    first = agent_columns.make_reduced_frame(population)
    again = agent_columns.make_reduced_frame(population, first)
    assert set(first) == {c.packet.split()[0] for c in columns if c.in_preview} | {"state/main"}
    assert all(again[name] is first[name] for name in first), "equal arrays are stored once"


def test_feet_have_the_columns_of_the_table() -> None:
    arrays = FeetState.make_empty(6).get_stored_arrays()
    assert list(arrays) == [column.name for column in FEET_COLUMNS]
    for column in FEET_COLUMNS:
        assert arrays[column.name].shape == tuple({"n": 0, "L": 6, "S": 0}.get(str(size), size) for size in column.shape)


def test_rows_of_records() -> None:
    feet = PlacedFeet(*(np.arange(3 * size, dtype=np.float32).reshape(3, size) for size in (1, 2, 3, 4, 5)))  # type: ignore[arg-type]
    record = {"feet": feet, "word": "ant", "pair": (np.arange(3), None)}
    taken = select_record_rows(record, np.array([2, 0]))
    assert taken["word"] == "ant" and taken["pair"][0].tolist() == [2, 0] and taken["pair"][1] is None  # type: ignore[index]
    assert np.array_equal(taken["feet"].tilt, feet.tilt[[2, 0]])  # type: ignore[attr-defined]
    joined = join_record_rows(record, record)
    assert joined["pair"][0].tolist() == [0, 1, 2, 0, 1, 2] and joined["feet"].P.shape == (6, 1) and joined["word"] == "ant"
    assert join_record_rows(record, None) is None
    at, known = match_ids(np.array([7, 2]), np.array([1, 2, 5]))
    assert known.tolist() == [False, True] and at[1] == 1
    assert not match_ids(np.array([7, 2]), np.empty(0, np.int64))[1].any()
