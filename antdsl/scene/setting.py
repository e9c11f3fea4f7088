"""The inputs that the run time receives from a scene: geometry, things, crowds and numbers, in mm, seconds and the scene's own
axes.

They are plain immutable values. They do not depend on file readers, so tests can create them directly."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from typing import TYPE_CHECKING, Literal

import numpy as np
from numpy.typing import NDArray

from antdsl.numerics.periodic_box import PeriodicBox
from antdsl.scene.crowds.body_choice import list_body_keys
from antdsl.scene.crowds.crowd_data import CrowdData as CrowdData
from antdsl.scene.crowds.crowd_data import PlacementData as PlacementData
from antdsl.scene.crowds.crowd_data import PointMm as PointMm
from antdsl.scene.crowds.crowd_data import ScriptedWalkData as ScriptedWalkData
from antdsl.scene.geometry.import_notes import MeshImport
from antdsl.scene.staging.motion import GeometryMotion
from antdsl.source import Span

if TYPE_CHECKING:
    from antdsl.scene.notes.notes_model import Note

SENSOR_WIDTH_MM, DEFAULT_FOCAL_MM = 36.0, 35.0  # of cameras
_MAX_ORIGIN_OFFSET_MM = 1e5  # mm; if the middle of the world is nearer to the zero point, the zero point is the origin


ContactMode = Literal["off", "soft", "hard"]


@dataclass(frozen=True, slots=True, eq=False)
class MeshData:
    """A triangle mesh: vertices float64 (n, 3) in mm, and faces int32 (m, 3), counter-clockwise as seen from outside."""

    vertices: NDArray[np.float64]
    faces: NDArray[np.int32]


@dataclass(frozen=True, slots=True, eq=False)
class SolidData:
    """A closed mesh with a solid interior, which is converted to voxels. `voxel`: the edge length of a voxel (mm)."""

    mesh: MeshData
    voxel: float


@dataclass(frozen=True, slots=True, eq=False)
class PaintedValues:
    """Numbers (n,) or vectors (n, 3) without a unit, painted on the vertices or on the faces of a surface."""

    surface: str
    values: NDArray[np.float64]
    is_per_face: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class FlowTarget:
    """The target of a flow, which may move.

    `positions` (n, 3): in mm; `radii` (n,): in mm.
    `is_line`: whether the target is the polyline through the positions.
    `name`: the name of the curve or items.
    `item_index`: the index of a single item; None for all items."""

    positions: NDArray[np.float64]
    radii: NDArray[np.float64]
    is_line: bool = False
    name: str = ""
    item_index: int | None = None


@dataclass(frozen=True, slots=True, eq=False)
class SpreadFlowData:
    """A flow around a target. It becomes weaker with the distance from the target.

    `direction`: along the target (a line), towards it, or away from it.
    `radius`: the distance in mm beyond which the flow is 0; None for no limit.
    `gather`: if above 0, a flow along a line also leads towards the line. At the radius, this is the ratio of the component
    towards the line to the component along the line.
    `cell`: the distance between sample points (mm); None for a fraction of the radius.
    `surfaces`: the surfaces with the flow; empty for all."""

    direction: Literal["tangent", "toward", "away"]
    target: FlowTarget
    radius: float | None = None
    falloff: str = "smooth"
    strength: float = 1.0
    cell: float | None = None
    surfaces: tuple[str, ...] = ()
    gather: float = 0.0


@dataclass(frozen=True, slots=True, eq=False)
class BorderFlowData:
    """A flow inward from the open borders of the surfaces `surfaces`, within a distance of `max_distance` mm."""

    surfaces: tuple[str, ...]
    max_distance: float
    falloff: str = "linear"
    strength: float = 1.0
    cell: float | None = None


@dataclass(frozen=True, slots=True, eq=False)
class SolvedFlowData:
    """A flow along the cheapest path to a target. The cost of a millimetre is the sum of these terms:

    - 1
    - slope · sine of the ground's slope
    - 8 (1 - d / clearance)², at a distance of d mm from an obstacle
    - the value of each map, times its factor in `maps`
    - crowding · fraction of the ground that agents cover

    Crowds and moving things are measured again every `interval` s."""

    target: FlowTarget
    slope: float = 0.0
    clearance: float = 0.0
    maps: Mapping[str, float] = field(default_factory=dict)
    crowding: float = 0.0
    interval: float = 1.0
    strength: float = 1.0
    cell: float | None = None
    surfaces: tuple[str, ...] = ()


FlowData = PaintedValues | SpreadFlowData | BorderFlowData | SolvedFlowData


@dataclass(frozen=True, slots=True, eq=False)
class ItemData:
    """One item. `attributes`: in base units; absent attributes have the declared default. `look`: the material in pictures.

    `power`: the strength of a lamp; None for other items. `colour`: the colour of the lamp's light, as display values; None for
    warm white."""

    name: str
    position: PointMm
    radius: float
    attributes: Mapping[str, float] = field(default_factory=dict)
    look: str | None = None
    power: float | None = None
    colour: tuple[float, float, float] | None = None


@dataclass(frozen=True, slots=True)
class ClipData:
    """A clip of a body. A phase of 1 is one complete cycle of the clip.

    `seconds`: the duration of a cycle.
    `stride`: the distance covered in one cycle, in body lengths; 0 if the body stays in place.
    `loop`: whether the clip loops.
    `marks`: the phases of events in the clip, by name."""

    seconds: float = 1.0
    stride: float = 0.0
    loop: bool = True
    marks: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, slots=True)
class BodyCapsuleData:
    """The capsule that represents the space of a body, in body lengths.

    `length`, `width`: the size along and across the heading.
    `height`: the height of its centre above the feet.
    `forward_offset`: how far its centre is ahead of the feet."""

    length: float
    width: float
    height: float
    forward_offset: float


@dataclass(frozen=True, slots=True)
class GaitData:
    """A gait, in body lengths and seconds. It has the fields of `bodies.agents.legs.Gait`. `phases`: the phase of each leg."""

    speed: float
    stride: float
    duty: float
    lift: float
    phases: tuple[float, ...]


@dataclass(frozen=True, slots=True, eq=False)
class LegsData:
    """The L legs of a body in its standing pose. All lengths are in body lengths.

    Axes: x along the heading, y up from the ground, z to the side (x × y). `foot` float64[L, 3]: the foot joints. `hip`
    float64[L, 3]: the start of each leg. `length` float64[L]: the distance from hip to foot joint for a straight leg.
    `gaits`: from slow to fast, at least one. `has_flat_soles`: whether the feet lie flat on the ground."""

    foot: NDArray[np.float64]
    hip: NDArray[np.float64]
    length: NDArray[np.float64]
    gaits: tuple[GaitData, ...]
    has_flat_soles: bool = False


@dataclass(frozen=True, slots=True, eq=False)
class FieldStartData:
    """A value of a field at the first frame: in all cells, or only within `radius` mm of `around`.

    `value`: a number, or a vector in the scene's axes. `on`: the surface of the cells; None for all surfaces of the field."""

    value: float | PointMm
    around: PointMm | None = None
    radius: float | None = None
    on: str | None = None


@dataclass(frozen=True, slots=True, eq=False)
class FieldGridData:
    """Values of a field at the first frame, in a grid that lies over the ground like a picture.

    `values`: float64[rows, columns], or float64[rows, columns, 3] of vectors.
    `extent`: the size (mm) along x and along the other level axis; None for the extent of the surfaces.
    `centre`: in mm; None for the middle of the surfaces.
    `on`: as in `FieldStartData`."""

    values: NDArray[np.float64]
    extent: tuple[float, float] | None = None
    centre: PointMm | None = None
    on: str | None = None


FieldStarts = tuple[FieldStartData | FieldGridData, ...]


@dataclass(frozen=True, slots=True, eq=False)
class CameraData:
    """A camera during the written frames. Each array has one row per frame, or a single row for a static camera.

    Positions are in mm, directions in the scene's axes.
    `focal`: the focal length in mm for a sensor with the width `SENSOR_WIDTH_MM`; 0 stands for `DEFAULT_FOCAL_MM`.
    `first`: the frame of the first row. The values are constant before the first and after the last row."""

    at: NDArray[np.float64]
    look_at: NDArray[np.float64]
    up: NDArray[np.float64]
    focal: NDArray[np.float64]
    first: int = 0

    @property
    def is_moving(self) -> bool:
        """Return whether the camera has one row for each frame rather than a single row."""
        return len(self.at) > 1

    def find_row(self, frame: int) -> int:
        """Return the row index for a frame of the scene. For earlier or later frames, this is the first or the last row."""
        return min(max(frame - self.first, 0), len(self.at) - 1)


@dataclass(frozen=True, slots=True, eq=False)
class DetailLevelData:
    """Level of detail by distance (mm) from a camera.

    `near_distance`: up to this distance, feelers hit triangles.
    `far_distance`: up to this distance, feelers hit boxes. Beyond it, they hit nothing.
    `camera` float64 (frames, 3): the camera's position at each frame from `first` on. It is constant before and after these
    frames."""

    camera: NDArray[np.float64]
    near_distance: float
    far_distance: float = float("inf")
    first: int = 0


@dataclass(frozen=True, slots=True, eq=False)
class WorldSetting:
    """Everything that binding a plan needs. Meshes, items and curves are at their positions of the first simulated frame.

    `unit_mm`: the length of one scene unit in mm.
    `up`: a unit vector.
    `params`: by qualified name (`forager.smell`); absent params have their default.
    `first_frame`: the number of the first simulated frame.
    `field_start`: by field; later values replace earlier ones.
    `motion`: the motion of meshes, items and curves.
    `cameras`: the cameras that do not depend on agents, by name.
    `uses_rays`: whether agents find the ground by two rays per step instead of walking from triangle to triangle.
    `orient`: what the up direction of bodies is perpendicular to: the ground with its smooth `normal`, the last two directions
    of motion (`turns`), or the directions to two `probes`.
    `deviations`: the largest distance (mm) between the triangles of height surfaces and bilinear patches.
    `contacts`: how bodies are separated.
    `body_weights`: for species with several bodies, the weight of each body.
    `clips`: the clips of bodies, by name. Here and below, bodies have the keys of `crowds.body_choice`.
    `body_capsules`: the capsules of bodies from files, and of all bodies of species with several bodies.
    `legs`: the legs of bodies with gaits.
    `undrawn_things`: things that are not drawn; feet do not stand on them.
    `imports`: the import report of each mesh file, by mesh.
    `spans`: where the scene defines each thing of the world.
    `notes`: what agents do in some frames.
    `lamp_strength`: a factor for the light of all lamps.
    `period`: the box of a periodic world, in the scene's coordinates; None if the world does not wrap."""

    fps: Fraction = Fraction(24)
    substeps: int = 1
    uses_rays: bool = False
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
    field_start: Mapping[str, FieldStarts] = field(default_factory=dict)
    solids: Mapping[str, SolidData] = field(default_factory=dict)
    motion: GeometryMotion = field(default_factory=GeometryMotion)
    cameras: Mapping[str, CameraData] = field(default_factory=dict)
    level_of_detail: DetailLevelData | None = None
    deviations: Mapping[str, float] = field(default_factory=dict)
    body_weights: Mapping[str, tuple[float, ...]] = field(default_factory=dict)
    clips: Mapping[str, Mapping[str, ClipData]] = field(default_factory=dict)
    body_capsules: Mapping[str, BodyCapsuleData] = field(default_factory=dict)
    legs: Mapping[str, LegsData] = field(default_factory=dict)
    undrawn_things: frozenset[str] = frozenset()
    imports: Mapping[str, MeshImport] = field(default_factory=dict)
    spans: Mapping[str, Span] = field(default_factory=dict)
    notes: tuple[Note, ...] = ()
    lamp_strength: float = 1.0
    period: PeriodicBox | None = None

    def list_body_keys(self, species: str) -> tuple[str, ...]:
        """Return the keys of all bodies of a species (`crowds.body_choice`). There is at least one."""
        return list_body_keys(species, len(self.body_weights.get(species, ())))

    @property
    def dt(self) -> float:
        """Return the duration of a step in seconds."""
        # cached: queried many times a step, and a Fraction takes ten times as long
        return self.fps.denominator / self.fps.numerator

    @property
    def initial_attributes(self) -> dict[str, frozenset[str]]:
        """Return, by species, the attributes that its crowd lines set at birth. Initial states are listed as `MACHINE.state`."""
        attributes: dict[str, frozenset[str]] = {}
        for crowd in self.crowds:
            names = crowd.place.values.keys() | crowd.initial_values.keys()
            attributes[crowd.species] = attributes.get(crowd.species, frozenset()) | names
        return attributes


def compute_world_origin(setting: WorldSetting) -> NDArray[np.float64]:
    """Return the point (3,) in mm to which positions are relative.

    It is the centre of the world, rounded to whole metres. It is (0, 0, 0) if the world is close to the coordinate origin."""
    meshes = setting.surfaces or {name: solid.mesh for name, solid in setting.solids.items()}
    meshes = meshes or setting.obstacles  # rounded, so that one more small object does not move the origin
    point_sets = [m.vertices for m in meshes.values() if len(m.vertices)]
    point_sets = point_sets or [
        np.array([i.position for items in setting.items.values() for i in items], np.float64).reshape(-1, 3)
    ]
    if not len(point_sets[0]):
        return np.zeros(3)
    low, high = (np.min([p.min(axis=0) for p in point_sets], axis=0), np.max([p.max(axis=0) for p in point_sets], axis=0))
    middle = (low + high) / 2
    return np.round(middle / 1000.0) * 1000.0 if np.abs(middle).max() > _MAX_ORIGIN_OFFSET_MM else np.zeros(3)
