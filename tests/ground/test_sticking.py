"""`stick: rays`: two rays a step in place of walking over triangles; where it leads, where it fails, how a scene asks for it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from meshes import ball, box, grid, terrain
from torture_long import SHAPES, long_walk
from torture_walks import BODY, crowd, wander

from antdsl.ground.mesh import walk_events
from antdsl.ground.mesh.surface import MeshGround
from antdsl.ground.sticking import RAY_LENGTH_BODY_LENGTHS, RAY_START_HEIGHT_BODY_LENGTHS
from antdsl.numerics import parallel
from antdsl.pipeline import RunChoices, open_scene
from antdsl.runtime import Options, bind, step

EXAMPLES = Path(__file__).resolve().parents[2] / "examples"
UP = np.array([[0.0, 1.0, 0.0]])


def stand(ground: MeshGround, at: tuple[float, float, float]):
    footing, is_placed = ground.place_points(np.array([at]), UP[0])
    assert is_placed.all()
    return footing


def test_on_level_ground_the_step_is_the_wish() -> None:
    ground = MeshGround({"floor": grid(100.0, 4)}, by_rays=True)
    moved = ground.move(stand(ground, (3.0, 5.0, 4.0)), np.array([[1.2, 0, 0.5]]), np.array([[0, 0, 1.0]]), UP, BODY)
    assert np.allclose(moved.position, [[4.2, 0, 4.5]], atol=1e-5) and np.allclose(moved.up, UP)
    assert np.allclose(moved.heading, [[0, 0, 1]]) and np.allclose(moved.direction, [[12 / 13, 0, 5 / 13]])
    assert moved.travelled == pytest.approx(1.3, abs=1e-5) and not moved.is_blocked[0] and not moved.is_lost[0]


def test_the_nearer_of_two_hits_wins() -> None:
    """A wall is climbed once the ray ahead and up is shorter than the one down, which is RISE bodies long on level ground."""
    ground = MeshGround({"floor": grid(100.0, 4), "wall": box((10.0, -5.0, -20.0), (14.0, 30.0, 20.0))}, by_rays=True)
    turning = RAY_START_HEIGHT_BODY_LENGTHS * BODY * np.cos(np.radians(30.0))  # from the wall: there ray 2 is as long as ray 1
    for away, climbs in ((turning + 0.05, False), (turning - 0.05, True)):
        moved = ground.move(stand(ground, (10.0 - away, 5.0, 0.0)), np.array([[0.01, 0, 0]]), np.array([[1.0, 0, 0]]), UP, BODY)
        assert (moved.footing.mesh[0] == 1) == climbs
        if climbs:
            assert np.allclose(
                moved.position[0], [10, RAY_START_HEIGHT_BODY_LENGTHS * BODY + np.tan(np.radians(30.0)) * away, 0], atol=1e-4
            )
            assert np.allclose(moved.up, [[-1, 0, 0]]) and np.allclose(moved.heading, [[0, 1, 0]])


def test_down_is_away_from_the_agents_own_up_on_a_ceiling_too() -> None:
    ground = MeshGround({"slab": box((-20, 10, -20), (20, 12, 20))}, by_rays=True)
    footing, _ = ground.find_nearest(np.array([[0.0, 9.0, 0.0]]))
    moved = ground.move(footing, np.array([[1.0, 0, 0]]), np.array([[1.0, 0, 0]]), -UP, BODY)
    assert np.allclose(moved.position, [[1, 10, 0]], atol=1e-5) and np.allclose(moved.up, -UP)


def test_who_meets_nothing_stays_and_says_so() -> None:
    ground = MeshGround({"floor": grid(20.0, 4)}, by_rays=True)
    moved = ground.move(stand(ground, (9.5, 5.0, 0.0)), np.array([[1.0, 0, 0]]), np.array([[1.0, 0, 0]]), UP, BODY)
    assert moved.is_blocked[0] and moved.travelled[0] == 0 and np.allclose(moved.position, [[9.5, 0, 0]])
    nowhere = ground.move(moved.footing.create_unplaced(1), np.array([[1.0, 0, 0]]), np.array([[1.0, 0, 0]]), UP, BODY)
    assert nowhere.is_lost[0] and not nowhere.is_blocked[0]
    still = ground.move(moved.footing, np.array([[np.nan, 0, 0]]), np.array([[1.0, 0, 0]]), UP, BODY)
    assert np.allclose(still.position, [[9.5, 0, 0]]) and not still.is_blocked[0]


def test_it_steps_through_what_is_thin_where_walkers_do_not() -> None:
    mesh = SHAPES.can()
    rays, triangles = (long_walk("can", mesh, 300, 60, by_rays) for by_rays in (True, False))
    assert rays.through > 30 and triangles.through == 0
    assert rays.measures.jump > 2 * triangles.measures.jump and RAY_LENGTH_BODY_LENGTHS * BODY > SHAPES.TIN


def test_results_are_the_same_bits_for_any_threads() -> None:
    mesh = terrain(120.0, 20)
    ends = []
    for threads in (1, 3):
        ground, rng = MeshGround({"hill": mesh}, by_rays=True), np.random.default_rng(3)
        *_, (_, at) = wander(ground, crowd(ground, [mesh], 200, rng), 20, rng, threads)
        ends.append(at)
    for at in ends[1:]:
        assert np.array_equal(at.position, ends[0].position) and np.array_equal(at.heading, ends[0].heading)


def test_agents_near_other_pieces_are_the_same_bits_for_any_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    """Each part of the agents that wait for a search of other pieces has separate room."""
    monkeypatch.setattr(walk_events, "_WAITING_AGENTS_PER_THREAD", 1)
    monkeypatch.setattr(parallel, "count_available_cores", lambda: 8)
    hill, waiting = terrain(60.0, 20), []
    pieces = {"hill": hill, **{f"ball {k}": ball(4.0, (6.0 * k - 20.0, 0.0, 3.0 * k - 10.0), 12) for k in range(8)}}
    on = walk_events.CrowdWalk.continue_waiting_agents

    def counted(self: walk_events.CrowdWalk, pending: walk_events.PendingWalkArrays, *arguments: Any) -> Any:
        waiting.append(pending.float_rows.shape[1])
        return on(self, pending, *arguments)

    monkeypatch.setattr(walk_events.CrowdWalk, "continue_waiting_agents", counted)
    ends = []
    for threads in (1, 2, 7):
        ground, rng = MeshGround(pieces), np.random.default_rng(3)
        *_, (_, at) = wander(ground, crowd(ground, list(pieces.values()), 200, rng), 20, rng, threads)
        ends.append(at)
    assert max(waiting) > 16, "several parts have agents"
    for at in ends[1:]:
        assert np.array_equal(at.position, ends[0].position) and np.array_equal(at.heading, ends[0].heading)


def scene(folder: Path, line: str) -> Path:
    text = (EXAMPLES / "minimal" / "scene.yaml").read_text(encoding="utf-8")
    for file in (EXAMPLES / "minimal").iterdir():
        if file.suffix in (".ant", ".ply"):
            (folder / file.name).write_bytes(file.read_bytes())
    (folder / "scene.yaml").write_text(text + line, encoding="utf-8")
    return folder / "scene.yaml"


def test_a_scene_asks_for_it(tmp_path: Path) -> None:
    ends = {}
    for how in ("triangles", "rays"):
        shot, report = open_scene(scene(tmp_path, f"stick: {how}\n"), RunChoices())
        assert shot is not None, report.sort_by_place()
        world = bind(shot.plan, shot.setting, Options())
        for _ in range(12):
            step(world)
        ends[how] = np.concatenate([p.position for p in world.populations.values()])
        assert np.isfinite(ends[how]).all()
    distances = np.linalg.norm(ends["rays"] - ends["triangles"], axis=1)
    assert distances.max() > 0 and np.median(distances) < 2.0


def test_another_word_is_an_error(tmp_path: Path) -> None:
    shot, report = open_scene(scene(tmp_path, "stick: glue\n"), RunChoices())
    assert shot is None and any("rays" in f"{d.message} {d.help}" for d in report.sort_by_place())
