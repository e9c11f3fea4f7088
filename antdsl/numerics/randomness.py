"""Random numbers that are a function of (seed, frame, species, site, id): the counter-based generator Philox4x32-10.

Nothing is drawn from a stream, so agents that come, go or are watched change no other agent's numbers.
Method: J. K. Salmon et al., Parallel random numbers: as easy as 1, 2, 3, SC 2011, p. 6 (rounds, constants) and table 2.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from hashlib import blake2b
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.numerics import compiled
from antdsl.numerics.philox import HALF, LOW, M0, M1, ROUNDS, SPREAD, UNIT, W0, W1

Kernel = Callable[..., Any]
Counters = tuple[tuple[int, int, int], tuple[int, int]]
Words = tuple[NDArray[np.uint64], NDArray[np.uint64], NDArray[np.uint64], NDArray[np.uint64]]


def philox(counter: Words, key: tuple[Any, Any]) -> Words:
    """Four random 32-bit words (in uint64 arrays) of four 32-bit counter words and a key of two (np.uint64)."""
    c0, c1, c2, c3 = counter
    k0, k1 = key
    for _ in range(ROUNDS):
        p0, p1 = c0 * M0, c2 * M1
        c0, c2 = p1 >> HALF, p0 >> HALF
        c0 ^= c1
        c0 ^= k0
        c2 ^= c3
        c2 ^= k1
        p1 &= LOW
        p0 &= LOW
        c1, c3 = p1, p0
        k0, k1 = (k0 + W0) & LOW, (k1 + W1) & LOW
    return c0, c1, c2, c3


@lru_cache(maxsize=4096)
def site_words(species: str, site: str) -> tuple[int, int]:
    """Two 32-bit words that name a place in the text of a species."""
    digest = blake2b(f"{species}\0{site}".encode(), digest_size=8).digest()
    return int.from_bytes(digest[:4], "little"), int.from_bytes(digest[4:], "little")


def words(seed: int, frame: int, species: str, site: str, block: int, ids: NDArray[np.int64]) -> Words:
    """Four random words for each id. `frame` may be negative (preroll)."""
    (c0, low, c3), key = counters(seed, frame, species, site, block)
    wide = ids.astype(np.uint64)
    first, last = (np.full(wide.shape, c, np.uint64) for c in (c0, c3))
    return of_ids(wide, first, np.uint64(low), last, (np.uint64(key[0]), np.uint64(key[1])))


def of_ids(wide: Any, first: Any, low: Any, last: Any, key: tuple[Any, Any]) -> Words:
    """Four words for each id (uint64) of the counters' first, third and last word, and the key."""
    return philox((first, wide & LOW, (((wide >> HALF) * SPREAD) & LOW) ^ low, last), key)


def counters(seed: int, frame: int, species: str, site: str, block: int) -> Counters:
    """The counter words that all ids share (the third but for the high half of an id), and the key."""
    low, high = site_words(species, site)
    return (frame_word(frame), low, (high + block) & 0xFFFFFFFF), (seed & 0xFFFFFFFF, (seed >> 32) & 0xFFFFFFFF)


def frame_word(frame: int) -> int:
    """The first counter word of all draws of a frame."""
    return frame & 0xFFFFFFFF


def unit_floats(word: NDArray[np.uint64]) -> NDArray[np.float32]:
    """float32 in [0, 1): the top 24 bits of a 32-bit word."""
    return (word >> np.uint64(8)).astype(np.float32) * UNIT


def uniform(seed: int, frame: int, species: str, site: str, index: int, ids: NDArray[np.int64]) -> NDArray[np.float32]:
    """The draw number `index` of a site for each id: float32 in [0, 1). Four draws of a site share one run of the generator."""
    if compiled.wanted(ids.size) and ids.ndim == 1:
        from antdsl.numerics.randomness_compiled import uniforms

        return _drawn(uniforms, np.empty(ids.size, np.float32), counters(seed, frame, species, site, index >> 2), index, ids)
    return unit_floats(words(seed, frame, species, site, index >> 2, ids)[index & 3])


def word(seed: int, frame: int, species: str, site: str, index: int, ids: NDArray[np.int64]) -> NDArray[np.uint64]:
    """The word of `words` that `uniform` makes that draw from."""
    if compiled.wanted(ids.size) and ids.ndim == 1:
        from antdsl.numerics.randomness_compiled import words as loop

        return _drawn(loop, np.empty(ids.size, np.uint64), counters(seed, frame, species, site, index >> 2), index, ids)
    return words(seed, frame, species, site, index >> 2, ids)[index & 3]


def _drawn(loop: Kernel, found: NDArray[Any], shared: Counters, index: int, ids: NDArray[np.int64]) -> NDArray[Any]:
    """Draws by a compiled loop."""
    loop(*compiled.plain(ids.astype(np.int64, copy=False)), (*shared[0], *shared[1]), index & 3, found)
    return found
