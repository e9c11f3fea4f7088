"""The compiled walk and the compiled passes of moving give the bits of the NumPy code beside them, on every sort of ground."""

from __future__ import annotations

import numpy as np
import pytest
from open_shapes import WORSE
from sampling import sampled
from torture_walks import shapes

from antdsl.casting.rays import RayScene
from antdsl.ground.mesh import surface_clearance
from antdsl.ground.mesh.surface import MeshGround
from antdsl.ground.moving import MovingGround
from antdsl.ground.protocol import Footing, Move
from antdsl.numerics import compiled
from tests.meshes import ball, box, grid, terrain

UP = np.array([0.0, 1.0, 0.0])
N = 500


def rumpled() -> dict:
    vertices, faces = ball(12, rings=9)
    odd = faces.copy()
    odd[::3] = odd[::3][:, ::-1]
    lines = np.array([[0, 0, 1], [2, 2, 2], [0, 1, 1]], np.int32)
    return {"ball": (vertices, np.concatenate([odd, faces[:20, [1, 2, 0]], faces[:9, ::-1], lines]).astype(np.int32))}


def forked() -> dict:
    vertices = np.array([[x, 0, z] for x in (-10, 0, 10) for z in (-10, 10)] + [[0, 10, -10], [0, 10, 10]], np.float64)
    faces = np.array([[0, 1, 3], [0, 3, 2], [2, 3, 5], [2, 5, 4], [2, 3, 7], [2, 7, 6]], np.int32)
    return {"room": (vertices, faces)}


def sheets() -> dict:
    vertices, faces = box((-10, -10, -10), (10, 10, 10))
    return {str(k): (vertices[faces[2 * k : 2 * k + 2]].reshape(-1, 3), np.arange(6).reshape(2, 3)) for k in range(6)}


GROUNDS = {
    "hills": lambda: {"hills": terrain(120, 40)},
    "open sheet": lambda: {"sheet": grid(14, 7)},
    "thin plate": lambda: {"plate": box((-8, 0, -8), (8, 0.05, 8))},
    "flipped, doubled and flat faces": rumpled,
    "a wall on a floor": forked,
    "loose sheets": sheets,
    "a hose through itself": lambda: {"eight": shapes().eight(), "floor": grid(60, 9)},
    **{name: (lambda made=made: {"worse": made()}) for name, made in WORSE.items()},
    "boulders": lambda: {"hills": terrain(100, 30), "a": ball(14, (8, 4, 3), 9), "b": box((-30, -20, -30), (-18, 15, -14))},
    "tiles and a fan of slivers": lambda: {
        "left": grid(30, 6),
        "right": (grid(30, 5)[0] + np.array([30.0, 0, 0]), grid(30, 5)[1]),
        "fan": (ball(6, (0, 5, 0), 3)[0] * np.array([1, 0.02, 1]), ball(6, (0, 5, 0), 3)[1]),
    },
}


def use(monkeypatch: pytest.MonkeyPatch, fast: bool) -> None:
    monkeypatch.setattr(compiled, "wanted", lambda count: fast)


def assert_same(one: Move, two: Move) -> None:
    assert list(one.footing.columns) == list(two.footing.columns)
    for a, b in ((one.footing.columns.values(), two.footing.columns.values()), (one.columns(), two.columns())):
        for first, second in zip(a, b, strict=True):
            assert first.dtype == second.dtype and first.shape == second.shape
            assert np.ascontiguousarray(first).tobytes() == np.ascontiguousarray(second).tobytes()


def crowd(ground: MeshGround, rng: np.random.Generator) -> Move:
    """Agents all over a ground, some below it, as after a step of no length."""
    footing, _ = ground.nearest(rng.uniform(ground.low - 1, ground.high + 1, (N, 3)))
    up = ground.normal(footing) * rng.choice([-1.0, 1.0], (N, 1), p=[0.2, 0.8])
    return ground.move(footing, np.zeros((N, 3)), rng.normal(size=(N, 3)), up, 4.0)


@pytest.mark.parametrize("name", sampled(GROUNDS, GROUNDS.keys() - {"slivers", "soup", "book", "layers", "bows"}))
def test_the_compiled_walk_gives_the_same_bits(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    ground = MeshGround(GROUNDS[name]())
    rng = np.random.default_rng(5)
    use(monkeypatch, False)
    at = crowd(ground, rng)
    slowly: list[int] = []
    body = rng.uniform(0, 5, N)
    moved = MeshGround._moved

    def counting(self: MeshGround, footing: Footing, *rest: object) -> Move:
        slowly.append(len(footing))
        return moved(self, footing, *rest)

    for _ in range(12):
        length = rng.choice([0.0, 1e-9, 0.4, 1.5, 6.0], (N, 1))
        heading = at.heading + np.cross(at.up, at.heading) * rng.normal(0, 0.5, (N, 1)) + at.up * rng.normal(0, 0.3, (N, 1))
        inputs = (at.footing, heading * length, heading, at.up, body)
        use(monkeypatch, False)
        expected = ground.move(*inputs)
        use(monkeypatch, True)
        with monkeypatch.context() as patch:
            patch.setattr(MeshGround, "_moved", counting)
            found = ground.move(*inputs)
        assert_same(expected, found)
        at = expected
    assert sum(slowly) < 0.9 * 12 * N  # the compiled walk did something


def test_odd_wishes_and_footings_nowhere_give_the_same_bits(monkeypatch: pytest.MonkeyPatch) -> None:
    ground = MeshGround(GROUNDS["boulders"]())
    rng = np.random.default_rng(6)
    use(monkeypatch, False)
    at = crowd(ground, rng)
    values = np.array([0.0, -0.0, np.nan, np.inf, -np.inf, 1e-160, 1e200, 1.0, 30.0])
    wish, heading, up = (rng.choice(values, (N, 3)) for _ in range(3))
    up[::2], heading[::3] = at.up[::2], at.heading[::3]
    lost = rng.random(N) < 0.1
    footing = Footing.on_faces(
        np.where(lost, -1, at.footing.mesh).astype(np.int32),
        np.where(lost, -1, at.footing.face).astype(np.int32),
        np.where(rng.random(N) < 0.2, -0.0, at.footing.b1),
        np.where(rng.random(N) < 0.2, 1.0, at.footing.b2),
    )
    results = []
    for fast in (False, True):
        use(monkeypatch, fast)
        results.append(ground.move(footing, wish, heading, up, 4.0))
    assert_same(*results)
    assert results[0].lost.sum() == lost.sum()


def test_how_far_agents_look_out_is_the_same_by_a_kernel(monkeypatch: pytest.MonkeyPatch) -> None:
    ground = MeshGround(GROUNDS["boulders"]())
    rng = np.random.default_rng(8)
    for values in ([0.0, 1.0, 3.0], [np.nan, np.inf, -np.inf, 1e200, 2.0], [np.nan]):
        wish, body = rng.choice(values, (3, 40)), rng.choice([*values, 2.5], 40)
        far = []
        for fast in (False, True):
            use(monkeypatch, fast)
            with np.errstate(all="ignore"):
                far.append(ground._reach(wish, body))
        assert far[0] == far[1] > 0


@pytest.mark.parametrize("name", ["boulders", "loose sheets", "tiles and a fan of slivers"])
def test_clearances_are_below_the_distance_to_other_pieces(name: str) -> None:
    ground = MeshGround(GROUNDS[name]())
    rng = np.random.default_rng(7)
    corners = ground._vertices[ground._faces]
    for reach in (0.5, 3.0):
        parts = ground._clearances.within(reach)
        assert parts.reach >= reach
        face = rng.integers(0, len(corners), 2000)
        b1 = rng.random(2000)
        b2 = rng.random(2000) * (1 - b1)
        clear = parts.of(face, b1, b2)
        a, b, c = (corners[face, k] for k in range(3))
        place = a + b1[:, None] * (b - a) + b2[:, None] * (c - a)
        for piece in range(ground._table.pieces):
            other = corners[(ground._table.piece != piece) & (ground._table.piece >= 0)]
            scene = RayScene(other.reshape(-1, 3), np.arange(3 * len(other), dtype=np.int32).reshape(-1, 3))
            own = ground._table.piece[face] == piece
            distance = scene.closest(place[own])[3]
            assert (clear[own] <= distance + 1e-9).all()
        assert (clear > 0).any()


@pytest.mark.slow
def test_looking_out_everywhere_finds_nothing_more(monkeypatch: pytest.MonkeyPatch) -> None:
    use(monkeypatch, False)
    for name in ("boulders", "loose sheets", "tiles and a fan of slivers"):
        ground = MeshGround(GROUNDS[name]())
        at = crowd(ground, np.random.default_rng(8))
        for _ in range(10):
            expected = ground.move(at.footing, at.heading * 1.7, at.heading, at.up, 4.0)
            with monkeypatch.context() as patch:
                patch.setattr(surface_clearance.Parts, "of", lambda self, face, b1, b2: np.zeros(face.size))
                assert_same(ground.move(at.footing, at.heading * 1.7, at.heading, at.up, 4.0), expected)
            at = expected


def test_finer_distances_of_an_obstacle_are_still_below_the_true_ones() -> None:
    (one, faces), (two, _) = ball(3, (300, 5, 0), 5), ball(3, (420, 90, 80), 5)
    scene = RayScene(np.concatenate([one, two]), np.concatenate([faces, faces + len(one)]))
    places = (
        one[np.random.default_rng(11).integers(0, len(one), 3000)] * 1.01 + np.random.default_rng(12).normal(size=(3000, 3)) * 2
    )
    coarse = np.concatenate([scene.clearance(*some_.T) for some_ in np.split(places, 6)])
    fine = scene.clearance(*places.T)
    distance = scene.closest(places)[3]
    assert (fine <= distance).all() and (fine >= coarse).all() and (fine > coarse).mean() > 0.2


def test_the_compiled_walk_gives_the_same_bits_beside_a_mesh_that_moves(monkeypatch: pytest.MonkeyPatch) -> None:
    meshes = {"sheet": grid(30, 12), "stone": ball(5, (0, 1, 0), 7)}
    ground = MovingGround(meshes, ["stone"])
    rng = np.random.default_rng(16)
    use(monkeypatch, False)
    at = crowd(ground, rng)
    for frame in range(6):
        ground.pose({"stone": meshes["stone"][0] + np.array([1.5 * frame, 0.1 * frame, 0])})
        inputs = (at.footing, at.heading * 1.1, at.heading, at.up, rng.uniform(0, 5, N))
        results = []
        for fast in (False, True):
            use(monkeypatch, fast)
            results.append(ground.move(*inputs))
        assert_same(*results)
        at = results[0]
    assert at.blocked.any() and (at.footing.mesh == 1).any()


@pytest.mark.parametrize("name", ["hills", "flipped, doubled and flat faces", "loose sheets", "a mesh that moves"])
def test_places_of_footings_have_the_same_bits(name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    rng = np.random.default_rng(3)
    if name == "a mesh that moves":
        stone = ball(14, (8, 4, 3), 9)
        ground: MeshGround = MovingGround({"stone": stone, "floor": grid(60, 9)}, ["stone"])
        ground.pose({"stone": stone[0] * 1.25 + np.array([3.0, 0.1, -0.0])})  # type: ignore[attr-defined]
    else:
        ground = MeshGround(GROUNDS[name]())
    use(monkeypatch, False)
    footing = crowd(ground, rng).footing
    for column in (footing.b1, footing.b2):  # corners and the far side of zero too
        column[:60] = rng.choice([0.0, -0.0, 1.0, np.nan, np.inf], 60)
    footing.over[::3] = rng.choice([-0.0, 0.3, -2.0, np.nan], len(footing.over[::3]))
    footing.mesh[5], footing.face[5:7] = -1, -1
    with np.errstate(invalid="ignore"):
        wanted = ground.position(footing)
    use(monkeypatch, True)
    found = ground.position(footing)
    unknown = np.isnan(wanted)
    assert (found.view(np.int64) == wanted.view(np.int64))[~unknown].all() and np.isnan(found[unknown]).all()
    for column, wrong in ((footing.face, len(ground.triangles[1])), (footing.mesh, len(ground.names) + 1)):
        kept, column[9] = column[9], wrong
        with pytest.raises(IndexError):
            ground.position(footing)
        column[9] = kept
