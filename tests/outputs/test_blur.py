"""Depth of field and motion blur: what is sharp, how wide discs are, and that samples leave no gaps or copies."""

from dataclasses import replace

import numpy as np
import pytest

from antdsl.bodies.body import build_orientations
from antdsl.bodies.shapes import build_flat_grid
from antdsl.numerics.imaging.surface_noise import compute_value_noise
from antdsl.outputs.pictures import Camera, Crowd, Picture, Renderer, Solid
from antdsl.outputs.pictures.blur.depth_of_field import PictureLayer, blur_layers, compose_layers
from antdsl.outputs.pictures.camera import make_view

W, H = 160, 90
UP = (0.0, 1.0, 0.0)
SIDE = Camera((0.0, 4.0, 40.0), (0.0, 2.0, 0.0), focal=50.0)


def stand(points, **fields):
    """Return agents at points, which head along x."""
    n = len(points)
    orient = build_orientations(np.tile([1.0, 0, 0], (n, 1)), np.tile([0.0, 1, 0], (n, 1)))
    return Crowd("ant", np.array(points, float), orient, np.full(n, 6.0), np.tile((0.8, 0.2, 0.1), (n, 1)), **fields)


def empty_layer(value=0.0):
    return PictureLayer(np.zeros((W * H, 3), np.float32), np.full(W * H, value, np.float32), np.full(W * H, np.inf, np.float32))


def test_a_point_becomes_the_disc_of_a_thin_lens_with_the_same_light():
    view = make_view(replace(SIDE, aperture=2.0, focus=20.0), W, H, UP)
    depth = 60.0
    static = empty_layer(1.0)
    middle = H // 2 * W + W // 2
    static.light[middle] = 1.0
    distance = static.distance.copy()
    distance[:] = depth / np.maximum(view.compute_depths(np.ones(W * H)), 1e-9)
    light = blur_layers(view, replace_distance(static, distance), empty_layer(), 1)[:, 0]
    assert light.sum() == pytest.approx(1, rel=0.02)
    radius = 1.0 * (1 / 20 - 1 / depth) * W / (2 * view.half_extent[0])
    row, column = np.nonzero(light.reshape(H, W) > 1e-4)
    assert radius > 3 and np.ptp(row) + 1 == pytest.approx(2 * radius, abs=1.6)
    assert np.ptp(column) + 1 == pytest.approx(2 * radius, abs=1.6)


def replace_distance(layer, distance):
    return PictureLayer(layer.light, layer.cover, distance.astype(np.float32))


def test_a_sharp_body_has_no_seam_of_the_blurred_surface_behind_it():
    view = make_view(replace(SIDE, aperture=2.0, focus=20.0), W, H, UP)
    ones = view.compute_depths(np.ones(W * H))
    static, bodies = empty_layer(1.0), empty_layer()
    static.light[:] = 0.5
    left = np.tile(np.arange(W) < W // 2, H)
    bodies.light[left], bodies.cover[left] = 0.1, 1.0
    far, near = replace_distance(static, 60 / ones), replace_distance(bodies, np.where(left, 20 / ones, np.inf))
    assert np.allclose(blur_layers(view, far, near, 1), compose_layers(static, bodies), atol=1e-3)
    assert np.array_equal(blur_layers(view, far, near, 1), blur_layers(view, far, near, 2))


def test_what_is_in_focus_stays_sharp_and_the_rest_is_blurred():
    line = np.linspace(-60.0, 60.0, 9)
    ants = stand([[0.0, 0, 0], [0.0, 0, -50.0]])
    scene = Picture((Solid("floor", *build_flat_grid(line, line)),), (ants,), grain=4.0)
    pinhole, lens = (Renderer(W, H).draw(scene, replace(SIDE, aperture=size, focus=40.0)).astype(int) for size in (0.0, 6.0))
    positions, _ = make_view(SIDE, W, H, UP).project(np.add(ants.position, [0, 0.8, 0]))
    change = [np.abs(pinhole - lens)[int(y) - 3 : int(y) + 4, int(x) - 4 : int(x) + 5].mean() for x, y in positions]
    assert change[1] > 4 * change[0]


def test_a_moving_body_covers_its_path_evenly():
    ants = stand([[-20.0, 0, 0]])
    moved = replace(ants, next_crowd=replace(ants, position=np.add(ants.position, [40.0, 0, 0])))
    line = np.linspace(-60.0, 60.0, 9)
    floor = (Solid("floor", *build_flat_grid(line, line)),)
    bare, blurred = (
        Renderer(W, H, blur=1.0).draw(Picture(floor, crowds, grain=4.0), SIDE).astype(float) for crowds in ((), (moved,))
    )
    place, _ = make_view(SIDE, W, H, UP).project(np.array([[-8.0, 0.9, 0], [8.0, 0.9, 0]]))
    (first, row), (last, _) = place.astype(int)
    change = np.abs(blurred - bare)[row - 2 : row + 3, first:last].mean(axis=(0, 2))
    assert change.min() > 5
    steps = np.diff(change, 2)
    assert np.abs(steps).max() < 0.2 * change.mean()  # copies of the body would be waves


def test_a_camera_that_moves_with_a_body_keeps_it_sharp_and_blurs_the_ground():
    line = np.linspace(-90.0, 90.0, 9)
    floor = (Solid("floor", *build_flat_grid(line, line)),)
    ants = stand([[0.0, 0, 0]])
    moved = replace(ants, next_crowd=replace(ants, position=np.add(ants.position, [12.0, 0, 0])))
    follow = replace(SIDE, at=(12.0, 4.0, 40.0), look_at=(12.0, 2.0, 0.0))
    pictures = [Picture(floor, (each,), grain=4.0) for each in (ants, moved)]
    sharp = Renderer(W, H).draw(pictures[0], SIDE).astype(int)
    still, along = (Renderer(W, H, blur=0.5).draw(pictures[1], SIDE, next_camera=other).astype(int) for other in (None, follow))
    (x, y), *_ = make_view(SIDE, W, H, UP).project(np.array([[0.0, 0.9, 0]]))[0].astype(int)
    body = np.s_[y - 4 : y + 4, x - 8 : x + 8]
    assert np.abs(along - sharp)[body].mean() < 0.5 * np.abs(still - sharp)[body].mean()
    ground = np.s_[-20:, :]
    assert np.abs(np.diff(along[ground], axis=1)).mean() < 0.6 * np.abs(np.diff(sharp[ground], axis=1)).mean()


def test_the_shutter_needs_no_agents_and_no_next_frame():
    line = np.linspace(-60.0, 60.0, 5)
    scene = Picture((Solid("floor", *build_flat_grid(line, line)),))
    lens = replace(SIDE, aperture=3.0, focus=30.0)
    assert Renderer(W, H, blur=0.5).draw(scene, lens, next_camera=replace(lens, at=(3.0, 4.0, 40.0))).shape == (H, W, 3)


def test_noise_is_smooth_and_its_gradient_is_that_of_its_values():
    points = np.random.default_rng(3).normal(size=(400, 3)).astype(np.float32) * 20
    value, gradient = compute_value_noise(points, 3.0, 5)
    assert np.abs(value).max() <= 1 and value.std() > 0.2
    for axis in range(3):
        step = np.zeros(3, np.float32)
        step[axis] = 0.01
        slope = (compute_value_noise(points + step, 3.0, 5)[0] - compute_value_noise(points - step, 3.0, 5)[0]) / 0.02
        assert np.allclose(slope, gradient[:, axis], atol=0.03)
