"""Claims on amounts, served one after the other: as `claims` serves those who do not ask for all, the same bits."""

from antdsl.machine_code.kernels import F64, I64, Array1, kernel


@kernel
def in_turn(rest: Array1[F64], item: Array1[I64], change: Array1[F64], got: Array1[F64]) -> None:
    """Write to `got` what each claim gets, its `change`, where there is enough for it and for those before it; `item`, ascending,
    says of which number of `rest` each is. Takes from the rest what they get together."""
    k = 0
    while k < item.size:
        which, begin, taken, enough = item[k], k, 0.0, True
        while k < item.size and item[k] == which:
            together = change[k] if k == begin else taken + change[k]
            enough = enough and together <= rest[which]
            if enough:
                taken, got[k] = together, change[k]
            k += 1
        if got[begin] >= 0.0:
            rest[which] -= taken
