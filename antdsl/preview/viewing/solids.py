"""Solids in pieces of a few bricks each; a piece is sent again when something was dug in it."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from antdsl.ground.solid import Volume
from antdsl.outputs.cache.solid_pieces import Piece, joined
from antdsl.preview.binary_packets import pack
from antdsl.preview.viewing.seen import Packets, Seen

_SIDE = 2  # bricks side by side in a piece
_EVERY = 0.1  # seconds between two showings while it plays


class Solids:
    """The slots `solid:NAME:N`; a packet without faces takes a piece away."""

    def __init__(self) -> None:
        self._volumes: dict[str, Volume] = {}
        self._bricks: dict[str, dict[int, dict[int, Piece]]] = {}  # by solid, piece and brick
        self._shown: set[tuple[str, int]] = set()  # pieces that pages have faces of
        self._last = -1.0

    def packets(self, seen: Seen) -> Packets:
        if not seen.wanted.solids or (seen.going and seen.now - self._last < _EVERY):
            return
        self._last = seen.now
        for name in self._volumes.keys() - seen.world.solids.keys():
            for piece in sorted(self._bricks.pop(name)):
                yield from self._given(name, piece, [], self._volumes[name])
            del self._volumes[name]
        for name, volume in seen.world.solids.items():
            yield from self._solid(name, volume)

    def _solid(self, name: str, volume: Volume) -> Packets:
        kept = self._bricks.setdefault(name, {})
        before = set(kept)
        anew = self._volumes.get(name) is not volume  # after a seek or an edit: another one, as it was then
        if anew:
            self._volumes[name] = volume
            kept.clear()
        touched = set()
        for brick, vertices, faces in volume.surface(changed_only=not anew):
            piece = _piece(brick, volume.bricks.shape)
            kept.setdefault(piece, {})[brick] = vertices, faces
            touched.add(piece)
        for piece in sorted(touched):
            yield from self._given(name, piece, kept[piece].values(), volume)
        if anew:
            for piece in sorted(before - set(kept)):
                yield from self._given(name, piece, [], volume)

    def _given(self, name: str, piece: int, bricks: Iterable[Piece], volume: Volume) -> Packets:
        """The packet of a piece; nothing for one that has no faces and never had."""
        vertices, faces = joined(list(bricks))
        if not len(faces) and (name, piece) not in self._shown:
            return
        (self._shown.add if len(faces) else self._shown.discard)((name, piece))
        slope = np.asarray(volume.gradient(vertices), np.float64) if len(vertices) else np.empty((0, 3))
        normal = slope / np.maximum(np.linalg.norm(slope, axis=1, keepdims=True), 1e-12)
        slot = f"solid:{name}:{piece}"
        arrays = {
            "position": vertices.astype(np.float32),
            "normal": normal.astype(np.float32),
            "face": faces.astype(np.uint32),
        }
        yield slot, pack(slot, arrays, solid=name)


def _piece(brick: int, shape: tuple[int, int, int]) -> int:
    """The number of the piece that a brick is in."""
    at = np.unravel_index(brick, shape)
    a, b, c = (-(-side // _SIDE) for side in shape)
    return int(np.ravel_multi_index([int(k) // _SIDE for k in at], (a, b, c)))
