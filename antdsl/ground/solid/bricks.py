"""Stores a solid as a table of bricks, and a pool of slots that hold the nodes of bricks.

Slot 0 stands for bricks of air, slot 1 for bricks of undug solid. Every other slot belongs to one brick."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from hashlib import sha256
from typing import Any

import numpy as np
from numpy.typing import NDArray

Index = NDArray[np.int64]
Distances = NDArray[np.float32]

NODES_PER_BRICK_SIDE = 16  # nodes along the edge of a brick
NODES_PER_BRICK = NODES_PER_BRICK_SIDE**3
AIR_BRICK_SLOT, SOLID_BRICK_SLOT = 0, 1  # slots shared by many bricks
FILL_STEPS_PER_VOXEL = 256  # steps between an empty and a full voxel
UINT64_MASK = (1 << 64) - 1


@dataclass(frozen=True, slots=True)
class UnusableMeshReason:
    """The reason why a mesh cannot be a solid, as a one-line message for artists, with a remedy."""

    message: str
    help: str


@dataclass(slots=True)
class BrickGrid:
    """The signed distances at the nodes of a solid. Node (i, j, k) is at `origin + (i, j, k) * voxel`. It belongs to brick (i //
    16, j // 16, k // 16).

    - `table`: the slot of each brick
    - `values` float32[slots * 4096]: the distances of the nodes of each slot, limited to the range from `min_distance` to
      `max_distance`; the last axis varies fastest
    - `volume_steps`, `start_volume_steps`: the solid volume now and before digging, in steps of `step_volume`

    The outermost nodes are all in air. So the distance of a point outside the grid can be that of the nearest point in the
    grid."""

    origin: NDArray[np.float64]
    voxel: float
    shape: tuple[int, int, int]  # number of bricks along each axis
    min_distance: float
    max_distance: float
    table: NDArray[np.int32]  # one slot per brick, flat
    values: NDArray[np.float32]  # may have capacity for more slots than are used
    used_slots: int  # number of slots in use
    volume_steps: int = 0
    start_volume_steps: int = 0
    needs_meshing: NDArray[np.bool_] = field(default_factory=lambda: np.zeros(0, bool))  # whether each brick must be meshed again
    original_values: dict[int, Distances | None] = field(
        default_factory=dict
    )  # values of dug bricks before digging; None for undug solid
    node_hash_sum: int = 0  # sum of `hash_nodes` over all nodes, minus that of the start
    start_digest: bytes = b""  # digest of the start

    @property
    def node_counts(self) -> tuple[int, int, int]:
        """Return the number of nodes along each axis."""
        a, b, c = self.shape
        return a * NODES_PER_BRICK_SIDE, b * NODES_PER_BRICK_SIDE, c * NODES_PER_BRICK_SIDE

    @property
    def step_volume(self) -> float:
        """Return the volume of one volume step, mm³. It is rounded to 16 binary digits, so that its multiples are exact."""
        fraction, exponent = np.frexp(self.voxel**3 / FILL_STEPS_PER_VOXEL)
        return float(np.ldexp(np.round(np.ldexp(fraction, 16)), int(exponent) - 16))

    @property
    def nbytes(self) -> int:
        """Return the memory of the arrays in bytes."""
        touched_bytes = sum(values.nbytes for values in self.original_values.values() if values is not None)
        return self.table.nbytes + self.values.nbytes + self.needs_meshing.nbytes + touched_bytes

    def to_dense(self) -> NDArray[np.float32]:
        """Return the distances of all nodes, float32[x, y, z]."""
        pool = self.values[: self.used_slots * NODES_PER_BRICK].reshape(
            -1, NODES_PER_BRICK_SIDE, NODES_PER_BRICK_SIDE, NODES_PER_BRICK_SIDE
        )
        blocks = pool[self.table.reshape(self.shape)]
        return np.ascontiguousarray(blocks.transpose(0, 3, 1, 4, 2, 5).reshape(self.node_counts))

    def record_start_values(self) -> None:
        """Measure the solid volume and store it as the volume before any digging."""
        used = self.values[: self.used_slots * NODES_PER_BRICK]
        filled = compute_fill_steps(used, self.voxel).reshape(-1, NODES_PER_BRICK).sum(axis=1, dtype=np.int64)
        self.volume_steps = self.start_volume_steps = int(filled.take(self.table).sum())
        self.needs_meshing = np.zeros(self.table.size, bool)
        self.mark_for_meshing(np.flatnonzero(self.table >= 2))
        hasher = sha256(
            np.array([*self.origin, self.voxel, self.min_distance, self.max_distance, *self.shape], np.float64).tobytes()
        )
        hasher.update(self.table.tobytes() + used.tobytes())
        self.start_digest = hasher.digest()

    def allocate_bricks(self, bricks: Index) -> None:
        """Give each of `bricks` its own slot of nodes, so that they can be written. `bricks` must be ascending, without
        duplicates."""
        shared = bricks[self.table[bricks] < 2]
        for brick in bricks:
            if int(brick) not in self.original_values:
                slot = int(self.table[brick])
                self.original_values[int(brick)] = (
                    None if slot < 2 else self.values[slot * NODES_PER_BRICK : (slot + 1) * NODES_PER_BRICK].copy()
                )
        if shared.size:
            self._reserve_slots(self.used_slots + shared.size)
            slots = np.arange(self.used_slots, self.used_slots + shared.size)
            pool = self.values.reshape(-1, NODES_PER_BRICK)
            pool[slots] = pool[self.table[shared]]
            self.table[shared] = slots
            self.used_slots += shared.size
        self.mark_for_meshing(bricks)

    def _reserve_slots(self, slots: int) -> None:
        """Extend `values` so that it has space for `slots` slots."""
        capacity = self.values.size // NODES_PER_BRICK
        if slots > capacity:
            new_values = np.empty(max(slots, capacity + capacity // 4) * NODES_PER_BRICK, np.float32)
            new_values[: self.used_slots * NODES_PER_BRICK] = self.values[: self.used_slots * NODES_PER_BRICK]
            self.values = new_values

    # ---- keeping

    def compute_digest(self) -> bytes:
        """Return a digest of all distances. It does not depend on the order of slots, and is fast to compute."""
        counts = np.array([self.node_hash_sum, self.volume_steps], np.uint64)
        return sha256(self.start_digest + counts.tobytes()).digest()

    def get_changes(self) -> dict[str, NDArray[Any]]:
        """Return the changes since the start, in the form of `Volume.get_changes`."""
        bricks = np.array(sorted(self.original_values), np.int64)
        return {
            "bricks": bricks,
            "values": self.values.reshape(-1, NODES_PER_BRICK)[self.table[bricks]],
            "steps": np.array(self.volume_steps, np.int64),
            "start": np.frombuffer(self.start_digest, np.uint8).copy(),
        }

    def restore_changes(self, arrays: Mapping[str, NDArray[Any]]) -> None:
        """Restore a stored state. Same as `Volume.restore_changes`."""
        bricks, values, start = (np.asarray(arrays[name]) for name in ("bricks", "values", "start"))
        if start.tobytes() != self.start_digest:
            raise ValueError("the stored solid was made from another mesh")
        if values.shape != (len(bricks), NODES_PER_BRICK) or values.dtype != np.float32 or not np.isfinite(values).all():
            raise ValueError("the bricks of the solid are damaged")
        if len(bricks) and not (bricks.min() >= 0 and bricks.max() < self.table.size and (np.diff(bricks) > 0).all()):
            raise ValueError("the bricks of the solid are damaged")
        pool = self.values.reshape(-1, NODES_PER_BRICK)
        for brick, was in self.original_values.items():
            pool[self.table[brick]] = pool[SOLID_BRICK_SLOT] if was is None else was
        self.mark_for_meshing(np.array(sorted(self.original_values), np.int64))
        self.allocate_bricks(bricks.astype(np.int64))
        pool = self.values.reshape(-1, NODES_PER_BRICK)
        slots = self.table[bricks]
        nodes = (bricks.astype(np.int64) << 12)[:, None] + np.arange(NODES_PER_BRICK)
        self.node_hash_sum = int((hash_nodes(nodes, values) - hash_nodes(nodes, pool[slots])).sum(dtype=np.uint64)) & UINT64_MASK
        pool[slots] = values
        self.original_values = {brick: was for brick, was in self.original_values.items() if brick in set(bricks.tolist())}
        self.volume_steps = int(arrays["steps"])

    def mark_for_meshing(self, bricks: Index) -> None:
        """Mark changed bricks for meshing. The previous bricks along each axis and diagonal are also marked, because their last
        cells extend into the changed bricks."""
        grid = self.needs_meshing.reshape(self.shape)
        i, j, k = np.unravel_index(bricks, self.shape)
        for a in (0, 1):
            for b in (0, 1):
                for c in (0, 1):
                    grid[np.maximum(i - a, 0), np.maximum(j - b, 0), np.maximum(k - c, 0)] = True


def hash_nodes(node: Index, distance: Distances) -> NDArray[np.uint64]:
    """Return a pseudorandom number for each pair of a node and its distance (Steele, Lea, Flood, Fast Splittable Pseudorandom
    Number Generators, 2014, p. 459).

    The sum of all these numbers identifies the state of a solid. When nodes change, only their old and new numbers are needed to
    update the sum."""
    bits = np.ascontiguousarray(distance, np.float32).view(np.uint32).astype(np.uint64)
    x = (node.astype(np.uint64) << np.uint64(32)) ^ bits
    x *= np.uint64(0x9E3779B97F4A7C15)
    x = (x ^ (x >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    x = (x ^ (x >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    x ^= x >> np.uint64(31)
    return x


def compute_fill_steps(distance: NDArray[np.float32], voxel: float) -> NDArray[np.int32]:
    """Return the solid fraction of the voxel around each node, in units of 1/256: from 0 to 256.

    It is 128 for a node on the surface, and 0 or 256 for a node at least half a voxel away from it."""
    part = np.float32(0.5) - distance * np.float32(1.0 / voxel)
    steps: NDArray[np.int32] = np.round(np.clip(part, np.float32(0), np.float32(1)) * np.float32(FILL_STEPS_PER_VOXEL)).astype(
        np.int32
    )
    return steps
