"""How bodies of one definition differ: parts that are larger or smaller, materials of other colours."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

Colour = tuple[float, float, float]


@dataclass(frozen=True, slots=True, eq=False)
class Variation:
    """`scales`: by transform group how much smaller and larger it may be. `materials`: by material colours (linear, 0 to 1), on
    the way through which that of each agent lies."""

    scales: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    materials: Mapping[str, tuple[Colour, ...]] = field(default_factory=dict)

    def __bool__(self) -> bool:
        return bool(self.scales or self.materials)


NONE = Variation()
