"""Bodies stand and walk as they should; the examples' geometry is what their scripts make."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest
import trimesh

from antdsl.bodies.ant import LEGS, POSES, STEP, STRIDE, ant, foot_at
from antdsl.bodies.body import orientation, turned
from antdsl.bodies.catalogue import BODIES, CAPSULES, body, body_of
from antdsl.bodies.placed import PLACED, placed, shape_of
from antdsl.program.tables.colours import COLOURS, default_rgb, rgb

EXAMPLES = Path(__file__).parents[2] / "examples"


def volume(vertices, faces):
    a, b, c = (vertices[faces[:, k]].astype(np.float64) for k in range(3))
    return float(np.einsum("ni,ni->n", a, np.cross(b, c)).sum() / 6)


def script(name):
    spec = importlib.util.spec_from_file_location(f"{name}_ground", EXAMPLES / name / "make_ground.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_ant_is_cheap_for_crowds_and_finer_near():
    assert len(ant().faces) <= 60
    assert 200 <= len(ant(fine=True).faces) <= 600


@pytest.mark.parametrize("fine", [False, True])
def test_the_ant_is_one_long_and_stands_on_its_feet(fine):
    made = ant(fine)
    trunk = made.poses[0][made.tint > 0.4]
    assert np.ptp(trunk[:, 0]) == pytest.approx(0.92, abs=0.05)
    assert made.poses[0][:, 0].min() == pytest.approx(-0.5, abs=0.01)
    for pose in made.poses:
        assert -0.02 < pose[:, 1].min() < 0.01


def test_a_standing_foot_stays_where_it_is_while_the_body_goes_on():
    for leg in LEGS:
        start = (1.0 - leg.phase) % 1.0
        places = [foot_at(leg, start + share)[0] + STRIDE * share for share in np.linspace(0.0, 0.4999, 20)]
        assert np.ptp(places) < 1e-9
    assert pytest.approx(STRIDE) == STEP * 2


def test_three_feet_stand_while_three_swing():
    for phase in (0.1, 0.3, 0.6, 0.9):
        assert sum(foot_at(leg, phase)[1] > 1e-6 for leg in LEGS) == 3


def test_poses_follow_the_way_walked():
    made = ant()
    poses = made.posed(np.array([0.0, STRIDE, STRIDE / POSES, STRIDE / POSES / 2, 7 * STRIDE - 1e-12]))
    assert np.allclose(poses[0], poses[1], atol=1e-5) and np.allclose(poses[0], poses[4], atol=1e-5)
    assert np.allclose(poses[2], made.poses[1], atol=1e-5)
    assert np.allclose(poses[3], (made.poses[0] + made.poses[1]) / 2, atol=1e-5)


@pytest.mark.parametrize("name", sorted(BODIES))
@pytest.mark.parametrize("fine", [False, True])
def test_bodies_face_outwards_and_stand_on_the_ground(name, fine):
    made = body(name, fine)
    assert volume(made.poses[0], made.faces) > 0.002
    assert abs(made.poses[0][:, 1].min()) < 0.07
    assert np.allclose(np.linalg.norm(made.normals, axis=1), 1, atol=1e-5)


@pytest.mark.parametrize("shape", sorted(PLACED))
def test_placed_shapes_face_outwards_with_colours(shape):
    vertices, faces, colour = placed(shape)
    assert volume(vertices, faces) > (0.2 if shape == "mound" else 0.5)  # a nest lies flat, lower than an ant
    assert colour.shape == vertices.shape and colour.min() >= 0 and colour.max() <= 1
    assert 0.9 < np.hypot(vertices[:, 0], vertices[:, 2]).max() < 1.3


def test_names_choose_bodies_and_shapes():
    assert [body_of(name) for name in ("forager", "person", "boids", "hunter")] == ["ant", "person", "arrow", "hunter"]
    assert [shape_of("food", "apple"), shape_of("food", "donut"), shape_of("nest", "home"), shape_of("food", "a")] == [
        "apple",
        "ring",
        "mound",
        "sphere",
    ]


def test_orientation_turns_x_to_the_heading_and_y_to_up():
    draw = np.random.Generator(np.random.Philox(5))
    up, heading = draw.normal(size=(300, 3)), draw.normal(size=(300, 3))
    up /= np.linalg.norm(up, axis=1, keepdims=True)
    orient = orientation(heading, up)
    ahead = turned(orient, np.tile([1.0, 0.0, 0.0], (300, 1)))
    flat = heading - up * (heading * up).sum(axis=1, keepdims=True)
    flat /= np.linalg.norm(flat, axis=1, keepdims=True)
    assert np.abs(turned(orient, np.tile([0.0, 1.0, 0.0], (300, 1))) - up).max() < 1e-12
    assert np.abs(ahead - flat).max() < 1e-12
    assert np.allclose(orientation(np.array([[1.0, 0, 0]]), np.array([[0, 1.0, 0]])), [[0, 0, 0, 1]])


def test_orientation_of_nothing_is_still_a_turn():
    orient = orientation(np.array([[0.0, 0, 0], [0, 2.0, 0]]), np.array([[0.0, 0, 0], [0, 1.0, 0]]))
    assert np.allclose(np.linalg.norm(orient, axis=1), 1)


def test_colours_have_names():
    assert rgb("amber") and rgb("teal") and rgb("amberish") is None
    assert all(0 <= value <= 255 for colour in COLOURS.values() for value in colour)
    assert len({default_rgb(k) for k in range(10)}) == 10


@pytest.mark.parametrize(
    ("example", "function", "file"),
    [
        ("foraging", "terrain", "terrain.ply"),
        ("foraging", "boulder", "boulder.ply"),
        ("foraging", "stones", "stones.ply"),
        ("flocking", "waves_sheet", "waves.ply"),
        ("minimal", "ground", "ground.ply"),
    ],
)
def test_the_examples_geometry_is_what_its_script_makes(example, function, file):
    vertices, faces = getattr(script(example), function)()
    kept = trimesh.load(EXAMPLES / example / file, process=False)
    assert np.array_equal(kept.faces, faces)
    assert np.abs(np.asarray(kept.vertices) - vertices).max() < 2e-3


def test_the_foraging_ground_has_relief_and_a_shelf_that_overhangs():
    ground = trimesh.load(EXAMPLES / "foraging" / "terrain.ply", process=False)
    down = ground.face_normals[:, 1] < -0.1
    assert 30_000 <= len(ground.faces) <= 50_000
    assert np.ptp(ground.vertices[:, 1]) > 100
    middle = ground.triangles_center[down]
    assert down.sum() > 100 and (middle[:, 0] > 100).all() and (middle[:, 2] < -150).all()
    assert trimesh.load(EXAMPLES / "foraging" / "boulder.ply", process=False).is_watertight


@pytest.mark.parametrize("name", BODIES)
def test_the_room_that_a_body_takes_is_that_of_its_mesh(name: str) -> None:
    """Nothing of the capsule is longer or wider than what is drawn; of a body without legs it is as long and wide as that."""
    room, drawn = CAPSULES[name], BODIES[name](False).poses[0]
    size = drawn.max(axis=0) - drawn.min(axis=0)
    assert room.width <= room.length <= max(size[0], size[2]) * 1.05 and room.width <= size[2] * 1.05
    if name != "ant":
        assert room.width >= size[2] * 0.9 and room.length >= max(size[0], size[2]) * 0.9
    assert drawn[:, 1].min() < room.height < drawn[:, 1].max()
