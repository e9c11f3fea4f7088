"""What a bound scene gives to the runtime: geometry, things, crowds and numbers, all in mm, seconds and the scene's own axes.

Plain frozen values without a reader behind them, so that a test can write one by hand.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from antdsl.scene.geometry.import_notes import MeshImport
from antdsl.scene.staging.moves import Moves
from antdsl.source import Span

_NEAR = 1e5  # mm: a world whose middle is no farther out keeps the zero point


Point = tuple[float, float, float]
Contacts = Literal["off", "soft", "hard"]


@dataclass(frozen=True, slots=True, eq=False)
class MeshData:
    """A triangle mesh: vertices float64 (n, 3) in mm, faces int32 (m, 3) counter-clockwise from outside."""

    vertices: NDArray[np.float64]
    faces: NDArray[np.int32]


@dataclass(frozen=True, slots=True, eq=False)
class SolidData:
    """A closed mesh that is solid inside, and the edge (mm) of the voxels that it becomes."""

    mesh: MeshData
    voxel: float


@dataclass(frozen=True, slots=True, eq=False)
class Painted:
    """Numbers (n,) or vectors (n, 3) without unit on the vertices of a surface, or on its faces."""

    surface: str
    values: NDArray[np.float64]
    of_faces: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class Target:
    """Where a flow leads: places (n, 3) in mm with their radii (n,), or, as a `line`, a curve from place to place.

    `of` names the curve or the items that these are, `which` (of one item alone) its number: they may move."""

    places: NDArray[np.float64]
    radii: NDArray[np.float64]
    line: bool = False
    of: str = ""
    which: int | None = None


@dataclass(frozen=True, slots=True, eq=False)
class SpreadFlow:
    """A flow about a target: along it (a line), toward it, or away; less the further off, nothing beyond `radius` mm. With
    `gather` a flow along leads onto the line as well, at the radius so much as it leads along.

    `cell`: how near (mm) the points lie in which it is worked out; else a share of the radius. `on`: surfaces; empty: all."""

    way: Literal["tangent", "toward", "away"]
    target: Target
    radius: float | None = None
    falloff: str = "smooth"
    strength: float = 1.0
    cell: float | None = None
    on: tuple[str, ...] = ()
    gather: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class BorderFlow:
    """Inward from the open borders of `on`, where these are nearer than `within` mm."""

    on: tuple[str, ...]
    within: float
    falloff: str = "linear"
    strength: float = 1.0
    cell: float | None = None


@dataclass(frozen=True, slots=True, eq=False)
class SolvedFlow:
    """The cheapest way to a target. A mm costs 1 + slope · sin + 8 (1 - d / room)² at d mm from an obstacle + maps · their
    values + crowding · share of ground covered by agents. Crowds that count and what moves are looked at every `every` s."""

    target: Target
    slope: float = 0.0
    room: float = 0.0
    maps: Mapping[str, float] = field(default_factory=dict)
    crowding: float = 0.0
    every: float = 1.0
    strength: float = 1.0
    cell: float | None = None
    on: tuple[str, ...] = ()


FlowData = Painted | SpreadFlow | BorderFlow | SolvedFlow


@dataclass(frozen=True, slots=True, eq=False)
class ItemData:
    """One item. `attributes` in base units; those absent take the declared default."""

    name: str
    position: Point
    radius: float
    attributes: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, eq=False)
class PlaceData:
    """Where a crowd starts.

    `points` (n, 3), one an agent, in order (those after the last start over); else a disc of `radius` mm around `around`, dropped
    along the scene's up onto the surfaces; else where lines from `inside` in all directions first meet a surface, on that side;
    else evenly over the surfaces, or as densely as the map `density` says. `on` narrows to some surfaces (empty: all).

    With `by_area` agents stand on the front of faces, whichever way these look, and `radius` is that of a ball; `points` go to
    the nearest place of a surface. `apart`: how far (mm) centres are from each other, at least; inf: as far as all who begin
    there with the same have room for. `seed`: of the places, instead of the setting's.

    `ahead` (n, 3): the unit vector along which the agent at each point faces, nan where its heading is drawn. `values` (n,):
    attributes that the one born at each point has instead of what its species says, by name, in base units, nan where that
    counts."""

    on: tuple[str, ...] = ()
    around: Point | None = None
    inside: Point | None = None
    radius: float | None = None
    points: NDArray[np.float64] | None = None
    density: str | None = None
    by_area: bool = False
    apart: float = 0.0
    seed: int | None = None
    ahead: NDArray[np.float64] | None = None
    values: Mapping[str, NDArray[np.float64]] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class WalkData:
    """A way that agents are led: a unit vector along which they set out, laid along the ground, mm/s, and mm."""

    direction: Point
    speed: float
    length: float


@dataclass(frozen=True, slots=True, eq=False)
class CrowdData:
    """`count` agents of one species; `group` is the number of this line of the scene, from 0. Those with a `walk` sense and
    decide nothing. `body` names what they look like; empty: what suits the species' name. `wears`: for each part that they
    show of their body, the layers of which each has one by chance, "" for none."""

    species: str
    count: int
    place: PlaceData = PlaceData()
    group: int = 0
    walk: WalkData | None = None
    body: str = ""
    wears: tuple[tuple[str, ...], ...] = ()


@dataclass(frozen=True, slots=True)
class ClipData:
    """A clip of a body: how many `seconds` it takes, the way that it covers in one turn, in body lengths (0: it stays where it
    is), whether it loops, and its marks in turns, by name."""

    seconds: float = 1.0
    stride: float = 0.0
    loop: bool = True
    marks: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class RoomData:
    """The room that a body takes, in its lengths: a capsule `length` long and `width` wide along the heading, whose middle is
    `height` above the feet and `ahead` of them."""

    length: float
    width: float
    height: float
    ahead: float


@dataclass(frozen=True, slots=True)
class GaitData:
    """A gait in body lengths and seconds, as `bodies.agents.legs.Gait`: `phases` has one number for each leg."""

    speed: float
    stride: float
    duty: float
    lift: float
    phases: tuple[float, ...]


@dataclass(frozen=True, slots=True, eq=False)
class LegsData:
    """The L legs of a body as it stands, in its lengths: x along the heading, y up from the ground, z to the side (x × y).

    `foot` float64[L,3]: the foot joints; `hip` float64[L,3]: where legs begin; `length` float64[L]: how far a leg reaches from
    hip to foot joint when it is straight. `gaits` go from slow to fast; there is at least one."""

    foot: NDArray[np.float64]
    hip: NDArray[np.float64]
    length: NDArray[np.float64]
    gaits: tuple[GaitData, ...]


@dataclass(frozen=True, slots=True, eq=False)
class FieldStart:
    """A field's value at the first frame: everywhere, or only within `radius` mm of `around`."""

    value: float
    around: Point | None = None
    radius: float | None = None


@dataclass(frozen=True, slots=True, eq=False)
class CameraData:
    """A camera over the written frames, one row a frame or a single one: places and directions in mm and the scene's axes, the
    focal length in mm for a sensor 36 mm wide."""

    at: NDArray[np.float64]
    look_at: NDArray[np.float64]
    up: NDArray[np.float64]
    focal: NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class DetailData:
    """Level of detail by distance (mm) from a camera: up to `near` triangles are felt, up to `far` boxes, beyond it nothing.
    `camera` float64 (frames, 3): where it is at each frame from the frame `first` on; the ends hold beyond."""

    camera: NDArray[np.float64]
    near: float
    far: float = float("inf")
    first: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class Setting:
    """Everything that binding a plan needs. `unit_mm` is the length of `u`; `up` a unit vector; `params` by qualified name
    (`forager.smell`), those absent take their default; `first_frame` is the number of the first simulated frame. Meshes, items
    and curves are where they are at that frame; `moves` says where they go. `camera` is one that a file brings. With
    `by_rays` agents stick to meshes by two rays a step and do not walk over triangles. `orient`: what bodies stand across: the
    ground's smooth `normal`, the last two directions of motion (`turns`), or the ways to two `probes`. `deviations`: how far (mm)
    the triangles of surfaces that are made of heights lie from bilinear patches, at most. `contacts` says how bodies
    keep apart. `clips`: of the body of each species, by name; `rooms`: what bodies that come from files take up;
    `legs`: what those that have gaits stand on. `unseen`: things that are not drawn, which no foot stands on.
    `imports`: by mesh, the report on its file. `spans`: where the scene says what each thing of the world is."""

    fps: Fraction = Fraction(24)
    substeps: int = 1
    by_rays: bool = False
    orient: str = "normal"
    contacts: Contacts = "off"
    up: Point = (0.0, 1.0, 0.0)
    unit_mm: float = 1.0
    seed: int = 0
    first_frame: int = 0
    surfaces: Mapping[str, MeshData] = field(default_factory=dict)
    obstacles: Mapping[str, MeshData] = field(default_factory=dict)
    items: Mapping[str, tuple[ItemData, ...]] = field(default_factory=dict)
    curves: Mapping[str, NDArray[np.float64]] = field(default_factory=dict)
    flows: Mapping[str, FlowData] = field(default_factory=dict)
    maps: Mapping[str, Painted] = field(default_factory=dict)
    crowds: tuple[CrowdData, ...] = ()
    params: Mapping[str, float] = field(default_factory=dict)
    field_start: Mapping[str, FieldStart] = field(default_factory=dict)
    solids: Mapping[str, SolidData] = field(default_factory=dict)
    moves: Moves = field(default_factory=Moves)
    camera: CameraData | None = None
    detail: DetailData | None = None
    deviations: Mapping[str, float] = field(default_factory=dict)
    clips: Mapping[str, Mapping[str, ClipData]] = field(default_factory=dict)
    rooms: Mapping[str, RoomData] = field(default_factory=dict)
    legs: Mapping[str, LegsData] = field(default_factory=dict)
    unseen: frozenset[str] = frozenset()
    imports: Mapping[str, MeshImport] = field(default_factory=dict)
    spans: Mapping[str, Span] = field(default_factory=dict)

    @property
    def dt(self) -> float:
        """Seconds a step."""
        return self.fps.denominator / self.fps.numerator  # asked for many times a step: a Fraction takes ten times as long

    @property
    def begun_with(self) -> dict[str, frozenset[str]]:
        """By species the attributes that places of its crowds give to those who are born there."""
        found: dict[str, frozenset[str]] = {}
        for crowd in self.crowds:
            found[crowd.species] = found.get(crowd.species, frozenset()) | crowd.place.values.keys()
        return found


def world_origin(setting: Setting) -> NDArray[np.float64]:
    """The point (3), in mm, that positions are relative to: the middle of the world in whole metres, or 0 near the zero point."""
    meshes = setting.surfaces or {name: solid.mesh for name, solid in setting.solids.items()}
    meshes = meshes or setting.obstacles  # one more stone moves nothing
    places = [m.vertices for m in meshes.values() if len(m.vertices)]
    places = places or [np.array([i.position for items in setting.items.values() for i in items], np.float64).reshape(-1, 3)]
    if not len(places[0]):
        return np.zeros(3)
    low, high = (np.min([p.min(axis=0) for p in places], axis=0), np.max([p.max(axis=0) for p in places], axis=0))
    middle = (low + high) / 2
    return np.round(middle / 1000.0) * 1000.0 if np.abs(middle).max() > _NEAR else np.zeros(3)
