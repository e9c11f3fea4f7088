"""A clip: sampled animation of some joints, in their parents' space, and of some channels."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True, eq=False)
class Clip:
    """F samples, `rate` of them a second, of the full local transforms of K joints and of C channels.

    `translation` float32[F, K, 3] in the definition's units, `rotation` float32[F, K, 4] (unit, x y z w), `scale` float32[F, K,
    3], `shear` float32[F, K, 3] or None; `transforms.py` says in which order they apply. `values` float32[F, C]. A clip that
    loops has its first pose again as its last sample. `stride`: how far it goes in one turn, in the definition's units, 0 for a
    clip that stays where it is. `marks`: seconds by name. `feet`: whether feet stand on the ground while it plays, else legs go
    as the clip has them."""

    name: str
    rate: float
    joints: tuple[str, ...]
    translation: NDArray[np.float32]
    rotation: NDArray[np.float32]
    scale: NDArray[np.float32]
    shear: NDArray[np.float32] | None = None
    channels: tuple[str, ...] = ()
    values: NDArray[np.float32] = field(default_factory=lambda: np.zeros((0, 0), np.float32))
    loop: bool = True
    stride: float = 0.0
    marks: Mapping[str, float] = field(default_factory=dict)
    feet: bool = True

    @property
    def samples(self) -> int:
        """How many samples it has."""
        return max(len(self.translation), len(self.values))

    @property
    def duration(self) -> float:
        """Seconds from its first sample to its last."""
        return (self.samples - 1) / self.rate
