"""Motion of agents in a cache, measured from its arrays alone: overlaps, bodies inside surfaces, lag, turns, steps, stops, feet.

The measures share no code with `motion` of summaries and specs, and use SciPy and Open3D. Angles are in degrees. Lengths are in
the cache's unit, or in body lengths where a measure says so."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from fractions import Fraction
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np
import open3d
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from antdsl.outputs.cache.cache_reader import Cache, open_cache
from antdsl.outputs.cache.dug_solids import DugSolids
from antdsl.scene.library_bodies import TrunkCapsule

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]

MAX_OVERLAP = 0.05  # of the width of the narrower body
MAX_DEPTH = 0.01  # of a body length: how far a trunk may be behind a surface
MAX_LAG = 60.0  # deg
ZIGZAG_TURN = 5.0  # deg a frame, to one side and then to the other
SPIN_TURN = 270.0  # deg within a second, on less than a body length
MOVING_SHARE, STANDING_SHARE, MIN_GO_SHARE = 0.2, 0.05, 0.4  # of the speed that 5 % of agent-frames exceed
MILLIMETRES = {"mm": 1.0, "cm": 10.0, "m": 1000.0}


@dataclass(frozen=True)
class MotionRow:
    """The measures of a run. All are better if they are lower. Shares are in percent.

    `overlap`: agents in the worst frame with a trunk deeper than MAX_OVERLAP in another one.
    `inside`: agent-frames with a trunk inside a surface, obstacle or solid; `inside_frames`: the longest time of an agent.
    `lag`: agent-frames with a body more than MAX_LAG off its ground.
    `turn`, `turn_max`: 99th percentile and maximum of the turn of a body per frame.
    `step`: the longest step, as a share of the longest allowed step.
    `zigzag`, `zigzags`: agents that ever turn left, then right; agent-frames in which they do.
    `spin`: agents that ever spin. `stops`: per agent and minute. `standing`: agent-frames.
    `backward`: moving agents that face more than a right angle off their path.
    `slide`: the longest slide of a standing foot per frame, in percent of a body length."""

    overlap: float = 0.0
    inside: float = 0.0
    inside_frames: float = 0.0
    lag: float = 0.0
    turn: float = 0.0
    turn_max: float = 0.0
    step: float = 0.0
    zigzag: float = 0.0
    zigzags: float = 0.0
    spin: float = 0.0
    stops: float = 0.0
    standing: float = 0.0
    backward: float = 0.0
    slide: float = 0.0


MEASURES = tuple(each.name for each in fields(MotionRow))


class Trunks(NamedTuple):
    """Trunks of agents: middles and unit axes (…, n, 3), half lengths of segments and radii (n), and body lengths (n)."""

    middle: Floats
    axis: Floats
    half: Floats
    radius: Floats
    size: Floats


def rotate(quaternion: Floats, vector: tuple[float, float, float]) -> Floats:
    """Return a vector, rotated by each quaternion (…, 4) x y z w."""
    u, w = quaternion[..., :3], quaternion[..., 3:]
    v = np.broadcast_to(vector, u.shape)
    return np.asarray(v + 2 * np.cross(u, np.cross(u, v) + w * v))


def angle(a: Floats, b: Floats) -> Floats:
    """Return the angle (deg) between vectors (…, 3)."""
    return np.asarray(np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b), axis=-1), (a * b).sum(axis=-1))))


def segment_distance(start: Floats, along: Floats, other_start: Floats, other_along: Floats) -> Floats:
    """Return the distance of segments from `start` (m, 3) along `along` to others (Ericson, Real-Time Collision Detection,
    2005, p. 148)."""
    between = start - other_start
    a, e = (np.maximum((each * each).sum(1), 1e-18) for each in (along, other_along))
    f, c, b = (other_along * between).sum(1), (along * between).sum(1), (along * other_along).sum(1)
    denominator = a * e - b * b
    s = np.where(denominator > 1e-12 * a * e, ((b * f - c * e) / np.maximum(denominator, 1e-18)).clip(0, 1), 0.0)
    t = (b * s + f) / e
    s = np.where(t < 0, (-c / a).clip(0, 1), np.where(t > 1, ((b - c) / a).clip(0, 1), s))
    nearest = start + along * s[:, None] - other_start - other_along * t.clip(0, 1)[:, None]
    return np.asarray(np.linalg.norm(nearest, axis=1))


def overlapping(trunks: Trunks) -> Flags:
    """Return which trunks of one frame are deeper in another one than MAX_OVERLAP of the lesser width."""
    result = np.zeros(len(trunks.size), np.bool_)
    if len(result) > 1:
        reach = 2 * float((trunks.half + trunks.radius).max())
        i, j = cKDTree(trunks.middle).query_pairs(reach, output_type="ndarray").T
        start = trunks.middle - trunks.axis * trunks.half[:, None]
        along = trunks.axis * (2 * trunks.half)[:, None]
        depth = trunks.radius[i] + trunks.radius[j] - segment_distance(start[i], along[i], start[j], along[j])
        visible = depth > MAX_OVERLAP * 2 * np.minimum(trunks.radius[i], trunks.radius[j])
        result[i[visible]] = result[j[visible]] = True
    return result


class Surroundings:
    """The surfaces and obstacles of a cache at a frame, for rays, and its solids."""

    def __init__(self, cache: Cache) -> None:
        self._static = cache.read_static()
        self._meshes = [mesh for mesh in cache.manifest.meshes if not mesh.row.is_dug]
        self._dug = DugSolids(cache, self._static) if any(mesh.row.is_dug for mesh in cache.manifest.meshes) else None
        self._scale = MILLIMETRES[cache.manifest.units]
        self._moves = any(mesh.moves for mesh in self._meshes)
        self._scene: tuple[Any, Floats] | None = None

    def _rays(self, arrays: Mapping[str, NDArray[Any]]) -> tuple[Any, Floats] | None:
        if not self._meshes:
            return None
        if self._scene is None or self._moves:
            vertices, faces, first = [], [], 0
            for mesh in self._meshes:
                own = self._static[f"mesh.{mesh.name}.vertices"]
                vertices.append(np.asarray(arrays.get(f"mesh.{mesh.name}.vertices", own), np.float64))
                faces.append(np.asarray(self._static[f"mesh.{mesh.name}.faces"], np.int64) + first)
                first += len(own)
            points = np.concatenate(vertices)
            scene: Any = open3d.t.geometry.RaycastingScene(nthreads=1)
            scene.add_triangles(points.astype(np.float32), np.concatenate(faces).astype(np.uint32))
            self._scene = scene, points
        return self._scene

    def inside(self, frame: int, arrays: Mapping[str, NDArray[Any]], foot: Floats, trunks: Trunks) -> Flags:
        """Return which trunks are inside. The path from a `foot` (n, 3) to the middle and on to both ends crosses a surface."""
        result = np.zeros(len(foot), np.bool_)
        rays = self._rays(arrays)
        ends = trunks.axis * (trunks.half + trunks.radius)[:, None]
        if rays is not None and len(foot):
            for start, displacement in ((foot, trunks.middle - foot), (trunks.middle, ends), (trunks.middle, -ends)):
                lines = np.concatenate([start, displacement], axis=1).astype(np.float32)
                hits = rays[0].cast_rays(lines, nthreads=1)
                part, normal = hits["t_hit"].numpy().astype(np.float64), hits["primitive_normals"].numpy()
                part = np.minimum(part, 1.0)
                result |= np.abs((displacement * normal).sum(axis=1)) * (1 - part) > MAX_DEPTH * trunks.size
        if self._dug is not None:
            self._dug.at(frame)
            for _, volume, offset in self._dug.iterate_volumes():
                depth = np.maximum(MAX_DEPTH * trunks.size * self._scale, volume.bricks.voxel / 2)
                for end in (trunks.middle, trunks.middle + ends, trunks.middle - ends):
                    result |= volume.sample_distances(end * self._scale - offset) < -depth
        return result


class MotionTrack:
    """The motion in a cache of the agents that live in all of its frames.

    `capsules`: of each species, by name. Arrays of the track have the shape (frames, n, …)."""

    def __init__(self, cache: Cache, capsules: Mapping[str, TrunkCapsule]) -> None:
        self.cache, self.numbers = cache, cache.frames()
        self.names = [each.name for each in cache.manifest.species]
        self.fps = float(Fraction(cache.manifest.fps))
        self._frames = [cache.frame(number) for number in self.numbers]
        self._capsule = np.array(
            [(c.length, c.width, c.height, c.forward_offset) for c in (capsules[name] for name in self.names)]
        )
        keys = [self._species(arrays) * 10**12 + np.asarray(arrays["id"], np.int64) for arrays in self._frames]
        self.common = keys[0]
        for each in keys[1:]:
            self.common = np.intersect1d(self.common, each, assume_unique=True)
        self.rows = []
        for each in keys:
            order = np.argsort(each)
            self.rows.append(order[np.searchsorted(each[order], self.common)])

    @staticmethod
    def _species(arrays: Mapping[str, NDArray[Any]]) -> NDArray[np.int64]:
        return np.asarray(arrays.get("species", np.zeros(len(arrays["id"]))), np.int64)

    def column(self, name: str) -> Floats:
        """Return a column of all frames, for the agents of the track."""
        pairs = zip(self._frames, self.rows, strict=True)
        return np.array([np.asarray(arrays[name], np.float64)[rows] for arrays, rows in pairs])

    @cached_property
    def position(self) -> Floats:
        return self.column("P")

    @cached_property
    def size(self) -> Floats:
        return self.column("pscale")

    @cached_property
    def heading(self) -> Floats:
        return rotate(self.column("orient"), (1.0, 0.0, 0.0))

    @cached_property
    def up(self) -> Floats:
        return rotate(self.column("orient"), (0.0, 1.0, 0.0))

    @cached_property
    def turn(self) -> Floats:
        """Return the signed turn (deg) per frame about the up of the body, float64[frames - 1, n]."""
        sine = (np.cross(self.heading[:-1], self.heading[1:]) * self.up[1:]).sum(axis=2)
        return np.asarray(np.degrees(np.arctan2(sine, (self.heading[:-1] * self.heading[1:]).sum(axis=2))))

    @cached_property
    def rotation(self) -> Floats:
        """Return the angle (deg) of the rotation of a body per frame, float64[frames - 1, n]."""
        axes = np.stack([self.heading, self.up, np.cross(self.heading, self.up)], axis=-1)
        trace = np.einsum("tnij,tnij->tn", axes[1:], axes[:-1])
        return np.asarray(2 * np.degrees(np.arcsin(np.sqrt((3 - trace).clip(0, 4)) / 2)))

    @cached_property
    def distance(self) -> Floats:
        """Return the distance per frame, float64[frames - 1, n]."""
        return np.asarray(np.linalg.norm(np.diff(self.position, axis=0), axis=2))

    def measure(self) -> MotionRow:
        """Return all measures."""
        if len(self.numbers) < 3 or not len(self.common):
            return MotionRow()
        overlap, inside, inside_frames = self._measure_bodies()
        lag, step = self._measure_checkpoints()
        zigzags = self._zigzags()
        full = float(np.quantile(self.distance, 0.95))
        moving, standing = self.distance > MOVING_SHARE * full, self.distance < STANDING_SHARE * full
        path = np.diff(self.position, axis=0)[moving]
        off = angle(path, self.heading[1:][moving])
        return MotionRow(
            overlap=100 * overlap,
            inside=100 * inside,
            inside_frames=inside_frames,
            lag=100 * lag,
            turn=float(np.quantile(np.abs(self.turn), 0.99)),
            turn_max=float(self.rotation.max()),
            step=100 * step,
            zigzag=100 * float(zigzags.any(axis=0).mean()),
            zigzags=100 * float(zigzags.mean()),
            spin=100 * float(self._spins().any(axis=0).mean()),
            stops=float((standing[1:] & ~standing[:-1]).sum()) * 60 * self.fps / standing.size,
            standing=100 * float(standing.mean()),
            backward=100 * float((off > 90).mean()) if len(off) else 0.0,
            slide=100 * self._slide(),
        )

    def _zigzags(self) -> Flags:
        big = np.abs(self.turn) > ZIGZAG_TURN
        return np.asarray(big[1:] & big[:-1] & (self.turn[1:] * self.turn[:-1] < 0))

    def _spins(self) -> Flags:
        """Return in which windows of a second agents spin, bool[windows, n]."""
        window = round(self.fps)
        total = np.concatenate([np.zeros((1, len(self.common))), np.cumsum(self.turn, axis=0)])
        if len(total) <= window:
            return np.zeros((1, len(self.common)), np.bool_)
        net = np.linalg.norm(self.position[window:] - self.position[:-window], axis=2)
        return np.asarray((np.abs(total[window:] - total[:-window]) > SPIN_TURN) & (net < self.size[window:]))

    def trunks(self, frame: int) -> tuple[Floats, Trunks]:
        """Return the feet and the trunks of all agents in the frame with an index."""
        arrays = self._frames[frame]
        size, orient = np.asarray(arrays["pscale"], np.float64), np.asarray(arrays["orient"], np.float64)
        length, width, height, ahead = (self._capsule[self._species(arrays)] * size[:, None]).T
        heading, up = rotate(orient, (1.0, 0.0, 0.0)), rotate(orient, (0.0, 1.0, 0.0))
        place = np.asarray(arrays["P"], np.float64)
        middle = place + up * height[:, None] + heading * ahead[:, None]
        return place - self._shifts(frame) + up * (MAX_DEPTH * size)[:, None], Trunks(
            middle, heading, np.maximum(length - width, 0) / 2, width / 2, size
        )

    def _shifts(self, frame: int) -> Floats:
        """Return the shifts of all bodies from their feet in the frame with an index; 0 without a checkpoint."""
        arrays, number = self._frames[frame], self.numbers[frame]
        result = np.zeros((len(arrays["id"]), 3))
        if number in self.cache.checkpoints():
            stored = self.cache.read_checkpoint(number)
            for species, name in enumerate(self.names):
                prefix = f"world.species.{name}."
                own = np.flatnonzero(self._species(arrays) == species)
                if f"{prefix}register.~lift.x" in stored and len(own):
                    ids = np.asarray(stored[f"{prefix}ids"])
                    order = np.argsort(ids)
                    at = order[np.searchsorted(ids[order], np.asarray(arrays["id"])[own])]
                    for axis in range(3):
                        lift = np.asarray(stored[f"{prefix}register.~lift.{'xyz'[axis]}"], np.float64)
                        result[own, axis] = lift[at] / MILLIMETRES[self.cache.manifest.units]
        return result

    def _measure_bodies(self) -> tuple[float, float, float]:
        """Return the share of overlapping trunks in the worst frame, the share inside, and the longest time inside (frames)."""
        around, worst, count, total = Surroundings(self.cache), 0.0, 0, 0
        duration = longest = np.zeros(len(self.common), np.int64)
        for frame, rows in enumerate(self.rows):
            foot, trunks = self.trunks(frame)
            if len(foot):
                worst = max(worst, float(overlapping(trunks).mean()))
            inside = around.inside(self.numbers[frame], self._frames[frame], foot, trunks)
            count, total = count + int(inside.sum()), total + len(inside)
            duration = np.where(inside[rows], duration + 1, 0)
            longest = np.maximum(longest, duration)
        return worst, count / max(1, total), float(longest.max())

    def _measure_checkpoints(self) -> tuple[float, float]:
        """Return the share of bodies off their ground, and the longest step, of frames with a checkpoint."""
        count, total, step = 0, 0, 0.0
        numbers = set(self.cache.checkpoints())
        previous: dict[str, Floats] = {}
        for frame in (k for k, number in enumerate(self.numbers) if number in numbers):
            arrays = self.cache.read_checkpoint(self.numbers[frame])
            for species, name in enumerate(self.names):
                prefix = f"world.species.{name}."
                own = self.common // 10**12 == species
                ids, known = np.asarray(arrays[f"{prefix}ids"]), self.common[own] % 10**12
                if not len(known):
                    continue
                order = np.argsort(ids)
                at = order[np.searchsorted(ids[order], known)]
                ground = np.asarray(arrays[f"{prefix}normal"], np.float64)[at]
                count, total = count + int((angle(ground, self.up[frame][own]) > MAX_LAG).sum()), total + len(at)
                fastest = np.asarray(arrays[f"{prefix}register.max_speed"], np.float64)[at]
                longest = np.maximum(fastest, previous.get(name, fastest)) / (self.fps * MILLIMETRES[self.cache.manifest.units])
                previous[name] = fastest
                if frame:
                    step = max(step, float((self.distance[frame - 1][own] / np.maximum(longest, 1e-9)).max()))
        return count / max(1, total), step

    def _slide(self) -> float:
        """Return the longest slide (body lengths) per frame of a foot that stands, of species without births and deaths."""
        worst = 0.0
        for name in self.names:
            feet = [arrays for arrays in self._frames if f"feet.{name}.P" in arrays]
            positions = [np.asarray(arrays[f"feet.{name}.P"], np.float64) for arrays in feet]
            if len(feet) < 2 or any(each.shape != positions[0].shape for each in positions) or not positions[0].size:
                continue
            own = self._species(feet[0]) == self.names.index(name)
            size = float(np.median(np.asarray(feet[0]["pscale"])[own]))
            down = np.array([arrays[f"feet.{name}.down"] == 1 for arrays in feet])
            slide = np.linalg.norm(np.diff(np.array(positions), axis=0), axis=-1)[down[1:] & down[:-1]]
            worst = max(worst, float(slide.max(initial=0.0)) / size)
        return worst


def measure_cache(folder: Any, capsules: Mapping[str, TrunkCapsule]) -> MotionRow:
    """Return the measures of the cache in a folder."""
    return MotionTrack(open_cache(folder), capsules).measure()
