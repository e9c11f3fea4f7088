"""Bodies stand and walk as they should; the examples' geometry is what their scripts make."""

import importlib.util
from pathlib import Path

import numpy as np
import pytest
import trimesh

from antdsl.bodies.body import build_orientations, rotate_vectors
from antdsl.bodies.library import load_library_body
from antdsl.bodies.shapes import ITEM_SHAPES, build_item_mesh
from antdsl.program.tables.colours import COLOUR_BY_NAME, choose_default_rgb, find_rgb
from antdsl.scene.library_bodies import BODY_WORDS, CAPSULE_BY_BODY, find_body_for_species
from antdsl.scene.looks import choose_item_shape

TRUNK = ("root", "thorax", "head", "petiole", "gaster", "gaster_tip")
EXAMPLES = Path(__file__).parents[2] / "examples"


def volume(vertices, faces):
    a, b, c = (vertices[faces[:, k]].astype(np.float64) for k in range(3))
    return float(np.einsum("ni,ni->n", a, np.cross(b, c)).sum() / 6)


def script(name):
    spec = importlib.util.spec_from_file_location(f"{name}_ground", EXAMPLES / name / "make_ground.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


@pytest.mark.parametrize("name", sorted(BODY_WORDS))
def test_bodies_face_outwards_and_stand_on_the_ground(name):
    body = load_library_body(name)
    for shape in body.shapes.values():
        assert volume(shape.points, shape.faces) > 1e-4
        assert shape.name == "crumb" or abs(shape.points[:, 1].min()) < 0.07


@pytest.mark.parametrize("shape", sorted(ITEM_SHAPES))
def test_placed_shapes_face_outwards_with_colours(shape):
    vertices, faces, colour = build_item_mesh(shape)
    flat = {"mound": 0.2, "flag": 0.005, "leaf": 0.01, "stick": 0.02}  # a nest lies flat, lower than an ant
    assert volume(vertices, faces) > flat.get(shape, 0.5)
    assert colour.shape == vertices.shape and colour.min() >= 0 and colour.max() <= 1
    assert 0.9 < np.hypot(vertices[:, 0], vertices[:, 2]).max() < 1.3


def test_names_choose_bodies_and_shapes():
    assert [find_body_for_species(name) for name in ("forager", "person", "boids", "hunter")] == [
        "ant",
        "person",
        "arrow",
        "hunter",
    ]
    names = (
        ("food", "apple"),
        ("food", "donut"),
        ("nest", "home"),
        ("food", "a"),
        ("food", "sugar_lump"),
        ("exits", "east"),
        ("rugs", "red"),
    )
    assert [choose_item_shape(*each) for each in names] == ["apple", "ring", "mound", "crumb", "cube", "flag", "sphere"]


def test_orientation_turns_x_to_the_heading_and_y_to_up():
    draw = np.random.Generator(np.random.Philox(5))
    up, heading = draw.normal(size=(300, 3)), draw.normal(size=(300, 3))
    up /= np.linalg.norm(up, axis=1, keepdims=True)
    orient = build_orientations(heading, up)
    ahead = rotate_vectors(orient, np.tile([1.0, 0.0, 0.0], (300, 1)))
    flat = heading - up * (heading * up).sum(axis=1, keepdims=True)
    flat /= np.linalg.norm(flat, axis=1, keepdims=True)
    assert np.abs(rotate_vectors(orient, np.tile([0.0, 1.0, 0.0], (300, 1))) - up).max() < 1e-12
    assert np.abs(ahead - flat).max() < 1e-12
    assert np.allclose(build_orientations(np.array([[1.0, 0, 0]]), np.array([[0, 1.0, 0]])), [[0, 0, 0, 1]])


def test_orientation_of_nothing_is_still_a_turn():
    orient = build_orientations(np.array([[0.0, 0, 0], [0, 2.0, 0]]), np.array([[0.0, 0, 0], [0, 1.0, 0]]))
    assert np.allclose(np.linalg.norm(orient, axis=1), 1)


def test_colours_have_names():
    assert find_rgb("amber") and find_rgb("teal") and find_rgb("amberish") is None
    assert all(0 <= value <= 255 for colour in COLOUR_BY_NAME.values() for value in colour)
    assert len({choose_default_rgb(k) for k in range(10)}) == 10


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
    stored_mesh = trimesh.load(EXAMPLES / example / file, process=False)
    assert np.array_equal(stored_mesh.faces, faces)
    assert np.abs(np.asarray(stored_mesh.vertices) - vertices).max() < 2e-3


def test_the_foraging_ground_has_relief_and_a_shelf_that_overhangs():
    ground = trimesh.load(EXAMPLES / "foraging" / "terrain.ply", process=False)
    down = ground.face_normals[:, 1] < -0.1
    assert 30_000 <= len(ground.faces) <= 50_000
    assert np.ptp(ground.vertices[:, 1]) > 100
    middle = ground.triangles_center[down]
    assert down.sum() > 100 and (middle[:, 0] > 100).all() and (middle[:, 2] < -150).all()
    assert trimesh.load(EXAMPLES / "foraging" / "boulder.ply", process=False).is_watertight


@pytest.mark.parametrize("name", ["ant", "arrow", "ball"])
def test_the_room_that_a_body_takes_is_that_of_its_mesh(name: str) -> None:
    """The capsule is as long and wide as what is drawn of the trunk."""
    capsule, drawn = CAPSULE_BY_BODY[name], load_library_body(name).shapes[name]
    points = drawn.points
    if name == "ant":  # without legs, feelers and the rings that coxae share with the thorax
        assert drawn.capture is not None
        trunk = [number for number, joint in enumerate(drawn.capture.names) if joint in TRUNK]
        points = points[np.isin(drawn.capture.joints[:, 0], trunk)]
        points = points[np.abs(points[:, 2]) < 0.13]
    low, high = points.min(axis=0), points.max(axis=0)
    size = high - low
    assert capsule.width == pytest.approx(size[2], rel=0.1) and capsule.length == pytest.approx(size[0], rel=0.1)
    assert (low[0] + high[0]) / 2 == pytest.approx(capsule.forward_offset, abs=0.06) and low[1] < capsule.height < high[1]
