"""Packets: what is packed comes out again, each array where a page can look at it without copying."""

from __future__ import annotations

import numpy as np
import pytest

from antdsl.preview.binary_packets import pack_arrays, unpack_arrays


def test_what_is_packed_comes_out_again() -> None:
    random = np.random.default_rng(1)
    arrays = {
        "places": random.random((5, 3)).astype(np.float32),
        "none": np.zeros((0, 3), np.float32),
        "bytes": np.arange(7, dtype=np.uint8),
        "every other": np.arange(20, dtype=np.int32)[::2],
        "big end first": random.random(3).astype(">f4"),
        "signed": np.array([-127, 127], np.int8),
        "one": np.array(3, np.uint32),
    }
    packet = pack_arrays("frame", arrays, frame=4, light=False)
    header, unpacked_arrays = unpack_arrays(packet)
    assert (header["slot"], header["frame"], header["light"]) == ("frame", 4, False)
    assert list(unpacked_arrays) == list(arrays)
    for name, array in arrays.items():
        np.testing.assert_array_equal(unpacked_arrays[name], array.reshape(-1))
    assert all(offset % 8 == 0 for _, _, _, offset in header["arrays"])
    assert isinstance(packet, bytes) and len(packet) % 8 == 0


def test_a_long_header_moves_the_arrays_back() -> None:
    arrays = {f"species {k}/state/machine {k}": np.full(k, k, np.uint8) for k in range(200)}
    header, unpacked_arrays = unpack_arrays(pack_arrays("frame", arrays))
    assert {name: array.tolist() for name, array in unpacked_arrays.items()} == {
        name: array.tolist() for name, array in arrays.items()
    }
    assert header["arrays"][0][3] > 4000


def test_other_types_are_refused() -> None:
    with pytest.raises(TypeError, match="`far` is float64"):
        pack_arrays("frame", {"far": np.zeros(3)})
    with pytest.raises(ValueError):
        unpack_arrays(b"ant2\x00\x00\x00\x00")
