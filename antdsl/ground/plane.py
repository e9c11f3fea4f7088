"""The ground of a scene that has no surfaces: the infinite plane through the origin, perpendicular to the scene's up axis."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray

from antdsl.ground.mesh.topology import classify_normal_directions
from antdsl.ground.protocol import Floats, Footing, GroundMove
from antdsl.machine_code.kernels import F64, Array1, Array2, Strided2, inlined, kernel
from antdsl.numerics.kernel_vectors import AgentPose, Vec3, dot, minus, plus, times


class PlaneGround:
    """The plane through the origin; `up` is its unit normal. Every point has a footing, and no agent is lost or blocked."""

    names: tuple[str, ...] = ()

    def __init__(self, up: Floats) -> None:
        self._up = np.asarray(up, np.float64)

    @property
    def up(self) -> Floats:
        """Return the plane's unit normal float64[3]."""
        return self._up

    @property
    def meshes(self) -> None:
        """Return None, because no part of this ground consists of meshes."""
        return None

    def _flatten_vectors(self, vectors: Floats) -> Floats:
        """Return vectors projected onto the plane."""
        along = self._compute_heights(vectors)
        flat: Floats = vectors - along[:, None] * self._up
        return flat

    def _compute_heights(self, vectors: Floats) -> Floats:
        """Return the signed distances of positions [n,3] from the plane."""
        along: Floats = (vectors[:, 0] * self._up[0] + vectors[:, 1] * self._up[1]) + vectors[:, 2] * self._up[2]
        return along

    def create_unplaced(self, n: int) -> Footing:
        """Return footings for n agents at the origin."""
        return Footing.from_plane(np.zeros((n, 3)))

    def place_points(
        self, points: Floats, up: Floats, surface_names: Iterable[str] | None = None
    ) -> tuple[Footing, NDArray[np.bool_]]:
        """Project points [n,3] onto the plane, along its normal. Return the footings, and an array that is True for
        every point."""
        return Footing.from_plane(self._flatten_vectors(np.asarray(points, np.float64).reshape(-1, 3))), np.ones(
            len(points), np.bool_
        )

    def find_nearest(self, points: Floats, surface_names: Iterable[str] | None = None) -> tuple[Footing, Floats]:
        """Return the nearest footings on the plane to points [n,3], and the distance float64[n]."""
        points = np.asarray(points, np.float64).reshape(-1, 3)
        return Footing.from_plane(self._flatten_vectors(points)), np.abs(self._compute_heights(points))

    def position(self, footing: Footing) -> Floats:
        """Return positions in the world, float64[n,3]."""
        return footing.point

    def normal(self, footing: Footing) -> Floats:
        """Return the plane's unit normal for each footing, float64[n,3]."""
        return np.broadcast_to(self._up, footing.point.shape)

    def find_sides(self, footing: Footing, threads: int = 1) -> NDArray[np.int8]:
        """Return the axis direction nearest to the plane's normal, int8[n], with the numbers of `Ground.find_sides`."""
        return classify_normal_directions(self.normal(footing))

    def compute_upright_normals(self, footing: Footing, up: Floats) -> Floats:
        """Return the plane's unit normal for each footing, float64[n,3], independent of `up`."""
        return self.normal(footing)

    def move(
        self,
        footing: Footing,
        displacement: Floats,
        heading: Floats,
        up: Floats,
        body: Floats | float,
        threads: int = 1,
        stop_at_borders: bool = False,
    ) -> GroundMove:
        """Move agents by their displacements, projected onto the plane."""
        n, none = len(displacement), np.zeros(len(displacement), np.bool_)
        point, ahead, direction, travelled = np.empty((n, 3)), np.empty((n, 3)), np.empty((n, 3)), np.empty(n)
        walk_all_agents_straight(self._up, footing.point, displacement, heading, point, ahead, direction, travelled)
        above = np.broadcast_to(self._up, up.shape)
        return GroundMove(Footing.from_plane(point), point, above, ahead, direction, travelled, none, none)


@inlined
def walk_straight_on_plane(up: Vec3, point: Vec3, displacement: Vec3, ahead: Vec3) -> tuple[AgentPose, F64]:
    """Move one agent by a displacement, which is projected onto the plane. Return its pose and the distance travelled."""
    step, look = minus(displacement, times(up, dot(displacement, up))), minus(ahead, times(up, dot(ahead, up)))
    far = np.sqrt(dot(step, step))
    direction = look
    if far > 0:
        direction = (step[0] / far, step[1] / far, step[2] / far)
    return AgentPose(plus(point, step), up, look, direction), far


@kernel
def walk_all_agents_straight(
    up: Array1[F64],
    point: Strided2[F64],
    displacements: Strided2[F64],
    ahead: Strided2[F64],
    end_positions: Array2[F64],
    heading: Array2[F64],
    direction: Array2[F64],
    travelled: Array1[F64],
) -> None:
    """Move all agents over a plane. `up`: the plane's normal. `point`, `displacements`, `ahead` (n, 3): positions, displacements
    and headings. The last four arrays receive the results."""
    normal = (up[0], up[1], up[2])
    for i in range(travelled.size):
        step, look = (displacements[i, 0], displacements[i, 1], displacements[i, 2]), (ahead[i, 0], ahead[i, 1], ahead[i, 2])
        pose, far = walk_straight_on_plane(normal, (point[i, 0], point[i, 1], point[i, 2]), step, look)
        for k in range(3):
            end_positions[i, k], heading[i, k], direction[i, k] = pose.position[k], pose.heading[k], pose.direction[k]
        travelled[i] = far
