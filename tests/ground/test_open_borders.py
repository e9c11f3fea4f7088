"""Borders that are marked as open lead no agent anywhere, and a crowd that walks along them gets the bits of one that looks."""

from __future__ import annotations

import numpy as np
import pytest
from open_shapes import WORSE
from walked import Reference

from antdsl.bench.cases import find_case
from antdsl.ground.mesh import open_borders as module
from antdsl.ground.mesh import walk_events
from antdsl.ground.mesh.face_table import EDGE_LINK_INDEX, EDGES_OFFSET, FLOATS_PER_FACE_ROW, OPEN_BORDER_LINK, mark_border_links
from antdsl.ground.mesh.open_borders import find_open_borders
from antdsl.ground.mesh.surface import MeshGround
from antdsl.ground.mesh.topology import NO_LINKED_EDGE
from antdsl.ground.moving import MovingGround
from antdsl.runtime import Options, World, bind, step
from tests.meshes import Mesh, box, grid, terrain

BODY = 4.0
EACH = 8  # walkers on a border


def shifted(mesh: Mesh, *by: float) -> Mesh:
    return mesh[0] + np.array(by), mesh[1]


def turned(mesh: Mesh) -> Mesh:
    """A mesh that no axis lies along, far from the origin."""
    axes, _ = np.linalg.qr(np.array([[3.0, 1.0, 2.0], [-1.0, 2.0, 0.5], [0.3, -2.0, 4.0]]))
    return mesh[0] @ axes.T + np.array([700.0, -300.0, 90.0]), mesh[1]


def beside(*by: float) -> dict[str, Mesh]:
    return {"sheet": grid(40, 1), "other": shifted(grid(40, 1), *by)}


GROUNDS = {
    "a sheet": {"sheet": grid(40, 1)},
    "a finer sheet": {"sheet": grid(40, 9)},
    "a turned sheet": {"sheet": turned(grid(40, 6))},
    "hills": {"hills": terrain(120, 40)},
    "a box": {"box": box((-8, 0, -8), (8, 3, 8))},
    "side by side": beside(40, 0, 0),
    "over a gap": beside(40 + 0.9 * 0.02 * BODY, 0, 0),
    "over a wide gap": beside(43, 0, 0),
    "a step up": beside(40, 1, 0),
    "a sheet below": beside(0, -0.9, 0),
    "a sheet far below": beside(0, -9, 0),
    "an L": {"l": (grid(40, 4)[0], grid(40, 4)[1][grid(40, 4)[0][grid(40, 4)[1]].mean(axis=1).min(axis=1) < 0])},
    **{name: {"worse": build()} for name, build in WORSE.items()},
}


def find_borders(ground: MeshGround, widest: float = BODY) -> np.ndarray:
    return find_open_borders(ground._topology, ground._box_tree, ground._scale, widest)


@pytest.mark.parametrize("name", GROUNDS)
def test_no_way_leads_on_from_an_open_border(name: str) -> None:
    ground, rng = MeshGround(GROUNDS[name]), np.random.default_rng(1)
    half = np.repeat(find_borders(ground), EACH)
    n, face, k = len(half), half // 3, half % 3
    along = rng.choice([0.0, 1e-9, 1.0], n) if n else np.zeros(0)
    along = np.where(rng.random(n) < 0.8, rng.random(n), along)
    corners, reference = ground.triangles[0][ground.triangles[1]], Reference(ground)
    one, two = corners[face, (k + 1) % 3], corners[face, (k + 2) % 3]
    place, side = one + (two - one) * along[:, None], rng.choice([-1.0, 1.0], n)
    body = np.where(rng.random(n) < 0.5, BODY, BODY * rng.random(n))
    for row in range(n):
        reference.look_around(place[row], 2 * BODY)
        assert reference.beyond(int(face[row]), place[row], side[row], body[row], int(k[row])) is None


@pytest.mark.parametrize(
    ("name", "share"),
    [
        ("a sheet", 1.0),
        ("a finer sheet", 1.0),
        ("a turned sheet", 1.0),
        ("a sheet far below", 1.0),
        ("over a wide gap", 1.0),
        ("side by side", 0.75),
        ("over a gap", 0.75),
        ("a step up", 0.25),  # at corners the other sheet is near the next border, too
        ("a sheet below", 0.0),
    ],
)
def test_borders_are_open_where_nothing_is_near(name: str, share: float) -> None:
    ground = MeshGround(GROUNDS[name])
    assert len(find_borders(ground)) == share * np.count_nonzero(ground._topology.link[0] == NO_LINKED_EDGE)


def test_wider_bodies_find_more() -> None:
    ground = MeshGround(GROUNDS["a sheet far below"])
    assert len(find_borders(ground, 10.0)) == 8 and not len(find_borders(ground, 20.0))


def test_no_more_pairs_are_looked_at_than_pay(monkeypatch: pytest.MonkeyPatch) -> None:
    ground = MeshGround(GROUNDS["a finer sheet"])
    all_borders = find_borders(ground, 30.0)
    assert len(all_borders) == 36
    monkeypatch.setattr(module, "_PAIRS_PER_CHUNK", 50)
    assert np.array_equal(find_borders(ground, 30.0), all_borders)
    monkeypatch.setattr(module, "_MAX_BORDER_PAIRS", 500)
    assert 0 < len(find_borders(ground, 30.0)) < 36


def marked(walk: walk_events.WalkTables) -> int:
    return int(
        np.count_nonzero(
            walk.packed_table.reshape(-1, FLOATS_PER_FACE_ROW)[:, EDGES_OFFSET + EDGE_LINK_INDEX : EDGES_OFFSET + 12 : 4]
            == OPEN_BORDER_LINK
        )
    )


def test_marks_are_for_the_widest_of_a_crowd_and_go_where_a_mesh_moves() -> None:
    ground = MeshGround(GROUNDS["a sheet far below"])
    for widest, count in ((4.0, 8), (1.0, 8), (30.0, 0), (4.0, 0)):
        walk = ground.build_crowd_walk(1.0, widest)
        assert walk is not None and marked(walk.walk_tables) == count
    moving = MovingGround(GROUNDS["a sheet far below"], ("other",))
    walk = moving.build_crowd_walk(1.0, 4.0)
    assert walk is not None and marked(walk.walk_tables) == 8
    moving.set_mesh_vertices({"other": GROUNDS["a sheet far below"]["other"][0] + np.array([0, 8.5, 0])})
    assert not marked(walk.walk_tables)
    moving.build_crowd_walk(1.0, 8.0)
    assert not marked(walk.walk_tables)


def bound(size: int) -> World:
    shot = find_case("trails").make_shot(size)
    return bind(shot.plan, shot.setting, Options(backend="numpy"))


def test_a_crowd_along_open_borders_gets_the_same_bits(monkeypatch: pytest.MonkeyPatch) -> None:
    waiting: list[int] = []
    monkeypatch.setattr(
        walk_events.CrowdWalk, "continue_waiting_agents", looked_at(walk_events.CrowdWalk.continue_waiting_agents, waiting)
    )
    populations = []
    for marks in (True, False):
        world = bound(300)
        step(world)
        walk = world.ground.meshes._get_walk_tables()
        if not marks:
            mark_border_links(walk.packed_table, walk._open_half_edges, NO_LINKED_EDGE)
        waiting.clear()
        for _ in range(60):
            step(world)
        mark_border_links(walk.packed_table, walk._open_half_edges, OPEN_BORDER_LINK)  # which is cached for another world
        assert (sum(waiting) > 500) != marks  # many come to the border
        populations.append(world.populations["ant"])
    one, other = populations
    for name, register in one.now.items():
        assert register.tobytes() == other.now[name].tobytes(), name
    for name, column in one.footing.columns.items():
        assert column.tobytes() == other.footing.columns[name].tobytes(), name


def looked_at(on, waiting: list[int]):
    def counted(self: walk_events.CrowdWalk, batch: walk_events.PendingWalkArrays, *rest):
        waiting.append(batch.integer_rows.shape[1])
        return on(self, batch, *rest)

    return counted
