"""Colours that fields give to the ground. The values of cells are smoothed along the surface."""

import numpy as np
from numpy.typing import NDArray

from antdsl.outputs.pictures.light import LUMINANCE_WEIGHTS, decode_srgb
from antdsl.outputs.pictures.model import Trail
from antdsl.outputs.pictures.shading_rows import Floats, split_rows
from antdsl.outputs.pictures.static_stage import SurfaceSamples
from antdsl.outputs.pictures.surface_materials import SOIL_COLOUR

Array = NDArray[np.float64]

_MAX_VOXELS = 40_000_000
_MAX_GROUND_COVER = 0.66  # share of the ground's own colour that a trail may replace
_GRAIN_BRIGHTNESS_RANGE = (0.5, 1.6)  # factors of the light of soil


class TrailVoxels:
    """The voxels that contain a trail, between the corners `low` and `high` (3,).

    They are created once per camera, and filled again for each frame."""

    def __init__(self, low: Array, high: Array, cell: float) -> None:
        self.cell = cell
        while np.prod(np.ceil((high - low) / self.cell) + 4) > _MAX_VOXELS:
            self.cell *= 1.26
        self.low = low - 1.5 * self.cell
        self.shape = tuple(int(v) for v in np.ceil((high - low) / self.cell) + 4)
        self._trail_cells: Array | None = None

    def add_trail(self, trail: Trail) -> None:
        """Distribute a trail over the voxels. Its cells are not on a lattice, so each is distributed over the eight voxels around
        it."""
        if self._trail_cells is not trail.position:
            self._trail_cells = trail.position
            self._spread = _TrilinearSpread(trail.position, self.low, self.cell, self.shape)
            self._weight_sums = self._spread.spread_values(np.ones(len(trail.position), np.float32))
        self._cover_sums = self._spread.spread_values(compute_ground_cover(trail))

    def interpolate_cover(self, points: Floats) -> Floats:
        """Return the fraction of the ground (n,), 0 to 1, that the trail covers at points (n, 3).

        It is a mean of the cells around the point, in which nearer cells have more weight."""
        scaled = (points - self.low.astype(np.float32)) * np.float32(1 / self.cell) - np.float32(0.5)
        corner = np.clip(np.floor(scaled), 0, np.asarray(self.shape, np.float32) - 2)
        part = np.clip(scaled - corner, 0, 1)
        cell = corner.astype(np.int32)
        _, b, c = self.shape
        first = (cell[:, 0] * b + cell[:, 1]) * c + cell[:, 2]
        return self._interpolate_voxels(self._cover_sums, first, part) / np.maximum(
            self._interpolate_voxels(self._weight_sums, first, part), 1e-6
        )

    def _interpolate_voxels(self, voxels: Floats, lowest_voxels: NDArray[np.int32], fractions: Floats) -> Floats:
        """Return values interpolated between the eight voxels around each point.

        `lowest_voxels`: the lowest of these voxels. `fractions` (n, 3): the position of the point between the voxels."""
        _, b, c = self.shape
        x, y, z = fractions.T
        rows = []
        for step in (0, c, b * c, b * c + c):
            low = voxels.take(lowest_voxels + np.int32(step))
            rows.append(low + (voxels.take(lowest_voxels + np.int32(step + 1)) - low) * z)
        between: Floats = (rows[0] + (rows[1] - rows[0]) * y) * (1 - x) + (rows[2] + (rows[3] - rows[2]) * y) * x
        return between


class FieldColours:
    """The colours of fields on everything that one camera shows. All points to be coloured must be near the points of
    `middle`."""

    def __init__(self, centre_samples: SurfaceSamples) -> None:
        self._centre_samples, self._colourable_rows = centre_samples, centre_samples.colourable_rows
        points = centre_samples.point[self._colourable_rows]
        if len(points):
            self._low, self._high = points.min(axis=0).astype(np.float64), points.max(axis=0).astype(np.float64)
        self._voxels_by_trail: dict[tuple[str, float], TrailVoxels] = {}
        self._trails: list[Trail] = []

    def set_trails(self, trails: tuple[Trail, ...]) -> None:
        """Set the trails of a frame."""
        self._trails = [
            each for each in trails if len(self._colourable_rows) and len(each.position) and (each.strength > 0).any()
        ]
        for trail in self._trails:
            cloth = self._voxels_by_trail.setdefault((trail.name, trail.cell), TrailVoxels(self._low, self._high, trail.cell))
            cloth.add_trail(trail)

    def colour_samples(self, samples: SurfaceSamples) -> Floats:
        """Return the colours (n, 3) of samples, including the trails on them."""
        if not self._trails:
            return samples.albedo
        rows = self._colourable_rows if samples is self._centre_samples else samples.colourable_rows
        colours, points = samples.albedo[rows], samples.point[rows]
        for trail in self._trails:
            cloth = self._voxels_by_trail[trail.name, trail.cell]
            for own in split_rows(len(rows)):
                colours[own] = colour_ground(colours[own], cloth.interpolate_cover(points[own]), trail)
        albedo = samples.albedo.copy()
        albedo[rows] = colours
        return albedo


class _TrilinearSpread:
    """The eight voxels around each cell at `position` (n, 3), and the weights of these voxels."""

    def __init__(self, position: Array, low: Array, cell: float, shape: tuple[int, ...]) -> None:
        scaled = (np.asarray(position, np.float64) - low) / cell - 0.5
        corner = np.floor(scaled)
        self.inner_rows = np.flatnonzero(((corner >= 0) & (corner < np.asarray(shape) - 1)).all(axis=1))
        part, corner = (scaled - corner)[self.inner_rows], corner[self.inner_rows].astype(np.int64)
        _, b, c = shape
        self.size = int(np.prod(shape))
        self.first = (corner[:, 0] * b + corner[:, 1]) * c + corner[:, 2]
        self.steps = [(i * b + j) * c + k for i in (0, 1) for j in (0, 1) for k in (0, 1)]
        sides = [np.stack([1 - part[:, axis], part[:, axis]]) for axis in range(3)]
        self.weights = [(sides[0][i] * sides[1][j] * sides[2][k]) for i in (0, 1) for j in (0, 1) for k in (0, 1)]

    def spread_values(self, values: Floats) -> Floats:
        """Return a value for each voxel: the weighted sum of the `values` (n,) of cells near it."""
        voxels = np.zeros(self.size, np.float32)
        for step, weight in zip(self.steps, self.weights, strict=True):
            np.add.at(voxels, self.first + step, (weight * values[self.inner_rows]).astype(np.float32))
        return voxels


def estimate_full_strength(strength: Array) -> float:
    """Return the strength to draw with the strongest colour. 0 if there is no scent.

    Cells with at least this strength contain 70 % of all scent, so the extent of faint scent hardly affects it."""
    held = np.sort(np.asarray(strength, np.float64)[np.asarray(strength) > 0])
    return float(held[np.searchsorted(np.cumsum(held), 0.3 * held.sum())]) if len(held) else 0.0


def choose_full_strength(trail: Trail) -> float:
    """Return the strength of a trail that is drawn with the strongest colour."""
    return trail.full_strength if trail.full_strength is not None else estimate_full_strength(trail.strength)


def compute_ground_cover(trail: Trail) -> Floats:
    """Return the fraction of the ground (n,) that the scent in each cell covers."""
    return compute_cover(trail.strength, choose_full_strength(trail))


def compute_cover(strength: Array, max_strength: float) -> Floats:
    """Return the fraction (n,) of the ground that each strength (n,) covers. `max_strength`: the strength with the strongest
    colour.

    Scent spans many powers of ten, and agents follow even faint scent. With the exponent 0.4, a thousandth of the strongest value
    covers a sixteenth of the ground."""
    share = np.clip(np.asarray(strength, np.float64) / max(max_strength, 1e-30), 0.0, 1.0) ** 0.4
    return np.asarray(share, np.float32)


def colour_ground(albedo: Floats, share: Floats, trail: Trail) -> Floats:
    """Return linear ground colours (n, 3) with a trail on them. `share` (n,): the fraction of the ground that the trail covers.

    At its strongest, the trail replaces two thirds of the ground's colour. Its brightness varies with the grains below it."""
    light = np.clip((albedo @ LUMINANCE_WEIGHTS) / np.float32(SOIL_COLOUR @ LUMINANCE_WEIGHTS), *_GRAIN_BRIGHTNESS_RANGE)
    return np.asarray(
        albedo + (decode_srgb(trail.colour) * light[:, None] - albedo) * (_MAX_GROUND_COVER * share)[:, None], np.float32
    )
