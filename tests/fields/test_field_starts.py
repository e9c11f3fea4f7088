"""Starting values of fields: numbers, vectors, discs, images and arrays, and where they land on the cells."""

from __future__ import annotations

import io
from pathlib import Path

import numpy as np
import pytest
from compilers import need_llvmlite
from PIL import Image

from antdsl.pipeline import Shot, open_scene
from antdsl.reload import migrate_world
from antdsl.runtime import Options, World, bind, state_hash, step
from antdsl.runtime.checkpoints import restore_checkpoint, take_checkpoint
from tests import commands
from tests.periodic.periodic_scenes import open_world, write_ply

PROGRAM = """ant 2
use steering
world { surface ground; surface roof; items nest }
field food on ground, roof { cell 4 mm; half_life 5 s }
field way: push on ground { cell 4 mm; half_life 5 s }
species bird {
  size 0.1 mm; max_speed 1 mm/step
  here = 0; strength = 0
  start seek
  state seek { steer wander() + along(way); here = food; strength = length(way); deposit food 0.5 /s; deposit way heading * 1 /s }
  layers { state }
}
"""
RNG = np.random.default_rng(3)
SAMPLES = RNG.integers(0, 9, (11, 21)).astype(np.float64)  # one for each cell of the ground: 40 mm × 80 mm


def write_rectangle(path: Path, x: float, z: float, height: float = 0.0, up: str = "y") -> None:
    """Write a level rectangle from -x to x and from -z to z, as seen by a scene with this `up`."""
    corners = np.array([[-x, height, -z], [x, height, -z], [x, height, z], [-x, height, z]])
    if up == "z":
        corners = np.stack([corners[:, 0], -corners[:, 2], corners[:, 1]], axis=1)
    write_ply(path, corners, [(0, 2, 1), (0, 3, 2)])


def write_scene(folder: Path, fields: str, up: str = "y", count: int = 4) -> Path:
    write_rectangle(folder / "ground.ply", 40, 20, up=up)
    write_rectangle(folder / "roof.ply", 12, 20, 30, up=up)
    (folder / "p.ant").write_text(PROGRAM)
    scene = folder / "scene.yaml"
    scene.write_text(
        f"antdsl: 1\nup: {up}\nfps: 1\nframes: 0..50\nworld:\n  ground: {{mesh: ground.ply}}\n  roof: {{mesh: roof.ply}}\n"
        f"  nest: {{home: {{at: [-20, 0, 0]}}, hole: {{at: [20, 0, 0]}}}}\nfields:\n  {fields}\n"
        f"crowd: [{{species: bird, from: p.ant, count: {count}, place: {{on: ground}}}}]\n"
    )
    return scene


def open_shot(scene: Path) -> Shot:
    shot, report = open_scene(scene)
    assert shot is not None, report
    return shot


def start(folder: Path, fields: str, up: str = "y") -> World:
    shot = open_shot(write_scene(folder, fields, up))
    return bind(shot.plan, shot.setting)


def read_table(world: World, name: str = "food", height: float = 0.0, up: str = "y") -> np.ndarray:
    """The values of the cells on a level surface: rows along z and columns along x, as seen from above."""
    field = {**world.fields, **world.vector_fields}[name]
    place, axes = np.round(field.cells.position / field.cells.cell), (2, 1) if up == "y" else (1, 2)
    own = np.flatnonzero(np.abs(place[:, axes[1]] * field.cells.cell - height) < 3)
    down = place[own, axes[0]] * (1 if up == "y" else -1)
    order = own[np.lexsort((place[own, 0], down))]
    values = field.vectors if name in world.vector_fields else field.amounts
    columns = len(np.unique(place[own, 0]))
    return values[order].reshape(len(own) // columns, columns, *values.shape[1:])


@pytest.mark.parametrize("up", ["y", "z"])
def test_a_grid_lies_over_the_ground_like_a_picture(up: str, tmp_path: Path) -> None:
    np.save(tmp_path / "food.npy", SAMPLES)
    world = start(tmp_path, "food: {values: food.npy, scale: 2, offset: 1}", up)
    np.testing.assert_array_equal(read_table(world, up=up), SAMPLES * 2 + 1)
    # the roof has what lies over it, as if seen from above
    np.testing.assert_array_equal(read_table(world, height=30, up=up), SAMPLES[:, 7:14] * 2 + 1)


def test_images_and_arrays_have_the_same_values(tmp_path: Path) -> None:
    small = SAMPLES.astype(np.uint8)
    Image.fromarray(small).save(tmp_path / "a.png")
    Image.fromarray(small.astype(np.uint16) * np.uint16(257)).save(tmp_path / "b.png")
    Image.fromarray(small.astype(np.float32)).save(tmp_path / "c.tif")
    np.savez(tmp_path / "d.npz", one=np.stack([small * 0, small]), two=small)
    keys = ("a.png, scale: 255", "b.png, scale: 255", "c.tif", "d.npz, array: one, layer: 1", "d.npz, array: two")
    for values in keys:
        np.testing.assert_allclose(read_table(start(tmp_path, f"food: {{values: {values}}}")), SAMPLES, rtol=1e-12)


def test_a_grid_covers_its_extent_only(tmp_path: Path) -> None:
    np.save(tmp_path / "food.npy", np.array([[1.0, 2.0], [3.0, 4.0], [5.0, 6.0]]))
    world = start(tmp_path, "food: [{start: 9}, {values: food.npy, extent: [16 mm, 24 mm], at: [-30 mm, 0, 2 mm], on: ground}]")
    table = read_table(world)
    expected = np.full((11, 21), 9.0)
    for row, z in enumerate(range(-20, 21, 4)):
        for column, x in enumerate(range(-40, 41, 4)):
            across, down = x + 38, z + 10  # from the corner of the grid
            if 0 <= across <= 16 and 0 <= down <= 24:
                expected[row, column] = 1 + min(across // 8, 1) + 2 * min(down // 8, 2)
    np.testing.assert_array_equal(table, expected)
    assert (read_table(world, height=30) == 9).all()


def test_discs_are_set_in_order_around_items_and_points(tmp_path: Path) -> None:
    fields = "food: [{start: 1}, {start: 3, around: home, radius: 10 mm}, {start: 5, around: [20, 0, 0], radius: 5 mm},"
    world = start(tmp_path, f"{fields} {{start: 7, around: hole, radius: 1 mm}}, {{start: 2, on: roof}}]")
    x, z = np.meshgrid(np.arange(-40, 41, 4), np.arange(-20, 21, 4))
    expected = np.ones(x.shape)
    expected[np.hypot(x + 20, z) <= 10] = 3
    expected[np.hypot(x - 20, z) <= 5] = 5
    expected[np.hypot(x - 20, z) <= 1] = 7
    np.testing.assert_array_equal(read_table(world), expected)
    assert (read_table(world, height=30) == 2).all()


def test_vectors_start_as_constants_discs_and_grids(tmp_path: Path) -> None:
    vectors = RNG.normal(size=(11, 21, 3))
    np.save(tmp_path / "way.npy", vectors)
    world = start(tmp_path, "way: [{start: [1, 2, -0.5]}, {start: [0, 0, 3], around: home, radius: 5 mm}]")
    table = read_table(world, "way")
    assert table[5, 5].tolist() == table[5, 6].tolist() == [0, 0, 3] and table[0, 0].tolist() == [1, 2, -0.5]
    assert np.count_nonzero((table == [0, 0, 3]).all(axis=2)) == 5
    np.testing.assert_array_equal(read_table(start(tmp_path, "way: {values: way.npy, scale: -2}"), "way"), vectors * -2)


def test_agents_read_the_part_of_a_vector_along_the_ground(tmp_path: Path) -> None:
    world = start(tmp_path, "way: {start: [0, 7, 0.25]}")
    step(world)
    (population,) = world.populations.values()
    np.testing.assert_allclose(population.now["strength"], 0.25, rtol=1e-6)


PERIODIC = """ant 2
use steering
world { surface ground }
field food on ground { cell 2 mm; half_life 5 s }
field way: push on ground { cell 2 mm; half_life 5 s }
species bird {
  size 0.1 mm; max_speed 1 mm/step
  start seek
  state seek { steer wander(); deposit food 1 /s; deposit way heading * 1 /s }
  layers { state }
}
"""


def test_a_grid_over_a_periodic_world_has_a_sample_for_each_cell(tmp_path: Path) -> None:
    samples = RNG.integers(0, 9, (8, 8)).astype(np.float64)
    np.save(tmp_path / "food.npy", samples)
    crowd = "count: 3, place: {on: ground}"
    tables = []
    for at in ("", ", at: [4 mm, 0, -2 mm]"):
        shot = open_world(tmp_path, PERIODIC, crowd, keys=f"fields: {{food: {{values: food.npy, extent: [16, 16]{at}}}}}\n")
        tables.append(read_table(bind(shot.plan, shot.setting)))
    np.testing.assert_array_equal(tables[0], samples)
    np.testing.assert_array_equal(tables[1], np.roll(samples, (-1, 2), (0, 1)))
    shot = open_world(tmp_path, PERIODIC, crowd, keys="fields: {food: {values: food.npy}}\n")
    np.testing.assert_array_equal(read_table(bind(shot.plan, shot.setting)), samples)


def test_a_disc_reaches_across_the_seam(tmp_path: Path) -> None:
    discs = {"food": "{start: 3, around: [8, 0, 8], radius: 3 mm}", "way": "{start: [1, 0, 0], around: [8, 0, 0], radius: 1 mm}"}
    keys = f"fields: {{food: {discs['food']}, way: {discs['way']}}}\n"
    shot = open_world(tmp_path, PERIODIC, "count: 3, place: {on: ground}", keys=keys)
    world = bind(shot.plan, shot.setting)
    table = read_table(world)
    assert np.argwhere(table == 3).tolist() == [[0, 0], [0, 1], [0, 7], [1, 0], [1, 1], [1, 7], [7, 0], [7, 1], [7, 7]]
    assert np.argwhere(read_table(world, "way")[:, :, 0]).tolist() == [[4, 0]]


def test_no_result_depends_on_backend_and_threads(tmp_path: Path) -> None:
    need_llvmlite()
    np.save(tmp_path / "food.npy", SAMPLES)
    fields = "{food: [{values: food.npy}, {start: 3, around: home, radius: 9}], way: {start: [1, 0, 0]}}"
    shot = open_shot(write_scene(tmp_path, fields))
    hashes = set()
    for options in (Options(backend="numpy"), Options(backend="native", wait_for_code=True, threads=2, shuffle_rows=3, chunk=7)):
        world = bind(shot.plan, shot.setting, options)
        for _ in range(4):
            step(world)
        hashes.add(state_hash(world))
    assert len(hashes) == 1


def test_checkpoints_hold_what_became_of_the_values(tmp_path: Path) -> None:
    shot = open_shot(write_scene(tmp_path, "{food: {start: 3, around: home, radius: 9}, way: {start: [1, 0, 0]}}"))
    world = bind(shot.plan, shot.setting)
    step(world)
    store = take_checkpoint(world)
    fresh = bind(shot.plan, shot.setting)
    restore_checkpoint(fresh, store)
    assert state_hash(fresh) == state_hash(world)


def test_a_reload_starts_only_changed_fields_again(tmp_path: Path) -> None:
    np.save(tmp_path / "food.npy", SAMPLES)
    fields = "{food: {values: food.npy}, way: {start: [1, 0, 0]}}"
    scene = write_scene(tmp_path, fields)
    shot = open_shot(scene)
    world = bind(shot.plan, shot.setting)
    for _ in range(3):
        step(world)
    np.save(tmp_path / "food.npy", SAMPLES + 1)
    new_world, migration = migrate_world(world, *(lambda s: (s.plan, s.setting))(open_shot(scene)))
    assert migration.reset_fields == ["food"]
    np.testing.assert_array_equal(read_table(new_world), SAMPLES + 1)
    np.testing.assert_array_equal(new_world.vector_fields["way"].vectors, world.vector_fields["way"].vectors)
    scene.write_text(scene.read_text().replace("start: [1, 0, 0]", "start: [1, 0, 1]"))
    _, migration = migrate_world(world, *(lambda s: (s.plan, s.setting))(open_shot(scene)))
    assert sorted(migration.reset_fields) == ["food", "way.x", "way.y", "way.z"]


def test_the_number_of_agents_may_be_zero(tmp_path: Path) -> None:
    scene = write_scene(tmp_path, "food: [{start: 1}, {start: 3, around: home, radius: 9}]", count=0)
    shot = open_shot(scene)
    world = bind(shot.plan, shot.setting)
    step(world)
    assert read_table(world).max() > 2


def npz(**arrays: np.ndarray) -> bytes:
    data = io.BytesIO()
    np.savez(data, **arrays)
    return data.getvalue()


@pytest.mark.parametrize(
    ("fields", "data", "words"),
    [
        ("food: {values: none.npy}", b"", "error[no-such-file]"),
        ("food: {values: a.npy}", np.zeros(9), "error[bad-paint]: `a.npy` has an array with 1 dimensions"),
        ("food: {values: a.npy}", np.zeros((0, 3)), "`a.npy` has no samples"),
        ("food: {values: a.npy}", np.array([[0, np.nan]]), "has a sample that is not a finite number"),
        ("food: {values: a.npy}", np.array([[0, -1.0]]), "gives -1 in row 0, column 1"),
        ("food: {values: a.npy, scale: 1e9}", np.array([[0, 2.0]]), "values go from 0 to 1e+09"),
        ("food: {values: a.npy}", np.asfortranarray(np.ones((3, 2))), "an unknown header"),
        ("food: {values: a.npy}", np.array([[{}]], object), "an unknown header"),
        ("food: {values: a.npy}", b"\x93NUMPY", "of an unknown kind"),
        ("food: {values: a.npy, array: b}", np.ones((3, 2)), "leave `array` out"),
        ("food: {values: a.npz}", npz(a=SAMPLES, b=SAMPLES), "name one: `array: …`"),
        ("food: {values: a.png}", b"no image", "cannot be read as PNG"),
        ("food: {values: a.csv}", b"1,2", "is not one of .png, .tif, .tiff, .npz, .npy"),
        ("food: {values: a.npy, radius: 3}", np.ones((3, 2)), "`radius` is not a key of"),
        ("food: {values: a.npy, on: floor}", np.ones((3, 2)), "`food` has no surface `floor`"),
        ("food: {start: 1, on: nest}", b"", "`food` has no surface `nest`"),
        ("food: {around: home, radius: 3}", b"", "error[missing-key]: `food` has no `start`"),
        ("food: {start: 1, around: home}", b"", "`around` has no effect without `radius`"),
        ("food: [{start: 1}, {start: 1, around: hoem, radius: 3}]", b"", "did you mean `home`?"),
        ("food: {start: -1}", b"", "is not between 0 and 1e+09"),
        ("food: {start: [1, 0, 0]}", b"", "`start` is a vector, but the cells of `food` hold numbers"),
        ("way: {start: [1, 0]}", b"", "this list has too few values"),
        ("way: {start: 1}", b"", "`start` is a number, but the cells of `way` hold vectors"),
        ("way: {values: a.npy}", np.ones((3, 2)), "save one of the shape (rows, columns, 3)"),
        ("way: {values: a.npy}", np.ones((3, 2, 2)), "has an array of the shape (3, 2, 2)"),
        ("way: {values: a.npy, offset: 1}", np.ones((3, 2, 3)), "leave `offset` out"),
        ("way: {values: a.png}", b"", "is an image, which has no vectors"),
    ],
)
def test_a_mistake_is_reported_at_its_place(fields: str, data: bytes | np.ndarray, words: str, tmp_path: Path) -> None:
    name = fields.partition("values: ")[2].partition(",")[0].strip("}") or "a"
    if isinstance(data, bytes):
        (tmp_path / name).write_bytes(data) if not name.startswith("none") else None
    else:
        np.save(tmp_path / name, data, allow_pickle=True)
    scene = write_scene(tmp_path, fields)
    result = commands.run("check", "scene.yaml", cwd=tmp_path)
    assert result.returncode and words in result.stdout, result.stdout
    assert "scene.yaml:10:" in result.stdout and scene.exists()


def test_values_outside_the_ground_are_reported(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", np.ones((3, 2)))
    fields = "food: [{start: 1, around: [900, 0, 0], radius: 3}, {values: a.npy, extent: [9, 9], at: [0, 0, 700]}, {start: 2}]"
    write_scene(tmp_path, fields)
    result = commands.run("run", "scene.yaml", "--frames", "1", cwd=tmp_path)
    assert (result.stdout + result.stderr).count("no cell of `food` is there, so this starting value has no effect") == 2


def test_a_grid_wider_than_a_periodic_world_is_an_error(tmp_path: Path) -> None:
    np.save(tmp_path / "a.npy", np.ones((3, 2)))
    open_world(tmp_path, PERIODIC, "count: 3, place: {on: ground}")
    scene = tmp_path / "scene.yaml"
    scene.write_text(scene.read_text() + "fields: {food: {values: a.npy, extent: [16, 20]}}\n")
    result = commands.run("check", "scene.yaml", cwd=tmp_path)
    assert "the grid is 20 mm wide along `z`, but the world repeats after 16 mm" in result.stdout
