"""What a part of a kernel has to itself while others are at work beside it."""

from antdsl.machine_code.kernels import inlined


@inlined
def own(begin, count, rooms):  # type: ignore[no-untyped-def]
    """The number of the room of the part of `count` numbers (1 at least) that starts at `begin`, of as many `rooms` as
    `compiled.parts` says: no two parts have the same."""
    return (begin * rooms + count - 1) // count
