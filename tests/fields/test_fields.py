"""Fields: cells on all sorts of surfaces, exact deposits, fading, spreading, and what an agent smells of it."""

from __future__ import annotations

import tracemalloc

import numpy as np
import pytest

from antdsl.fields.cells import FieldTooFineError, SurfaceCells, are_sides_compatible, classify_normal_directions
from antdsl.fields.pheromone import DEPOSIT_QUANTUM, MAX_DEPOSIT, PheromoneField
from antdsl.scene.field_settings import compute_max_diffusion
from tests.meshes import Mesh, ball, box, grid, terrain


def on_surface(mesh: Mesh, n: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Points evenly over a mesh, and the normals of their faces."""
    rng = np.random.default_rng(seed)
    corners = mesh[0][mesh[1]]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    area = np.linalg.norm(across, axis=1)
    face = rng.choice(len(area), n, p=area / area.sum())
    points = (corners[face] * rng.dirichlet([1, 1, 1], n)[:, :, None]).sum(axis=1)
    return points, across[face] / area[face][:, None]


def flat_field(**options) -> PheromoneField:
    return PheromoneField(SurfaceCells([grid(80, 4)], 4.0), **options)


def cell_at(field: PheromoneField, x: float, z: float) -> np.ndarray:
    return field.cells.find_cells(np.array([[x, 0.0, z]]), np.array([[0, 1.0, 0]]))


@pytest.mark.parametrize("cell", [1.7, 5.0, 23.0])
@pytest.mark.parametrize("mesh", [terrain(200, 25), ball(30, (3, 4, 5)), box((-20, 0, -20), (20, 0.4, 20)), grid(90, 1)])
def test_every_surface_point_has_a_cell_of_its_side(mesh, cell):
    cells = SurfaceCells([mesh], cell)
    points, normals = on_surface(mesh, 5000)
    cell_numbers = cells.find_cells(points, normals)
    assert (cell_numbers >= 0).all()
    assert np.array_equal(cells.side_by_cell[cell_numbers], classify_normal_directions(normals))
    assert np.abs(cells.position[cell_numbers] - points).max() < 1.6 * cell
    assert len(np.unique(cell_numbers)) <= len(cells) <= 3.2 * np.abs(points.max() - points.min() + cell) ** 2 * 6 / cell**2


def test_cells_lie_on_their_surface():
    cells = SurfaceCells([grid(80, 7)], 4.0)
    inner = np.abs(cells.position[:, [0, 2]]).max(axis=1) < 36
    assert np.abs(cells.position[:, 1]).max() < 1e-12
    off = cells.position[inner] / 4.0
    assert np.abs(off - np.round(off)).max() < 0.25
    hilly = SurfaceCells([terrain(200, 60)], 4.0)
    from antdsl.casting.rays import RayScene

    assert RayScene(*terrain(200, 60)).find_closest(hilly.position)[3].max() < 1.0


def test_both_sides_of_a_thin_plate_have_separate_cells():
    mesh = box((-20, 0, -20), (20, 0.4, 20))
    field = PheromoneField(SurfaceCells([mesh], 4.0))
    place = np.array([[1.0, 0.4, 1.0], [1.0, 0.0, 1.0]])
    top, bottom = field.cells.find_cells(place, np.array([[0, 1.0, 0], [0, -1.0, 0]]))
    assert top != bottom
    field.deposit(np.array([top]), np.array([5.0], np.float32))
    field.advance(1.0, 10.0, 1 / 24)
    for _ in range(3):
        field.advance(1.0, 10.0, 1 / 24)
    assert field.sample_strongest(np.array([top]))[0] > 1 and field.sample_strongest(np.array([bottom]))[0] == 0


def test_several_surfaces_share_a_field_and_the_order_of_faces_is_not_observable():
    ground, stone = terrain(120, 15), ball(15, (0, 5, 0))
    cells = SurfaceCells([ground, stone], 5.0)
    mixed = (ground[0], ground[1][np.random.default_rng(1).permutation(len(ground[1]))])
    again = SurfaceCells([stone, mixed], 5.0)
    assert len(cells) == len(again) and np.array_equal(cells.side_by_cell, again.side_by_cell)
    assert np.allclose(cells.position, again.position)
    assert np.array_equal(cells.links.linked_cells, again.links.linked_cells)
    for mesh in (ground, stone):
        assert (cells.find_cells(*on_surface(mesh, 500)) >= 0).all()


def test_table_and_search_find_equal_cells(monkeypatch):
    from antdsl.fields import cells as module

    mesh = ball(30, (3, 4, 5))
    points, normals = on_surface(mesh, 2000)
    points += np.random.default_rng(2).normal(0, 3, points.shape)
    one = SurfaceCells([mesh], 4.0)
    monkeypatch.setattr(module, "_MAX_DENSE_VOXELS", 0)
    two = SurfaceCells([mesh], 4.0)
    assert two._start_table is None and one._start_table is not None
    assert np.array_equal(one.find_cells(points, normals), two.find_cells(points, normals))
    assert np.array_equal(one.nearest_block_cells, two.nearest_block_cells)


def test_cells_are_searched_again_only_in_another_voxel(monkeypatch):
    from antdsl.fields import cells as module

    monkeypatch.setattr(module, "_MAX_DENSE_VOXELS", 0)
    mesh, rng = ball(30, (3, 4, 5)), np.random.default_rng(2)
    cells, (points, normals) = SurfaceCells([mesh], 4.0), on_surface(mesh, 2000)
    side, known = classify_normal_directions(normals), None
    for step in range(8):
        points = points + rng.normal(0, 0.4, points.shape)
        points[step], points[10 * step] = np.nan, 1e9
        side = np.where(rng.random(2000) < 0.02, rng.integers(0, 6, 2000), side).astype(np.int8)
        cell_numbers, known = cells.update_cells(points, side, known)
        assert np.array_equal(cell_numbers, cells.find_cells_by_side(points, side))
    subset = np.flatnonzero(known.cells >= 0)[:7]
    original_cells, known.cells[subset] = known.cells[subset], (known.cells[subset] + 1) % len(cells)
    again = cells.update_cells(points, side, known)[0]
    assert np.array_equal(again[subset], (original_cells + 1) % len(cells))  # what is known of a voxel is not looked up again
    known.cells[subset] = original_cells
    rows = rng.permutation(2000)[:1500]
    assert np.array_equal(cells.update_cells(points[rows], side[rows], known)[0], cell_numbers[rows])


def test_nearest_cells_equal_a_plain_search():
    """On two balls that stand in each other, where more cells than sixteen are around many."""
    cells = SurfaceCells([ball(12, (0, 0, 0)), ball(12, (3, 1, 0)), ball(12, (1, 4, 2))], 3.0)
    voxel = np.stack(np.unravel_index(cells._voxel_numbers, tuple(cells._size)), axis=1)
    crowded, most = 0, len(cells)
    for a in range(most):
        near = np.flatnonzero((np.abs(voxel - voxel[a]).max(axis=1) <= 1) & ((cells.side_by_cell ^ 1) != cells.side_by_cell[a]))
        gap = ((cells.position[near] - cells.position[a]) ** 2).sum(axis=1)
        expected = np.sort(near[np.lexsort((near, gap))][:16])
        crowded += len(near) > 16
        assert np.array_equal(cells.nearest_block_cells[a], np.pad(expected, (0, 16 - len(expected)), constant_values=most))
    assert crowded > 100 and crowded < most


def test_points_without_a_cell_get_a_nearby_compatible_cell():
    cells = SurfaceCells([grid(80, 4)], 4.0)
    up = np.array([[0, 1.0, 0]])
    near = cells.find_cells(np.array([[0.0, 3.0, 0.0]]), up)[0]
    assert near == cells.find_cells(np.array([[0.0, 0.0, 0.0]]), up)[0]
    assert cells.find_cells(np.array([[0.0, 0.0, 0.0]]), -up)[0] == -1
    assert cells.find_cells(np.array([[0.0, 0.0, 0.0]]), np.array([[1.0, 0, 0]]))[0] == near
    odd = np.array([[0, 30.0, 0], [np.nan, 0, 0], [1e30, 0, 0], [np.inf, 0, 0]])
    assert (cells.find_cells(odd, np.repeat(up, 4, axis=0)) == -1).all()
    assert (SurfaceCells([], 4.0).find_cells(odd, np.repeat(up, 4, axis=0)) == -1).all()


def test_too_many_cells_are_rejected_before_allocation():
    tracemalloc.start()
    for cell in (0.02, 1e-9):
        with pytest.raises(FieldTooFineError, match="cells are needed") as error_info:
            SurfaceCells([grid(1000, 4)], cell)
        assert error_info.value.needed > error_info.value.cap
    assert tracemalloc.get_traced_memory()[1] < 1e6
    tracemalloc.stop()
    with pytest.raises(FieldTooFineError):
        SurfaceCells([grid(100, 4)], 1.0, cap=9_000)
    ribbon = (np.array([[0, 0, 0], [0, 0, 0.5], [1e5, 0, 0]]), np.array([[0, 1, 2]], np.int32))
    with pytest.raises(FieldTooFineError) as error_info:
        SurfaceCells([ribbon], 0.1)
    assert error_info.value.is_axis_limit and error_info.value.needed > error_info.value.cap
    slivers = np.array([[[0, 0, 9 * k], [0, 0, 9 * k + 1e-3], [1e5, 0, 9 * k]] for k in range(600)], float).reshape(-1, 3)
    tracemalloc.start()
    with pytest.raises(FieldTooFineError) as error_info:
        SurfaceCells([(slivers, np.arange(1800, dtype=np.int32).reshape(-1, 3))], 1.0)
    assert not error_info.value.is_axis_limit and error_info.value.needed == 60_000_000
    assert tracemalloc.get_traced_memory()[1] < 1e6
    tracemalloc.stop()
    for cell in (0.0, -1.0, np.nan, np.inf):
        with pytest.raises(ValueError, match="more than 0"):
            SurfaceCells([grid(100, 4)], cell)


@pytest.mark.parametrize("mesh", [terrain(150, 20), ball(20), box((-20, -20, -20), (20, 20, 20))])
def test_links_are_symmetric_adjacent_and_connect_the_surface(mesh):
    from scipy.sparse import csr_array
    from scipy.sparse.csgraph import connected_components

    cells = SurfaceCells([mesh], 4.0)
    links = cells.links
    own = np.repeat(np.arange(len(cells)), np.diff(links.link_starts))
    assert {*zip(own.tolist(), links.linked_cells.tolist(), strict=True)} == {
        *zip(links.linked_cells.tolist(), own.tolist(), strict=True)
    }
    assert (own != links.linked_cells).all() and are_sides_compatible(
        cells.side_by_cell[own], cells.side_by_cell[links.linked_cells]
    ).all()
    gap = np.linalg.norm(cells.position[own] - cells.position[links.linked_cells], axis=1)
    assert gap.max() < 2.5 * 4.0
    graph = csr_array((np.ones(own.size), links.linked_cells, links.link_starts), shape=(len(cells), len(cells)))
    assert connected_components(graph)[0] == 1


def test_deposits_add_exactly_in_any_order_and_any_parts():
    rng = np.random.default_rng(3)
    one, two = flat_field(), flat_field()
    cells = rng.integers(0, 50, 20_000).astype(np.int32)
    amounts = (10.0 ** rng.uniform(-6, 4, 20_000)).astype(np.float32)
    one.deposit(cells, amounts)
    order = rng.permutation(20_000)
    for part in np.array_split(order, 17):
        two.deposit(cells[part], amounts[part])
    assert not one.amounts.any()  # lands at the end of the step
    one.advance(0.9, 0.0, 1 / 24)
    two.advance(0.9, 0.0, 1 / 24)
    assert one.amounts.tobytes() == two.amounts.tobytes()
    expected = np.bincount(cells, amounts.astype(np.float64), len(one.cells))
    assert np.abs(one.amounts - expected).max() < DEPOSIT_QUANTUM * 1000
    one.advance(0.9, 0.0, 1 / 24)
    assert np.allclose(one.amounts, np.float64(np.float32(0.9)) * two.amounts, rtol=1e-15)


def test_combine_max_stores_the_greatest_deposit():
    field = flat_field(combine="max")
    field.deposit(np.array([4, 4, 9]), np.array([2.0, 5.0, 1.0], np.float32))
    field.advance(0.5, 0.0, 1.0)
    field.deposit(np.array([4, 9]), np.array([1.0, 3.0], np.float32))
    field.advance(0.5, 0.0, 1.0)
    assert field.amounts[4] == 2.5 and field.amounts[9] == 3.0


def test_invalid_deposits_are_counted_and_ignored():
    field = flat_field(limit=3.0)
    amounts = np.array([np.nan, np.inf, 1e30, 2.0, 2.0, 2.0, -9.0], np.float32)
    assert field.deposit(np.array([1, 1, 2, -1, 3, 3, 5]), amounts) == 3
    field.advance(1.0, 0.0, 1.0)
    assert field.amounts[1] == 0 and field.amounts[2] == 3.0 and field.amounts[3] == 3.0 and field.amounts[5] == 0
    assert field.amounts.sum() == 6.0
    crowd = flat_field()
    crowd.deposit(np.zeros(5000, np.int32), np.full(5000, 1e9, np.float32))
    crowd.advance(1.0, 0.0, 1.0)
    assert crowd.amounts[0] == 5000 * MAX_DEPOSIT


def test_amounts_halve_by_half_life_and_become_zero():
    field = flat_field()
    field.deposit(np.array([7]), np.array([8.0], np.float32))
    field.advance(1.0, 0.0, 1 / 24)
    keep = 0.5 ** (1 / 24 / 2.0)
    for _ in range(48):
        field.advance(keep, 0.0, 1 / 24)
    assert field.amounts[7] == pytest.approx(4.0, rel=1e-5)
    for _ in range(50 * 48):
        field.advance(keep, 0.0, 1 / 24)
    assert field.amounts[7] == 0.0


def test_diffusion_solves_the_heat_equation_and_conserves_the_sum():
    cells = SurfaceCells([grid(200, 4)], 2.0)
    field = PheromoneField(cells)
    dt, rate = 1 / 24, 6.0
    field.deposit(cells.find_cells(np.zeros((1, 3)), np.array([[0, 1.0, 0]])), np.array([1000.0], np.float32))
    field.advance(1.0, 0.0, dt)
    for _ in range(240):
        field.advance(1.0, rate, dt)
        assert field.amounts.min() >= 0
    assert field.amounts.sum() == pytest.approx(1000.0, rel=1e-9)
    variance = (field.amounts * cells.position[:, 0] ** 2).sum() / 1000.0
    assert variance == pytest.approx(2 * rate * 10.0, rel=0.02)


def test_a_stencil_of_eight_is_isotropic():
    """After twelve steps from one cell: what lies 5 cells off along an axis, and at (3, 4), which is as far."""
    cells = SurfaceCells([grid(200, 4)], 2.0)
    dt, rate, ratio = 1 / 24, 20.0, {}
    for stencil in (4, 8):
        field = PheromoneField(cells, stencil=stencil)
        field.amounts[cells.find_cells(np.zeros((1, 3)), np.array([[0, 1.0, 0]]))] = 1000.0
        for _ in range(12):
            field.advance(1.0, rate, dt)
        assert field.amounts.sum() == pytest.approx(1000.0, rel=1e-12) and field.amounts.min() >= 0
        variance = (field.amounts * cells.position[:, 0] ** 2).sum() / 1000.0
        assert variance == pytest.approx(2 * rate * 12 * dt, rel=0.02)  # as the heat equation says
        along, across = (
            float(field.amounts[cells.find_cells(np.array([[x, 0.0, z]]), np.array([[0, 1.0, 0]]))[0]])
            for x, z in ((10.0, 0.0), (6.0, 8.0))
        )
        ratio[stencil] = across / along
    assert abs(ratio[8] - 1) < 0.25 * abs(ratio[4] - 1)


def test_a_step_with_a_stencil_of_eight_by_hand():
    """The nine-point Laplacian: 4 / 6 D dt / h² of a cell of 60 goes to each neighbour, a quarter of that to a corner."""
    cells = SurfaceCells([grid(40, 4)], 2.0)
    at = {(x, z): int(cells.find_cells(np.array([[x, 0.0, z]]), np.array([[0, 1.0, 0]]))[0]) for x in (0, 2, 4) for z in (0, 2)}
    field = PheromoneField(cells, stencil=8)
    field.amounts[at[0, 0]] = 60.0
    field.advance(1.0, 2.0, 0.2)
    assert field.amounts[at[2, 0]] == pytest.approx(4.0) and field.amounts[at[2, 2]] == pytest.approx(1.0)
    assert field.amounts[at[0, 0]] == pytest.approx(40.0) and field.amounts[at[4, 0]] == 0


@pytest.mark.parametrize("combine", ["add", "max"])
def test_deposits_first_spread_and_evaporate_in_the_same_step(combine):
    cells = SurfaceCells([grid(40, 4)], 2.0)
    own = cells.find_cells(np.zeros((1, 3)), np.array([[0, 1.0, 0]]))
    left = {}
    for first in (False, True):
        field = PheromoneField(cells, combine, limit=50.0, deposits_first=first)
        field.deposit(own, np.array([60.0], np.float32))
        field.advance(0.5, 2.0, 0.2)
        left[first] = field.amounts[own[0]], field.amounts.sum()
    assert left[False] == (50.0, 50.0)
    assert left[True] == pytest.approx((50 * 0.6 * 0.5, 25.0))


@pytest.mark.parametrize("stencil", [4, 8])
@pytest.mark.parametrize("mesh", [terrain(150, 20), ball(20), box((-20, -20, -20), (20, 20, 20))])
def test_the_stability_limit_depends_only_on_the_cell_size(mesh, stencil):
    field = PheromoneField(SurfaceCells([mesh], 4.0), stencil=stencil)
    most = compute_max_diffusion(4.0, 1 / 24)
    assert most == pytest.approx(96.0)
    with pytest.raises(ValueError, match="write at most 96 mm²/s"):
        field.advance(1.0, 96.1, 1 / 24)
    field.amounts[:] = np.random.default_rng(4).uniform(0, 1, len(field.cells)) * (np.arange(len(field.cells)) % 7 == 0)
    total, high = field.amounts.sum(), field.amounts.max()
    for _ in range(30):
        field.advance(1.0, most, 1 / 24)
        assert field.amounts.min() >= 0 and field.amounts.max() <= high + 1e-12
        high = field.amounts.max()
    assert field.amounts.sum() == pytest.approx(total, rel=1e-9)


def test_strongest_of_the_nearest_sixteen_against_plain_search():
    mesh = terrain(150, 30)
    cells = SurfaceCells([mesh], 4.0)
    field = PheromoneField(cells)
    rng = np.random.default_rng(5)
    field.amounts[:] = rng.choice([0.0, 1.0, 2.0, 3.0], len(cells))
    own = cells.find_cells(*on_surface(mesh, 300))
    value, x, y, z = field.sample_strongest(own)
    lattice = np.column_stack(np.unravel_index(cells._voxel_numbers, cells._size))
    for k, cell in enumerate(own):
        near = np.flatnonzero(
            (np.abs(lattice - lattice[cell]).max(axis=1) <= 1)
            & are_sides_compatible(cells.side_by_cell, cells.side_by_cell[cell])
        )
        gap = ((cells.position[near] - cells.position[cell]) ** 2).sum(axis=1)
        near = np.sort(near[np.lexsort((near, gap))[:16]])
        best = near[np.argmax(field.amounts[near])]
        assert value[k] == field.amounts[best]
        assert np.array_equal([x[k], y[k], z[k]], cells.position[best].astype(np.float32))


def test_empty_fields_have_no_smell():
    field = flat_field()
    own = np.array([5, -1])
    value, x, y, z = field.sample_strongest(own)
    assert not value.any() and np.allclose([x[0], y[0], z[0]], field.cells.position[5]) and x[1] == y[1] == z[1] == 0
    assert not field.sample(own).any() and not np.any(field.sample_gradient(own))
    nothing = PheromoneField(SurfaceCells([], 4.0))
    nothing.advance(0.9, 1.0, 1 / 24)
    assert nothing.sample_strongest(np.array([-1]))[0] == 0 and nothing.sample_gradient(np.array([-1]))[0] == 0
    assert nothing.sample(np.array([-1, -1])).tolist() == [0, 0]


@pytest.mark.parametrize("tilt", [0.0, 0.5, 1.1, 2.8])
def test_gradients_are_tangential_to_the_surface(tilt):
    vertices, faces = grid(80, 6)
    turn = np.array([[np.cos(tilt), np.sin(tilt), 0], [-np.sin(tilt), np.cos(tilt), 0], [0, 0, 1]])
    field = PheromoneField(SurfaceCells([(vertices @ turn, faces)], 3.0))
    along = np.array([0.6, 0, 0.8]) @ turn
    field.amounts[:] = 5.0 + 0.01 * (field.cells.position @ along)
    inner = np.flatnonzero(np.linalg.norm(field.cells.position, axis=1) < 30)
    slope = np.stack(field.sample_gradient(inner), axis=1)
    assert np.allclose(slope, 0.01 * along, atol=4e-4)
    assert np.abs(slope @ (np.array([0, 1.0, 0]) @ turn)).max() < 1e-4


def test_answers_do_not_depend_on_the_batch():
    mesh = terrain(150, 30)
    field = PheromoneField(SurfaceCells([mesh], 4.0))
    field.amounts[:] = np.random.default_rng(6).random(len(field.cells))
    points, normals = on_surface(mesh, 400)
    own = field.cells.find_cells(points, normals)
    together = (*field.sample_strongest(own), *field.sample_gradient(own), field.sample(own))
    for k in range(0, 400, 29):
        one = field.cells.find_cells(points[k : k + 1], normals[k : k + 1])
        alone = (*field.sample_strongest(one), *field.sample_gradient(one), field.sample(one))
        assert [a[k] for a in together] == [a[0] for a in alone]


def test_strongest_is_the_first_of_the_greatest_around() -> None:
    mesh = terrain(150, 30)
    field = PheromoneField(SurfaceCells([mesh], 4.0))
    rng = np.random.default_rng(8)
    own = np.concatenate([field.cells.find_cells(*on_surface(mesh, 2500)), np.full(10, -1, np.int32)])
    for share in (0.0, 0.01, 0.6):
        field.amounts[:] = np.where(rng.random(len(field.cells)) < share, rng.integers(0, 5, len(field.cells)), 0)
        held, place = np.append(field.amounts, 0.0), np.append(field.cells.position, np.zeros((1, 3)), axis=0)
        for k in (1, 9, 16):
            around = np.append(field.cells.get_nearest_cells(k), [[len(field.cells)] * k], axis=0)[own]
            best = around[np.arange(len(own)), held[around].argmax(axis=1)]
            best = np.where(held[around].max(axis=1) > 0, best, np.where(own < 0, len(field.cells), own))
            value, *positions = field.sample_strongest(own, k)
            assert value.dtype == np.float32 and np.array_equal(value, held[best].astype(np.float32))
            assert np.array_equal(np.stack(positions, axis=1), place[best].astype(np.float32))
        assert len(field.sample_strongest(own[:0])[0]) == 0
