"""Fields of vectors: what agents deposit, how it fades and spreads, what they read, and where else it goes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from compilers import need_llvmlite

from antdsl.fields.cells import SurfaceCells
from antdsl.fields.pheromone import DEPOSIT_QUANTUM, PheromoneField
from antdsl.fields.vector_field import VectorField
from antdsl.outputs.cache.cache_reader import open_cache
from antdsl.outputs.cache.field_strengths import FieldReader
from antdsl.outputs.gallery import Gallery
from antdsl.pipeline import Shot, open_scene
from antdsl.reload import migrate_world
from antdsl.runtime import Options, bind, state_hash, step
from antdsl.runtime.checkpoints import restore_checkpoint, take_checkpoint
from tests import commands
from tests.meshes import grid
from tests.periodic.periodic_scenes import HALF, open_world, read_vector, run, wrapped, write_points

PROGRAM = """ant 2
use steering
world { surface ground }
field way: push on ground { cell 1 mm; half_life 5 s; diffuse 0.1 mm^2/s }
species bird {
  size 0.1 mm; max_speed 1 mm/step; response 1 step; max_turn none
  strength = 0
  start lead
  state lead {
    steer wander() + along(way) * 0.5
    deposit way heading * (1 + id * 0.01) / 1 step
    strength = length(way)
    when reachable(way) and id > 20 -> led
  }
  state led {
    steer along(way, weight: 2)
    strength = length(way)
    when not reachable(way) -> lead
  }
  layers { state }
}
"""


def open_plane(folder: Path, program: str, crowd: str, keys: str = "", frames: str = "0..50") -> Shot:
    """Return a shot of a plane that does not wrap."""
    open_world(folder, program, crowd, keys=keys, half=30)
    scene = folder / "scene.yaml"
    lines = [line for line in scene.read_text().splitlines() if not line.startswith("wrap")]
    scene.write_text("\n".join(lines).replace("0..50", frames) + "\n")
    shot, report = open_scene(scene)
    assert shot is not None, report
    return shot


def test_no_result_depends_on_backend_threads_and_rows(tmp_path: Path) -> None:
    need_llvmlite()
    every = (
        Options(backend="numpy"),
        Options(backend="native", wait_for_code=True),
        Options(backend="native", wait_for_code=True, threads=2, shuffle_rows=3, chunk=7),
        Options(backend="numpy", threads=2, shuffle_rows=5, chunk=11),
    )
    for open_shot in (open_plane, open_world):
        shot = open_shot(tmp_path, PROGRAM, "count: 60, place: {on: ground}")
        assert len({state_hash(run(shot, 12, options)) for options in every}) == 1
        assert state_hash(run(shot, 4, Options(backend="reference"))) == state_hash(run(shot, 4, Options(backend="numpy")))


def test_a_cell_holds_the_sum_of_the_vectors_that_fades_by_its_half_life(tmp_path: Path) -> None:
    program = """ant 2
world { surface ground }
field way: push on ground { cell 2 mm; half_life 2 s }
species bird {
  size 0.1 mm; max_speed 0.000001 mm/s
  strength = 0; side = 0
  start wait
  state wait { when frame == 1 -> laid { deposit way vector(0.75, 0.5, -0.25 * id) } }
  state laid { strength = length(way); side = dot(way, vector(0, 0, 1)) }
  layers { state }
}
"""
    shot = open_plane(tmp_path, program, write_points(tmp_path, np.array([[0.2, 0, 0.2], [0.3, 0, -0.4], [9.0, 0, 9.0]])))
    world = run(shot, 1)
    vectors = world.vector_fields["way"].vectors
    ids = next(iter(world.populations.values())).ids
    assert sorted(ids.tolist()) == [0, 1, 2]
    assert {tuple(v) for v in vectors.tolist() if any(v)} == {(1.5, 1.0, -0.25), (0.75, 0.5, -0.5)}
    world = run(shot, 4)
    (population,) = world.populations.values()
    rows = population.get_rows_by_id()
    half = 0.5  # two steps of a second each, before those of the fourth step are read
    np.testing.assert_allclose(population.now["side"][rows], np.array([-0.25, -0.25, -0.5]) * half, rtol=1e-6)
    # the part along the ground's normal is left out of what agents read
    np.testing.assert_allclose(population.now["strength"][rows][2], np.hypot(0.75, 0.5) * half, rtol=1e-6)


def test_components_keep_their_sign_when_they_spread() -> None:
    field = PheromoneField(SurfaceCells([grid(40, 4)], 4.0), has_signed_amounts=True)
    middle = int(field.cells.find_cells(np.zeros((1, 3)), np.array([[0, 1.0, 0]]))[0])
    field.deposit(np.array([middle]), np.array([-8.0], np.float32))
    for _ in range(5):
        field.advance(0.5, 10.0, 0.1)
    assert (field.amounts <= 0).all() and np.count_nonzero(field.amounts) > 20
    np.testing.assert_allclose(field.amounts.sum(), -8.0 * 0.5**4, rtol=1e-12)
    for _ in range(60):
        field.advance(0.5, 0.0, 0.1)
    assert not field.amounts.any(), "what is nearer to 0 than 1e-12 becomes 0 on both sides"


def test_a_limit_shortens_vectors_and_keeps_their_direction() -> None:
    components = tuple(PheromoneField(SurfaceCells([grid(40, 4)], 4.0), has_signed_amounts=True) for _ in range(3))
    field = VectorField(components, limit=2.0)  # type: ignore[arg-type]
    for each, amount in zip(components, (3.0, 0.0, -4.0), strict=True):
        each.amounts[7] = amount
        each.amounts[8] = amount / 4
    field.limit_lengths()
    np.testing.assert_allclose(field.vectors[7], [1.2, 0, -1.6], rtol=1e-15)
    np.testing.assert_array_equal(field.vectors[8], [0.75, 0, -1.0])
    assert field.amounts[7] == pytest.approx(2) and np.count_nonzero(field.amounts) == 2


def test_deposits_do_not_depend_on_their_order() -> None:
    rng = np.random.default_rng(2)
    cells, amounts = rng.integers(0, 20, 4000), rng.normal(0, 1e-3, 4000).astype(np.float32)
    sums = []
    for order in (np.arange(4000), rng.permutation(4000)):
        field = PheromoneField(SurfaceCells([grid(40, 4)], 4.0), has_signed_amounts=True)
        for part in np.array_split(order, 7):
            field.deposit(cells[part], amounts[part])
        field.advance(1.0, 0.0, 0.1)
        sums.append(field.amounts.copy())
    np.testing.assert_array_equal(*sums)
    units = np.zeros(len(sums[0]))
    np.add.at(units, cells, np.rint(amounts.astype(np.float64) / DEPOSIT_QUANTUM))
    np.testing.assert_array_equal(sums[0], np.where(np.abs(units * DEPOSIT_QUANTUM) < 1e-12, 0, units * DEPOSIT_QUANTUM))


def test_followers_go_where_the_leader_went(tmp_path: Path) -> None:
    """One walks along x; those that stand on its path without a direction of their own follow it, those next to it do not."""
    program = """ant 2
use steering
world { surface ground }
field way: push on ground { cell 2 mm; half_life 60 s }
species bird {
  size 0.2 mm; max_speed 2 mm/step; response 1 step; max_turn none
  start wait
  state wait { when id == 0 -> lead; when id > 0 -> follow }
  state lead { steer toward(vector(1, 0, 0)); deposit way heading / 1 step }
  state follow { steer if reachable(way) then along(way) else halt() }
  layers { state }
}
"""
    starts = np.array([[-20.0, 0, 0], [-12, 0, 0], [-4, 0, 0], [-12, 0, 8], [-4, 0, -8]])
    place = read_vector(run(open_plane(tmp_path, program, write_points(tmp_path, starts)), 20), "position")
    displacement = place - starts
    assert (displacement[:3, 0] > 8).all(), displacement
    assert np.abs(displacement[3:]).max() < 0.01, displacement


def test_a_shifted_periodic_world_gives_the_shifted_field(tmp_path: Path) -> None:
    points = np.round(np.random.default_rng(7).uniform(-HALF, HALF, (40, 3)) * 1024) / 1024 * (1, 0, 1)
    shift, runs = np.array([HALF, 0, HALF]), []
    for by in (np.zeros(3), shift):
        world = run(open_world(tmp_path, PROGRAM, write_points(tmp_path, points + by), half=40), 6)
        runs.append((read_vector(world, "position") - by, world.vector_fields["way"]))
    difference = runs[1][0] - runs[0][0]
    difference[:, [0, 2]] = wrapped(difference[:, [0, 2]])
    assert np.abs(difference).max() < 1e-3
    stored = []
    for by, (_, field) in zip((np.zeros(3), shift), runs, strict=True):
        key = np.round(field.cells.position - by).astype(int) % 16
        stored.append({(int(x), int(z)): v for (x, _, z), v in zip(key, field.vectors, strict=True) if np.abs(v).max() > 1e-2})
    assert stored[0].keys() == stored[1].keys() and len(stored[0]) > 30
    assert max(np.abs(stored[0][key] - stored[1][key]).max() for key in stored[0]) < 1e-2


def test_a_checkpoint_and_a_reload_keep_the_vectors(tmp_path: Path) -> None:
    shot = open_plane(tmp_path, PROGRAM, "count: 30, place: {on: ground}")
    world = run(shot, 6)
    other = bind(shot.plan, shot.setting)
    restore_checkpoint(other, take_checkpoint(world))
    step(world)
    step(other)
    assert state_hash(world) == state_hash(other)
    for change, remains in ((("half_life 5 s", "half_life 2 s"), True), ((": push on", " on"), False)):
        text = PROGRAM.replace(*change)
        if not remains:
            text = text.replace("heading * ", "").replace("along(way, weight: 2)", "climb(way)")
            text = text.replace("along(way)", "climb(way)")
            text = text.replace("length(way)", "way").replace("reachable(way)", "way > 0")
        edited = open_plane(tmp_path, text, "count: 30, place: {on: ground}")
        new = migrate_world(world, edited.plan, edited.setting)[0]
        if remains:
            np.testing.assert_array_equal(new.vector_fields["way"].vectors, world.vector_fields["way"].vectors)
        else:
            assert not new.vector_fields and not new.fields["way"].amounts.any()


@pytest.mark.parametrize("crowd", ["count: 20, place: {on: ground}", "count: 0, place: {on: ground}"])
def test_a_cache_has_the_components_and_pictures_show_the_lengths(tmp_path: Path, crowd: str) -> None:
    shot = open_plane(tmp_path, PROGRAM, crowd, frames="0..5")
    assert commands.run("run", "scene.yaml", "--out", "out", cwd=tmp_path).returncode == 0
    cache = open_cache(tmp_path / "out")
    world = run(shot, 5)
    arrays, vectors = cache.frame(5), world.vector_fields["way"].vectors
    for name, component in zip("xyz", vectors.T, strict=True):
        np.testing.assert_array_equal(arrays[f"field.way.{name}.cells"], np.flatnonzero(component))
        np.testing.assert_array_equal(arrays[f"field.way.{name}.values"], component[component != 0].astype(np.float32))
    fields = [field for _, field in FieldReader(cache.manifest, cache.read_static()).read_frame(arrays)]
    assert len(fields) == len(Gallery(cache, full_strengths={"way": 3.0}).make_picture(5).trails) == (1 if vectors.any() else 0)
    for field in fields:
        assert field.name == "way" and field.cell == 1
        np.testing.assert_allclose(field.strengths, world.vector_fields["way"].amounts, rtol=1e-6)
    assert "field        way, vectors, cells of 1 mm" in commands.run("info", "out", cwd=tmp_path).stdout


@pytest.mark.parametrize(
    "old, new, code",
    [
        ("heading * (1 + id * 0.01) / 1 step", "2 /s", "wrong-kind"),
        ("heading * (1 + id * 0.01) / 1 step", "heading", "not-a-rate"),
        ("heading * (1 + id * 0.01) / 1 step", "velocity * 1 /s", "wrong-unit"),
        ("along(way, weight: 2)", "climb(way)", "wrong-kind"),
        ("along(way, weight: 2)", "direction(strongest(way))", "wrong-kind"),
        ("cell 1 mm", "cell 1 mm; combine max", "wrong-kind"),
        (": push on", ": velocity on", "unknown-type"),
        ("strength = length(way)", "strength = way", "wrong-kind"),
    ],
)
def test_what_does_not_fit_vectors_is_reported_at_its_place(tmp_path: Path, old: str, new: str, code: str) -> None:
    (tmp_path / "p.ant").write_text(PROGRAM.replace(old, new, 1))
    result = commands.run("check", "p.ant", cwd=tmp_path)
    assert result.returncode and f"error[{code}]" in result.stdout + result.stderr and "p.ant:" in result.stdout + result.stderr


def test_a_scene_cannot_start_vectors_with_a_number(tmp_path: Path) -> None:
    open_plane(tmp_path, PROGRAM, "count: 3, place: {on: ground}")
    scene = tmp_path / "scene.yaml"
    scene.write_text(scene.read_text() + "fields: {way: {start: 1}}\n")
    result = commands.run("check", "scene.yaml", cwd=tmp_path)
    assert result.returncode and "error[wrong-value]: `start` is a number, but the cells of `way` hold vectors" in result.stdout
    assert f"scene.yaml:{len(scene.read_text().splitlines())}:" in result.stdout


def test_advice_about_unused_vectors_names_vectors(tmp_path: Path) -> None:
    text = PROGRAM.replace("    deposit way heading * (1 + id * 0.01) / 1 step\n", "")
    open_plane(tmp_path, text, "count: 3, place: {on: ground}")
    assert "write `deposit way heading * 1 /s` in a state" in commands.run("check", "scene.yaml", cwd=tmp_path).stdout
    lines = [line for line in PROGRAM.splitlines() if "length(way)" not in line and "reachable" not in line]
    text = "\n".join(lines).replace(" + along(way) * 0.5", "").replace("along(way, weight: 2)", "wander()")
    (tmp_path / "p.ant").write_text(text + "\n")
    assert "let agents follow it: `steer along(way)`" in commands.run("check", "p.ant", cwd=tmp_path).stdout
