"""Digging: tunnels are walked through, no agent passes undug solid, what is removed is counted, and a run can be repeated and
continued to the bit."""

from __future__ import annotations

from pathlib import Path

import digging_shots
import numpy as np
import pytest
from test_cli import antdsl

from antdsl.bodies.shapes import build_sphere
from antdsl.fields.cells import SurfaceCells
from antdsl.fields.growing import GrowingCells
from antdsl.ground.combined import CombinedGround
from antdsl.ground.mesh.topology import classify_normal_directions
from antdsl.ground.protocol import Footing
from antdsl.ground.solid import Volume
from antdsl.ground.solid_feelers import SolidProximityQueries
from antdsl.outputs.cache.cache_reader import open_cache
from antdsl.outputs.cache.dug_solids import DugSolids
from antdsl.outputs.cut_plane import CutPlane
from antdsl.pipeline import Shot
from antdsl.runtime import CheckpointError, Options, World, bind, restore_checkpoint, state_hash, step, take_checkpoint

STEPS = 80


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return digging_shots.folder(tmp_path_factory.mktemp("dig"))


@pytest.fixture(scope="module")
def shot(scene: Path) -> Shot:
    return digging_shots.opened(scene)


def bound(shot: Shot, **options: object) -> World:
    return bind(shot.plan, shot.setting, Options(**options))  # type: ignore[arg-type]


@pytest.fixture(scope="module")
def watched(shot: Shot) -> tuple[World, list[str], dict[str, list[np.ndarray]]]:
    """A run, its hashes, and all positions at each frame."""
    world = bound(shot)
    hashes = [state_hash(world)]
    positions_by_name: dict[str, list[np.ndarray]] = {"digger": [], "walker": [], "on": [], "off": []}
    hill, falls = world.solids["hill"], 0
    for _ in range(STEPS):
        previous_positions = {name: p.position[p.get_rows_by_id()] for name, p in world.populations.items()}
        step(world)
        hashes.append(state_hash(world))
        for name, population in world.populations.items():
            rows = population.get_rows_by_id()
            place, mesh = population.position[rows], population.footing.mesh[rows]
            positions_by_name[name].append(place)
            away = hill.sample_distances(place).astype(np.float64)
            assert (away[mesh == 0] > -0.06 * hill.voxel).all(), "on ground that is inside undug solid"
            level = 1.2 * np.sin(place[:, 0] / 20) + np.cos(place[:, 2] / 17)
            assert (place[:, 1] > level - 0.4).all(), "below the ground"
            middle = hill.sample_distances((place + previous_positions[name]) / 2)
            assert (middle > -0.75 * hill.voxel).all(), "through undug solid"
            distances = np.sqrt(((place - previous_positions[name]) ** 2).sum(axis=1))
            most = population.now["max_speed"][rows].astype(np.float64) / 24
            assert (distances < 1.01 * most).all(), "farther than a step, or a fall of one frame"
            falling = (mesh == 1) & (np.abs(away) > 4e-4)
            assert (distances[falling] > 0.99 * most[falling]).all(), "off the solid's surface, and not on the way down to it"
            falls += int(falling.sum())
            heading, up = population.read_vector("heading")[rows], population.read_vector("up")[rows]
            assert np.abs((heading * up).sum(axis=1)).max() < 1e-4
            assert np.abs((heading * heading).sum(axis=1) - 1).max() < 1e-4
    assert falls, "nobody's ground was dug away"
    return world, hashes, positions_by_name


def test_diggers_come_out_on_the_other_side_of_the_hill_they_went_into(watched, shot):
    _, _, positions_by_name = watched
    digger = np.stack(positions_by_name["digger"])
    fresh = bound(shot).solids["hill"]
    inside = fresh.sample_distances(digger.reshape(-1, 3)).reshape(digger.shape[:2])
    through = (inside.min(axis=0) < -1.5) & (digger[0, :, 0] < -15) & (digger[-1, :, 0] > 15)
    assert through.sum() >= 3
    assert digger[:, through, 1].max() < 9, "through, not over: the hill is 17 high"


def test_an_agent_that_does_not_dig_stays_outside(watched, shot):
    _, _, positions_by_name = watched
    walker = np.stack(positions_by_name["walker"])
    dug = watched[0].solids["hill"].sample_distances(walker.reshape(-1, 3))
    assert dug.min() > -0.06
    assert (walker[-1, :, 0] > 0).sum() > 2, "over the hill, round it or through what others dug"
    assert walker[:, :, 1].max() > 5, "some of them climbed it"


def test_what_is_removed_is_what_was_counted(watched, shot):
    world = watched[0]
    hill = world.solids["hill"]
    held = world.populations["digger"].now["soil"].astype(np.float64).sum()
    dropped_soil = world.items["heap"].amounts["soil"].sum()
    start_volume = bound(shot).solids["hill"].measure_volume()
    assert hill.removed_volume > 500 and dropped_soil > 100
    assert held + dropped_soil == hill.removed_volume == start_volume - hill.measure_volume()


def test_open_ground_in_a_tunnel_is_walked_on(watched, shot):
    """The floor of a tunnel is the ground's own triangles where they are in the open again."""
    fresh = bound(shot)
    hill, ground = fresh.solids["hill"], fresh.ground
    middle = np.array([[0.0, 0.0, 0.0]])
    standing, _ = ground.place_points(middle, fresh.up, ["ground"])
    assert standing.mesh[0] == 1, "closed by the hill: the place is on top of it"
    floor = ground.meshes.position(ground.meshes.place_points(middle, fresh.up, None)[0])
    hill.carve_balls(floor + np.array([0.0, 2.0, 0.0]), np.array([5.0]), np.zeros(1, np.int64))
    direction = np.array([[1.0, 0.0, 0.0]])
    onto = ground.find_nearest(floor)[0]
    moved = ground.move(onto, direction, direction, np.array([[0.0, 1.0, 0.0]]), 4.0)
    assert moved.footing.mesh[0] == 0 and not moved.is_blocked[0]
    assert moved.position[0, 0] == pytest.approx(floor[0, 0] + 1.0, abs=0.05)


def test_fields_lie_on_the_walls_that_were_dug(watched):
    world = watched[0]
    field = world.fields["trail"]
    cells = field.cells
    assert cells.used_count - cells.initial_count > 50
    new = slice(cells.initial_count, cells.used_count)
    assert (field.amounts[new] > 0).sum() > 10, "scent was laid in them"
    away = np.abs(world.solids["hill"].sample_distances(cells.position[new]))
    assert np.quantile(away, 0.5) < 1.0
    assert (cells.find_cells(cells.position[new], cells.normal[new]) >= 0).all()
    table, none = cells.nearest_block_cells[new], len(cells)
    assert ((table == np.arange(cells.initial_count, cells.used_count)[:, None]).any(axis=1)).all() and (table < none).sum(
        axis=1
    ).min() > 2
    again = cells._compute_nearest_cells(np.arange(cells.used_count), 16)
    assert np.array_equal(again, cells.nearest_block_cells[: cells.used_count]), "rows kept up to date are those made anew"


@pytest.mark.parametrize(
    "options",
    [
        {"chunk": 3, "shuffle_rows": 1},
        {"threads": 2, "chunk": 5},
        pytest.param({"backend": "reference", "shuffle_rows": 4}, marks=pytest.mark.slow),
    ],
    ids=str,
)
def test_the_same_hash_at_every_frame(shot, watched, options):
    world = bound(shot, **options)
    for frame in range(40):
        step(world)
        assert state_hash(world) == watched[1][frame + 1], frame


def test_a_checkpoint_goes_on_to_the_same_hashes(shot, watched):
    world = bound(shot)
    for _ in range(45):
        step(world)
    saved = take_checkpoint(world)
    other = bound(shot, shuffle_rows=2)
    restore_checkpoint(other, saved)
    for frame in range(45, 60):
        assert state_hash(other) == watched[1][frame]
        step(other)
    saved["solid.hill.values"] = saved["solid.hill.values"][:-1]
    with pytest.raises(CheckpointError, match="hill"):
        restore_checkpoint(bound(shot), saved)


def run(*words: str | Path, code: int = 0) -> str:
    process = antdsl(*map(str, words), cwd=Path.cwd())
    assert process.returncode == code, process.stdout + process.stderr
    return process.stdout + process.stderr


def surface(folder: Path, frame: int, solids: DugSolids | None = None) -> tuple[np.ndarray, np.ndarray]:
    cache = open_cache(folder)
    (dug_solid,) = (solids or DugSolids(cache, cache.read_static())).at(frame)
    return dug_solid.vertices, dug_solid.faces


def triangles(vertices: np.ndarray, faces: np.ndarray) -> np.ndarray:
    corners = vertices[faces].reshape(-1, 9)
    return corners[np.lexsort(corners.T)]


def written_out(folder: Path, frame: int) -> np.ndarray:
    """The triangles of a frame that has all that was dug, by the arrays alone."""
    cache = open_cache(folder)
    static, arrays = cache.read_static(), cache.frame(frame)
    is_unchanged = ~np.isin(static["mesh.hill.bricks"], arrays["mesh.hill.changed"])
    old = static["mesh.hill.vertices"][static["mesh.hill.faces"][is_unchanged]]
    corners = np.concatenate([old, arrays["mesh.hill.vertices"][arrays["mesh.hill.faces"]]]).reshape(-1, 9)
    return corners[np.lexsort(corners.T)]


@pytest.mark.slow
def test_a_cache_shows_what_was_dug_and_can_be_continued(scene, shot, tmp_path):
    complete, parts = tmp_path / "whole", tmp_path / "parts"
    run("run", scene, "--out", complete)
    run("run", scene, "--out", parts, "--frames", "1..21")
    run("run", scene, "--out", parts, "--frames", "1..40", "--resume")
    assert open_cache(complete).read_state_hashes() == open_cache(parts).read_state_hashes()
    world = bound(shot)
    cache = open_cache(complete)
    in_order = DugSolids(cache, cache.read_static())
    counts = set()
    for frame in range(1, 41):
        if frame in (1, 20, 33, 40):
            pieces = [(v, f) for _, v, f in world.solids["hill"].iterate_brick_meshes(changed_only=False)]
            shift = np.cumsum([0, *(len(v) for v, _ in pieces)])
            faces = np.concatenate([f + s for (_, f), s in zip(pieces, shift, strict=False)])
            true = triangles(np.concatenate([v for v, _ in pieces]), faces)
            if frame == 33:
                for folder in (complete, parts):
                    assert np.array_equal(written_out(folder, frame), true), "for those who do not dig it again"
            counts.add(len(true))
            for dug_mesh in (surface(complete, frame), surface(parts, frame), surface(complete, frame, in_order)):
                assert np.array_equal(triangles(*dug_mesh), true), frame
        step(world)
    assert len(counts) > 2, "something was dug in between"
    assert in_order.at(40)[0] is in_order.at(40)[0]
    run("render", complete, "--frames", "40..40", "--width", "160", "--height", "90")


@pytest.mark.parametrize(
    ("line", "code", "word"),
    [
        ("  hill: {mesh: hill.ply}", "missing-key", "voxel: 1 mm"),
        ("  hill: {mesh: hill.ply, voxel: 0.001 mm}", "too-large", "voxels of"),
        ("  hill: {mesh: ground.ply, voxel: 1 mm}", "bad-mesh", "is not closed: 140 edges belong to only one face"),
    ],
)
def test_solids_that_cannot_be(tmp_path, line, code, word):
    text = digging_shots.SCENE.replace("  hill: {mesh: hill.ply, voxel: 1 mm}", line)
    scene = digging_shots.folder(tmp_path, scene=text)
    said = run("check", scene, code=1)
    assert code in said and word in said and str(scene.name) + ":" in said


@pytest.mark.parametrize(("voxel", "warned"), [("1 mm", False), ("1.3 mm", False), ("1.4 mm", True)])
def test_voxels_too_coarse_for_who_walks_there_are_warned_of(tmp_path, voxel, warned):
    """Those who walk and dig there are 4 mm long."""
    scene = digging_shots.folder(tmp_path, scene=digging_shots.SCENE.replace("voxel: 1 mm", f"voxel: {voxel}"))
    output = run("check", scene, "--format", "concise")
    assert ("odd-scale" in output and f"voxels of `hill` are {voxel} wide" in output) is warned


def test_a_surface_has_no_voxels(tmp_path):
    text = digging_shots.SCENE.replace("  ground: {mesh: ground.ply}", "  ground: {mesh: ground.ply, voxel: 1 mm}")
    scene = digging_shots.folder(tmp_path, scene=text)
    assert "only solids have voxels" in run("check", scene, code=1)


@pytest.mark.parametrize("dense", [8_000_000, 0])
def test_cells_are_found_alike_however_many_are_looked_up(dense, monkeypatch):
    """Rows of the nearest and cells near a place, one by one and all at once, in a box that is listed and in one that is not."""
    from antdsl.fields import cells as cell_tables

    monkeypatch.setattr(cell_tables, "_MAX_DENSE_VOXELS", dense)
    cells, draw = GrowingCells([digging_shots.hill()], 3.0), np.random.default_rng(3)
    cells.get_nearest_cells(5)
    for _ in range(6):
        normal = draw.normal(size=(80, 3))
        cells.add_cells_at_points(draw.uniform(-16, 16, (80, 3)), normal / np.linalg.norm(normal, axis=1)[:, None])
    draw = np.random.default_rng(4)
    positions, normals = draw.uniform(-24, 24, (900, 3)), draw.normal(size=(900, 3))
    cell_rows = cells.find_cells(positions, normals)
    assert 0.05 < (cell_rows < 0).mean() < 0.9 and cells.used_count - cells.initial_count > 200
    one_by_one = [cells.find_cells(positions[n : n + 1], normals[n : n + 1])[0] for n in range(0, 900, 30)]
    assert np.array_equal(one_by_one, cell_rows[::30])
    voxel = np.floor(positions / cells.cell + 0.5).astype(np.int64) - cells._low
    assert np.array_equal(
        SurfaceCells._find_nearby_cells(cells, positions, voxel, classify_normal_directions(normals).astype(np.int64)),
        cells._find_nearby_cells(positions, voxel, classify_normal_directions(normals).astype(np.int64)),
    )
    for count in (5, 16):
        assert np.array_equal(
            cells._compute_nearest_cells(np.arange(cells.used_count), count), cells.get_nearest_cells(count)[: cells.used_count]
        )


def test_feelers_meet_a_ball_where_it_is_and_run_along_it_free():
    vertices, faces = build_sphere(4)
    ball = Volume.from_mesh(vertices * 20.0, faces, 1.0)
    assert isinstance(ball, Volume)
    feel = SolidProximityQueries(ball)
    draw = np.random.default_rng(1)
    direction = draw.normal(size=(200, 3))
    direction /= np.linalg.norm(direction, axis=1)[:, None]
    start = -direction * 32.0 + np.cross(direction, [0.3, 0.5, 0.8]) * 9.0
    off = np.linalg.norm(np.cross(direction, [0.3, 0.5, 0.8]), axis=1) * 9.0
    hits = feel.cast_feelers(start.T, direction.T, 60.0)
    assert hits.hit.all()
    assert hits.t == pytest.approx(32.0 - np.sqrt(400 - off**2), abs=0.35)
    hit_points = start + hits.t[:, None] * direction
    normal = np.stack([hits.nx, hits.ny, hits.nz], axis=1)
    assert ((normal * hit_points).sum(axis=1) > 0.97 * np.linalg.norm(hit_points, axis=1)).all()
    assert not feel.cast_feelers(start.T, direction.T, 11.0).hit.any(), "nothing so near"
    on = ball.project_to_surface(direction * 20.0, direction).points
    side = np.cross(direction, [0.1, 0.9, 0.2])
    side /= np.linalg.norm(side, axis=1)[:, None]
    assert not feel.cast_feelers(on.T, side.T, 6.0).hit.any(), "along its surface"
    assert feel.cast_feelers(on.T, -direction.T, 6.0).hit.all(), "into it"
    for away, error in ((2.0, 0.1), (30.0, 2.0)):
        near = feel.find_nearest_within(*(direction * (20 + away)).T, np.inf)
        assert near.t == pytest.approx(away, abs=error)
        assert (np.stack([near.nx, near.ny, near.nz], axis=1) * direction).sum(axis=1).min() > 0.99
    assert not feel.find_nearest_within(*(direction * 50.0).T, ball.distance_band[1]).hit.any(), (
        "nothing is touched by who reaches just to the band's end"
    )
    clear = feel.measure_clearance(*(direction * 50.0).T)
    assert (clear <= 30.0 + 1e-3).all() and (clear > 0).all()


def test_who_hangs_from_a_ceiling_that_is_dug_away_falls_to_the_floor(shot):
    world = bound(shot)
    hill, ground = world.solids["hill"], world.ground
    hill.carve_balls(np.array([[0.0, 7.0, 0.0]]), np.array([4.0]), np.zeros(1, np.int64))
    ceiling = hill.project_to_surface(np.array([[0.0, 10.5, 0.0]]), np.array([[0.0, -1.0, 0.0]]))
    assert ceiling.is_in_reach[0] and ceiling.normals[0, 1] < -0.8
    standing = Footing.from_solids(1, ceiling.points)
    hill.carve_balls(np.array([[0.0, 15.0, 0.0]]), np.array([9.0]), np.zeros(1, np.int64))  # now the sky is over it
    still = np.zeros((1, 3))
    moved = ground.move(standing, still, np.array([[1.0, 0.0, 0.0]]), ceiling.normals, 4.0)
    assert moved.footing.mesh[0] == 1 and moved.position[0, 1] == pytest.approx(3.0, abs=0.3), moved.position
    assert moved.up[0, 1] > 0.9 and abs((moved.heading * moved.up).sum()) < 1e-6


def test_one_solid_is_hard_for_who_walks_on_another(shot):
    ball, faces = build_sphere(3)
    solids = {name: Volume.from_mesh(ball * 10 + [at, 0, 0], faces, 1.0) for name, at in (("one", 0.0), ("two", 12.0))}
    ground = CombinedGround(None, solids, np.array([0.0, 1.0, 0.0]))
    place, is_placed = ground.place_points(np.array([[0.0, 20.0, 0.0]]), np.array([0.0, 1.0, 0.0]))
    assert is_placed[0] and place.mesh[0] == 0
    up, direction = np.array([[0.0, 1.0, 0.0]]), np.array([[1.0, 0.0, 0.0]])
    visited = set()
    for _ in range(40):
        moved = ground.move(place, direction * 1.1, direction, up, 4.0)
        place, direction, up = moved.footing, moved.direction, moved.up
        visited.add(int(place.mesh[0]))
        assert min(volume.sample_distances(moved.position)[0] for volume in solids.values()) > -0.06
    assert visited == {0, 1} and moved.position[0, 0] > 12, "over the notch between them and on"


def test_a_cut_shows_the_inside(scene, shot):
    world = bound(shot)
    hill = world.solids["hill"]
    hill.carve_balls(np.array([[0.0, 6.0, 0.0]]), np.array([4.0]), np.zeros(1, np.int64))
    cut = CutPlane.parse("z > 0.5")
    assert cut is not None and CutPlane.parse("z = 3") is None and CutPlane.parse("z > 0; x") is None
    opened = cut.cut_volume(hill, np.zeros(3), 1.0)
    vertices = np.concatenate([v for _, v, f in opened.iterate_brick_meshes(changed_only=False)])
    assert vertices[:, 2].max() == pytest.approx(0.5, abs=0.01)
    level = vertices[np.abs(vertices[:, 2] - 0.5) < 1e-3]
    inside = np.linalg.norm(level[:, :2] - [0.0, 6.0], axis=1)
    assert len(level) > 300 and inside.min() > 3.5, "a section with a hole where the cave is"
    assert hill.sample_distances(np.array([[0.0, 12.0, 5.0]]))[0] < 0, "the solid itself is whole"
