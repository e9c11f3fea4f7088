"""Periodic worlds against plain NumPy: neighbours, fields, movement; a world shifted by half its width gives the shifted run."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from compilers import need_llvmlite
from periodic_scenes import FLOCK, HALF, PLAIN_FLOCK, open_world, read_vector, run, wrapped, write_points
from typer.testing import CliRunner

from antdsl.cli import app
from antdsl.fields.cells import SurfaceCells
from antdsl.fields.periodic_cells import CellsDoNotFit, PeriodicCells
from antdsl.fields.pheromone import PheromoneField
from antdsl.numerics.periodic_box import PeriodicBox, measure_offset
from antdsl.runtime import Options, bind, state_hash, step
from antdsl.runtime.faults import LimitStop
from antdsl.scene.geometry.clipping import clip_mesh

BOX = PeriodicBox((-HALF, 0.0, -HALF), (2 * HALF, 0.0, 2 * HALF))
STILL = """ant 2
world {{ surface ground; items food {{ load = 1 }} }}
species bird {{
  size 0.1 mm; max_speed 0.001 mm/s
  seen = 0; near = 0 mm; middle = 0 mm; item = 0 mm; ring = 0; far = 0 mm
  start look
  state look {{
    seen = count(neighbours(radius: {radius}))
    near = if any(neighbours(radius: {radius})) then min(n in neighbours(radius: {radius}): distance(n)) else 0 mm
    middle = length(sum(n in neighbours(radius: {radius}): n.position - position))
    item = distance(nearest(food))
    ring = count(n in neighbours(radius: {radius}, fov: 120 deg): n.id > 3)
    far = distance(nearest(bird))
  }}
  layers {{ state }}
}}
"""


@pytest.mark.parametrize("radius", [2.5, 7.9, 8.0, 30.0])
def test_neighbours_are_the_nearest_images(tmp_path: Path, radius: float) -> None:
    points = np.random.default_rng(4).uniform(-HALF, HALF, (60, 3)) * (1, 0, 1)
    food = "food: {{a: {{at: [7.5, 0, -7.75]}}, b: {{at: [9.5, 0, 1]}}}}".format()
    shot = open_world(
        tmp_path,
        STILL.format(radius=f"{radius} mm"),
        write_points(tmp_path, points),
        world=f"{{ground: {{mesh: ground.ply}}, {food}}}",
    )
    start = bind(shot.plan, shot.setting)
    place, ahead = read_vector(start, "position"), read_vector(start, "heading")
    world = run(shot, 1)
    (population,) = world.populations.values()
    rows = population.get_rows_by_id()
    offset = wrapped(place[None, :] - place[:, None])
    distance = np.sqrt((offset**2).sum(axis=2))
    np.fill_diagonal(distance, np.inf)
    near = distance <= radius

    def check(name: str, expected: np.ndarray) -> None:
        np.testing.assert_allclose(population.now[name][rows], expected, atol=2e-4, err_msg=name)

    check("seen", near.sum(axis=1))
    check("near", np.where(near.any(axis=1), distance.min(axis=1), 0))
    check("middle", np.sqrt(((offset * near[:, :, None]).sum(axis=1) ** 2).sum(axis=1)))
    check("far", distance.min(axis=1))
    items = np.array([[7.5, 0, -7.75], [9.5, 0, 1]])
    check("item", np.sqrt((wrapped(items[None, :] - place[:, None]) ** 2).sum(axis=2)).min(axis=1))
    visible = near & ((offset * ahead[:, None]).sum(axis=2) >= 0.5 * distance)
    check("ring", (visible & (np.arange(60) > 3)[None, :]).sum(axis=1))


def test_no_result_depends_on_backend_threads_and_rows(tmp_path: Path) -> None:
    need_llvmlite()
    shot = open_world(tmp_path, FLOCK, "count: 60, place: {on: ground}")
    every = (
        Options(backend="numpy"),
        Options(backend="native", wait_for_code=True),
        Options(backend="native", wait_for_code=True, threads=2, shuffle_rows=3, chunk=7),
        Options(backend="numpy", threads=2, shuffle_rows=5, chunk=11),
    )
    assert len({state_hash(run(shot, 12, options)) for options in every}) == 1
    assert state_hash(run(shot, 4, Options(backend="reference"))) == state_hash(run(shot, 4, Options(backend="numpy")))


@pytest.mark.parametrize("wrap", ["both", "x", "z"])
def test_a_shifted_world_gives_the_shifted_run(tmp_path: Path, wrap: str) -> None:
    """Start points are multiples of 2**-10 mm and the shift is half the width, so starts are exact. Later, coordinates of another
    size round differently: to some 1e-6 mm a step."""
    sides = {"both": "{x: -8 mm .. 8 mm, z: -8 mm .. 8 mm}", "x": "{x: -8 mm .. 8 mm}", "z": "{z: -8 mm .. 8 mm}"}[wrap]
    shift = np.array({"both": (8.0, 0, 8.0), "x": (8.0, 0, 0), "z": (0, 0, 8.0)}[wrap])
    points = np.round(np.random.default_rng(7).uniform(-HALF, HALF, (40, 3)) * 1024) / 1024 * (1, 0, 1)
    runs = []
    for by in (np.zeros(3), shift):
        shot = open_world(tmp_path, FLOCK, write_points(tmp_path, points + by), wrap=sides, half=40)
        world = run(shot, 8)
        runs.append((read_vector(world, "position"), read_vector(world, "heading"), read_vector(world, "unwrapped"), world))
    (place, heading, unwrapped, first), (moved, turned, _, second) = runs
    difference = moved - place - shift
    for axis in (0, 2):
        difference[:, axis] = wrapped(difference[:, axis]) if shift[axis] else difference[:, axis]
    assert np.abs(difference).max() < 1e-3
    assert np.abs(turned - heading).max() < 1e-3
    assert (np.abs(place[:, [k for k in (0, 2) if shift[k]]]) <= HALF).all()
    assert np.abs(unwrapped - points)[:, [0, 2]].max() > 2, "agents have crossed the seam"
    assert np.abs(wrapped(unwrapped - place)[:, [k for k in (0, 2) if shift[k]]]).max() < 1e-5
    cells = [field for world in (first, second) for field in world.fields.values()]
    where = [np.round(each.cells.position * 2).astype(int) for each in cells]
    amounts = []
    for each, at, by in zip(cells, where, (np.zeros(3), shift), strict=True):
        key = at - (2 * by).astype(int)
        for axis in (0, 2):
            key[:, axis] = key[:, axis] % 32 if shift[axis] else key[:, axis]
        amounts.append({tuple(k): v for k, v in zip(key.tolist(), each.amounts.tolist(), strict=True) if v > 1e-3})
    assert amounts[0].keys() == amounts[1].keys()
    assert all(abs(amounts[0][key] - amounts[1][key]) < 1e-2 for key in amounts[0])


def test_agents_wrap_and_keep_an_unwrapped_position(tmp_path: Path) -> None:
    program = """ant 2
world { surface ground }
species bird {
  size 0.1 mm; max_speed 3 mm/step; response 1 step; max_turn none
  gone = 0 mm
  start fly
  state fly { steer match(heading * 3 mm/step); gone = length(unwrapped) }
  layers { state }
}
"""
    shot = open_world(tmp_path, program, write_points(tmp_path, np.zeros((1, 3))))
    world = bind(shot.plan, shot.setting)
    heading = read_vector(world, "heading")[0]
    for frame in range(1, 12):
        step(world)
        np.testing.assert_allclose(read_vector(world, "unwrapped")[0], 3 * frame * heading, atol=1e-4)
        place = read_vector(world, "position")[0]
        assert (np.abs(place) <= HALF + 1e-6).all()
        np.testing.assert_allclose(wrapped(place - 3 * frame * heading), 0, atol=1e-4)
        (population,) = world.populations.values()
        np.testing.assert_allclose(population.now["gone"][0], 3 * (frame - 1), atol=1e-4)
    assert world.motion.summarise()["step_max"] <= 1 + 1e-5, "no measure takes a wrap for a step"


def test_a_world_without_surfaces_wraps(tmp_path: Path) -> None:
    shot = open_world(tmp_path, PLAIN_FLOCK, "count: 30, place: {around: [0, 0, 0], radius: 8 mm}", world="{}")
    world = run(shot, 20)
    place, unwrapped = read_vector(world, "position"), read_vector(world, "unwrapped")
    assert (np.abs(place) <= HALF).all() and np.abs(unwrapped).max() > HALF
    assert np.abs(wrapped(unwrapped - place)).max() < 1e-5
    assert state_hash(run(shot, 8, Options(backend="reference"))) == state_hash(run(shot, 8, Options(threads=2, shuffle_rows=2)))


@pytest.mark.parametrize("count", [0, 1])
def test_few_agents(tmp_path: Path, count: int) -> None:
    shot = open_world(tmp_path, FLOCK, f"count: {count}, place: {{on: ground}}")
    hashes = {state_hash(run(shot, 5, Options(backend=name))) for name in ("numpy", "native", "reference")}  # type: ignore[arg-type]
    assert len(hashes) == 1


# --- fields ----------------------------------------------------------------------------------------------------------


def make_cells(half: float, cell: float, low: float = -HALF) -> PeriodicCells:
    """Cells of a level square in a box of 16 mm that begins at `low`."""
    ends = np.array([[low, 0, low], [low + 2 * half, 0, low], [low + 2 * half, 0, low + 2 * half], [low, 0, low + 2 * half]])
    box = PeriodicBox((low, 0.0, low), (2 * half, 0.0, 2 * half))
    return PeriodicCells([(ends, np.array([[0, 2, 1], [0, 3, 2]], np.int32))], cell, box)


@pytest.mark.parametrize("stencil", [4, 8])
@pytest.mark.parametrize("low", [-HALF, -7.5, 0.0, 3.25])
def test_fields_spread_as_on_a_torus(stencil: int, low: float) -> None:
    cells = make_cells(HALF, 1.0, low)
    assert len(cells) == 16 * 16
    np.testing.assert_array_equal(cells.position, np.round(cells.position))
    field = PheromoneField(cells, stencil=stencil)
    start = np.random.default_rng(2).uniform(0, 9, 256)
    field.amounts[:] = start
    at = np.round(cells.position[:, [0, 2]]).astype(int) % 16
    grid = np.zeros((16, 16))
    grid[at[:, 0], at[:, 1]] = start
    for _ in range(5):
        field.advance(1.0, 0.2, 1.0)
        flat = sum(np.roll(grid, by, axis) for axis in (0, 1) for by in (1, -1)) - 4 * grid
        corners = sum(np.roll(np.roll(grid, a, 0), b, 1) for a in (1, -1) for b in (1, -1)) - 4 * grid
        grid = grid + 0.2 * (flat if stencil == 4 else (4 * flat + corners) / 6)
    np.testing.assert_allclose(field.amounts, grid[at[:, 0], at[:, 1]], rtol=1e-12)
    assert field.amounts.sum() == pytest.approx(start.sum(), rel=1e-12)


def test_cells_are_found_and_ranked_across_the_seam() -> None:
    cells = make_cells(HALF, 1.0)
    rng = np.random.default_rng(3)
    points = rng.uniform(-3 * HALF, 3 * HALF, (500, 3)) * (1, 0, 1)
    numbers = cells.find_cells(points, np.tile([0.0, 1, 0], (500, 1)))
    expected = np.floor(points + 0.5)
    np.testing.assert_array_equal(wrapped(cells.position[numbers] - expected)[:, [0, 2]], 0)
    nearest = cells.get_nearest_cells(9)
    for cell in rng.integers(0, 256, 20):
        offset = wrapped(cells.position[nearest[cell]] - cells.position[cell])
        assert np.abs(offset).max() == 1 and len(set(nearest[cell].tolist())) == 9


def test_a_field_slopes_evenly_across_the_seam() -> None:
    cells = make_cells(HALF, 1.0)
    field = PheromoneField(cells)
    field.amounts[:] = 5 + np.sin(cells.position[:, 0] * np.pi / HALF)
    slope = field.sample_gradient(np.arange(256))
    np.testing.assert_allclose(slope[0], np.cos(cells.position[:, 0] * np.pi / HALF) * np.sin(np.pi / HALF), atol=1e-5)


def test_cells_of_heights_are_those_of_the_continued_surface() -> None:
    """The cells of a wavy surface are those of three by three copies of it, as far as they are in the box."""
    side = np.linspace(-HALF, HALF, 17)
    x, z = np.meshgrid(side, side, indexing="ij")
    vertices = np.stack([x, np.sin(x * np.pi / HALF) + np.cos(z * np.pi / HALF), z], axis=-1).reshape(-1, 3)
    vertices[:, 1] = np.round(vertices[:, 1], 9)
    a = (np.arange(16)[:, None] * 17 + np.arange(16)).ravel()
    faces = np.concatenate([np.stack([a, a + 1, a + 18], 1), np.stack([a, a + 18, a + 17], 1)]).astype(np.int32)
    wide = [(vertices + np.array([i, 0, k]) * 2 * HALF, faces) for i in (-1, 0, 1) for k in (-1, 0, 1)]
    copies, cells = SurfaceCells(wide, 1.0), PeriodicCells([(vertices, faces)], 1.0, BOX)
    inside = ((np.round(copies.position[:, [0, 2]]) >= -HALF) & (np.round(copies.position[:, [0, 2]]) < HALF)).all(axis=1)
    keys = {tuple(row) for row in np.round(copies.position[inside], 3).tolist()}
    own = {tuple(row) for row in np.round(cells.position, 3).tolist()}
    assert len(own & keys) > 0.95 * len(own)
    links = {
        tuple(key): n for key, n in zip(np.round(copies.position, 3).tolist(), np.diff(copies.links.link_starts), strict=True)
    }
    pairs = zip(np.round(cells.position, 3).tolist(), np.diff(cells.links.link_starts).tolist(), strict=True)
    counts = [(links[tuple(key)], n) for key, n in pairs if tuple(key) in links]
    assert len(counts) > 0.95 * len(own) and all(expected == n for expected, n in counts), "no cell is at a border"


@pytest.mark.parametrize("cell", [0.75, 3.0, 8.0])
def test_cells_must_fit(cell: float) -> None:
    with pytest.raises(CellsDoNotFit) as error:
        make_cells(HALF, cell)
    make_cells(HALF, error.value.fitting_cell)


# --- parts -----------------------------------------------------------------------------------------------------------


def test_box() -> None:
    points = np.array([[-8.0, 99, 8.0], [8.25, 0, -24.5], [100.0, 0, 0], [np.nan, 0, np.inf]])
    wrapped_points = BOX.wrap_points(points)
    np.testing.assert_array_equal(wrapped_points[:3], [[-8, 99, 8], [-7.75, 0, 7.5], [4, 0, 0]])
    assert BOX.axes == (0, 2) and BOX.least_width == 16 and len(BOX.list_images()) == 9
    first, second = np.random.default_rng(1).uniform(-8, 8, (2, 1000)).astype(np.float32)
    np.testing.assert_allclose(measure_offset(first, second, 16.0), wrapped(first.astype(float) - second), atol=2e-6)
    np.testing.assert_array_equal(measure_offset(first, second, 0.0), first - second)
    half = np.array([-8.0, 0.0], np.float32), np.array([0.0, -8.0], np.float32)
    np.testing.assert_array_equal(measure_offset(*half, 16.0), [-8, 8])


def test_clipping_keeps_area_and_fronts() -> None:
    rng = np.random.default_rng(5)
    vertices, faces = rng.uniform(-2, 2, (90, 3)), np.arange(90, dtype=np.int32).reshape(-1, 3)
    low, high = np.array([-1.0, -np.inf, -0.5]), np.array([0.75, np.inf, 1.0])
    points, cut = clip_mesh(vertices, faces, low, high)
    corners = points[cut]
    assert (corners[..., [0, 2]] >= low[[0, 2]]).all() and (corners[..., [0, 2]] <= high[[0, 2]]).all()

    def areas(c: np.ndarray) -> np.ndarray:
        return np.cross(c[:, 1] - c[:, 0], c[:, 2] - c[:, 0]) / 2

    weights = rng.dirichlet(np.ones(3), 20000)
    inside = 0.0
    for face in faces:
        at = weights @ vertices[face]
        share = ((at >= low) & (at <= high)).all(axis=1).mean()
        inside += share * np.linalg.norm(areas(vertices[face][None]))
    assert np.linalg.norm(areas(corners), axis=1).sum() == pytest.approx(inside, rel=0.02)
    for parts in (([-np.inf] * 3, [np.inf] * 3),):
        np.testing.assert_array_equal(clip_mesh(vertices, faces, *map(np.array, parts))[1], faces)


QUICK = """ant 2
use steering
world { surface ground }
species bird {
  size 1 mm
  response 1 step
  max_turn none
  max_speed uniform(1 mm/step, SPEED)
  start go
  state go { steer match(heading * max_speed) }
}
"""


def test_a_step_of_half_a_width_stops_the_run(tmp_path: Path) -> None:
    shot = open_world(tmp_path, QUICK.replace("SPEED", "7 mm/step"), "count: 40, place: {on: ground}")
    run(shot, 3)
    shot = open_world(tmp_path, QUICK.replace("SPEED", "14 mm/step"), "count: 40, place: {on: ground}")
    with pytest.raises(
        LimitStop, match=r"bird \d+ at frame \d+: `velocity` is so high that the agent crosses half of the world"
    ) as stop:
        run(shot, 3)
    assert "`max_speed`" in str(stop.value) and "step = " in str(stop.value)
    result = CliRunner().invoke(app, ["run", str(tmp_path / "scene.yaml"), "--out", str(tmp_path / "out"), "-q"])
    assert result.exit_code == 1 and "half of the world or more in one step" in str(result.exception)
