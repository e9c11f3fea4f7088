"""Kernels that make frames and measure them, against NumPy in a line or two, for extreme values too."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from plans import bare, block, crowd

from antdsl.bodies.agents.machine_clips import EARLIER_CLIP_FIELDS
from antdsl.outputs.cache.agent_arrays import write_colours, write_column, write_numbers, write_orientations
from antdsl.outputs.cache.frame_maker import _find_nonzero_cells
from antdsl.outputs.cache.pose_arrays import _REGISTER_BY_FIELD, make_clip_arrays, make_feet_arrays, mark_layer
from antdsl.outputs.surface_error import _find_greatest_error, measure_surface_error
from antdsl.program.tables.columns import COLUMN_BY_ATTRIBUTE
from antdsl.runtime import Options, Population, World, bind
from antdsl.runtime.feet.feet_state import FeetState
from antdsl.runtime.feet.trunk import compute_slope_quaternions

EXTREMES = np.array([0.0, -0.0, 1.0, -1.0, 1e-13, -1e-13, 1e-30, 1e30, np.inf, -np.inf, np.nan, 0.6, -0.8], np.float32)


@pytest.fixture
def world() -> World:
    bound_world = bind(bare(block()), crowd(600, radius=90.0), Options(backend="numpy"))
    rng = np.random.default_rng(5)
    now = bound_world.populations["ant"].now
    for name in ("heading", "up", "velocity"):
        for axis in "xyz":
            now[f"{name}.{axis}"][:300] = rng.choice(EXTREMES, 300)
            now[f"{name}.{axis}"][300:] = rng.normal(size=300)
    now["heading.x"][:40], now["heading.z"][:40] = -1.0, 0.0  # straight back, where `up` may lie along it
    now["heading.y"][:40] = rng.choice(EXTREMES[:2], 40)
    return bound_world


def written(write: Callable[[NDArray[Any]], None], shape: tuple[int, ...]) -> NDArray[Any]:
    """What is written into the middle rows of an array: those beside them stay."""
    padded_array = np.full((shape[0] + 5, *shape[1:]), 77, np.float32)
    write(padded_array[2:-3])
    assert (padded_array[:2] == 77).all() and (padded_array[-3:] == 77).all()
    return padded_array[2:-3]


def mixed(population: Population) -> None:
    """Give the rows ids in another order."""
    population.ids = np.random.default_rng(2).permutation(len(population)).astype(np.int64) * 3
    population.version += 1


@pytest.mark.parametrize("attribute", ["P", "v"])
def test_places_and_velocities_of_a_frame(world: World, attribute: str) -> None:
    population = world.populations["ant"]
    mixed(population)
    population.position[:5] = -0.0
    rows = np.argsort(population.ids)
    result = written(lambda out: write_column(population, COLUMN_BY_ATTRIBUTE[attribute], 0.1, out), (600, 3))
    if attribute == "P":
        expected = ((population.position[rows] + 0.0) * 0.1).astype(np.float32)
    else:
        velocity = np.stack([population.now[f"velocity.{axis}"] for axis in "xyz"], axis=1)
        with np.errstate(all="ignore"):
            expected = velocity[rows] * np.float32(0.1)
    unknown = np.isnan(expected)
    assert (result.view(np.int32) == expected.view(np.int32))[~unknown].all() and np.isnan(result[unknown]).all()


def test_orientations_of_a_frame_turn_the_axes_as_they_say(world: World) -> None:
    """+x to the heading, +x where there is none, and +y as near to up as can be."""
    population = world.populations["ant"]
    mixed(population)
    orientations = written(lambda out: write_orientations(world, population, out), (600, 4))
    orientations = orientations[np.argsort(np.argsort(population.ids))]
    heading, up = (
        np.stack([population.now[f"{name}.{axis}"] for axis in "xyz"], axis=1).astype(np.float64) for name in ("heading", "up")
    )
    with np.errstate(all="ignore"):
        size = np.sqrt((heading * heading).sum(axis=1))
        heading = np.where(size[:, None] < 1e-12, [1.0, 0, 0], heading / np.where(size < 1e-12, 1, size)[:, None])
        sound = np.isfinite(heading).all(axis=1) & np.isfinite(up).all(axis=1) & (np.abs(up).max(axis=1) < 1e20)
    x, y, z, w = np.nan_to_num(orientations.astype(np.float64)).T
    heading, up = np.where(sound[:, None], heading, 0.0), np.where(sound[:, None], up, 0.0)
    along = np.stack([1 - 2 * (y * y + z * z), 2 * (x * y + z * w), 2 * (x * z - y * w)], axis=1)
    above = np.stack([2 * (x * y - z * w), 1 - 2 * (x * x + z * z), 2 * (y * z + x * w)], axis=1)
    assert sound.sum() > 330 and np.abs(along - heading)[sound].max() < 1e-5
    assert np.abs(np.sqrt(x * x + y * y + z * z + w * w) - 1)[sound].max() < 1e-6
    flat = up - (up * heading).sum(axis=1)[:, None] * heading
    size = np.sqrt((flat * flat).sum(axis=1))
    clear = sound & (size > 1e-6 * np.sqrt((up * up).sum(axis=1))) & (size > 1e-11)
    assert clear.sum() > 320 and np.abs(above - flat / np.where(size > 0, size, 1)[:, None])[clear].max() < 1e-5
    level = sound & (size < 1e-13)  # no up: the shortest turn to the heading, half a one about z straight back
    assert level.sum() > 5 and np.abs(x[level]).max() < 1e-6
    back = level & (heading[:, 0] < -1 + 1e-12)
    assert back.any() and np.abs(z[back] - 1).max() < 1e-6


def test_numbers_of_agents(world: World) -> None:
    population = world.populations["ant"]
    mixed(population)
    population.now["size"][:] = np.random.default_rng(9).choice(EXTREMES, 600)
    sizes = written(lambda out: write_numbers(population, "size", 0.1, out), (600,))
    expected = population.now["size"][np.argsort(population.ids)] * np.float32(0.1)
    assert np.array_equal(expected, sizes, equal_nan=True) and len(np.unique(expected)) > 5


@pytest.mark.parametrize("three", [False, True])
def test_what_agents_play(three: bool) -> None:
    rng, ids = np.random.default_rng(11), np.random.default_rng(12).permutation(300)
    now = {
        f"m.{register}": rng.integers(-1, 9, 300).astype("i4" if kind == "i2" else kind)
        for register, kind in _REGISTER_BY_FIELD.values()
    }
    now["m.clip_earlier_fade"] = (now["m.clip_fade"] > 0).astype(np.float32) * np.float32(three)
    plan = SimpleNamespace(machines=[SimpleNamespace(name="m")], registers={"m.clip": None})

    class Subset(SimpleNamespace):
        def __len__(self) -> int:
            return 300

    rows = np.argsort(ids)
    population = Subset(
        name="ant", plan=plan, now=now, compute_id_ranks=lambda: ids.astype(np.int32), get_rows_by_id=lambda: rows
    )
    clip_arrays = make_clip_arrays(population)  # type: ignore[arg-type]
    assert list(clip_arrays) == [
        f"clips.ant.m.{field}" for field in _REGISTER_BY_FIELD if three or field not in EARLIER_CLIP_FIELDS
    ]
    for name, array in clip_arrays.items():
        register, kind = _REGISTER_BY_FIELD[name.rsplit(".", 1)[1]]
        assert array.dtype == kind and np.array_equal(array, now[f"m.{register}"][rows]) and len(np.unique(array)) > 1


@pytest.mark.parametrize("odd", [0.0, np.nan])
def test_the_distance_from_the_ground(world: World, odd: float) -> None:
    population = world.populations["ant"]
    population.position += np.random.default_rng(3).normal(size=(600, 3))
    population.now["size"][:3] = 0.0
    for rows in (slice(0, 3), slice(3, None)):
        population.now["clearance"][7] = odd
        population.now["clearance"][rows] += 0.25
        away = population.position.astype(np.float32) - world.ground.position(population.footing)
        distance = np.sqrt((away[:, 0] * away[:, 0] + away[:, 1] * away[:, 1]) + away[:, 2] * away[:, 2])
        shares = np.abs(distance - population.now["clearance"]) / np.maximum(population.now["size"].astype(np.float64), 1e-9)
        worst = _find_greatest_error(world, population, world.ground.position(population.footing))
        assert worst == shares.max() or (np.isnan(worst) and np.isnan(odd))
        assert np.isnan(odd) or measure_surface_error(world) == worst > 0
        population.now["size"][:3] = 50.0


@pytest.mark.parametrize("count", [0, 1, 7, 4000])
def test_cells_of_a_field(count: int) -> None:
    values = np.random.default_rng(count).choice([0.0, -0.0, 1e-300, -2.5, 1e300, np.inf, np.nan, 0.1], count)
    cells, strength = _find_nonzero_cells(values)
    assert cells.dtype == np.int32 and np.array_equal(cells, np.flatnonzero(values != 0))
    with np.errstate(over="ignore"):
        assert np.array_equal(strength, values[values != 0].astype(np.float32), equal_nan=True)


def test_who_wears_a_layer() -> None:
    rng = np.random.default_rng(4)
    on, ids, initial_bits = rng.random(500) < 0.3, rng.permutation(500), rng.integers(0, 2**63, 500).astype(np.uint64)
    population, layer_bits, rows = (
        SimpleNamespace(compute_id_ranks=lambda: ids.astype(np.int32)),
        initial_bits.copy(),
        np.argsort(ids),
    )
    for bit in (0, 5, 63):
        mark_layer(population, on, np.uint64(1 << bit), layer_bits)  # type: ignore[arg-type]
    expected = np.where(on[rows], initial_bits | np.uint64(1 | 1 << 5 | 1 << 63), initial_bits)
    assert np.array_equal(layer_bits, expected) and not np.array_equal(layer_bits, initial_bits)


def test_colours_of_states() -> None:
    states = np.random.default_rng(6).integers(0, 5, 300).astype(np.int32)
    ids = np.random.default_rng(8).permutation(300)
    colours = np.random.default_rng(7).random((5, 3)).astype(np.float32)
    plan = SimpleNamespace(machines=[SimpleNamespace(name="m", colours=colours)])
    world = SimpleNamespace(options=SimpleNamespace(threads=1))
    population = SimpleNamespace(plan=plan, now={"m.state": states}, compute_id_ranks=lambda: ids.astype(np.int32))
    result = written(lambda out: write_colours(world, population, out), (300, 3))  # type: ignore[arg-type]
    assert np.array_equal(result[ids], colours[states])
    for wrong in (5, -1):
        states[17] = wrong
        with pytest.raises(IndexError):
            write_colours(world, population, result)  # type: ignore[arg-type]


@pytest.mark.parametrize(("count", "threads"), [(0, 1), (3, 1), (700, 1), (5_000, 2)])
def test_feet_of_a_frame(count: int, threads: int) -> None:
    rng, scale = np.random.default_rng(count), 0.1
    feet = FeetState.make_empty(6).match_ids(rng.permutation(count))[0]
    for array in (feet.shown, feet.slope, feet.rise, feet.phase):
        array[:] = rng.choice(EXTREMES, array.shape)
        array[..., count // 2 :] = rng.normal(size=array[..., count // 2 :].shape) * 1000
    feet.swing[:] = rng.choice(np.array([-1.0, 0.0, 0.5], np.float32), feet.swing.shape)
    world = SimpleNamespace(feet={"ant": feet}, populations={}, options=SimpleNamespace(threads=threads))
    arrays = make_feet_arrays(world, "ant", scale)  # type: ignore[arg-type]
    feet = feet.sort_by_id()
    with np.errstate(all="ignore"):
        expected = {
            "P": ((feet.shown.transpose(1, 2, 0) + 0.0) * scale).astype(np.float32),
            "down": feet.is_standing.astype(np.uint8),
            "phase": feet.phase,
            "rise": feet.rise * np.float32(scale),
            "tilt": compute_slope_quaternions(feet.slope),
        }
    assert list(arrays) == [f"feet.ant.{name}" for name in expected]
    for name, array in expected.items():
        result = arrays[f"feet.ant.{name}"]
        assert result.dtype == array.dtype and result.shape == array.shape and result.flags.c_contiguous
        kind = f"u{array.itemsize}"
        number = np.isnan(array) if array.dtype.kind == "f" else np.zeros(array.shape, np.bool_)
        assert (np.ascontiguousarray(array).view(kind)[~number] == result.view(kind)[~number]).all()
        assert array.dtype.kind != "f" or (np.isnan(result) == number).all()
