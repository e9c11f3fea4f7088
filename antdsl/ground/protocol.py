"""The ground that agents stand and walk on, as the rest of the run time sees it: `Ground` is what a scene without surfaces
(`Plane`), one of meshes (`MeshGround`, `MovingGround`) and one of meshes and solids (`Terrain`) have in common.

A ground gives a `Footing` for places and takes it back for everything else: it alone knows what the columns of one mean. A step
goes in as a displacement and comes out as a `Move`. Lengths are mm; vectors of n agents are float64[n,3].
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from antdsl.ground.mesh.topology import Topology

Floats = NDArray[np.float64]
Flags = NDArray[np.bool_]
Index = NDArray[np.int64]
Numbers = NDArray[np.int32]
Rows = NDArray[np.integer[Any]] | Flags
Column = NDArray[Any]

_FACES = ("mesh", "face", "b1", "b2", "over")
_PLACE = ("x", "y", "z")
_ON_MESHES: dict[str, Column | float] = dict.fromkeys(_PLACE, 0.0)  # of who stands on a mesh of a ground with solids


def rows_of(array: NDArray[Any], rows: Rows) -> NDArray[Any]:
    """Some rows of an array; `take` is several times faster than an index."""
    return array[rows] if rows.dtype == bool else array.take(rows, axis=0)


class Footing:
    """Where agents stand, one row each: a table of named columns, of which each kind of ground has its own.

    meshes             `mesh` and `face` (int32[n], -1 = nowhere), the weights `b1`, `b2` of the face's second and third corner.
                       Who is stepping over a border is `over` mm off it along the face's normal; 0 for others.
    meshes and solids  the same, and `x`, `y`, `z`. On a solid `mesh` counts solids after the meshes, `face` is 0 and (x, y, z) is
                       the place on its surface (mm); 0 on meshes.
    plane              `point` float64[n,3] on it, and `mesh`, 0 as if the plane were the only surface.

    Columns have these names in checkpoints and caches, and their order is that of state hashes.
    """

    __slots__ = ("columns",)

    def __init__(self, columns: Mapping[str, Column]) -> None:
        self.columns: dict[str, Column] = dict(columns)

    # ---- made

    @staticmethod
    def on_faces(mesh: Numbers, face: Numbers, b1: Floats, b2: Floats, over: Floats | None = None) -> Footing:
        """On faces of meshes; nobody over a border where `over` is not given."""
        over = np.zeros(len(face)) if over is None else over
        return Footing({"mesh": mesh, "face": face, "b1": b1, "b2": b2, "over": over})

    @staticmethod
    def on_solids(mesh: int | Numbers, place: Floats) -> Footing:
        """At places [n,3] on the surfaces of the solids that count as `mesh`, one or [n]."""
        n = len(place)
        on = Footing.on_faces(np.full(n, mesh, np.int32), np.zeros(n, np.int32), *np.zeros((2, n)))
        return on._with(np.ascontiguousarray(place.T))

    @staticmethod
    def on_plane(point: Floats) -> Footing:
        """At points [n,3] of the plane."""
        return Footing({"point": point, "mesh": np.zeros(len(point), np.int32)})

    @staticmethod
    def nowhere(n: int) -> Footing:
        """Footings of agents that stand on no face of any mesh."""
        return Footing.on_faces(np.full(n, -1, np.int32), np.full(n, -1, np.int32), np.zeros(n), np.zeros(n))

    def with_places(self) -> Footing:
        """A copy of footings on meshes for a ground that has solids too."""
        return self.copy()._with(np.zeros((3, len(self))))

    def _with(self, place: Floats) -> Footing:
        return Footing(self.columns | dict(zip(_PLACE, place, strict=True)))

    # ---- read

    def __len__(self) -> int:
        return len(self.columns["mesh"])

    @property
    def mesh(self) -> Numbers:
        """The number of the surface or solid, int32[n]; -1 = nowhere."""
        return self.columns["mesh"]

    @property
    def face(self) -> Numbers:
        """The number of the face in its mesh, int32[n]."""
        return self.columns["face"]

    @property
    def b1(self) -> Floats:
        """The weight of the face's second corner, float64[n]."""
        return self.columns["b1"]

    @property
    def b2(self) -> Floats:
        """The weight of the face's third corner, float64[n]."""
        return self.columns["b2"]

    @property
    def over(self) -> Floats:
        """How far off its face along the normal each agent is, float64[n]."""
        return self.columns["over"]

    @property
    def point(self) -> Floats:
        """The place on the plane, float64[n,3]."""
        return self.columns["point"]

    @property
    def x(self) -> Floats:
        """The first coordinate of the place on a solid, float64[n]."""
        return self.columns["x"]

    @property
    def y(self) -> Floats:
        """The second coordinate of the place on a solid, float64[n]."""
        return self.columns["y"]

    @property
    def z(self) -> Floats:
        """The third coordinate of the place on a solid, float64[n]."""
        return self.columns["z"]

    # ---- rows

    def take(self, rows: Rows | slice) -> Footing:
        """The footings of some rows: copies, or views of a slice."""
        if isinstance(rows, slice):
            return Footing({name: column[rows] for name, column in self.columns.items()})
        return Footing({name: rows_of(column, rows) for name, column in self.columns.items()})

    def faces(self, rows: Rows) -> Footing:
        """As `take`, of rows that stand on meshes, for a ground of meshes alone."""
        return Footing({name: rows_of(self.columns[name], rows) for name in _FACES})

    def put(self, rows: Rows, other: Footing) -> None:
        """Put other footings into rows: of the same kind of ground, or of its meshes alone."""
        columns = _ON_MESHES | other.columns
        for name, column in self.columns.items():
            column[rows] = columns[name]

    def copy(self) -> Footing:
        """The same in arrays of its own."""
        return Footing({name: column.copy() for name, column in self.columns.items()})

    @staticmethod
    def joined(first: Footing, *others: Footing) -> Footing:
        """Footings on one ground, one after another."""
        return Footing(
            {name: np.concatenate([column, *(o.columns[name] for o in others)]) for name, column in first.columns.items()}
        )

    @staticmethod
    def chosen(which: Flags, one: Footing, other: Footing) -> Footing:
        """On meshes: the footings of `one` where `which` says so, else those of `other`."""
        return Footing({name: np.where(which, column, other.columns[name]) for name, column in one.columns.items()})


@dataclass(frozen=True, slots=True, eq=False)
class Move:
    """Where a step led. Vectors are float64[n,3], lengths mm.

    Of vectors each component is contiguous. `up` is the smooth normal on the agent's side, `heading` a unit vector at right
    angles to it. `direction` is the unit direction of travel at the end, in the face: a velocity is carried along by taking
    its length times this. `travelled` is the way walked. `blocked` says that an open border ended the way, or that it could not
    be walked to its end, `lost` that there was no footing to walk from, or no surface near to stand on.
    """

    footing: Footing
    position: Floats
    up: Floats
    heading: Floats
    direction: Floats
    travelled: Floats
    blocked: Flags
    lost: Flags

    def columns(self) -> tuple[Column, ...]:
        """All but the footing, in order."""
        return self.position, self.up, self.heading, self.direction, self.travelled, self.blocked, self.lost

    def take(self, rows: Rows) -> Move:
        """The results of some rows."""
        position, up, heading, direction, travelled, blocked, lost = (rows_of(column, rows) for column in self.columns())
        return Move(self.footing.take(rows), position, up, heading, direction, travelled, blocked, lost)

    def put(self, rows: Rows, other: Move) -> None:
        """Put other results of the same ground into rows. What a ground has once for everybody (a plane's `up`) stays."""
        self.footing.put(rows, other.footing)
        for column, values in zip(self.columns(), other.columns(), strict=True):
            if column.flags.writeable:
                column[rows] = values


class Ground(Protocol):
    """What agents stand and walk on. Implemented by `plane.Plane`, `mesh.surface.MeshGround` (some of whose meshes move in
    `moving.MovingGround`) and `combined.Terrain`."""

    @property
    def names(self) -> tuple[str, ...]:
        """Of surfaces, then of solids, in the order in which footings count them."""

    @property
    def meshes(self) -> Meshes | None:
        """The part of the ground that is made of meshes."""

    def nowhere(self, n: int) -> Footing:
        """Footings of n agents that stand on nothing yet."""

    def place(self, points: Floats, up: Floats, on: Iterable[str] | None = None) -> tuple[Footing, Flags]:
        """Footings below points [n,3]: the first that a ray from far above along -`up` ([3] or [n,3]) meets of the names in `on`,
        all when None. Where it meets nothing, the nearest point, and False in the second array, bool[n]. KeyError for an unknown
        name."""

    def nearest(self, points: Floats, on: Iterable[str] | None = None) -> tuple[Footing, Floats]:
        """Footings at the nearest point of what `on` names, all when None, to points [n,3], and the distance float64[n]."""

    def position(self, footing: Footing) -> Floats:
        """Places in the world, float64[n,3]; zero for footings nowhere."""

    def normal(self, footing: Footing) -> Floats:
        """Unit normals, float64[n,3], of faces by how they are wound, out of solids; zero for footings nowhere."""

    def sides(self, footing: Footing, threads: int = 1) -> NDArray[np.int8]:
        """Which of six ways the normals point most, int8[n]: 0 +x, 1 -x, 2 +y, 3 -y, 4 +z, 5 -z; 0 for nowhere."""

    def upright(self, footing: Footing, up: Floats) -> Floats:
        """Smooth unit normals float64[n,3] on the side that `up` ([3] or [n,3]) points to; `up` itself for footings nowhere."""

    def move(
        self,
        footing: Footing,
        displacement: Floats,
        heading: Floats,
        up: Floats,
        body: Floats | float,
        threads: int = 1,
        straight: bool = False,
    ) -> Move:
        """Walk every agent along the ground by a displacement [n,3], on the side its `up` [n,3] points to. `heading` [n,3] is
        turned as the ground turns; `body` (mm, one or [n]) is how long each agent is. With `straight` a way ends at an open
        border, which else is gone along."""


class Meshes(Ground, Protocol):
    """The part of a ground that is made of meshes: what rays, flows, maps and fields ask of faces."""

    @property
    def low(self) -> Floats:
        """The lowest corner float64[3] of a box around all vertices."""

    @property
    def high(self) -> Floats:
        """The highest corner float64[3] of the same box."""

    @property
    def extent(self) -> float:
        """The longest side of the box, mm; of meshes that move, the longest so far."""

    @property
    def triangles(self) -> tuple[Floats, Numbers, Numbers, Topology]:
        """All surfaces as one: vertices [n,3], faces [m,3], the surface that each is of by number, and their tables."""

    def on_faces(self, footing: Footing) -> tuple[Index, Flags]:
        """The face of each footing, counted over all surfaces (0 for none), and whether it is on one."""

    def laid_out(self, face: Index, c: Floats, s: Floats) -> Floats:
        """Vectors (3, n) in the world, from their parts along the two axes of their faces."""

    def met(self, origin: Floats, way: Floats, threads: int = 1) -> tuple[Flags, Floats, Footing]:
        """Whose straight way from `origin` [n,3] by `way` [n,3] meets a surface, after what part of it, and the footing there."""

    def faced(self, origin: Floats, way: Floats, threads: int = 1) -> tuple[Index, Floats, Floats]:
        """Whose straight way from `origin` [n,3] by `way` [n,3] meets a surface: their numbers, ascending, after what part of it,
        and the face's unit normal (3, k), by how it is wound."""

    def rising(self, footing: Footing, place: Floats, reach: Floats, threads: int = 1) -> Index:
        """The rows, ascending, of agents at places [n,3] for whom a surface may rise within `reach` [n] mm, if that is over 0: at
        an inner crease, another piece, or a mesh that moves. All for whom one does, and the same whoever else is asked for."""
