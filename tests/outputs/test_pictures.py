"""Pictures show what they are given: light and shadow, agents in their colours, trails, items, lines and words."""

import sys
from dataclasses import replace

import numpy as np
import pytest

from antdsl.bodies.body import build_orientations
from antdsl.bodies.shapes import build_flat_grid, build_sphere
from antdsl.outputs.pictures import (
    Camera,
    Crowd,
    Item,
    LegendRow,
    Picture,
    Renderer,
    Solid,
    Trail,
    add_legend,
    compute_legend_width,
    make_contact_sheet,
    make_eye_level_camera,
    make_overview_camera,
    render,
    render_frame,
    surface_materials,
    write_film,
    write_still,
)
from antdsl.outputs.pictures.camera import make_view
from antdsl.outputs.pictures.cameras import make_top_camera
from antdsl.outputs.pictures.light import make_sun
from antdsl.outputs.pictures.moving_bodies import make_item_mesh
from antdsl.outputs.pictures.static_setting import is_floor, make_setting
from antdsl.outputs.pictures.static_stage import make_stage
from antdsl.outputs.pictures.surface_materials import PictureScales
from antdsl.outputs.pictures.trail_colours import TrailVoxels, compute_ground_cover, estimate_full_strength

ABOVE = Camera((0.0, 60.0, 0.01), (0.0, 0.0, 0.0), focal=30.0)
W, H = 160, 90


def floor(reach=40.0, lines=9):
    line = np.linspace(-reach, reach, lines)
    return Solid("floor", *build_flat_grid(line, line))


def crowd(points, colour, **fields):
    n = len(points)
    orient = build_orientations(np.tile([1.0, 0, 0], (n, 1)), np.tile([0.0, 1, 0], (n, 1)))
    fields = {"scale": np.full(n, 4.0), "ids": np.arange(n), **fields}
    return Crowd("forager", np.asarray(points, float), orient, colour=np.tile(colour, (n, 1)), **fields)


def at(image, picture, camera, point):
    positions, _ = make_view(camera, image.shape[1], image.shape[0], picture.up).project(np.array([point], float))
    column, row = positions[0].astype(int)
    return image[row, column].astype(int)


def test_rays_and_projection_agree():
    ready = make_view(Camera((10.0, 20.0, 30.0), (1.0, 2.0, -3.0), fov=50.0), W, H, (0.0, 1.0, 0.0))
    for camera in (
        Camera((10.0, 20.0, 30.0), (1.0, 2.0, -3.0), fov=50.0),
        Camera((10.0, 20.0, 30.0), (1.0, 2.0, -3.0), parallel_width=9.0),
    ):
        ready = make_view(camera, W, H, (0.0, 1.0, 0.0))
        start, directions = ready.make_rays(np.array([40 * W + 3, 40 * W + 90]), 0.25, 0.5)
        positions, ahead = ready.project(start + 7.0 * directions.astype(float))
        assert np.allclose(positions, [[3.25, 40.5], [90.25, 40.5]], atol=1e-3) and (ahead > 0).all()
        assert np.allclose(ready.compute_distances(start + 7.0 * directions.astype(float)), 7.0, atol=1e-5)
    ready = make_view(Camera((10.0, 20.0, 30.0), (1.0, 2.0, -3.0), fov=50.0), W, H, (0.0, 1.0, 0.0))
    assert ready.half_extent[0] == pytest.approx(np.tan(np.radians(25)))


def test_a_body_between_sun_and_ground_throws_a_shadow():
    vertices, faces = build_sphere(2)
    ball = Solid("ball", vertices * 6 + [0, 14, 0], faces, "stone")
    bare, under = render_frame(Picture((floor(),)), ABOVE, W, H), render_frame(Picture((floor(), ball)), ABOVE, W, H)
    darker = (bare.astype(int) - under).sum(axis=2) > 90
    outside = np.hypot(*(np.indices((H, W)) - np.array([H / 2, W / 2])[:, None, None])) > 26
    assert (darker & outside).sum() > 60
    assert not (under.astype(int) - bare > 40)[outside].any()


def test_ants_wear_their_states_colour_and_keep_the_ground_around():
    scene = floor()
    red = Picture((scene,), (crowd([[0, 0, 0], [15, 0, 8]], (0.84, 0.19, 0.17)),), grain=4.0)
    bare, image = render_frame(Picture((scene,), grain=4.0), ABOVE, W, H), render_frame(red, ABOVE, W, H)
    for point in ([-1.2, 0.5, 0], [13.8, 0.5, 8]):
        r, g, b = at(image, red, ABOVE, point)
        assert r > 1.6 * g and r > 1.6 * b
    away = np.s_[:, : W // 4]
    assert np.abs(image[away].astype(int) - bare[away]).max() <= 2


def test_small_ants_are_drawn_longer_but_not_more_than_threefold():
    far = Camera((0.0, 300.0, 0.1), (0.0, 0.0, 0.0), focal=30.0)
    picture = Picture((floor(400),), (crowd([[0, 0, 0]], (0.1, 0.2, 0.9)),), grain=4.0)
    bare = render_frame(Picture((floor(400),), grain=4.0), far, W, H)
    drawn = [Renderer(W, H, min_body_pixels=least).draw(picture, far).astype(int) for least in (0.0, 3.5, 100.0)]
    changed = [(np.abs(image - bare).max(axis=2) > 12).sum() for image in drawn]
    assert 0 < changed[0] < changed[1] < changed[2] < 60


def test_trails_colour_the_ground_where_they_lie():
    cells = np.array([[x, 0.0, 0.0] for x in np.arange(-12.0, 13.0, 2.0)])
    trail = Trail("trail", cells, np.full(len(cells), 3.0), 2.0, colour=(0.1, 0.2, 0.9))
    picture = Picture((floor(),), trails=(trail,))
    plain, dyed = (render_frame(picture, ABOVE, W, H, show=show) for show in ((), ("trail",)))
    on, off = at(dyed, picture, ABOVE, (4, 0, 0)), at(dyed, picture, ABOVE, (4, 0, 12))
    assert on[2] > 1.5 * on[0]
    assert np.array_equal(off, at(plain, picture, ABOVE, (4, 0, 12)))
    assert np.array_equal(plain, render_frame(Picture((floor(),)), ABOVE, W, H))


def test_even_scent_on_uneven_cells_shows_no_pattern():
    draw = np.random.default_rng(5)
    grid = np.stack(np.meshgrid(np.arange(-30, 31, 3.0), np.arange(-30, 31, 3.0), indexing="ij"), -1).reshape(-1, 2)
    flat = grid + draw.uniform(-1.4, 1.4, grid.shape)
    slope = np.array([[1.0, 0.7, 0.2], [0.0, 0.3, 1.0]])  # ground that lies across the lattice
    trail = Trail("trail", flat @ slope, np.ones(len(flat)), 3.0)
    points = (draw.uniform(-24, 24, (4000, 2)) @ slope).astype(np.float32)
    cloth = TrailVoxels(points.min(axis=0).astype(float), points.max(axis=0).astype(float), 3.0)
    cloth.add_trail(trail)
    assert np.allclose(cloth.interpolate_cover(points), 1.0, atol=1e-3)


def test_a_thin_veil_of_scent_everywhere_does_not_hide_a_trail():
    path = np.geomspace(0.5, 300, 150)
    alone, veiled = estimate_full_strength(path), estimate_full_strength(np.concatenate([np.full(30_000, 3e-3), path]))
    assert veiled == pytest.approx(alone, rel=0.1) and alone > 30
    assert estimate_full_strength(np.zeros(4)) == 0
    faint, strong = compute_ground_cover(Trail("trail", np.zeros((2, 3)), np.array([3e-3, 300.0]), 6.0, full_strength=alone))
    assert faint < 0.04 and strong == 1


def test_what_closes_on_itself_is_a_figure_that_stands_on_the_table():
    vertices, faces = build_sphere(2)
    up = np.array([0.0, 1.0, 0.0])
    assert is_floor(floor().vertices, floor().faces, up) and not is_floor(vertices, faces, up)
    figure, ground = make_setting((Solid("ground", vertices * 20, faces),), up), make_setting((floor(),), up)
    assert figure.table_height == pytest.approx(-20, abs=0.1) and ground.table_height < -2
    assert (
        surface_materials.FIGURE_KIND in figure.kind
        and surface_materials.EDGE_KIND not in figure.kind
        and surface_materials.EDGE_KIND in ground.kind
    )


def test_the_soil_of_a_nest_follows_the_ground():
    plain = floor(60.0, 3)
    up = np.array([0.0, 1.0, 0.0])
    steep = plain.vertices + up * 0.5 * plain.vertices[:, :1]
    ground = make_setting((Solid("ground", steep, plain.faces),), up)
    nest = Item("home", (0.0, 0.0, 0.0), 10.0, 1.0, "mound")
    flat, laid = make_item_mesh(nest, (0.0, 1.0, 0.0)).vertices, make_item_mesh(nest, (0.0, 1.0, 0.0), ground).vertices
    assert np.allclose(laid - flat, up * 0.5 * flat[:, :1], atol=1e-3) and np.ptp(flat[:, 0]) > 20


def test_food_shrinks_with_what_is_left():
    def size(left):
        picture = Picture((floor(),), items=(Item("apple", (0.0, 0.0, 0.0), 6.0, left, "apple"),))
        image = render_frame(picture, ABOVE, W, H).astype(int)
        return ((image[..., 0] > 1.7 * image[..., 1]) & (image[..., 0] > 60)).sum()

    sizes = [size(left) for left in (1.0, 0.5, 0.1, 0.0)]
    assert sizes[0] > sizes[1] > sizes[2] > 0 == sizes[3]


def test_threads_and_stored_rays_change_no_byte(monkeypatch):
    stage_calls = []
    real = render.make_stage
    monkeypatch.setattr(render, "make_stage", lambda *args: stage_calls.append(1) or real(*args))
    scene = (floor(),)
    walk = [Picture(scene, (crowd([[x, 0, 0]], (0.9, 0.6, 0.1)),), frame=1) for x in (0.0, 5.0)]
    one, two = Renderer(W, H, threads=1), Renderer(W, H, threads=2)
    first = [one.draw(picture, ABOVE) for picture in walk]
    assert len(stage_calls) == 1 and not np.array_equal(first[0], first[1])
    again = [two.draw(picture, ABOVE) for picture in reversed(walk)]
    assert np.array_equal(first[0], again[1]) and np.array_equal(first[1], again[0])
    one.draw(walk[0], Camera((0.0, 61.0, 0.01), (0.0, 0.0, 0.0)))
    assert len(stage_calls) == 3


def test_lines_and_ids_are_drawn_where_agents_are_and_others_are_refused():
    ants = crowd([[0, 0, 0], [10, 0, 5]], (0.9, 0.6, 0.1), velocity=np.tile([0.0, 0, -60.0], (2, 1)))
    ants = Crowd(**{name: getattr(ants, name) for name in Crowd.__slots__} | {"feelers": np.array([[[0, 1.0, 0], [-20, 1, 0]]])})
    picture = Picture((floor(),), (ants,))
    plain = render_frame(picture, ABOVE, W, H).astype(int)
    for word, point in (("velocity", (0, 1, -10)), ("feelers", (-12, 1, 0))):
        changed = np.abs(render_frame(picture, ABOVE, W, H, show=("trail", word)) - plain).max(axis=2) > 25
        row, column = np.nonzero(changed)
        positions, _ = make_view(ABOVE, W, H, picture.up).project(np.array([point], float))
        assert 0 < changed.sum() < 300 and np.hypot(column - positions[0, 0], row - positions[0, 1]).min() < 3
    assert (np.abs(render_frame(picture, ABOVE, W, H, show=("trail", "ids")) - plain) > 40).sum() > 20
    with pytest.raises(ValueError, match="`trails`"):
        render_frame(picture, ABOVE, W, H, show=("trails",))


def test_what_is_behind_a_wall_gets_no_line():
    vertices, faces = build_sphere(2)
    wall = Solid("wall", vertices * [30, 2, 30] + [0, 20, 0], faces, "stone")
    hidden = crowd([[0, 0, 0]], (0.9, 0.6, 0.1), velocity=np.array([[60.0, 0, 0]]))
    picture = Picture((floor(), wall), (hidden,))
    assert np.array_equal(
        render_frame(picture, ABOVE, W, H), render_frame(picture, ABOVE, W, H, show=("trail", "velocity", "ids"))
    )


def test_the_strip_tells_states_by_species_and_scales_with_numbers():
    picture = Picture(
        (floor(),), legend=(LegendRow("search", (242, 163, 31), 412, "ant"), LegendRow("run", (40, 90, 230), 7, "roach"))
    )
    image = np.zeros((300, 400, 3), np.uint8)
    assert compute_legend_width(Picture(), 500, ("trail",)) == 0
    wide = compute_legend_width(picture, 500, ("trail",))
    sheet = add_legend(image, picture, wide, ("trail",))
    strip_pixels = sheet[:, 400:].astype(int)
    assert sheet.shape == (300, 400 + wide, 3) and not sheet[:, :400].any()
    dots = [np.abs(strip_pixels - colour).sum(axis=2) < 12 for colour in ([242, 163, 31], [40, 90, 230])]
    assert all(dot.sum() > 20 for dot in dots) and np.nonzero(dots[0])[0].max() < np.nonzero(dots[1])[0].min()
    trail = Trail("smell", np.zeros((2, 3)), np.array([1.0, 5.0]), 2.0, colour=(0.1, 0.2, 0.9), full_strength=5.0)
    scaled = Picture((floor(),), trails=(trail,), legend=picture.legend)
    assert np.array_equal(add_legend(image, scaled, wide, ()), sheet)
    bar = add_legend(image, scaled, wide, ("trail",))[:, 400:].astype(int)
    assert ((bar[..., 2] - bar[..., 0]) > 60).any(axis=1).sum() > 3 + dots[1].any(axis=1).sum()


def test_names_in_the_strip_keep_clear_of_their_numbers():
    rows = tuple(LegendRow("a very long name of a state " * 3, (242, 163, 31), 10**k, "ant") for k in range(7))
    image = add_legend(np.zeros((200, 100, 3), np.uint8), Picture(legend=rows), 160, ())
    assert image.shape == (200, 260, 3) and image[:, 258:].max() < 60


def test_shadows_have_soft_edges_without_noise():
    vertices, faces = build_sphere(3)
    ball = Solid("ball", vertices * 5 + [0, 14, 0], faces, "stone")
    up, scales = np.array([0.0, 1.0, 0.0]), PictureScales(80.0, 4.0)
    bare, under = (
        make_stage(make_setting(solids, up), make_view(ABOVE, 480, 270, (0.0, 1.0, 0.0)), make_sun(up), scales, 1)
        for solids in ((floor(),), (floor(), ball))
    )
    ground = (under.centre_samples.kind == surface_materials.GROUND_KIND) & (bare.centre_samples.sun_cosine > 0.2)
    share = np.where(ground, under.centre_samples.sun_cosine / np.maximum(bare.centre_samples.sun_cosine, 1e-6), 1.0).reshape(
        270, 480
    )
    between = (share > 0.1) & (share < 0.9)
    assert between.sum() > 60 and len(np.unique(share[between].round(3))) > 20
    across = np.diff(share, axis=1)
    turns = (across[:, 1:] * across[:, :-1] < 0) & (np.minimum(np.abs(across[:, 1:]), np.abs(across[:, :-1])) > 0.06)
    plain = ~(under.grid.is_edge | ~ground).reshape(270, 480)
    turns &= plain[:, :-2] & plain[:, 1:-1] & plain[:, 2:]
    assert turns.sum() < 4  # nowhere lighter and darker from pixel to pixel


def test_what_moves_is_blurred_along_its_way_and_what_stands_is_sharp():
    scene = (floor(),)
    ants = crowd([[-8.0, 0, 0], [8.0, 0, 8.0]], (0.9, 0.1, 0.1))
    then = replace(ants, position=ants.position + np.array([[6.0, 0, 0], [0, 0, 0]]))
    still, moved = Picture(scene, (ants,), grain=4.0), Picture(scene, (replace(ants, next_crowd=then),), grain=4.0)
    sharp, shut, open_ = (
        Renderer(W, H, blur=blur).draw(picture, ABOVE).astype(int) for blur, picture in ((0.0, still), (0.0, moved), (1.0, moved))
    )
    assert np.array_equal(sharp, shut)
    positions, _ = make_view(ABOVE, W, H, (0.0, 1.0, 0.0)).project(np.array([[-8.0, 0, 0], [-2.0, 0, 0], [8.0, 0, 8.0]]))
    x, y = positions.round().astype(int).T
    changed = np.abs(open_ - sharp).max(axis=2)
    assert changed[y[0] - 3 : y[0] + 4, x[0] : x[1] + 4].max() > 40
    assert changed[y[2] - 4 : y[2] + 5, x[2] - 8 : x[2] + 9].max() < 30
    swept = np.nonzero((changed > 12)[y[0] - 4 : y[0] + 5].any(axis=0))[0]
    assert swept.max() > x[1] - 2 and swept.max() < x[1] + 20  # as far as it comes


def test_marks_are_discs_of_one_size_in_the_colours_of_states():
    ants = crowd([[-8.0, 0, 0], [8.0, 0, 8.0]], (0.1, 0.2, 0.9))
    for reach, width in ((6.0, W), (12.0, W)):
        image = Renderer(width, H, marks=reach).draw(Picture((floor(),), (ants,), grain=4.0), ABOVE).astype(int)
        blue = (image[..., 2] > 150) & (image[..., 0] < 90)
        assert blue.sum() == pytest.approx(2 * np.pi * (reach / 2) ** 2, rel=0.35)


def test_magnified_agents_have_the_requested_length():
    far = Camera((0.0, 300.0, 0.1), (0.0, 0.0, 0.0), focal=30.0)
    picture = Picture((floor(400),), (crowd([[0, 0, 0]], (0.1, 0.2, 0.9)),), grain=4.0)
    bare = render_frame(Picture((floor(400),), grain=4.0), far, W, H)
    drawn = Renderer(W, H, min_body_pixels=40.0, max_enlargement=np.inf).draw(picture, far).astype(int)
    columns = np.nonzero((np.abs(drawn - bare).max(axis=2) > 12).any(axis=0))[0]
    assert 30 < np.ptp(columns) < 90


def test_a_view_from_straight_above_has_one_scale():
    ants = crowd([[-12.0, 0, -9.0], [12.0, 9.0, 9.0]], (0.9, 0.1, 0.1))
    picture = Picture((floor(),), (ants,), grain=4.0)
    camera = make_top_camera(picture, aspect=W / H)
    camera_view = make_view(camera, W, H, picture.up)
    positions, ahead = camera_view.project(np.array([[0.0, 0, 0], [10, 0, 0], [10, 9, 0], [0, 0, 10]]))
    assert (
        (ahead > 0).all()
        and positions[1] == pytest.approx(positions[2])
        and positions[1, 0] > positions[0, 0]
        and positions[3, 1] > positions[0, 1]
    )
    assert np.linalg.norm(positions[1] - positions[0]) == pytest.approx(np.linalg.norm(positions[3] - positions[0]))
    held, _ = camera_view.project(floor().vertices)
    assert (held >= 0).all() and (held <= [W, H]).all()
    image = render_frame(picture, camera, W, H).astype(int)
    assert image.std() > 5


@pytest.mark.parametrize(("look", "expected"), [("metal", "grey"), ("leaf", "green"), ("soil", "brown"), ("light", "bright")])
def test_things_look_as_what_the_scene_says_they_are_made_of(look, expected):
    vertices, faces = build_sphere(3)
    kind = {"soil": "hill"}.get(look, look)
    pictures = (
        Picture((floor(), Solid("thing", vertices * 8 + [0, 4, 0], faces, kind)), grain=4.0),
        Picture((floor(),), items=(Item("thing", (0.0, 0.0, 0.0), 8.0, look=look),), grain=4.0),
    )
    for picture in pictures:
        r, g, b = render_frame(picture, ABOVE, W, H)[H // 2 - 4 : H // 2 + 4, W // 2 - 6 : W // 2 + 6].reshape(-1, 3).mean(axis=0)
        colour_checks = {
            "grey": abs(r - b) < 40,
            "green": g > 1.1 * r and g > 1.3 * b,
            "brown": r > 1.15 * g > 1.2 * b,
            "bright": min(r, g, b) > 215,
        }
        assert colour_checks[expected], (look, r, g, b)


def test_ground_has_grain_from_afar_and_from_near():
    picture = Picture((floor(),), grain=4.0)
    for height in (60.0, 6.0, 0.8):
        camera = Camera((0.0, height, 0.01), (0.0, 0.0, 0.0), focal=35.0)
        image = render_frame(picture, camera, W, H).astype(float).sum(axis=2)
        fine = image - (np.roll(image, 1, 0) + np.roll(image, -1, 0) + np.roll(image, 1, 1) + np.roll(image, -1, 1)) / 4
        assert fine[4:-4, 4:-4].std() > 3.0, height  # of 765: no smear


def test_cameras_of_their_own_see_the_scene_and_an_ant_that_is_not_hidden():
    vertices, faces = build_sphere(2)
    rock = Solid("rock", vertices * 5 + [-12, 3, 0], faces, "stone")
    picture = Picture((floor(), rock), (crowd([[x, 0, z] for x in (0, 6, 12) for z in (0, 6)], (0.9, 0.6, 0.1)),))
    over = make_view(make_overview_camera(picture), W, H, picture.up)
    positions, ahead = over.project(picture.solids[0].vertices)
    assert (ahead > 0).all() and (positions >= 0).all() and (positions <= [W, H]).all()
    camera = make_eye_level_camera(picture, 3)
    image = render_frame(picture, camera, W, H).astype(int)
    assert ((image[..., 0] > 1.5 * image[..., 2]) & (image[..., 0] > 120)).sum() > 100
    assert np.linalg.norm(np.array(camera.at) - picture.crowds[0].position[3]) < 5 * 4.0
    assert make_eye_level_camera(picture, 99) is None
    (full_crowd,) = picture.crowds
    parts = replace(picture, crowds=tuple(full_crowd.select_rows(np.isin(full_crowd.ids, ids)) for ids in ((0, 1), (2, 3, 4, 5))))
    split_camera = make_eye_level_camera(parts, 3)
    assert split_camera is not None and split_camera.at == camera.at, "whatever others of the species wear"
    first = replace(crowd([[30, 0, 30]], (0.9, 0.6, 0.1), ids=np.array([7])), species="first")
    both = replace(picture, crowds=(first, *picture.crowds))
    assert make_eye_level_camera(both, 3) is not None and make_eye_level_camera(both, 3, species="first") is None


@pytest.mark.parametrize("up", [(0.0, 1.0, 0.0), (0.0, 0.0, 1.0)])
def test_the_sky_is_above_whatever_up_is(up):
    solid = floor()
    if up[2]:
        solid = Solid("floor", solid.vertices[:, [2, 0, 1]], solid.faces)
    level = Camera((0.0, 8.0, 70.0) if up[1] else (70.0, 0.0, 8.0), (0.0, 0.0, 0.0), up=up)
    image = render_frame(Picture((solid,), up=up), level, W, H).astype(int)
    assert image[2, :, 2].mean() > image[2, :, 0].mean() + 8
    assert image[H // 2, W // 3 : W // 2, 0].mean() > image[H // 2, W // 3 : W // 2, 2].mean() + 8


def test_nothing_at_all_and_broken_agents_draw_without_a_fuss():
    assert render_frame(Picture(), ABOVE, 32, 18).shape == (18, 32, 3)
    broken = crowd([[np.nan, 0, 0], [np.inf, 0, 0], [0, 0, 0]], (0.9, 0.6, 0.1), scale=np.array([4.0, 4.0, np.nan]))
    assert np.array_equal(
        render_frame(Picture((floor(),), (broken,)), ABOVE, 32, 18), render_frame(Picture((floor(),)), ABOVE, 32, 18)
    )
    with pytest.raises(ValueError, match="8192"):
        Renderer(100_000, 10)


def test_a_contact_sheet_holds_every_picture():
    tiles = [np.full((90, 160, 3), shade, np.uint8) for shade in (60, 120, 180, 240, 90)]
    sheet_image = make_contact_sheet(tiles, [f"frame {k}" for k in range(5)], columns=3, width=600)
    assert sheet_image.shape[1] == 600
    assert all((np.abs(sheet_image.astype(int) - int(tile[0, 0, 0])).max(axis=2) == 0).sum() > 15_000 for tile in tiles)
    with pytest.raises(ValueError, match="label"):
        make_contact_sheet(tiles, ["one"])


def test_stills_and_films_reach_the_disk(tmp_path):
    from PIL import Image

    frames = [np.full((91, 160, 3), shade, np.uint8) for shade in (20, 200)]
    write_still(frames[0], tmp_path / "one.png")
    assert np.array_equal(np.asarray(Image.open(tmp_path / "one.png")), frames[0])
    pytest.importorskip("imageio_ffmpeg")
    import imageio_ffmpeg

    assert write_film(frames, tmp_path / "film.mp4", 24).ok
    count, _ = imageio_ffmpeg.count_frames_and_secs(str(tmp_path / "film.mp4"))
    assert count == 2 and sorted(path.name for path in tmp_path.iterdir()) == ["film.mp4", "one.png"]
    assert [d.code for d in write_film([], tmp_path / "none.mp4", 24).errors] == ["no-pictures"]
    assert [d.code for d in write_film(frames, tmp_path / "no" / "such.mp4", 24).errors] == ["cannot-write"]


def test_a_film_without_its_extra_names_it(monkeypatch, tmp_path):
    monkeypatch.setitem(sys.modules, "imageio_ffmpeg", None)
    report = write_film([np.zeros((4, 4, 3), np.uint8)], tmp_path / "film.mp4", 24)
    assert report.errors[0].code == "missing-extra" and "[video]" in report.errors[0].message


def test_an_ant_in_the_shade_of_a_rock_is_darker():
    vertices, faces = build_sphere(2)
    roof = Solid("roof", vertices * [14, 1, 14] + [-24.0, 20, 0], faces, "stone")
    ant = crowd([[0, 0, 0]], (0.9, 0.6, 0.1))
    low = Camera((8.0, 9.0, 14.0), (0.0, 0.0, 0.0))

    def brightness(solids):
        image = render_frame(Picture(solids, (ant,), grain=4.0), low, W, H).astype(int)
        body = (image[..., 0] > 1.7 * image[..., 2]) & (np.hypot(*(np.indices((H, W)) - np.array([45, 80])[:, None, None])) < 25)
        return image[body][:, 0].mean()

    assert brightness((floor(), roof)) < 0.8 * brightness((floor(),))


def test_no_face_stands_out_over_its_neighbours():
    """Triangles are widened for rays by hairs, which go by what is looked at and not by the wide table below it."""
    vertices, faces = build_sphere(4)
    ball = Solid("ball", vertices * 50, faces, "stone")
    still = make_setting((ball,), np.array([0.0, 1, 0]))
    corners = ball.vertices[faces]
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normal /= np.linalg.norm(normal, axis=1)[:, None]
    corners, normal = corners[normal[:, 1] > -0.5], normal[normal[:, 1] > -0.5]  # the others have the table before them
    near_a_side = (corners * np.array([0.495, 0.495, 0.01])[:, None]).sum(axis=1)
    assert not still.rays.find_occluded_rays(near_a_side + 0.001 * normal, normal, 5.0).any()
    assert still.rays.find_first_hits(near_a_side + 0.5 * normal, -normal).t == pytest.approx(0.5, abs=1e-4)
