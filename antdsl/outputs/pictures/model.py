"""The content of a picture: solids, crowds, items, trails, flows, a camera. Plain values; nothing here draws."""

from dataclasses import dataclass, field, replace
from functools import cache
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from antdsl.bodies.agents.driving import DrivenPose
from antdsl.bodies.agents.leg_ik import BodySpaceFeet, PlacedFeet
from antdsl.bodies.agents.machine_clips import MachineClips
from antdsl.bodies.agents.poses import Poses
from antdsl.bodies.library import library_body
from antdsl.bodies.posed_body import NO_DRIVEN_POSE, PosedBody
from antdsl.numerics.records import take_rows

Array = NDArray[np.float64]
# A ground that is no floor is drawn as a figure of clay; a hill is bare soil.
SurfaceKind = Literal["ground", "stone", "boulder", "hill", "metal", "leaf", "light"]
MaterialName = Literal["metal", "soil", "leaf", "light"]
ItemShapeName = Literal["apple", "ring", "crumb", "cube", "mound", "sphere", "none"]


@dataclass(frozen=True, slots=True, eq=False)
class Solid:
    """A mesh that is static between frames: `vertices` (n, 3) in world units, `faces` (m, 3).

    `colour`: display (sRGB) values 0..1, one (3,) or one per vertex (n, 3). None, or NaN for a vertex, means the look of its
    `kind`."""

    name: str
    vertices: Array
    faces: NDArray[np.int32]
    kind: SurfaceKind = "ground"
    colour: Array | None = None


@dataclass(frozen=True, slots=True, eq=False)
class AgentPathLines:
    """Positions of agents over consecutive frames: `positions` (n, frames, 3), NaN where an agent is missing. `now` is the index
    of the picture's own frame."""

    positions: Array
    now: int


@cache
def _default_body() -> PosedBody:
    return PosedBody(library_body("ant"), ())


@dataclass(frozen=True, slots=True, eq=False)
class Crowd:
    """Agents of one species. `position` (n, 3). `orient` (n, 4): quaternions x, y, z, w that turn +x to the heading and +y to up.
    `scale` (n,): body lengths in world units. `colour` (n, 3): display values 0..1.

    `worn` is their body (an ant by default), posed by the clips that agents play; `plays` is what each of their machines does.
    `driven` is what else their states display, and `feet` is where they stand, if known. A species with agents in different
    layers is several crowds. `next_crowd`: the same agents, row by row, in the next frame, for motion blur. `ids`, `velocity` (n,
    3), `feelers` (k, 2, 3: starts and ends) and `paths` are needed only where they are displayed."""

    species: str
    position: Array
    orient: Array
    scale: Array
    colour: Array
    ids: NDArray[np.int64] | None = None
    velocity: Array | None = None
    feelers: Array | None = None
    paths: AgentPathLines | None = None
    worn: PosedBody = field(default_factory=_default_body)
    plays: tuple[MachineClips, ...] = ()
    feet: PlacedFeet | None = None
    driven: DrivenPose = NO_DRIVEN_POSE
    next_crowd: "Crowd | None" = None

    def poses(self, local: bool = False) -> Poses:
        """Return transforms and channels of all agents in the space of their body."""
        count = len(self.position)
        return self.worn.poses(self.plays, count, self.feet_beside(np.arange(count)), driven=self.driven, local=local)

    def posed(self, body: PosedBody, rows: NDArray[np.intp]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Return vertices and unit normals float32[n, v, 3] of some agents, in body lengths along their own axes. `body` is their
        body or its `fine` or `coarse` form."""
        return body.posed(take_rows(self.plays, rows), len(rows), self.feet_beside(rows), driven=take_rows(self.driven, rows))

    def feet_beside(self, rows: NDArray[np.intp] | NDArray[np.bool_]) -> BodySpaceFeet | None:
        """Return the feet of some agents as `PosedBody.posed` expects them; None where none are known."""
        if self.feet is None:
            return None
        return take_rows(self.feet, rows).relative_to(
            *(np.asarray(each)[rows] for each in (self.position, self.orient, self.scale))
        )

    def rows(self, chosen: NDArray[np.bool_] | NDArray[np.intp]) -> "Crowd":
        """Return selected agents of the crowd. Feelers are dropped, since they have no rows of agents."""
        return take_rows(replace(self, feelers=None), chosen)


@dataclass(frozen=True, slots=True, eq=False)
class Item:
    """Food, a nest or another placed object. `left` is the remaining share, 0..1; the body shrinks with it. A `look` replaces the
    material of its shape."""

    name: str
    position: tuple[float, float, float]
    radius: float
    left: float = 1.0
    shape: ItemShapeName = "sphere"
    look: MaterialName | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Trail:
    """A field on the ground: all its cells, at `position` (n, 3) on the surface, with edge `cell` and `strength` (n,).

    Cells without scent have strength 0; scent fades towards them. `full` is the strength drawn strongest (None: 70 % of the scent
    lies in cells of at least that strength)."""

    name: str
    position: Array
    strength: Array
    cell: float
    colour: tuple[float, float, float] = (0.68, 0.10, 0.46)
    full: float | None = None


@dataclass(frozen=True, slots=True, eq=False)
class FlowArrows:
    """A flow on the ground: arrows from `position` (n, 3) to `position + way`; `colour` is one colour in display values
    0..255."""

    name: str
    position: Array
    displacement: Array
    colour: tuple[int, int, int]


@dataclass(frozen=True, slots=True)
class Camera:
    """A pinhole camera with a 36 mm wide sensor: `focal` in millimetres, or `fov` (degrees across the width) if set. With `wide`,
    rays are parallel, and the picture has that width in world units."""

    at: tuple[float, float, float]
    look_at: tuple[float, float, float]
    focal: float = 35.0
    fov: float | None = None
    up: tuple[float, float, float] | None = None
    wide: float | None = None


@dataclass(frozen=True, slots=True)
class LegendRow:
    """A state's name, colour (display values 0..255) and how many agents of its species are in it."""

    name: str
    colour: tuple[int, int, int]
    count: int
    species: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class Picture:
    """One frame, ready to draw. `up` is the world's up; `legend`, `frame` and the scales of trails are written beside it.

    `grain`: the reference length of the ground's grain and pebbles; None means the body length of the first crowd."""

    solids: tuple[Solid, ...] = ()
    crowds: tuple[Crowd, ...] = ()
    items: tuple[Item, ...] = ()
    trails: tuple[Trail, ...] = ()
    flows: tuple[FlowArrows, ...] = ()
    up: tuple[float, float, float] = (0.0, 1.0, 0.0)
    legend: tuple[LegendRow, ...] = field(default=())
    frame: int | None = None
    grain: float | None = None
