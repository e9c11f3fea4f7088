"""Fits the surfaces of a periodic world to its box. They must reach the sides of the box and continue on the opposite side."""

from __future__ import annotations

from collections.abc import Iterator
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from antdsl.numerics.periodic_box import PeriodicBox
from antdsl.scene.checks.wrap_checks import WRAP_AXES, make_periodic_box
from antdsl.scene.geometry.clipping import clip_mesh
from antdsl.scene.setting import MeshData

if TYPE_CHECKING:
    from antdsl.scene.staging.stage_scene import SceneStaging

_TOLERANCE = 1e-6  # share of a width by which a surface may miss a side of the box, or heights may differ there
_LEVEL_TOLERANCE = 1e-9  # share of a width: a surface that varies less in height is level


def fit_surfaces_to_box(staging: SceneStaging) -> None:
    """Cut the surfaces at the sides of the periodic box. Report surfaces that do not continue on the opposite side.

    A level surface that covers the box becomes one rectangle, so that its triangles meet at the seam."""
    box = make_periodic_box(staging.scene)
    if box is None or not staging.report.ok:
        return
    for name, mesh in staging.surfaces.items():
        span, gaps = staging.scene.find_span("world", name), list(_list_gaps(mesh, box))
        if gaps:
            words = f"`{name}` reaches from {gaps[0][1]:g} to {gaps[0][2]:g} mm along {gaps[0][0]}, and the world wraps beyond"
            advice = f"write `{gaps[0][0]}: {gaps[0][1]:g} mm .. {gaps[0][2]:g} mm` below `wrap`, or a larger surface"
            staging.report.error("bad-seam", words, span, advice)
            continue
        cut = _make_rectangle(mesh, box) or _cut_at_box(mesh, box)
        difference = _find_seam_difference(cut, box)
        if difference is None:
            staging.surfaces[name] = cut
            continue
        axis, height = difference
        words = f"`{name}` does not continue across the seam along {axis}"
        words += f": its heights differ by up to {height:.3g} mm" if height else ""
        advice = "make both sides equal: the last row of heights must be the first, with the same points"
        staging.report.error("bad-seam", words, span, advice)


def _list_gaps(mesh: MeshData, box: PeriodicBox) -> Iterator[tuple[str, float, float]]:
    """Yield each axis along which a surface does not reach both sides of the box. With each axis, yield the lower and upper end
    of the surface (mm)."""
    for axis in box.axes:
        values, slack = mesh.vertices[mesh.faces.ravel(), axis], _TOLERANCE * box.widths[axis]
        low, high = float(values.min(initial=np.inf)), float(values.max(initial=-np.inf))
        if low > box.low[axis] + slack or high < box.low[axis] + box.widths[axis] - slack:
            yield WRAP_AXES[axis], low, high


def _find_bounds(mesh: MeshData, box: PeriodicBox) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the lowest and the highest corner (3,) of the part of a mesh inside the box. Along axes that do not wrap, these are
    the bounds of the mesh itself."""
    wraps, begin = np.array(box.widths) > 0, np.array(box.low)
    low, high = mesh.vertices[mesh.faces.ravel()].min(axis=0), mesh.vertices[mesh.faces.ravel()].max(axis=0)
    return np.where(wraps, begin, low), np.where(wraps, begin + np.array(box.widths), high)


def _cut_at_box(mesh: MeshData, box: PeriodicBox) -> MeshData:
    """Return the part of a mesh inside the box. Vertices that are almost on a side are moved onto it."""
    wraps, begin, widths = np.array(box.widths) > 0, np.array(box.low), np.array(box.widths)
    vertices = mesh.vertices.copy()
    for side in (begin, begin + widths):
        near = wraps & (np.abs(vertices - side) <= _TOLERANCE * widths)
        vertices = np.where(near, side, vertices)
    low, high = (np.where(wraps, side, end) for side, end in ((begin, -np.inf), (begin + widths, np.inf)))
    return MeshData(*clip_mesh(vertices, mesh.faces, low, high))


def _make_rectangle(mesh: MeshData, box: PeriodicBox) -> MeshData | None:
    """Return a rectangle of two triangles that replaces a level surface covering the box, or None for any other surface."""
    corners = mesh.vertices[mesh.faces]
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    up = int(np.argmax(np.abs(across).sum(axis=0))) if len(across) else 0
    heights, slack = mesh.vertices[mesh.faces.ravel(), up], _LEVEL_TOLERANCE * box.least_width
    if up in box.axes or np.ptp(heights) > slack or not ((across[:, up] > 0).all() or (across[:, up] < 0).all()):
        return None
    low, high = _find_bounds(mesh, box)
    a, b = (axis for axis in range(3) if axis != up)
    inside = _cut_at_box(mesh, box)
    parts = inside.vertices[inside.faces]
    area = np.abs(np.cross(parts[:, 1] - parts[:, 0], parts[:, 2] - parts[:, 0])[:, up]).sum() / 2
    expected = (high[a] - low[a]) * (high[b] - low[b])
    if abs(area - expected) > _TOLERANCE * expected:
        return None
    vertices = np.empty((4, 3))
    vertices[:, up] = heights[0]
    vertices[:, a], vertices[:, b] = (low[a], high[a], high[a], low[a]), (low[b], low[b], high[b], high[b])
    is_upward = (across[0, up] > 0) == (up != 1)  # x × y and y × z lead along the third axis, x × z against it
    faces = [(0, 1, 2), (0, 2, 3)] if is_upward else [(0, 2, 1), (0, 3, 2)]
    return MeshData(vertices, np.array(faces, np.int32))


def _find_seam_difference(mesh: MeshData, box: PeriodicBox) -> tuple[str, float] | None:
    """Return the first axis along which the surface edges at the two sides of the box differ. Also return the difference of
    their heights (mm). Return None if all edges match."""
    for axis in box.axes:
        low, high = (_list_side_edges(mesh, axis, box.low[axis] + k * box.widths[axis]) for k in (0, 1))
        low[..., axis] = high[..., axis] = 0.0
        if low.shape == high.shape and np.abs(low - high).max(initial=0.0) <= _TOLERANCE * box.widths[axis]:
            continue
        return WRAP_AXES[axis], float(np.abs(low - high).max()) if low.shape == high.shape else 0.0
    return None


def _list_side_edges(mesh: MeshData, axis: int, place: float) -> NDArray[np.float64]:
    """Return the edges float64[k, 2, 3] of a mesh that lie on the plane at `place` (mm) along an axis, sorted by position."""
    edges = np.concatenate([mesh.faces[:, [0, 1]], mesh.faces[:, [1, 2]], mesh.faces[:, [2, 0]]])
    ends = mesh.vertices[edges[(mesh.vertices[edges][:, :, axis] == place).all(axis=1)]]
    rounded = np.round(ends, 6)
    swap = np.array([tuple(a) > tuple(b) for a, b in rounded], np.bool_).reshape(-1)
    ends[swap] = ends[swap][:, ::-1]
    order = np.lexsort(np.round(ends, 6).reshape(-1, 6).T[::-1])
    sorted_ends: NDArray[np.float64] = ends[order]
    return sorted_ends
