"""Flows and maps on surfaces. A flow gives a vector along the surface at each point, and a map gives a painted number. Agents
read both at their footing. This module also has flows around curves and points, which are defined everywhere in space."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from antdsl.casting.curves import SampledCurve
from antdsl.fields.face_points import FaceLattice
from antdsl.ground.protocol import Floats, Footing, Index, MeshSurfaces
from antdsl.scene.setting import FlowTarget, SpreadFlowData

if TYPE_CHECKING:
    from antdsl.runtime.world import World

VectorColumns = tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]
VectorFunction = Callable[[Floats], Floats]  # vectors (n, 3) at positions (n, 3), not projected onto a surface

_CURVE_SPACING_MM = 1.0  # mm, as for curves in nearest-point queries
_MIN_FACE_COSINE = 0.5  # cosine of the angle to the face; below it, a projected vector loses length


def project_to_faces(v: Floats, axis1: Floats, axis2: Floats) -> tuple[Floats, Floats]:
    """Project vectors `v` (n, 3) onto faces. Return their components (n) along the first and the second axis of the face. A
    vector at an angle of up to 60 degrees to its face retains its length. `axis1`, `axis2` (3, n): the axes of each vector's
    face."""
    c, s = (axis1 * v.T).sum(axis=0), (axis2 * v.T).sum(axis=0)
    flat = np.sqrt(c * c + s * s)
    length = np.sqrt((v * v).sum(axis=1))
    factor = np.minimum(length, flat / _MIN_FACE_COSINE) / np.where(flat > 1e-150, flat, 1.0)
    return c * factor, s * factor


def project_across_up(v: Floats, up: Floats) -> Floats:
    """Return the vectors `v` (n, 3) projected onto the planes perpendicular to `up` (n, 3). Used for agents that stand on no
    face.

    A vector at an angle of up to 60 degrees to its plane retains its length."""
    tangential = v - (v * up).sum(axis=1)[:, None] * up
    flat, length = (np.sqrt((w * w).sum(axis=1)) for w in (tangential, v))
    down: Floats = tangential * (np.minimum(length, flat / _MIN_FACE_COSINE) / np.where(flat > 1e-150, flat, 1.0))[:, None]
    return down


def compute_falloff(distance: Floats, radius: float | None, falloff_kind: str) -> Floats:
    """Return the strength of a flow at a distance (mm) from its source: 1 at the source, and 0 beyond `radius` (mm).

    The strength is 1 everywhere if `radius` is None. `falloff_kind`: how the strength decreases; `none` (not at all, up to the
    radius), `linear`, or any other word for a smooth decrease."""
    if radius is None:
        return np.ones_like(distance)
    t = np.minimum(distance / radius, 1.0)
    if falloff_kind == "none":
        return (distance <= radius).astype(np.float64)
    strength: Floats = 1 - t if falloff_kind == "linear" else 1 - t * t * (3 - 2 * t)
    return strength


@dataclass(slots=True, eq=False)
class SurfaceFlow:
    """A flow along the ground's faces, with a vector at each slot of a lattice.

    `axis1_components`, `axis2_components`: the components of each slot's vector along the first and the second axis of the
    face. `compute_vectors`: evaluates the flow at any position, for agents on ground without faces. If this is None, the flow
    is zero for these agents. `update_after_motion`: a function that updates the flow after things have moved."""

    lattice: FaceLattice
    axis1_components: Floats
    axis2_components: Floats
    compute_vectors: VectorFunction | None = None
    update_after_motion: Callable[[World], None] | None = None

    def sample_on_faces(self, face: Index, b1: Floats, b2: Floats) -> tuple[Floats, Floats]:
        """Return the flow's components along the first and the second axis of the face, at points on faces.

        `face`, `b1`, `b2`: the face of each point, and the barycentric weights of its second and third corner."""
        slots, weights = self.lattice.find_slots(face, b1, b2)
        return (self.axis1_components.take(slots) * weights).sum(axis=0), (self.axis2_components.take(slots) * weights).sum(
            axis=0
        )

    def sample(self, meshes: MeshSurfaces | None, footing: Footing, place: Floats, up: Floats) -> VectorColumns:
        """Return the flow at the agents' positions, as float32 x, y, z.

        `meshes`: the part of the ground that consists of meshes, or None.
        `place`, `up` (n, 3): the position and up direction of each agent, used for agents that stand on no face."""
        vectors, is_on_mesh = np.zeros((3, len(place))), np.zeros(len(place), bool)
        if meshes is not None:
            face, is_on_mesh = meshes.get_face_numbers(footing)
            vectors = meshes.to_world_vectors(face, *self.sample_on_faces(face, footing.b1, footing.b2))
        if not is_on_mesh.all():
            vectors[:, ~is_on_mesh] = 0.0
            if self.compute_vectors is not None:
                vectors[:, ~is_on_mesh] = project_across_up(self.compute_vectors(place[~is_on_mesh]), up[~is_on_mesh]).T
        return tuple(np.ascontiguousarray(part, np.float32) for part in vectors)  # type: ignore[return-value]

    def has_flow_at(self, meshes: MeshSurfaces | None, footing: Footing, place: Floats, up: Floats) -> NDArray[np.bool_]:
        """Return for each agent whether the flow at its position is non-zero, bool[n]. The arguments are those of `sample`."""
        x, y, z = self.sample(meshes, footing, place, up)
        is_flowing: NDArray[np.bool_] = (x != 0) | (y != 0) | (z != 0)
        return is_flowing

    def update_for_step(self, world: World) -> None:
        """Update the flow before a step. Does nothing for a flow that is computed only once."""
        if self.update_after_motion is not None:
            self.update_after_motion(world)

    def get_state(self) -> dict[str, NDArray[Any]]:
        """Return the arrays, by name, that are needed to continue a run. The result is empty if the flow depends only on the
        frame."""
        return {}

    def restore_state(self, arrays: dict[str, NDArray[Any]]) -> None:
        """Restore a state that `get_state` returned."""


@dataclass(frozen=True, slots=True, eq=False)
class PaintedMap:
    """Painted numbers on the ground. `corner_values` (3, faces): the number at each corner of each face; 0 on unpainted
    surfaces."""

    corner_values: Floats

    def sample(self, meshes: MeshSurfaces, footing: Footing) -> NDArray[np.float32]:
        """Return the painted number at each agent's footing, float32[n]; 0 for agents that stand on no face. `meshes`: as in
        `SurfaceFlow.sample`."""
        face, is_on_mesh = meshes.get_face_numbers(footing)
        a, b, c = (corner.take(face) for corner in self.corner_values)
        return np.where(is_on_mesh, a * (1 - footing.b1 - footing.b2) + b * footing.b1 + c * footing.b2, 0.0).astype(np.float32)


# --- about a curve or places -----------------------------------------------------------------------------------------


def find_nearest_on_target(target: FlowTarget, positions: Floats) -> tuple[Floats, Floats, Floats]:
    """Find the point of a target that is nearest to each position. Return its distance (n,; mm), the point (n, 3; mm) and the
    target's unit tangent there (n, 3). The tangent is zero if the target consists of points."""
    if target.is_line:
        closest = SampledCurve(target.positions, _CURVE_SPACING_MM).find_closest(*positions.T)
        columns = (closest.px, closest.py, closest.pz, closest.tx, closest.ty, closest.tz)
        px, py, pz, tx, ty, tz = (part.astype(np.float64) for part in columns)
        return closest.distance.astype(np.float64), np.stack([px, py, pz], axis=1), np.stack([tx, ty, tz], axis=1)
    from scipy.spatial import cKDTree

    distance, nearest = cKDTree(target.positions).query(positions)
    return distance, target.positions[nearest], np.zeros_like(positions)


def make_spread_source(flow: SpreadFlowData, target: FlowTarget) -> VectorFunction:
    """Return a function that evaluates a flow around a target. It takes positions (n, 3) and returns vectors (n, 3).

    The target's coordinates are along the world's axes, relative to the world's origin."""

    def compute_vectors(positions: Floats) -> Floats:
        distance, point, tangent = find_nearest_on_target(target, positions)
        direction = tangent
        if flow.gather and flow.radius is not None:
            direction = tangent + (point - positions) * (flow.gather / flow.radius)
            direction /= np.maximum(np.sqrt((direction * direction).sum(axis=1)), 1e-12)[:, None]
        if flow.direction != "tangent":
            offset = positions - point
            offset /= np.where(distance > 1e-9, distance, 1.0)[:, None]
            direction = offset if flow.direction == "away" else -offset
        return direction * (compute_falloff(distance, flow.radius, flow.falloff) * flow.strength)[:, None]

    return compute_vectors
