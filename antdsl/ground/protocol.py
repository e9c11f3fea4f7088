"""The interface through which the runtime uses the ground that agents stand and walk on.

A `Ground` is a plane (`PlaneGround`), meshes (`MeshGround`, `MovingGround`), or meshes and solids (`CombinedGround`). It creates
a `Footing` from positions, and its other methods take this footing. Only the ground interprets the columns of a footing. A step
takes a displacement and returns a `GroundMove`. Lengths are in mm; vectors of n agents are float64[n,3]."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from antdsl.ground.mesh.topology import MeshTopology

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]
Index = NDArray[np.int64]
Int32Array = NDArray[np.int32]
Rows = NDArray[np.integer[Any]] | Flags
ColumnArray = NDArray[Any]

_FACE_COLUMNS = ("mesh", "face", "b1", "b2", "over")
_POSITION_COLUMNS = ("x", "y", "z")
_DEFAULT_MESH_COLUMNS: dict[str, ColumnArray | float] = dict.fromkeys(
    _POSITION_COLUMNS, 0.0
)  # agents on meshes of a ground that has solids


def select_array_rows(array: NDArray[Any], rows: Rows) -> NDArray[Any]:
    """Return the given rows of an array. It uses NumPy's `take`, which is several times faster than indexing."""
    return array[rows] if rows.dtype == bool else array.take(rows, axis=0)


class Footing:
    """A table of footings, one row per agent. Its columns depend on the kind of ground:

    - meshes: `mesh` and `face` (int32[n], -1 for none), and `b1`, `b2`, the weights of the face's second and third corner. An
      agent that steps over a border is `over` mm off the face along its normal; for others, `over` is 0
    - meshes and solids: the same, and `x`, `y`, `z`. On a solid, `mesh` is the solid's number, counted after the meshes, and
      `face` is 0. (x, y, z) is the position on the solid's surface (mm), 0 on meshes
    - plane: `point` float64[n,3], the position on the plane, and `mesh`, which is 0

    Checkpoints and caches use the same column names. State hashes depend on the order of the columns."""

    __slots__ = ("columns",)

    def __init__(self, columns: Mapping[str, ColumnArray]) -> None:
        self.columns: dict[str, ColumnArray] = dict(columns)

    # ---- made

    @staticmethod
    def from_faces(mesh: Int32Array, face: Int32Array, b1: Floats, b2: Floats, heights: Floats | None = None) -> Footing:
        """Return footings on faces of meshes. Without `heights`, no agent is stepping over a border."""
        heights = np.zeros(len(face)) if heights is None else heights
        return Footing({"mesh": mesh, "face": face, "b1": b1, "b2": b2, "over": heights})

    @staticmethod
    def from_solids(mesh: int | Int32Array, place: Floats) -> Footing:
        """Return footings at positions [n,3] on the surfaces of solids. `mesh`: the solid's number, one or [n]."""
        n = len(place)
        on = Footing.from_faces(np.full(n, mesh, np.int32), np.zeros(n, np.int32), *np.zeros((2, n)))
        return on._add_position_columns(np.ascontiguousarray(place.T))

    @staticmethod
    def from_plane(point: Floats) -> Footing:
        """Return footings at points [n,3] of the plane."""
        return Footing({"point": point, "mesh": np.zeros(len(point), np.int32)})

    @staticmethod
    def create_unplaced(n: int) -> Footing:
        """Return footings of n agents that are not on any mesh."""
        return Footing.from_faces(np.full(n, -1, np.int32), np.full(n, -1, np.int32), np.zeros(n), np.zeros(n))

    def with_position_columns(self) -> Footing:
        """Return a copy of mesh footings with columns for positions, for a ground that also has solids."""
        return self.copy()._add_position_columns(np.zeros((3, len(self))))

    def _add_position_columns(self, place: Floats) -> Footing:
        return Footing(self.columns | dict(zip(_POSITION_COLUMNS, place, strict=True)))

    # ---- read

    def __len__(self) -> int:
        return len(self.columns["mesh"])

    @property
    def mesh(self) -> Int32Array:
        """Return the number of the surface or solid, int32[n]; -1 = nowhere."""
        return self.columns["mesh"]

    @property
    def face(self) -> Int32Array:
        """Return the number of each footing's face within its mesh, int32[n]."""
        return self.columns["face"]

    @property
    def b1(self) -> Floats:
        """Return the weight of the face's second corner, float64[n]."""
        return self.columns["b1"]

    @property
    def b2(self) -> Floats:
        """Return the weight of the face's third corner, float64[n]."""
        return self.columns["b2"]

    @property
    def over(self) -> Floats:
        """Return the distance of each agent from its face along the face's normal (mm), float64[n]. It is 0 except at borders."""
        return self.columns["over"]

    @property
    def point(self) -> Floats:
        """Return the position on the plane, float64[n,3]."""
        return self.columns["point"]

    @property
    def x(self) -> Floats:
        """Return the first coordinate of the position on a solid, float64[n]."""
        return self.columns["x"]

    @property
    def y(self) -> Floats:
        """Return the second coordinate of the position on a solid, float64[n]."""
        return self.columns["y"]

    @property
    def z(self) -> Floats:
        """Return the third coordinate of the position on a solid, float64[n]."""
        return self.columns["z"]

    # ---- rows

    def select_rows(self, rows: Rows | slice) -> Footing:
        """Return the footings of the given rows. For a slice, they are views; otherwise, they are copies."""
        if isinstance(rows, slice):
            return Footing({name: column[rows] for name, column in self.columns.items()})
        return Footing({name: select_array_rows(column, rows) for name, column in self.columns.items()})

    def select_rows_on_meshes(self, rows: Rows) -> Footing:
        """Return the footings of the given rows, all of which are on meshes, for a ground that consists of meshes only."""
        return Footing({name: select_array_rows(self.columns[name], rows) for name in _FACE_COLUMNS})

    def write_rows(self, rows: Rows, other: Footing) -> None:
        """Replace the footings in `rows` by `other`, which are footings on the same ground or on its meshes."""
        columns = _DEFAULT_MESH_COLUMNS | other.columns
        for name, column in self.columns.items():
            column[rows] = columns[name]

    def copy(self) -> Footing:
        """Return a copy with its own arrays."""
        return Footing({name: column.copy() for name, column in self.columns.items()})

    @staticmethod
    def concatenate(first: Footing, *others: Footing) -> Footing:
        """Return one table with the rows of several tables of footings, in order. All must belong to the same ground."""
        return Footing(
            {name: np.concatenate([column, *(o.columns[name] for o in others)]) for name, column in first.columns.items()}
        )

    @staticmethod
    def choose_rows(use_first: Flags, first: Footing, second: Footing) -> Footing:
        """Return footings on meshes: those of `first` where `use_first` is true, else those of `second`."""
        return Footing({name: np.where(use_first, column, second.columns[name]) for name, column in first.columns.items()})


@dataclass(frozen=True, slots=True, eq=False)
class GroundMove:
    """The result of a step. Vectors are float64[n,3], with contiguous components; lengths are in mm.

    - `up`: the smooth normal on the agent's side
    - `heading`: a unit vector perpendicular to `up`
    - `direction`: the unit direction of travel at the end of the path, perpendicular to `up`. Multiplied by the speed, it is the
      new velocity; projected into the face, it is the direction of the path
    - `travelled`: the distance walked
    - `is_blocked`: whether the path ended at an open border or could not be completed
    - `is_lost`: whether the agent had no footing at the start, or no surface near enough to stand on"""

    footing: Footing
    position: Floats
    up: Floats
    heading: Floats
    direction: Floats
    travelled: Floats
    is_blocked: Flags
    is_lost: Flags

    def list_columns(self) -> tuple[ColumnArray, ...]:
        """Return all fields except `footing`, in order."""
        return self.position, self.up, self.heading, self.direction, self.travelled, self.is_blocked, self.is_lost

    def select_rows(self, rows: Rows) -> GroundMove:
        """Return the results of the agents in the given rows."""
        position, up, heading, direction, travelled, blocked, lost = (
            select_array_rows(column, rows) for column in self.list_columns()
        )
        return GroundMove(self.footing.select_rows(rows), position, up, heading, direction, travelled, blocked, lost)

    def write_rows(self, rows: Rows, other: GroundMove) -> None:
        """Replace the results in `rows` by those in `other`, which are results of the same ground. Values that all agents share,
        such as `up` of a plane, do not change."""
        self.footing.write_rows(rows, other.footing)
        for column, values in zip(self.list_columns(), other.list_columns(), strict=True):
            if column.flags.writeable:
                column[rows] = values


class Ground(Protocol):
    """The interface of grounds that agents stand and walk on. The implementations are `plane.PlaneGround`,
    `mesh.surface.MeshGround`, `moving.MovingGround` (with meshes that move) and `combined.CombinedGround`."""

    @property
    def names(self) -> tuple[str, ...]:
        """Return the names of surfaces, then those of solids. Their indices are the numbers in footings."""

    @property
    def meshes(self) -> MeshSurfaces | None:
        """Return the part of the ground that consists of meshes, or None if there are no meshes."""

    def create_unplaced(self, n: int) -> Footing:
        """Return footings for n agents that have no position on the ground yet."""

    def place_points(self, points: Floats, up: Floats, surface_names: Iterable[str] | None = None) -> tuple[Footing, Flags]:
        """Return footings below points [n,3]: the first hit of a ray from far above along -`up` ([3] or [n,3]).

        `surface_names`: the surfaces and solids that rays can hit; None means all. If a ray hits nothing, the footing is the
        nearest point, and the second array, bool[n], is False. Raises KeyError for an unknown name."""

    def find_nearest(self, points: Floats, surface_names: Iterable[str] | None = None) -> tuple[Footing, Floats]:
        """Return the ground point nearest to each of points [n,3] as a footing, and its distance float64[n].

        `surface_names`: the surfaces and solids to search; None means all."""

    def position(self, footing: Footing) -> Floats:
        """Return positions in the world, float64[n,3]. They are zero for agents without a footing."""

    def normal(self, footing: Footing) -> Floats:
        """Return unit normals, float64[n,3]: by winding on faces, outwards on solids, and zero for agents without a footing."""

    def find_sides(self, footing: Footing, threads: int = 1) -> NDArray[np.int8]:
        """Return the axis direction nearest to each normal, int8[n]: 0 +x, 1 -x, 2 +y, 3 -y, 4 +z, 5 -z. Agents without a
        footing get 0."""

    def compute_upright_normals(self, footing: Footing, up: Floats) -> Floats:
        """Return smooth unit normals float64[n,3] on the side that `up` ([3] or [n,3]) points to; `up` itself for agents without
        a footing."""

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
        """Move every agent along the ground by its displacement [n,3], on the side that its `up` [n,3] points to.

        - `heading` [n,3]: rotates with the ground
        - `body`: the length of each agent (mm), one for all or [n]
        - `stop_at_borders`: whether a path ends at an open border; otherwise the agent continues along the border"""


class MeshSurfaces(Ground, Protocol):
    """The part of a ground that consists of meshes, with the queries that rays, flows, maps and fields need."""

    @property
    def low(self) -> Floats:
        """Return the lowest corner float64[3] of a box around all vertices."""

    @property
    def high(self) -> Floats:
        """Return the highest corner float64[3] of a box around all vertices."""

    @property
    def extent(self) -> float:
        """Return the longest side (mm) of the box around all vertices. For moving meshes, it is the longest side so far."""

    @property
    def triangles(self) -> tuple[Floats, Int32Array, Int32Array, MeshTopology]:
        """Return all surfaces as one mesh: vertices [n,3], faces [m,3], the surface number of each face, and the topology
        tables."""

    def get_face_numbers(self, footing: Footing) -> tuple[Index, Flags]:
        """Return the face number of each footing, counted over all surfaces (0 for none), and whether the footing is on a
        face."""

    def to_world_vectors(self, face: Index, c: Floats, s: Floats) -> Floats:
        """Return vectors (3, n) in world space, from their components `c` and `s` along the two axes of their faces."""

    def find_path_hits(self, origin: Floats, displacement: Floats, threads: int = 1) -> tuple[Flags, Floats, Footing]:
        """Return a mask of the straight paths from `origin` [n,3] by `displacement` [n,3] that hit a surface.

        Also return the fraction of each path before the hit, and the footing at the hit."""

    def find_hit_normals(self, origin: Floats, displacement: Floats, threads: int = 1) -> tuple[Index, Floats, Floats]:
        """Return the ascending rows of the straight paths from `origin` [n,3] by `displacement` [n,3] that hit a surface.

        For these k rows, also return the fraction of the path before the hit, and the face's unit normal (3, k), by its
        winding."""

    def find_rows_near_slopes(self, footing: Footing, place: Floats, reach: Floats, threads: int = 1) -> Index:
        """Return the ascending rows of the agents that may have a rising surface within `reach` [n] mm. `place`: their positions
        [n,3].

        A surface may rise at an inner crease, where another piece of the ground is near, or at a moving mesh. No agent near a
        rise is omitted, except agents with a `reach` of 0 or less. The result for an agent does not depend on other agents."""
