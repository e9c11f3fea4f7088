"""Cells that triangles touch: thin ones are sliced, and named are still the cells that a test of boxes one by one finds."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from antdsl.casting import rasterise
from antdsl.casting.rasterise import iterate_triangle_cells
from antdsl.diagnostics import Report
from antdsl.pipeline import open_scene
from antdsl.runtime import bind

Floats = NDArray[np.float64]
Cell = tuple[int, ...]
HAIR = 1e-6  # cells: what is nearer to touching than this may be named or not


def gaps(triangle: Floats, cells: NDArray[np.int64]) -> Floats:
    """How far apart (cells) a triangle and cells are along the axis that separates them best; below 0 where none does."""
    edges = np.roll(triangle, -1, axis=0) - triangle
    axes = [*np.eye(3), np.cross(edges[0], edges[1]), *(np.cross(one, edge) for one in np.eye(3) for edge in edges)]
    distances = np.full(len(cells), -np.inf)
    for axis in axes:
        if (length := float(np.linalg.norm(axis))) < 1e-12:
            continue
        along = (triangle[None] - (cells[:, None] + 0.5)) @ (axis / length)
        half = 0.5 * np.abs(axis / length).sum()
        distances = np.maximum(distances, np.maximum(along.min(axis=1) - half, -half - along.max(axis=1)))
    return distances


def needles(count: int) -> list[Floats]:
    """Thin triangles along axes, in planes of axes and aslant, corners in any order, some without any width."""
    rng = np.random.default_rng(7)
    triangles = []
    for k in range(count):
        direction = np.eye(3)[k % 3] if k % 4 == 0 else rng.normal(size=3)
        if k % 4 == 1:
            direction[k % 3] = 0.0
        long = rng.uniform(70, 110) * direction / np.linalg.norm(direction)
        wide = rng.normal(size=3) * (0.0 if k % 8 == 2 else rng.uniform(0, 0.6))
        start = rng.uniform(-5, 5, 3)
        triangles.append(np.stack([start, start + long, start + long * rng.uniform(-0.2, 1.2) + wide])[rng.permutation(3)])
    return triangles


def named(triangles: Floats, **how: float) -> list[set[Cell]]:
    """The cells of each triangle."""
    cells_by_triangle: list[set[Cell]] = [set() for _ in triangles]
    for cells, which in iterate_triangle_cells(triangles, **how):
        for cell, triangle in zip(cells.tolist(), which.tolist(), strict=True):
            cells_by_triangle[triangle].add(tuple(cell))
    return cells_by_triangle


def test_cells_of_thin_triangles_equal_the_separating_axis_test():
    triangles = np.stack(needles(24))
    assert rasterise._find_thin_triangles(triangles).sum() >= 16
    exact, around, wider = named(triangles), named(triangles, exact=False), named(triangles, margin=0.25)
    for triangle, touched, loose, reached in zip(triangles, exact, around, wider, strict=True):
        low, high = np.floor(triangle.min(axis=0)).astype(int) - 1, np.floor(triangle.max(axis=0)).astype(int) + 2
        cells = np.stack(np.meshgrid(*map(np.arange, low, high), indexing="ij"), axis=-1).reshape(-1, 3)
        distances = gaps(triangle, cells)
        must = {tuple(cell) for cell in cells[distances < -HAIR].tolist()}
        may = {tuple(cell) for cell in cells[distances < HAIR].tolist()}
        assert must <= touched <= may
        assert touched <= loose and touched <= reached
        assert reached <= {tuple(cell) for cell in cells[distances < 0.25 * 3**0.5 + HAIR].tolist()}


def test_wide_triangles_are_quartered(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setattr(rasterise, "_iterate_triangle_chunks", lambda tri: pytest.fail("a triangle that is not thin was sliced"))
    wide = np.array([[[0.0, 0, 0], [200, 0, 0], [0, 1, 200]], [[0, 0, 0], [60, 0, 0], [60, 0, 1e-3]]])
    assert [len(cells) > 60 for cells in named(wide)] == [True, True]


@pytest.mark.parametrize("direction", [(1, 0, 0), (1, 0, 1), (3, 2, 4)])
def test_slices_of_a_needle_do_not_exceed_its_cells(direction: tuple[float, ...], monkeypatch: pytest.MonkeyPatch):
    parts = counted(monkeypatch)
    long, side = 50_000.0 * np.array(direction, float), np.array([0, 0.5, 0.0])
    cells = sum(len(cells) for cells, _ in iterate_triangle_cells(np.array([[[0.3, 0.2, 0.1], long, long + side]])))
    assert cells > 50_000
    assert max(parts) <= rasterise._TRIANGLES_PER_CHUNK
    assert sum(parts) <= 2 * cells


def test_two_needles_are_bound(tmp_path, monkeypatch: pytest.MonkeyPatch):
    """Two faces, 400 m long and 2 mm wide: quartered they were ten billion parts."""
    (tmp_path / "ground.obj").write_text(
        "v 0 0 0\nv 400000 0 0\nv 400000 0 2\nv 0 0 4\nv 400000 0 4\nv 0 0 6\nf 1 3 2\nf 4 6 5\n", encoding="utf-8"
    )
    (tmp_path / "walker.ant").write_text(
        "ant 1\nuse steering\nworld { surface ground }\nfield trail on ground { cell 6 mm; half_life 12 s }\n"
        'species walker {\n  max_speed 30 mm/s\n  state stroll "" amber {\n    steer climb(trail)\n    deposit trail 1 /s\n  }\n'
        "  layers { state }\n}\n",
        encoding="utf-8",
    )
    (tmp_path / "scene.yaml").write_text(
        "antdsl: 1\nunits: mm\nup: y\nfps: 24\nframes: 1..2\nworld:\n  ground: {mesh: ground.obj}\n"
        "crowd:\n  - {species: walker, from: walker.ant, count: 5, place: {on: ground}}\n",
        encoding="utf-8",
    )
    shot, report = open_scene(tmp_path / "scene.yaml")
    assert isinstance(report, Report) and shot is not None, str(report)
    parts = counted(monkeypatch)
    world = bind(shot.plan, shot.setting)
    assert len(world.fields["trail"].cells) > 60_000
    assert world.ground.extent == 400_000.0
    assert 0 < sum(parts) <= 2_000_000


def counted(monkeypatch: pytest.MonkeyPatch) -> list[int]:
    """How many parts of triangles are held against cells, call by call."""
    parts: list[int] = []
    real = rasterise._find_cells_by_box

    def counting(tri, *rest):
        parts.append(len(tri))
        return real(tri, *rest)

    monkeypatch.setattr(rasterise, "_find_cells_by_box", counting)
    return parts
