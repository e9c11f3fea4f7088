"""A binary message that holds arrays: `ant1`, the length of the header, the header as JSON, then the arrays.

Each array begins at a multiple of 8 bytes."""

from __future__ import annotations

import json
import struct
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

PACKET_MAGIC = b"ant1"
_ALLOWED_DTYPES = frozenset(("f4", "i4", "u4", "u1", "i1", "u2", "i2"))


def pack_arrays(slot: str, arrays: Mapping[str, NDArray[Any]], **header: Any) -> bytes:
    """Return a packet for the slot `slot`. Its header lists the name, type, count and offset of each array, and the values of
    `header`. Raises TypeError for an array with elements that are not 1, 2 or 4 bytes long."""
    listed: list[tuple[str, str, int, int]] = []
    little = {name: np.ascontiguousarray(array) for name, array in arrays.items()}
    types = {name: f"{array.dtype.kind}{array.dtype.itemsize}" for name, array in little.items()}
    for name, kind in types.items():
        if kind not in _ALLOWED_DTYPES:
            raise TypeError(f"`{name}` is {little[name].dtype}, which packets do not support")

    def make_header(start: int) -> tuple[bytes, int]:
        """Return the encoded header for arrays that begin at the offset `start`, and the offset at which the arrays end."""
        listed.clear()
        at = start
        for name, array in little.items():
            listed.append((name, types[name], array.size, at))
            at += -(-array.nbytes // 8) * 8
        return json.dumps({**header, "slot": slot, "arrays": listed}, separators=(",", ":"), allow_nan=False).encode(), at

    start = 64
    while True:  # repeated, because the header contains offsets with digits that make it longer
        said, end = make_header(start)
        if 8 + len(said) <= start:
            break
        start = -(-(8 + len(said)) // 8) * 8
    parts: list[Any] = [PACKET_MAGIC, struct.pack("<I", len(said)), said]
    at = 8 + len(said)
    for (_, _, _, offset), array in zip(listed, little.values(), strict=True):
        parts += [bytes(offset - at), array.astype(array.dtype.newbyteorder("<"), copy=False).reshape(-1).view(np.uint8)]
        at = offset + array.nbytes
    return b"".join([*parts, bytes(end - at)])  # one copy, because a frame has half a megabyte


def unpack_arrays(packet: bytes) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """Return the header and the arrays of a packet, each array flattened. Raises ValueError if the bytes are not a packet."""
    if packet[:4] != PACKET_MAGIC or len(packet) < 8:
        raise ValueError("not a packet")
    (length,) = struct.unpack("<I", packet[4:8])
    header = json.loads(packet[8 : 8 + length])
    arrays = {name: np.frombuffer(packet, f"<{kind}", count, offset) for name, kind, count, offset in header["arrays"]}
    return header, arrays
