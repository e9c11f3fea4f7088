"""Where footings are in the world, of many in one pass: as `surface.MeshGround.position`.

From vertices, of which neighbours share most, so that less of memory is read than of a table of faces."""

from antdsl.machine_code.kernels import BOOL, F64, I32, I64, Array1, Array2, kernel


@kernel
def places(
    vertices: Array2[F64],
    faces: Array2[I32],
    normal: Array2[F64],
    first: Array1[I64],
    mesh: Array1[I32],
    face: Array1[I32],
    b1: Array1[F64],
    b2: Array1[F64],
    over: Array1[F64],
    place: Array2[F64],
) -> BOOL:
    """Write the place of each footing, [n,3], 0 for nowhere, and say whether all faces are there: they are `faces`, with a
    `normal` (3, m), by mesh from `first` on."""
    for n in range(mesh.size):
        x, y, z = 0.0, 0.0, 0.0
        if mesh[n] >= 0 and face[n] >= 0:
            if mesh[n] >= first.size:
                return False
            f = first[mesh[n]] + face[n]
            if f >= faces.shape[0]:
                return False
            i, j, k = faces[f, 0], faces[f, 1], faces[f, 2]
            p, q, h = b1[n], b2[n], over[n]
            x, y, z = vertices[i, 0], vertices[i, 1], vertices[i, 2]
            x = (x + p * (vertices[j, 0] - x)) + q * (vertices[k, 0] - x)
            y = (y + p * (vertices[j, 1] - y)) + q * (vertices[k, 1] - y)
            z = (z + p * (vertices[j, 2] - z)) + q * (vertices[k, 2] - z)
            if h != 0.0 or x == 0.0 or y == 0.0 or z == 0.0:  # else it changes nothing, not even the sign of nothing
                x, y, z = x + h * normal[0, f], y + h * normal[1, f], z + h * normal[2, f]
        place[n, 0], place[n, 1], place[n, 2] = x, y, z
    return True
