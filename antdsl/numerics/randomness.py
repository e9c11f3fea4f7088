"""Random numbers that depend only on seed, frame, species, site and id, from the counter-based generator Philox4x32-10.

There is no stream of numbers. So adding, removing or inspecting an agent does not change the numbers of other agents. Method:
J. K. Salmon et al., Parallel random numbers: as easy as 1, 2, 3, SC 2011, p. 6 (rounds, constants) and table 2."""

from __future__ import annotations

from collections.abc import Callable
from functools import lru_cache
from hashlib import blake2b
from typing import Any

import numpy as np
from numpy.typing import NDArray

from antdsl.machine_code.kernels import F32, I64, U64, Array1, inlined, kernel, simd_range

PHILOX_MULTIPLIER0, PHILOX_MULTIPLIER1 = np.uint64(0xD2511F53), np.uint64(0xCD9E8D57)
PHILOX_KEY_STEP0, PHILOX_KEY_STEP1 = np.uint64(0x9E3779B9), np.uint64(0xBB67AE85)
LOW_32_BITS = np.uint64(0xFFFFFFFF)
HALF_WORD_BITS = np.uint64(32)
PHILOX_ROUNDS = 10
UNIT_FLOAT_STEP = np.float32(2.0**-24)
ID_SPREAD_MULTIPLIER = np.uint64(
    0x9E3779B1
)  # spreads the high half of an id over counters; odd, so that different high halves give different results
RandomKernel = Callable[..., Any]
SharedCounters = tuple[U64, U64, U64, U64, U64]  # first, third and last word of the counters, and the two of the key
CounterWords = tuple[tuple[int, int, int], tuple[int, int]]
WordColumns = tuple[NDArray[np.uint64], NDArray[np.uint64], NDArray[np.uint64], NDArray[np.uint64]]


def run_philox(counter: WordColumns, key: tuple[Any, Any]) -> WordColumns:
    """Return four random 32-bit words, as uint64 arrays. `counter`: four 32-bit counter words. `key`: two 32-bit words
    (np.uint64)."""
    c0, c1, c2, c3 = counter
    k0, k1 = key
    for _ in range(PHILOX_ROUNDS):
        p0, p1 = c0 * PHILOX_MULTIPLIER0, c2 * PHILOX_MULTIPLIER1
        c0, c2 = p1 >> HALF_WORD_BITS, p0 >> HALF_WORD_BITS
        c0 ^= c1
        c0 ^= k0
        c2 ^= c3
        c2 ^= k1
        p1 &= LOW_32_BITS
        p0 &= LOW_32_BITS
        c1, c3 = p1, p0
        k0, k1 = (k0 + PHILOX_KEY_STEP0) & LOW_32_BITS, (k1 + PHILOX_KEY_STEP1) & LOW_32_BITS
    return c0, c1, c2, c3


@lru_cache(maxsize=4096)
def compute_site_words(species: str, site: str) -> tuple[int, int]:
    """Return two 32-bit words that identify a site. A site is a random draw in the program of a species."""
    digest = blake2b(f"{species}\0{site}".encode(), digest_size=8).digest()
    return int.from_bytes(digest[:4], "little"), int.from_bytes(digest[4:], "little")


def draw_four_words(seed: int, frame: int, species: str, site: str, block: int, ids: NDArray[np.int64]) -> WordColumns:
    """Return four random 32-bit words for each id. `frame`: the frame, which is negative during preroll. `block`: the number of a
    group of four draws of the site."""
    (c0, low, c3), key = build_counters(seed, frame, species, site, block)
    wide = ids.astype(np.uint64)
    first, last = (np.full(wide.shape, c, np.uint64) for c in (c0, c3))
    return draw_words_of_ids(wide, first, np.uint64(low), last, (np.uint64(key[0]), np.uint64(key[1])))


def draw_words_of_ids(wide_ids: Any, first: Any, low: Any, last: Any, key: tuple[Any, Any]) -> WordColumns:
    """Return four random 32-bit words for each id.

    `wide_ids`: the ids as uint64. `first`, `low`, `last`: the first, third and last counter word, before the id is combined
    with them. `key`: both words of the key."""
    return run_philox(
        (first, wide_ids & LOW_32_BITS, (((wide_ids >> HALF_WORD_BITS) * ID_SPREAD_MULTIPLIER) & LOW_32_BITS) ^ low, last), key
    )


def build_counters(seed: int, frame: int, species: str, site: str, block: int) -> CounterWords:
    """Return the first, third and last counter word, which all ids share, and both words of the key. The second counter word
    is the low half of the id. The caller must still combine the third word with the high half of the id."""
    low, high = compute_site_words(species, site)
    return (compute_frame_word(frame), low, (high + block) & 0xFFFFFFFF), (seed & 0xFFFFFFFF, (seed >> 32) & 0xFFFFFFFF)


def compute_frame_word(frame: int) -> int:
    """Return the first counter word, which all draws of a frame share."""
    return frame & 0xFFFFFFFF


def to_unit_floats(word: NDArray[np.uint64]) -> NDArray[np.float32]:
    """Return float32 numbers in [0, 1) from the top 24 bits of 32-bit words."""
    return (word >> np.uint64(8)).astype(np.float32) * UNIT_FLOAT_STEP


def draw_uniform(seed: int, frame: int, species: str, site: str, index: int, ids: NDArray[np.int64]) -> NDArray[np.float32]:
    """Return the draw number `index` of a site for each id, a float32 number in [0, 1). One run of the generator gives four
    draws."""
    return _draw_numbers(fill_uniforms, np.float32, build_counters(seed, frame, species, site, index >> 2), index, ids)


def draw_word(seed: int, frame: int, species: str, site: str, index: int, ids: NDArray[np.int64]) -> NDArray[np.uint64]:
    """Return the random 32-bit words from which `draw_uniform` computes its results for the same arguments."""
    return _draw_numbers(fill_words, np.uint64, build_counters(seed, frame, species, site, index >> 2), index, ids)


def _draw_numbers(
    fill_kernel: RandomKernel, dtype: type[np.generic], shared_counters: CounterWords, index: int, ids: NDArray[np.int64]
) -> NDArray[Any]:
    """Return the draw number `index` for each id. The kernel `fill_kernel` computes it, as numbers of type `dtype`."""
    draws: NDArray[Any] = np.empty(ids.size, dtype)
    fill_kernel(np.ascontiguousarray(ids.reshape(-1), np.int64), (*shared_counters[0], *shared_counters[1]), index & 3, draws)
    return draws.reshape(ids.shape)


@kernel
def fill_uniforms(ids: Array1[I64], shared_counters: SharedCounters, draw_index: I64, output: Array1[F32]) -> None:
    """Write one draw in [0, 1) for each id to `output`. `draw_index`: its index among the four draws of a counter."""
    for n in simd_range(0, ids.size):
        output[n] = np.float32(_compute_word(ids[n], shared_counters, draw_index) >> 8) * UNIT_FLOAT_STEP


@kernel
def fill_words(ids: Array1[I64], shared_counters: SharedCounters, draw_index: I64, output: Array1[U64]) -> None:
    """Write one random 32-bit word for each id to `output`. The arguments are those of `fill_uniforms`."""
    for n in simd_range(0, ids.size):
        output[n] = _compute_word(ids[n], shared_counters, draw_index)


@inlined
def _compute_word(number: I64, shared_counters: SharedCounters, draw_index: I64) -> U64:
    """Return one of the four random words that `run_philox` gives for an id. `draw_index`: which word, 0 .. 3."""
    wide = np.uint64(number)
    c0, low, c3, first, second = shared_counters
    a, b, c, d = c0, wide & LOW_32_BITS, (((wide >> HALF_WORD_BITS) * ID_SPREAD_MULTIPLIER) & LOW_32_BITS) ^ low, c3
    for _ in range(PHILOX_ROUNDS):
        p0, p1 = a * PHILOX_MULTIPLIER0, c * PHILOX_MULTIPLIER1
        a, b, c, d = (p1 >> HALF_WORD_BITS) ^ b ^ first, p1 & LOW_32_BITS, (p0 >> HALF_WORD_BITS) ^ d ^ second, p0 & LOW_32_BITS
        first, second = (first + PHILOX_KEY_STEP0) & LOW_32_BITS, (second + PHILOX_KEY_STEP1) & LOW_32_BITS
    return a if draw_index == 0 else b if draw_index == 1 else c if draw_index == 2 else d
