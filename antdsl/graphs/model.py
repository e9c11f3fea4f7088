"""The classes that describe a picture of a state machine: boxes and arrows of a chart, and their positions in a layout.

Charts do not depend on a picture format, and layouts do not depend on a library. Code that draws a picture, to a file or live,
reads only these classes."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

RGB = tuple[float, float, float]  # display values, 0..1
Point = tuple[float, float]  # x to the right, y down, in px
BoxKind = Literal["state", "start", "any", "previous", "choice"]


@dataclass(frozen=True, slots=True)
class Box:
    """One box of a chart.

    - `kind`: `start` is the dot that points at the first state. `any` is the source of transitions `from any`. `previous` is the
      return to the previous state. `choice` is the fork of a `choose`. Any other kind is a state.
    - `key`: unique in its chart.
    - `name`: the name of the state.
    - `details`: the tooltip."""

    key: str
    kind: BoxKind
    name: str
    label: str
    colour: RGB
    details: str


@dataclass(frozen=True, slots=True)
class Arrow:
    """The transitions from one box to another. Either all of them are interrupts (`interrupt`), or none of them is.

    `source`, `target`: the keys of the boxes. `lines`: one condition per transition, in order of evaluation. `details`: the
    tooltip."""

    source: str
    target: str
    lines: tuple[str, ...]
    interrupt: bool
    details: str


@dataclass(frozen=True, slots=True)
class Chart:
    """The chart of one machine of a species. `title`: such as `forager`, or `forager.mood` if the species has several
    machines."""

    title: str
    boxes: tuple[Box, ...]
    arrows: tuple[Arrow, ...]


@dataclass(frozen=True, slots=True)
class PlacedBox:
    """The position of a box or of words: centre and size in px."""

    centre: Point
    width: float
    height: float

    @property
    def left(self) -> float:
        """Return the x coordinate of the left edge, px."""
        return self.centre[0] - self.width / 2

    @property
    def top(self) -> float:
        """Return the y coordinate of the top edge, px."""
        return self.centre[1] - self.height / 2


@dataclass(frozen=True, slots=True)
class PlacedArrow:
    """An arrow with its path: a chain of straight segments that ends at the tip.

    `words`: the position of its words; None without words. `lines`: its words, wrapped into lines."""

    arrow: Arrow
    points: tuple[Point, ...]
    words: PlacedBox | None
    lines: tuple[str, ...]


@dataclass(frozen=True, slots=True)
class PlacedChart:
    """A chart with positions for all its parts, which are between (0, 0) and (width, height)."""

    chart: Chart
    width: float
    height: float
    boxes: tuple[tuple[Box, PlacedBox], ...]
    arrows: tuple[PlacedArrow, ...]

    def shift(self, horizontal_shift: float, vertical_shift: float) -> PlacedChart:
        """Return the chart, moved by `horizontal_shift` px to the right and by `vertical_shift` px down."""

        def shift_box(place: PlacedBox) -> PlacedBox:
            return replace(place, centre=(place.centre[0] + horizontal_shift, place.centre[1] + vertical_shift))

        arrows = tuple(
            replace(
                a,
                points=tuple((x + horizontal_shift, y + vertical_shift) for x, y in a.points),
                words=shift_box(a.words) if a.words else None,
            )
            for a in self.arrows
        )
        return replace(self, boxes=tuple((box, shift_box(place)) for box, place in self.boxes), arrows=arrows)
