"""The crowd lines of a setting: how many agents, when, where, with which attributes, in mm, seconds and the scene's axes."""

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
    """An item that is the centre of a placement: the item with this index in `items`. The centre moves with the item."""

    items: str
    index: int


@dataclass(frozen=True, slots=True, eq=False)
class VolumeData:
    """A box or a ball. Agents start at the surface points nearest to its inside.

    `low`, `high`: the corners of a box (mm). A ball has a `radius` (mm) above 0 and the centre `low`."""

    low: PointMm = (0.0, 0.0, 0.0)
    high: PointMm = (0.0, 0.0, 0.0)
    radius: float = 0.0  # mm; above 0 for a ball with the centre `low`


@dataclass(frozen=True, slots=True)
class RanksData:
    """Ranks of agents; the first rank is ahead. `spacing_within`, `spacing_between`: the distance (mm) between neighbours within
    a rank, and between ranks."""

    columns: int
    rows: int
    spacing_within: float
    spacing_between: float


@dataclass(frozen=True, slots=True)
class ClumpsData:
    """`number` discs with a radius (mm), each around a random position of the place."""

    number: int
    radius: float


@dataclass(frozen=True, slots=True)
class FacingData:
    """The direction in which agents begin, along the ground.

    `kind`: `out` and `in` lead away from the centre or line of the placement, or towards it; from an edge, `in` leads into the
    surface. `along` is the direction of a line.
    `vector`: the target (mm) for the kind `point`, or a direction in the scene's axes for the kind `direction`."""

    kind: Literal["out", "in", "along", "point", "direction"]
    vector: PointMm = (0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True, eq=False)
class PlacementData:
    """The starting positions of a crowd. The first of these that is set applies:

    `points` (n, 3): one per agent, in order, repeated after the last.
    `ranks`: ranks around `disc_centre`.
    `line`: along a curve of the world; `border_surface`: along the open borders of a surface. Both within `radius` of it.
    `volume`: the nearest surface points to a volume.
    `radius`: a disc of `radius` mm around `disc_centre`, dropped along the scene's up onto the surfaces.
    `ray_origin`: the first hits of lines from this point in all directions, on the side of the point. Otherwise: evenly over the
    surfaces, or with the density of the map `density`.

    `centre_item`: the item that is the centre.
    `clumps`: agents stand in discs around positions of the place.
    `facing`: the direction of the heading; None for a random one.
    `surfaces`: the surfaces; empty for all.
    `is_by_area`: agents stand on the front of faces of any direction. `radius` is then that of a ball, and `points` move to the
    nearest surface point.
    `spacing`: the least distance (mm) between centres; inf: as large as the space allows for all lines with equal settings.
    `seed`: for the positions; None for the setting's seed.
    `headings` (n, 3): the unit vector of the heading at each point; nan for a random heading.
    `values` (n,): by name, attributes of the agent at each point, in base units; nan for the species' value."""

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
    """A walk of agents.

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
    """The value of an attribute at birth, in base units, or the index of a state.

    `uniform`: between `low` and `high`. `normal`: around `low` with the deviation `high`, cut off at three deviations. `choice`:
    one of `values`, with these weights. `painted`: from `low` to `high`, where the map `map_name` is 0 to 1. `number`: `low`."""

    kind: Literal["number", "uniform", "normal", "choice", "painted"]
    low: float = 0.0
    high: float = 0.0
    values: tuple[float, ...] = ()
    weights: tuple[float, ...] = ()
    map_name: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class CrowdData:
    """`count` agents of one species.

    `line_index`: the index of this line of the scene, from 0.
    `walk`: agents with a walk do not sense or decide.
    `body`: the name of the body; empty for the body that fits the species' name.
    `worn_layers`: for each displayed part of the body, the layers from which one is drawn; "" means none.
    `name`: the name of the line; empty without one.
    `release`: when agents are created; None for all in the first frame.
    `initial_values`: by name, attributes at birth, and the initial states of machines as `MACHINE.state`."""

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
        """Return how many agents of the line were created up to a frame. The result does not depend on where the run starts."""
        if self.release is None:
            return self.count
        frames = frame + 1 - self.release.begin
        if frames <= 0:
            return 0
        return self.count if not self.release.interval else min(self.count, ceil(frames / self.release.interval))
