"""The crowd lines of a setting: how many agents start, when, where and with which attributes, in mm, seconds and the scene's
axes."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from math import ceil
from typing import TYPE_CHECKING, Literal

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray

PointMm = tuple[float, float, float]


MAX_STANDARD_DEVIATIONS = 3  # draws of a normal distribution are at most so many deviations from its mean


@dataclass(frozen=True, slots=True)
class ItemCentre:
    """An item that is the centre of a placement. The centre moves with the item. `items`: the name of its group. `index`: its
    index in the group."""

    items: str
    index: int


@dataclass(frozen=True, slots=True, eq=False)
class VolumeData:
    """A box or a ball. Points are drawn inside it, and agents start at the surface points nearest to these.

    `low`, `high`: the corners of a box (mm). A ball has a `radius` above 0 (mm) and its centre at `low`."""

    low: PointMm = (0.0, 0.0, 0.0)
    high: PointMm = (0.0, 0.0, 0.0)
    radius: float = 0.0  # mm; above 0 for a ball with the centre `low`


@dataclass(frozen=True, slots=True)
class RanksData:
    """Ranks of agents; the first rank is ahead of the others. `spacing_within`: the distance between neighbours within a rank
    (mm). `spacing_between`: the distance between ranks (mm)."""

    columns: int
    rows: int
    spacing_within: float
    spacing_between: float


@dataclass(frozen=True, slots=True)
class ClumpsData:
    """`number` discs, each around a random position of the placement. `radius`: the radius of each disc (mm)."""

    number: int
    radius: float


@dataclass(frozen=True, slots=True)
class FacingData:
    """The direction that agents face at the start, along the ground.

    `kind`: `out` leads away from the centre or line of the placement, and `in` leads towards it. From an edge, `in` leads into
    the surface. `along` is the direction of a line.
    `vector`: for the kind `point`, the point to face (mm); for the kind `direction`, a direction in the scene's axes."""

    kind: Literal["out", "in", "along", "point", "direction"]
    vector: PointMm = (0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True, eq=False)
class PlacementData:
    """The starting positions of a crowd. The first of the following fields that is set decides.

    `points` (n, 3): one point per agent, in order. If there are more agents than points, the points are used again from the
    start.
    `ranks`: ranks around `disc_centre`.
    `line`: along a curve of the world. `border_surface`: along the open borders of a surface. Both within `radius` of the line.
    `volume`: the surface points nearest to a volume.
    `radius`: a disc of `radius` mm around `disc_centre`, dropped along the scene's up onto the surfaces.
    `ray_origin`: the first hits of rays from this point in all directions, on the side of the surface that faces the point. If
    none is set: evenly over the surfaces, or with the density of the map `density`.

    `centre_item`: the item at the centre.
    `clumps`: agents start in discs around random positions of the placement.
    `facing`: the direction of the heading; None for a random one.
    `surfaces`: the surfaces on which agents start; empty for all.
    `is_by_area`: whether agents start on the front of faces of any orientation. `radius` is then the radius of a ball, and
    `points` move to the nearest surface point.
    `spacing`: the smallest distance (mm) between the centres of agents. inf: the largest distance for which all lines with equal
    settings find space.
    `seed`: the seed for the random positions; None for the setting's seed.
    `headings` (n, 3): the unit vector of the heading at each point; nan for a random heading.
    `values` (n,): by name, the attributes of the agent at each point, in base units; nan for the species' value."""

    surfaces: tuple[str, ...] = ()
    disc_centre: PointMm | None = None
    ray_origin: PointMm | None = None
    radius: float | None = None
    points: NDArray[np.float64] | None = None
    density: str | None = None
    is_by_area: bool = False
    spacing: float = 0.0
    seed: int | None = None
    headings: NDArray[np.float64] | None = None
    values: Mapping[str, NDArray[np.float64]] = field(default_factory=dict)
    ranks: RanksData | None = None
    curve_name: str | None = None
    border_surface: str | None = None
    volume: VolumeData | None = None
    clumps: ClumpsData | None = None
    facing: FacingData | None = None
    centre_item: ItemCentre | None = None


@dataclass(frozen=True, slots=True)
class ScriptedWalkData:
    """A walk that replaces the decisions of agents.

    `direction`: a unit vector, projected onto the ground at the start.
    `speed`: in mm/s.
    `length`: in mm."""

    direction: PointMm
    speed: float
    length: float


@dataclass(frozen=True, slots=True)
class ReleaseData:
    """The frames in which the agents of a line are created: agent k in frame `begin` + k · `interval`, rounded down."""

    begin: Fraction
    interval: Fraction


@dataclass(frozen=True, slots=True)
class ValueDraw:
    """The value that an attribute gets at birth, in base units, or the index of a state.

    `uniform`: between `low` and `high`. `normal`: around the mean `low` with the deviation `high`, cut off at three deviations.
    `choice`: one of `values`, with the given weights. `painted`: from `low`, where the map `map_name` is 0, to `high`, where it
    is 1. `number`: `low`."""

    kind: Literal["number", "uniform", "normal", "choice", "painted"]
    low: float = 0.0
    high: float = 0.0
    values: tuple[float, ...] = ()
    weights: tuple[float, ...] = ()
    map_name: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class CrowdData:
    """The agents of one crowd line: `count` agents of one species.

    `line_index`: the index of the crowd line in the scene, from 0.
    `walk`: a scripted walk. Agents with a walk do not sense or decide.
    `body`: the name of the body; empty for the body that fits the species' name.
    `worn_layers`: for each part of `wear`, the layers of which each agent shows one, drawn at random; "" stands for no layer.
    `name`: the name of the line; empty if it has none.
    `release`: when agents are created; None if all are created in the first frame.
    `initial_values`: attributes at birth by name, and the initial states of machines as `MACHINE.state`."""

    species: str
    count: int
    place: PlacementData = PlacementData()
    line_index: int = 0
    walk: ScriptedWalkData | None = None
    body: str = ""
    worn_layers: tuple[tuple[str, ...], ...] = ()
    name: str = ""
    release: ReleaseData | None = None
    initial_values: Mapping[str, ValueDraw] = field(default_factory=dict)

    def count_created(self, frame: int) -> int:
        """Return how many agents of the line have been created by the end of a frame. Frames before the start of the run also
        count."""
        if self.release is None:
            return self.count
        frames = frame + 1 - self.release.begin
        if frames <= 0:
            return 0
        return self.count if not self.release.interval else min(self.count, ceil(frames / self.release.interval))
