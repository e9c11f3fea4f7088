"""The passes of `rounds` as loops: the same operations in the same order, and so the same bits."""

from __future__ import annotations

from antdsl.machine_code.kernels import BOOL, F64, I64, Array1, Array2, Strided2, independent, kernel
from antdsl.numerics.vectors_compiled import dot, minus, of, plus, put

_MISSED, _HELD, _SEEN = 0.05, 0.5, 0.05  # as `rounds`


@kernel
def led(asked: Array2[F64], some: Array1[I64], wanted: Array2[F64]) -> I64:
    """As `rounds.led`: how many rows go anywhere, which are the first of `some` and `wanted` (3, k)."""
    count = 0
    for k in range(some.size):
        way = of(asked, k)
        some[count] = k  # written whatever it is: no branch that is hard to foretell
        put(wanted, count, way)
        count += (way[0] != 0) | (way[1] != 0) | (way[2] != 0)
    return count


@kernel
def missed(
    some: Array1[I64],
    wanted: Strided2[F64],
    got: Strided2[F64],
    radius: Array1[F64],
    middle: Strided2[F64],
    held: Array1[BOOL],
    touched: Array1[BOOL],
) -> None:
    """As `rounds.missed`."""
    for n in independent(0, some.size):
        row, to, on = some[n], of(wanted, n), of(got, n)
        short, far = minus(to, on), _MISSED * radius[row]
        put(middle, row, plus(of(middle, row), on))
        if dot(short, short) > far * far:
            touched[row] = True
            if dot(on, to) < _HELD * dot(to, to):
                held[row] = True


@kernel
def visible(
    i: Array1[I64], j: Array1[I64], gap: Array1[F64], radius: Array1[F64], touched: Array1[BOOL], which: Array1[BOOL]
) -> BOOL:
    """As `rounds.visible`, into `which`; says whether there are any that more is walked for."""
    for pair in independent(0, i.size):
        which[pair] = touched[i[pair]] | touched[j[pair]]
    found = False
    for pair in range(i.size):
        if which[pair]:
            found |= gap[pair] < -((radius[i[pair]] + radius[j[pair]]) * _SEEN)
    return found
