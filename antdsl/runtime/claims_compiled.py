"""Claims on amounts, served one after the other: as `claims` serves those who do not ask for all, the same bits."""

import numpy as np

from antdsl.machine_code.kernels import BOOL, F32, F64, I64, Array1, inlined, kernel


@kernel
def in_turn(rest: Array1[F64], item: Array1[I64], change: Array1[F64], got: Array1[F64]) -> None:
    """Write to `got` what each claim gets, its `change`, where there is enough for it and for those before it; `item`, ascending,
    says of which number of `rest` each is. Takes from the rest what they get together."""
    _serve(rest, item, change, got, item.size)


@kernel
def settled(
    rest: Array1[F64],
    order: Array1[I64],
    item: Array1[I64],
    row: Array1[I64],
    amount: Array1[F32],
    own: Array1[F32],
    won: Array1[BOOL],
    claimed: Array1[I64],
    change: Array1[F64],
    got: Array1[F64],
) -> bool:
    """Settle the claims of one statement, of different agents, in an order by `item`: who is served has its `amount` added to its
    `own` register and has `won`. Not where one asks for all: then nothing is settled, and it gives False.

    `item`, `row` and `amount` [n] of each claim, `claimed`, `change` and `got` [n]: room."""
    for k in range(order.size):
        if amount[k] == np.inf:
            return False
    count = 0
    for k in range(order.size):
        n = order[k]
        if item[n] >= 0 and item[n] < rest.size and amount[n] >= np.float32(0.0):
            had = own[row[n]]
            order[count], claimed[count], got[count] = n, item[n], -1.0
            change[count] = np.float64(had + amount[n]) - np.float64(had)
            count += 1
    _serve(rest, claimed, change, got, count)
    for k in range(count):
        n = order[k]
        if got[k] >= 0.0:
            own[row[n]] += amount[n]
            won[row[n]] = True
    return True


@inlined
def _serve(rest, item, change, got, count):  # type: ignore[no-untyped-def]
    k = 0
    while k < count:
        which, begin, taken, enough = item[k], k, 0.0, True
        while k < count and item[k] == which:
            together = change[k] if k == begin else taken + change[k]
            enough = enough and together <= rest[which]
            if enough:
                taken, got[k] = together, change[k]
            k += 1
        if got[begin] >= 0.0:
            rest[which] -= taken
