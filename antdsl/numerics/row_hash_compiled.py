"""The compiled half of `row_hash`: the same bits. All in int64, whose products wrap as those of uint64 do.

Imported only where `compiled.wanted` says so."""

from __future__ import annotations

from antdsl.machine_code.kernels import I32, I64, Array1, independent, inlined, kernel

_HALF = 0xFFFFFFFF
_REST = 0x7FFFFFFF  # what a logical shift by 33 leaves
_BY, _THEN = 0xFF51AFD7ED558CCD - 2**64, 0xC4CEB9FE1A85EC53 - 2**64
Wholes = tuple[Array1[I64], Array1[I64], Array1[I64], Array1[I64]]
Halves = tuple[Array1[I32], Array1[I32], Array1[I32], Array1[I32]]


@inlined
def _product(a, b, of_a, of_b):  # type: ignore[no-untyped-def]
    return ((a + of_a) & _HALF) * ((b + of_b) & _HALF)


@inlined
def _products(word, k, m, p, q):  # type: ignore[no-untyped-def]
    a, b = word & _HALF, (word >> 32) & _HALF
    return _product(a, b, k, m), _product(a, b, p, q)


@inlined
def _mixed(h):  # type: ignore[no-untyped-def]
    h = (h ^ ((h >> 33) & _REST)) * _BY
    h = (h ^ ((h >> 33) & _REST)) * _THEN
    return h ^ ((h >> 33) & _REST)


@kernel
def fold_whole(word: Array1[I64], keys: Array1[I64], first: Array1[I64], second: Array1[I64], begin: I64) -> None:
    """Add the products of the halves of each word to both lanes: those of the words from `begin` on, one for each lane."""
    k, m, p, q = keys[0], keys[1], keys[2], keys[3]
    for i in independent(0, first.size):
        g, h = _products(word[begin + i], k, m, p, q)
        first[i] += g
        second[i] += h


@kernel
def fold_wholes(words: Wholes, keys: Array1[I64], first: Array1[I64], second: Array1[I64], begin: I64) -> None:
    """The same of four words at once."""
    k0, m0, p0, q0 = keys[0], keys[1], keys[2], keys[3]
    k1, m1, p1, q1 = keys[4], keys[5], keys[6], keys[7]
    k2, m2, p2, q2 = keys[8], keys[9], keys[10], keys[11]
    k3, m3, p3, q3 = keys[12], keys[13], keys[14], keys[15]
    a, b, c, d = words
    for i in independent(0, first.size):
        j = begin + i
        s0, t0 = _products(a[j], k0, m0, p0, q0)
        s1, t1 = _products(b[j], k1, m1, p1, q1)
        s2, t2 = _products(c[j], k2, m2, p2, q2)
        s3, t3 = _products(d[j], k3, m3, p3, q3)
        first[i] += (s0 + s1) + (s2 + s3)
        second[i] += (t0 + t1) + (t2 + t3)


@kernel
def numbered(word: Array1[I64], keys: Array1[I64]) -> tuple[I64, I64]:
    """The sums of both lanes of rows that are their number and one word, each row mixed."""
    k0, m0, p0, q0 = keys[0], keys[1], keys[2], keys[3]
    k1, m1, p1, q1 = keys[4], keys[5], keys[6], keys[7]
    s, t = 0, 0
    for i in range(word.size):
        g0, h0 = _products(i, k0, m0, p0, q0)
        g1, h1 = _products(word[i], k1, m1, p1, q1)
        s += _mixed(g0 + g1)
        t += _mixed(h0 + h1)
    return s, t


@kernel
def fold_half(
    low: Array1[I32], high: Array1[I32], keys: Array1[I64], first: Array1[I64], second: Array1[I64], begin: I64
) -> None:
    """The same of words whose halves lie in two arrays."""
    k, m, p, q = keys[0], keys[1], keys[2], keys[3]
    for i in independent(0, first.size):
        first[i] += _product(low[begin + i], high[begin + i], k, m)
        second[i] += _product(low[begin + i], high[begin + i], p, q)


@kernel
def fold_halves(low: Halves, high: Halves, keys: Array1[I64], first: Array1[I64], second: Array1[I64], begin: I64) -> None:
    """The same of four such words at once."""
    k0, m0, p0, q0 = keys[0], keys[1], keys[2], keys[3]
    k1, m1, p1, q1 = keys[4], keys[5], keys[6], keys[7]
    k2, m2, p2, q2 = keys[8], keys[9], keys[10], keys[11]
    k3, m3, p3, q3 = keys[12], keys[13], keys[14], keys[15]
    a, c, e, g = low
    b, d, f, h = high
    for i in independent(0, first.size):
        j = begin + i
        s = _product(a[j], b[j], k0, m0) + _product(c[j], d[j], k1, m1)
        t = _product(a[j], b[j], p0, q0) + _product(c[j], d[j], p1, q1)
        first[i] += (s + _product(e[j], f[j], k2, m2)) + _product(g[j], h[j], k3, m3)
        second[i] += (t + _product(e[j], f[j], p2, q2)) + _product(g[j], h[j], p3, q3)


@kernel
def finish(first: Array1[I64], second: Array1[I64]) -> tuple[I64, I64]:
    """The sums of both lanes, each row mixed."""
    s, t = 0, 0
    for i in range(first.size):
        s += _mixed(first[i])
        t += _mixed(second[i])
    return s, t
