"""The content of a picture: solids, crowds, items, trails, flows and a camera. These are plain data; nothing is drawn here."""

from dataclasses import dataclass, field, replace
from functools import cache

import numpy as np
from numpy.typing import NDArray

from antdsl.bodies.agents.driving import PoseAdjustments
from antdsl.bodies.agents.leg_ik import BodySpaceFeet, PlacedFeet
from antdsl.bodies.agents.machine_clips import MachineClips
from antdsl.bodies.agents.poses import WorldPoses
from antdsl.bodies.library import load_library_body
from antdsl.bodies.posed_body import NO_DRIVEN_POSE, PosedBody
from antdsl.numerics.records import select_record_rows
from antdsl.scene.light_model import DEFAULT_LIGHT, LightSettings
from antdsl.scene.looks import compute_drawn_radius

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Solid:
    """A mesh that does not move between frames: `vertices` (n, 3) in world units, `faces` (m, 3).

    `kind`: a key of SURFACE_KINDS. A `ground` that is not a floor is drawn like a clay figure. `colour`: sRGB display values
    0..1, either one colour (3,) or one per vertex (n, 3). None, or NaN for a vertex, means the look of the solid's `kind`."""

    name: str
    vertices: Array
    faces: NDArray[np.int32]
    kind: str = "ground"
    colour: Array | None = None


@dataclass(frozen=True, slots=True, eq=False)
class AgentPathLines:
    """The positions of n agents in consecutive frames.

    `positions` (n, frames, 3): NaN where an agent is missing.
    `current_index`: the index of the picture's own frame."""

    positions: Array
    current_index: int


@cache
def _load_default_body() -> PosedBody:
    """Return the body of an ant."""
    return PosedBody(load_library_body("ant"), ())


@dataclass(frozen=True, slots=True, eq=False)
class Crowd:
    """Agents of one species. A species with several bodies, or with agents in different layers, is several crowds.

    `position` (n, 3): in world units. `orient` (n, 4): quaternions x, y, z, w that rotate +x to the heading and +y to up. `scale`
    (n,): body lengths in world units. `colour` (n, 3): display values 0..1, for vertices without a material or with the material
    `state`. `is_marked` (n,): whether `colour` has a meaning, so that small bodies show it on all parts; None means that all do.
    `body`: the body, by default that of an ant. `body_key`: the body's key among the bodies of all species; empty means the
    species' name. `machine_clips`: the clips that each machine plays. `driven_pose`: channels and looks that states set. `feet`:
    positions of the feet; None if unknown. `next_crowd`: the same agents, row by row, in the next frame, for motion blur. `ids`,
    `velocity` (n, 3), `feelers` (k, 2, 3: starts and ends), `paths`: needed only if they are displayed."""

    species: str
    position: Array
    orient: Array
    scale: Array
    colour: Array
    ids: NDArray[np.int64] | None = None
    velocity: Array | None = None
    feelers: Array | None = None
    paths: AgentPathLines | None = None
    body: PosedBody = field(default_factory=_load_default_body)
    machine_clips: tuple[MachineClips, ...] = ()
    feet: PlacedFeet | None = None
    driven_pose: PoseAdjustments = NO_DRIVEN_POSE
    next_crowd: "Crowd | None" = None
    body_key: str = ""
    is_marked: NDArray[np.bool_] | None = None

    def compute_poses(self, needs_local: bool = False) -> WorldPoses:
        """Return the transforms and channels of all agents in the space of their body."""
        count = len(self.position)
        return self.body.compute_poses(
            self.machine_clips, count, self.select_feet(np.arange(count)), driven_pose=self.driven_pose, needs_local=needs_local
        )

    def pose_vertices(self, body: PosedBody, rows: NDArray[np.intp]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Return the vertices and unit normals float32[n, v, 3] of the agents in `rows`, in the axes of their bodies, in body
        lengths.

        `body`: the crowd's body, or its `fine_body` or `coarse_body`."""
        return body.pose_vertices(
            select_record_rows(self.machine_clips, rows),
            len(rows),
            self.select_feet(rows),
            driven_pose=select_record_rows(self.driven_pose, rows),
        )

    def select_feet(self, rows: NDArray[np.intp] | NDArray[np.bool_]) -> BodySpaceFeet | None:
        """Return the feet of the agents in `rows`, as an argument for `PosedBody.pose_vertices`. None if the feet are unknown."""
        if self.feet is None:
            return None
        return select_record_rows(self.feet, rows).convert_to_body_space(
            *(np.asarray(each)[rows] for each in (self.position, self.orient, self.scale))
        )

    def select_rows(self, rows: NDArray[np.bool_] | NDArray[np.intp]) -> "Crowd":
        """Return a crowd of only the agents in `rows`. It has no feelers, because these have no rows of agents."""
        return select_record_rows(replace(self, feelers=None), rows)


@dataclass(frozen=True, slots=True, eq=False)
class Item:
    """A placed object, such as food or a nest.

    `remaining_share`: the fraction of its amount that is left, 0..1; the drawn body shrinks with it. `look`: replaces the
    material of the item's shape. `power`, `colour`: for a lamp, its strength and its colour (display values 0..1); None for the
    default."""

    name: str
    position: tuple[float, float, float]
    radius: float
    remaining_share: float = 1.0
    shape: str = "sphere"
    look: str | None = None
    power: float | None = None
    colour: tuple[float, float, float] | None = None

    @property
    def drawn_radius(self) -> float:
        """Return the radius at which the volume of the item is the remaining fraction of its full volume."""
        return compute_drawn_radius(self.radius, self.remaining_share)


@dataclass(frozen=True, slots=True, eq=False)
class Trail:
    """A field on the ground, with all its cells.

    `position` (n, 3): the positions of cells on the surface. `cell`: the edge length of a cell. `strength` (n,): also for cells
    without scent (0), so that scent fades towards them. `full_strength`: the strength that is drawn with the strongest colour.
    None chooses one such that cells above it contain 70 % of the scent."""

    name: str
    position: Array
    strength: Array
    cell: float
    colour: tuple[float, float, float] = (0.68, 0.10, 0.46)
    full_strength: float | None = None


@dataclass(frozen=True, slots=True, eq=False)
class FlowArrows:
    """A flow on the ground, as arrows from `position` (n, 3) to `position + displacement`. `colour`: one colour, display values
    0..255."""

    name: str
    position: Array
    displacement: Array
    colour: tuple[int, int, int]


@dataclass(frozen=True, slots=True)
class Camera:
    """A camera with a sensor 36 mm wide.

    `focal`: focal length in mm. `fov`: angle of view across the width in degrees; if set, it overrides `focal`. `parallel_width`:
    if set, rays are parallel, and the picture is this wide in world units. `aperture`: the diameter of the lens in world units; 0
    for a pinhole, through which everything is sharp. `focus`: the distance ahead that is in focus, in world units; None for the
    distance of `look_at`."""

    at: tuple[float, float, float]
    look_at: tuple[float, float, float]
    focal: float = 35.0
    fov: float | None = None
    up: tuple[float, float, float] | None = None
    parallel_width: float | None = None
    aperture: float = 0.0
    focus: float | None = None


@dataclass(frozen=True, slots=True)
class LegendRow:
    """One state in the legend: its name, its number of agents, and its colour (display values 0..255) if the picture shows it."""

    name: str
    colour: tuple[int, int, int] | None
    count: int
    species: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class Picture:
    """The content of one frame, ready to draw.

    `up`: the world's up.
    `legend`, `frame`: written next to the picture, with the scales of the trails.
    `light`: the settings of sun, sky, haze and lamps.
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
    light: LightSettings = DEFAULT_LIGHT
