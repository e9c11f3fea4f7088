"""Volumes, painted numbers and solids: V1 to V7. Volumes of other programs are refused where they are named."""

from __future__ import annotations

import io
import zipfile
from collections.abc import Callable

import numpy as np
from cases.hostile.rows import GROUND, PROGRAM, SCENE, Row, named

FLOW = PROGRAM.replace(b"surface ground", b"surface ground; flow wind").replace(b"steer wander", b"steer along(wind) + wander")
SOLID = PROGRAM.replace(b"surface ground", b"surface ground; solid hill")
BOX = b"".join(b"v %d %d %d\n" % (x, y, z) for x in (-20, 20) for y in (-20, 20) for z in (-20, 20))
BOX += b"f 1 2 4 3\nf 5 7 8 6\nf 1 5 6 2\nf 3 4 8 7\nf 1 3 7 5\nf 2 6 8 4\n"


def npz(**arrays: np.ndarray) -> bytes:
    buffer = io.BytesIO()
    np.savez(buffer, **arrays)
    return buffer.getvalue()


def raw(header: str, body: bytes = b"", name: str = "wind.npy", compression: int = zipfile.ZIP_STORED) -> bytes:
    """An archive with an array of any header."""
    buffer = io.BytesIO()
    data = b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header.encode() + body
    with zipfile.ZipFile(buffer, "w", compression) as file:
        file.writestr(name, data)
    return buffer.getvalue()


def painted(
    name: str, data: bytes | Callable[[], bytes], verdict: str = "", words: str = "", file: str = "wind.npz", frames: int = 0
) -> Row:
    scene = SCENE.replace(b"crowd:", f"  wind: {{painted: {file}}}\ncrowd:".encode())
    return Row(name, verdict, words, {"walker.ant": FLOW, "scene.yaml": scene, file: data}, frames=frames)


def solid(
    name: str, data: bytes, verdict: str = "", words: str = "", voxel: str = "2 mm", file: str = "hill.obj", frames: int = 0
) -> Row:
    scene = SCENE.replace(b"crowd:", f"  hill: {{mesh: {file}, voxel: {voxel}}}\ncrowd:".encode())
    return Row(name, verdict, words, {"walker.ant": SOLID, "scene.yaml": scene, file: data}, frames=frames, warned=True)


WINDY = GROUND.replace(b"float z\n", b"float z\n" + b"".join(b"property float wind_%c\n" % axis for axis in b"xyz"))
INSIDE_OUT = b"".join(
    b" ".join([line[:1], *reversed(line.split()[1:])]) + b"\n" if line[:1] == b"f" else line for line in BOX.splitlines(True)
)
SHAPE = "{'descr': '<f4', 'fortran_order': False, 'shape': (%s), }"
ROWS = [
    painted("V6 a flow of nothing", npz(wind=np.zeros((4, 3))), frames=3),
    painted("V6 a flow of 1e6 m/s", npz(wind=np.full((4, 3), 1e9)), frames=3),
    painted("V6 islands of nan", npz(wind=np.array([[0, 0, 1], [np.nan, 0, 0], [0, 0, 1], [0, 0, 1]])), "bad-paint", "number 1"),
    painted("V6 inf", npz(wind=np.full((4, 3), np.inf)), "bad-paint", "number 0"),
    painted("V7 of another mesh", npz(wind=np.zeros((9, 3))), "bad-paint", "9 values"),
    painted("V7 of no dimensions", npz(wind=np.zeros(())), "bad-paint"),
    painted("V1 a shape of 2^32", raw(SHAPE % "65536, 65536"), "bad-paint", "does not fit its size"),
    painted("V1 a shape that overflows", raw(SHAPE % "4294967296, 4294967296, 3"), "bad-paint", "does not fit its size"),
    painted("V1 a shape below 0", raw(SHAPE % "-4, 3"), "bad-paint", "an unknown header"),
    painted("V1 a shape of truth", raw(SHAPE % "True,"), "bad-paint", "an unknown header"),
    painted("V1 objects", raw(SHAPE.replace("<f4", "|O") % "4, 3", b"cos\nsystem\n."), "bad-paint", "an unknown header"),
    painted("V1 text", raw(SHAPE.replace("<f4", "<U2147483647") % "4,"), "bad-paint", "an unknown header"),
    painted(
        "V1 most significant byte first", raw(SHAPE.replace("<f4", ">f4") % "4, 3", bytes(48)), "bad-paint", "an unknown header"
    ),
    painted("V1 columns first", raw(SHAPE.replace("False", "True") % "4, 3", bytes(48)), "bad-paint", "an unknown header"),
    painted("V2 compressed", raw(SHAPE % "4, 3", bytes(48), compression=zipfile.ZIP_DEFLATED), "bad-paint", "compressed"),
    painted(
        "V2 a bomb",
        lambda: raw(SHAPE % "9000000,", bytes(36_000_000), compression=zipfile.ZIP_DEFLATED),
        "bad-paint",
        "more data than its size",
    ),
    painted("V2 a name that leaves", raw(SHAPE % "4, 3", bytes(48), "../wind.npy"), "bad-paint", "invalid name"),
    painted("V2 a number that was changed", npz(wind=np.zeros((4, 3))).replace(bytes(40), bytes(39) + b"\1", 1), "bad-paint"),
    painted("V4 a picture", b"\x89PNG\r\n\x1a\n" + bytes(90), "bad-paint", "neither a .ply nor an .npz", "wind.png"),
    painted("V4 a TIFF that says 16 TB", b"II*\0" + b"\xff" * 90, "bad-paint", "neither a .ply nor an .npz", "wind.tif"),
    painted("V3 a VDB that is painted", b" BDV" + bytes(90), "bad-paint", "neither a .ply nor an .npz", "wind.vdb"),
    painted(
        "V5 paint as text with nan",
        WINDY.replace(b" 0 -100", b" 0 -100 nan 0 0").replace(b" 0 100", b" 0 100 1 0 0"),
        "bad-paint",
        "not finite",
        "wind.ply",
    ),
    painted("V5 paint as text with words", WINDY.replace(b" 0 -100", b" 0 -100 a b c"), "bad-paint", "line 14", "wind.ply"),
    Row("V3 a VDB for a mesh", "bad-mesh", "is not one of", {"ground.vdb": b" BDV" + bytes(90)}, named("ground.vdb")),
    Row("V4 a height map for a mesh", "bad-mesh", "is not one of", {"ground.exr": b"v/1\x01" + bytes(90)}, named("ground.exr")),
    solid("V5 a box", BOX, frames=2),
    solid("V5 voxels of 0", BOX, "wrong-value", voxel="0 mm"),
    solid("V5 voxels of 1e-9 mm", BOX, "too-large", "voxels", voxel="0.000000001 mm"),
    solid("V5 a solid that is open", BOX.replace(b"f 1 2 4 3\n", b""), "bad-mesh", "a hole of 4 edges"),
    solid("V5 a solid turned inside out", INSIDE_OUT, frames=2),
    solid("V5 a solid that is flat", BOX.replace(b" 20 ", b" -20 "), "bad-mesh", "has no volume"),
    solid("V5 a solid with nan", BOX.replace(b"v -20 -20 -20", b"v nan -20 -20"), "bad-mesh", "not a finite point"),
    solid("V3 a VDB for a solid", b" BDV" + bytes(90), "bad-mesh", "is not one of", file="hill.vdb"),
    Row(
        "V7 agents about a place beside the ground",
        "off-surface",
        "nearest",
        edits={"scene.yaml": ("{on: ground}", "{on: ground, around: [9000, 0, 0], radius: 5 mm}")},
    ),
]
