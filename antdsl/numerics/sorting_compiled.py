"""Where a number stands among ascending ones, for kernels."""

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
