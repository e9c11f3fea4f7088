"""What a bound scene passes to the runtime: geometry, things, crowds and numbers, all in mm, seconds and the scene's own axes.

They are plain frozen values, independent of readers, so that a test can write them by hand."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from antdsl.scene.geometry.import_notes import MeshImport
from antdsl.scene.staging.moves import GeometryMoves
from antdsl.source import Span

_MAX_ORIGIN_OFFSET_MM = 1e5  # mm: a world with its middle no farther out retains the zero point


PointMm = tuple[float, float, float]
ContactMode = Literal["off", "soft", "hard"]


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
class PaintedValues:
    """Numbers (n,) or vectors (n, 3) without unit on the vertices of a surface, or on its faces."""

    surface: str
    values: NDArray[np.float64]
    of_faces: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class FlowTarget:
    """The target of a flow: positions (n, 3) in mm with their radii (n,); or, with `line`, a polyline through them.

    `of`: the name of their curve or items; `which`: the index of a single item. They may move."""

    positions: NDArray[np.float64]
    radii: NDArray[np.float64]
    line: bool = False
    of: str = ""
    which: int | None = None


@dataclass(frozen=True, slots=True, eq=False)
class SpreadFlow:
    """A flow around a target: along it (a line), towards it, or away from it. It decreases with distance and is 0 beyond `radius`
    mm. With `gather`, a flow along a line also leads onto it; `gather` is the ratio of the two parts at the radius.

    `cell`: distance (mm) of the points where it is computed; default: a share of the radius. `on`: surfaces; empty: all."""

    direction: Literal["tangent", "toward", "away"]
    target: FlowTarget
    radius: float | None = None
    falloff: str = "smooth"
    strength: float = 1.0
    cell: float | None = None
    on: tuple[str, ...] = ()
    gather: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class BorderFlow:
    """A flow inward from the open borders of `on`, up to a distance of `within` mm."""

    on: tuple[str, ...]
    within: float
    falloff: str = "linear"
    strength: float = 1.0
    cell: float | None = None


@dataclass(frozen=True, slots=True, eq=False)
class SolvedFlow:
    """The cheapest path to a target. A mm costs 1 + slope · sin + 8 (1 - d / room)² at d mm from an obstacle + maps · their
    values + crowding · share of ground covered by agents. Crowds and moving things are updated every `every` s."""

    target: FlowTarget
    slope: float = 0.0
    clearance: float = 0.0
    maps: Mapping[str, float] = field(default_factory=dict)
    crowding: float = 0.0
    every: float = 1.0
    strength: float = 1.0
    cell: float | None = None
    on: tuple[str, ...] = ()


FlowData = PaintedValues | SpreadFlow | BorderFlow | SolvedFlow


@dataclass(frozen=True, slots=True, eq=False)
class ItemData:
    """One item. `attributes` in base units; absent ones have the declared default."""

    name: str
    position: PointMm
    radius: float
    attributes: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, eq=False)
class PlaceData:
    """Where a crowd starts.

    `points` (n, 3): one per agent, in order; after the last they repeat. Without points: a disc of `radius` mm around `around`,
    dropped along the scene's up onto the surfaces. Else: where lines from `inside` in all directions first hit a surface, on that
    side. Else: evenly over the surfaces, or with the density of the map `density`. `on` limits this to some surfaces (empty:
    all).

    With `by_area`, agents stand on the front of faces of any direction, `radius` is that of a ball, and `points` move to the
    nearest surface point. `spacing`: the least distance (mm) of centres; inf: as large as there is room for all that start there
    with the same setting. `seed`: for the positions, instead of the setting's.

    `ahead` (n, 3): the unit vector of the heading at each point, nan for a drawn heading. `values` (n,): attributes of the agent
    at each point that override its species, by name, in base units, nan for the species' value."""

    on: tuple[str, ...] = ()
    around: PointMm | None = None
    inside: PointMm | None = None
    radius: float | None = None
    points: NDArray[np.float64] | None = None
    density: str | None = None
    by_area: bool = False
    spacing: float = 0.0
    seed: int | None = None
    ahead: NDArray[np.float64] | None = None
    values: Mapping[str, NDArray[np.float64]] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class WalkData:
    """A walk of agents: a unit vector along which they start, projected onto the ground; the speed in mm/s; and the length in
    mm."""

    direction: PointMm
    speed: float
    length: float


@dataclass(frozen=True, slots=True, eq=False)
class CrowdData:
    """`count` agents of one species. `group`: the index of this line of the scene, from 0. Agents with a `walk` do not sense or
    decide. `body`: the name of their body; empty: the one that suits the species' name. `wears`: for each displayed part of their
    body, the layers from which one is drawn, "" for none."""

    species: str
    count: int
    place: PlaceData = PlaceData()
    group: int = 0
    walk: WalkData | None = None
    body: str = ""
    wears: tuple[tuple[str, ...], ...] = ()


@dataclass(frozen=True, slots=True)
class ClipData:
    """A clip of a body: its duration in `seconds`, the distance it covers in one turn, in body lengths (0: it stays in place),
    whether it loops, and its marks in turns, by name."""

    seconds: float = 1.0
    stride: float = 0.0
    loop: bool = True
    marks: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class RoomData:
    """The space that a body takes, in body lengths: a capsule `length` long and `width` wide along the heading. Its middle is
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
    """The L legs of a body in its standing pose, in body lengths: x along the heading, y up from the ground, z to the side (x ×
    y).

    `foot` float64[L,3]: the foot joints; `hip` float64[L,3]: where legs begin; `length` float64[L]: the reach of a straight leg
    from hip to foot joint. `gaits` go from slow to fast; there is at least one."""

    foot: NDArray[np.float64]
    hip: NDArray[np.float64]
    length: NDArray[np.float64]
    gaits: tuple[GaitData, ...]


@dataclass(frozen=True, slots=True, eq=False)
class FieldStart:
    """A field's value at the first frame: everywhere, or only within `radius` mm of `around`."""

    value: float
    around: PointMm | None = None
    radius: float | None = None


@dataclass(frozen=True, slots=True, eq=False)
class CameraData:
    """A camera over the written frames, one row per frame or a single one: positions and directions in mm and the scene's axes,
    the focal length in mm for a sensor 36 mm wide."""

    at: NDArray[np.float64]
    look_at: NDArray[np.float64]
    up: NDArray[np.float64]
    focal: NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class DetailData:
    """Level of detail by distance (mm) from a camera: up to `near`, feelers hit triangles; up to `far`, boxes; beyond it nothing.
    `camera` float64 (frames, 3): its position at each frame from `first` on; the end values hold outside."""

    camera: NDArray[np.float64]
    near: float
    far: float = float("inf")
    first: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class WorldSetting:
    """Everything that binding a plan needs.

    `unit_mm`: the length of `u`; `up`: a unit vector; `params`: by qualified name (`forager.smell`), absent ones have their
    default; `first_frame`: the number of the first simulated frame. Meshes, items and curves are at their positions of that
    frame; `moves` has their motion. `camera`: one from a file.

    With `by_rays`, agents find meshes by two rays per step and do not walk over triangles. `orient`: what bodies stand
    perpendicular to: the ground's smooth `normal`, the last two directions of motion (`turns`), or the directions to two
    `probes`. `deviations`: the largest distance (mm) of the triangles of height surfaces from bilinear patches. `contacts`: how
    bodies are separated.

    `clips`: of the body of each species, by name; `rooms`: the sizes of bodies from files; `legs`: of bodies with gaits.
    `unseen`: things that are not drawn, on which no foot stands. `imports`: by mesh, the report on its file. `spans`: where the
    scene defines each thing of the world."""

    fps: Fraction = Fraction(24)
    substeps: int = 1
    by_rays: bool = False
    orient: str = "normal"
    contacts: ContactMode = "off"
    up: PointMm = (0.0, 1.0, 0.0)
    unit_mm: float = 1.0
    seed: int = 0
    first_frame: int = 0
    surfaces: Mapping[str, MeshData] = field(default_factory=dict)
    obstacles: Mapping[str, MeshData] = field(default_factory=dict)
    items: Mapping[str, tuple[ItemData, ...]] = field(default_factory=dict)
    curves: Mapping[str, NDArray[np.float64]] = field(default_factory=dict)
    flows: Mapping[str, FlowData] = field(default_factory=dict)
    maps: Mapping[str, PaintedValues] = field(default_factory=dict)
    crowds: tuple[CrowdData, ...] = ()
    params: Mapping[str, float] = field(default_factory=dict)
    field_start: Mapping[str, FieldStart] = field(default_factory=dict)
    solids: Mapping[str, SolidData] = field(default_factory=dict)
    moves: GeometryMoves = field(default_factory=GeometryMoves)
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
        return self.fps.denominator / self.fps.numerator  # queried many times a step: a Fraction takes ten times as long

    @property
    def initial_attributes(self) -> dict[str, frozenset[str]]:
        """Return, by species, the attributes that the places of its crowds set at birth."""
        attributes: dict[str, frozenset[str]] = {}
        for crowd in self.crowds:
            attributes[crowd.species] = attributes.get(crowd.species, frozenset()) | crowd.place.values.keys()
        return attributes


def world_origin(setting: WorldSetting) -> NDArray[np.float64]:
    """The point (3), in mm, that positions are relative to: the middle of the world in whole metres, or 0 near the zero point."""
    meshes = setting.surfaces or {name: solid.mesh for name, solid in setting.solids.items()}
    meshes = meshes or setting.obstacles  # one more stone moves nothing
    point_sets = [m.vertices for m in meshes.values() if len(m.vertices)]
    point_sets = point_sets or [
        np.array([i.position for items in setting.items.values() for i in items], np.float64).reshape(-1, 3)
    ]
    if not len(point_sets[0]):
        return np.zeros(3)
    low, high = (np.min([p.min(axis=0) for p in point_sets], axis=0), np.max([p.max(axis=0) for p in point_sets], axis=0))
    middle = (low + high) / 2
    return np.round(middle / 1000.0) * 1000.0 if np.abs(middle).max() > _MAX_ORIGIN_OFFSET_MM else np.zeros(3)
