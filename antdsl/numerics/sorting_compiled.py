"""Where a number stands among ascending ones, and which of some flags are set, for kernels."""

from antdsl.machine_code.kernels import inlined


@inlined
def place_among(keys, key, first, last):  # type: ignore[no-untyped-def]
    """How many of the keys are less than a key, which is known to stand between `first` and `last`: by halving."""
    a, b = first, last
    while a < b:
        middle = (a + b) >> 1
        if keys[middle] < key:
            a = middle + 1
        else:
            b = middle
    return a


@inlined
def listed(flags, count):  # type: ignore[no-untyped-def]
    """How many of the first flags are 1, not 0, whose numbers come first now."""
    found = 0
    for k in range(count):
        flag = flags[k]
        flags[found] = k  # written whatever it is: no branch that is hard to foretell
        found += flag
    return found
