"""The rig of an agent: a tree of named joints with a rest pose, and channels."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True, slots=True)
class Channel:
    """A number that clips animate beside joints. `transform`: the joint that it belongs to, "" for none."""

    name: str
    default: float = 0.0
    transform: str = ""


@dataclass(frozen=True, slots=True, eq=False)
class Rig:
    """`names` of J joints, parents before children; `parents` int32[J], -1 for a root; `rest` float64[J, 4, 4], local."""

    names: tuple[str, ...]
    parents: NDArray[np.int32]
    rest: NDArray[np.float64]
    channels: tuple[Channel, ...] = ()

    def joint(self, name: str) -> int:
        """The number of a joint. Raises KeyError."""
        try:
            return self.names.index(name)
        except ValueError:
            raise KeyError(name) from None

    def channel(self, name: str) -> int:
        """The number of a channel. Raises KeyError."""
        for number, each in enumerate(self.channels):
            if each.name == name:
                return number
        raise KeyError(name)

    def below(self, joint: int) -> NDArray[np.intp]:
        """The numbers of a joint and of all that hang on it, parents before children."""
        inside = np.zeros(len(self.names), bool)
        inside[joint] = True
        for number in range(joint + 1, len(self.names)):
            inside[number] = self.parents[number] >= 0 and inside[self.parents[number]]
        return np.flatnonzero(inside)

    @property
    def defaults(self) -> NDArray[np.float32]:
        """The default of each channel, float32[C]."""
        return np.array([each.default for each in self.channels], np.float32)
