"""Which way faces point, of many footings in one pass: as `surface.MeshGround.sides`."""

from antdsl.machine_code.kernels import I8, I32, I64, Array1, kernel


@kernel
def faced(
    mesh: Array1[I32], face: Array1[I32], first: Array1[I64], side: Array1[I8], found: Array1[I8], begin: I64, end: I64
) -> None:
    """Write the side of each face from `begin` to before `end`, of those of its mesh, which begin at `first`; 0 for nowhere."""
    for n in range(begin, end):
        if mesh[n] >= 0 and face[n] >= 0:
            found[n] = side[first[mesh[n]] + face[n]]
        else:
            found[n] = 0
