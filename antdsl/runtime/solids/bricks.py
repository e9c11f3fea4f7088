"""Storage of a solid: a table of bricks and a pool of their nodes. Slot 0 is air, slot 1 undug solid; others are one brick's."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from hashlib import sha256
from typing import Any

import numpy as np
from numpy.typing import NDArray

Index = NDArray[np.int64]

SIDE = 16  # nodes along the edge of a brick
CUBE = SIDE**3
AIR, SOLID = 0, 1  # slots that many bricks share
STEPS = 256  # in which a voxel is filled


@dataclass(frozen=True, slots=True)
class Unusable:
    """Why a mesh cannot be a solid: one line in an artist's words, and what to do instead."""

    message: str
    help: str


@dataclass(slots=True)
class Bricks:
    """Node (i, j, k) lies at `origin + (i, j, k) * voxel` and belongs to brick (i // 16, ...); `table` gives the brick's slot.

    `values` float32[slots * 4096] holds the distances of a slot's nodes, the last axis fastest, between `least` and `most`.
    All nodes of the outermost layer are air, so that a place outside the grid has the distance of the nearest place in it.
    """

    origin: NDArray[np.float64]
    voxel: float
    shape: tuple[int, int, int]  # bricks
    least: float
    most: float
    table: NDArray[np.int32]  # flat, of shape
    values: NDArray[np.float32]  # room for more slots than are used
    used: int  # slots
    steps: int = 0
    steps_at_start: int = 0
    fresh: NDArray[np.bool_] = field(default_factory=lambda: np.zeros(0, bool))  # by brick: to be meshed again
    touched: NDArray[np.bool_] = field(default_factory=lambda: np.zeros(0, bool))  # by brick: differs from the start
    unread: NDArray[np.bool_] = field(default_factory=lambda: np.zeros(0, bool))  # by brick: changed since the last digest
    started: bytes = b""  # digest of the start
    _digests: NDArray[np.uint8] = field(default_factory=lambda: np.zeros((0, 32), np.uint8))

    @property
    def nodes(self) -> tuple[int, int, int]:
        a, b, c = self.shape
        return a * SIDE, b * SIDE, c * SIDE

    @property
    def step_volume(self) -> float:
        """Volume of one step, mm³: cut to 16 binary digits, so that any count of steps times it is exact."""
        fraction, exponent = np.frexp(self.voxel**3 / STEPS)
        return float(np.ldexp(np.round(np.ldexp(fraction, 16)), int(exponent) - 16))

    @property
    def nbytes(self) -> int:
        arrays = (self.table, self.values, self.fresh, self.touched, self.unread, self._digests)
        return sum(a.nbytes for a in arrays)

    def begin(self) -> None:
        """Count what is solid and take this as the start."""
        count = self.table.size
        stored = self.table >= 2
        filled = filling(self.values[: self.used * CUBE], self.voxel).reshape(-1, CUBE).sum(axis=1, dtype=np.int64)
        self.steps = self.steps_at_start = int(filled.take(self.table).sum())
        self.fresh, self.touched, self.unread = stored.copy(), np.zeros(count, bool), stored.copy()
        self._digests = np.zeros((self.used, 32), np.uint8)
        self.started = self.digest()

    def own(self, bricks: Index) -> Index:
        """Slots of some bricks (each named once, ascending), which from now on have nodes of their own."""
        shared = bricks[self.table[bricks] < 2]
        if shared.size:
            self._grow(self.used + shared.size)
            slots = np.arange(self.used, self.used + shared.size)
            pool = self.values.reshape(-1, CUBE)
            pool[slots] = np.where(self.table[shared] == AIR, np.float32(self.most), np.float32(self.least))[:, None]
            self.table[shared] = slots
            self.used += shared.size
        return self.table[bricks].astype(np.int64)

    def _grow(self, slots: int) -> None:
        room = self.values.size // CUBE
        if slots > room:
            more = np.empty(max(slots, room + room // 4) * CUBE, np.float32)
            more[: self.used * CUBE] = self.values[: self.used * CUBE]
            self.values = more

    # ---- keeping

    def digest(self) -> bytes:
        """Of all that is solid, whatever slots the bricks have."""
        if len(self._digests) < self.used:
            grown = np.zeros((self.used, 32), np.uint8)
            grown[: len(self._digests)] = self._digests
            self._digests = grown
        pool = self.values.reshape(-1, CUBE)
        for slot in self.table[np.flatnonzero(self.unread)]:
            if slot >= 2:
                self._digests[slot] = np.frombuffer(sha256(pool[slot].tobytes()).digest(), np.uint8)
        self.unread[:] = False
        stored = np.flatnonzero(self.table >= 2)
        whole = sha256(np.array([*self.origin, self.voxel, self.least, self.most, *self.shape], np.float64).tobytes())
        whole.update(np.int64(self.steps).tobytes() + stored.astype(np.int64).tobytes())
        whole.update(np.minimum(self.table, 2).astype(np.uint8).tobytes())
        whole.update(self._digests[self.table[stored]].tobytes())
        return whole.digest()

    def state(self) -> dict[str, NDArray[Any]]:
        bricks = np.flatnonzero(self.touched)
        return {
            "bricks": bricks.astype(np.int64),
            "values": self.values.reshape(-1, CUBE)[self.table[bricks]],
            "steps": np.array(self.steps, np.int64),
            "start": np.frombuffer(self.started, np.uint8).copy(),
        }

    def restore(self, arrays: Mapping[str, NDArray[Any]]) -> None:
        """As `Volume.restore`: this must not have been dug itself where the state has not."""
        bricks, values, start = (np.asarray(arrays[name]) for name in ("bricks", "values", "start"))
        if start.tobytes() != self.started:
            raise ValueError("the solid is not made from the same mesh")
        if values.shape != (len(bricks), CUBE) or values.dtype != np.float32 or not np.isfinite(values).all():
            raise ValueError("the bricks of the solid are damaged")
        if len(bricks) and not (bricks.min() >= 0 and bricks.max() < self.table.size and (np.diff(bricks) > 0).all()):
            raise ValueError("the bricks of the solid are damaged")
        if np.flatnonzero(self.touched & ~np.isin(np.arange(self.table.size), bricks)).size:
            raise ValueError("the solid has been dug already")
        self.values.reshape(-1, CUBE)[self.own(bricks.astype(np.int64))] = values
        self.touched[bricks] = self.unread[bricks] = True
        self.steps = int(arrays["steps"])
        self.mark_fresh(bricks)

    def mark_fresh(self, bricks: Index) -> None:
        """Some bricks changed: they and those before them, whose last cells reach into them, are meshed again."""
        grid = self.fresh.reshape(self.shape)
        i, j, k = np.unravel_index(bricks, self.shape)
        for a in (0, 1):
            for b in (0, 1):
                for c in (0, 1):
                    grid[np.maximum(i - a, 0), np.maximum(j - b, 0), np.maximum(k - c, 0)] = True


def filling(distance: NDArray[np.float32], voxel: float) -> NDArray[np.int32]:
    """How full the voxels around nodes are, 0 .. 256: half at the surface, and all or nothing half a voxel from it."""
    part = np.float32(0.5) - distance * np.float32(1.0 / voxel)
    steps: NDArray[np.int32] = np.round(np.clip(part, np.float32(0), np.float32(1)) * np.float32(STEPS)).astype(np.int32)
    return steps
