"""Meshes as text (.ply, .stl, .obj) and the binary ones that only the general reader takes."""

from __future__ import annotations

import os
import struct

from cases.hostile.rows import GROUND, Row, named

STL = b"""solid ground
facet normal 0 1 0
outer loop
vertex -100 0 -100
vertex -100 0 100
vertex 100 0 100
endloop
endfacet
facet normal 0 1 0
outer loop
vertex -100 0 -100
vertex 100 0 100
vertex 100 0 -100
endloop
endfacet
endsolid
"""
OBJ = b"v -100 0 -100\nv -100 0 100\nv 100 0 100\nv 100 0 -100\nf 1 2 3\nf 1 3 4\n"


def ply(name: str, old: bytes, new: bytes, verdict: str, words: str = "") -> Row:
    assert old in GROUND, name
    return Row(name, verdict, words, {"ground.ply": GROUND.replace(old, new, 1)})


def stl(name: str, data: bytes, verdict: str, words: str = "") -> Row:
    return Row(name, verdict, words, {"ground.stl": data}, named("ground.stl"))


def obj(name: str, data: bytes, verdict: str, words: str = "") -> Row:
    return Row(name, verdict, words, {"ground.obj": data}, named("ground.obj"))


def binary(faces: bytes, count: int, listed: str = "uchar int", order: str = "little") -> bytes:
    head = f"ply\nformat binary_{order}_endian 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n"
    head += f"element face {count}\nproperty list {listed} vertex_indices\nend_header\n"
    corners = (-100, 0, -100, -100, 0, 100, 100, 0, 100, 100, 0, -100)
    return head.encode() + struct.pack(("<" if order == "little" else ">") + "12f", *corners) + faces


POLYGON = b"".join(b"v %d 0 %d\n" % (k % 317, k // 317) for k in range(20_000))
POLYGON += b"f " + b" ".join(b"%d" % k for k in range(1, 20_001)) + b"\n"
QUAD = struct.pack("<B4i", 4, 0, 1, 2, 3)
ROWS = [
    Row("M1 text ply", "", frames=3),
    ply("M1 points only", b"element face 2\nproperty list uchar int vertex_indices\n", b"", "bad-mesh", "has no faces"),
    ply("M1 no vertices", b"element vertex 4", b"element vertex 0", "bad-mesh", "line"),
    ply("M3 vertices of 4e9", b"vertex 4", b"vertex 4000000000", "bad-mesh", "more than 30,000,000"),
    ply("M3 vertices of 1e9 that fit no file", b"vertex 4", b"vertex 20000000", "bad-mesh", "too many for a file"),
    ply("M3 a negative count", b"vertex 4", b"vertex -4", "bad-mesh", "not understood"),
    ply("M3 a count with an exponent", b"vertex 4", b"vertex 4e0", "bad-mesh", "not understood"),
    ply("M3 a vertex too many", b"vertex 4", b"vertex 5", "bad-mesh", "line"),
    ply("M3 a vertex too few", b"vertex 4", b"vertex 3", "bad-mesh", "line 13"),
    ply("M3 a face too many", b"face 2", b"face 3", "bad-mesh", "2 of 3 face lines"),
    ply("M3 a list of 4e9", b"3 0 1 2", b"4294967295 0 1 2", "bad-mesh", "line 14"),
    ply("M3 a list of -1", b"3 0 1 2", b"-1 0 1 2", "bad-mesh", "line 14"),
    ply("M3 a list that is cut off", b"3 0 2 3\n", b"3 0 2", "bad-mesh", "line 15"),
    ply("M3 no end of the header", b"end_header", b"end", "bad-mesh", "not a .ply file"),
    ply("M3 a kind that is none", b"float x", b"float128 x", "bad-mesh", "not understood"),
    ply("M3 no x", b"float x", b"float u", "bad-mesh", "without x, y and z"),
    ply(
        "M3 faces that list nothing",
        b"list uchar int vertex_indices",
        b"int vertex_indices",
        "bad-mesh",
        "without exactly one list",
    ),
    ply("M3 faces of parts of vertices", b"uchar int", b"uchar float", "bad-mesh", "not whole"),
    ply("M4 index -1", b"3 0 1 2", b"3 0 -1 2", "bad-mesh", "missing vertex"),
    ply("M4 index 4e9", b"3 0 1 2", b"3 0 4294967296 2", "bad-mesh", "missing vertex"),
    ply("M4 index 1e40", b"3 0 1 2", b"3 0 " + b"9" * 40 + b" 2", "bad-mesh", "line 14"),
    ply("M4 index that is no number", b"3 0 1 2", b"3 0 x 2", "bad-mesh", "line 14"),
    ply("M4 an index with a point", b"3 0 1 2", b"3 0 1.5 2", "bad-mesh", "line 14"),
    ply("M5 nan", b"-100 0 -100", b"nan 0 -100", "bad-mesh", "not a finite point"),
    ply("M5 inf", b"-100 0 -100", b"-inf 0 -100", "bad-mesh", "not a finite point"),
    ply("M5 1e999", b"-100 0 -100", b"1e999 0 -100", "bad-mesh", "not a finite point"),
    ply("M5 1e38", b"-100 0 -100", b"1e38 0 -100", "bad-mesh", "not a finite point"),
    ply("M5 numbers of Python alone", b"-100 0 -100", b"-1_0_0 0 -100", "bad-mesh", "line 10"),
    ply("M5 a number of 1 MB", b"-100 0 -100", b"1" * 900_000 + b" 0 -100", "bad-mesh", "line 10"),
    ply("M5 a line without end", b"-100 0 -100", b"1 " * 900_000, "bad-mesh", "line 10 of more than"),
    ply("M5 no text", b"-100 0 -100", b"\xff\xfe\x00 0 -100", "bad-mesh", "line 10"),
    ply("M5 the same face twice", b"3 0 2 3", b"3 0 1 2", "degenerate-faces", "duplicated"),
    ply("M5 a face of two corners", b"3 0 2 3", b"2 0 2", "unread-content", "fewer than three"),
    Row("A5 CRLF in a text ply", "", files={"ground.ply": GROUND.replace(b"\n", b"\r\n")}, frames=2),
    Row("A5 blank lines in a text ply", "", files={"ground.ply": GROUND.replace(b"100 0 100\n", b"100 0 100\n\n  \n")}, frames=2),
    Row("M10 a vertex 20 km out", "far-away", files={"ground.ply": GROUND.replace(b"100 0 ", b"100 20000000 ", 1)}),
    Row("M1 binary quads", "", files={"ground.ply": binary(QUAD, 1)}, frames=2),
    Row("M1 quads and triangles", "", files={"ground.ply": binary(QUAD + struct.pack("<B3i", 3, 0, 1, 3), 2)}, frames=2),
    Row(
        "M1 quads, most significant byte first",
        "",
        files={"ground.ply": binary(struct.pack(">B4i", 4, 0, 1, 2, 3), 1, order="big")},
    ),
    Row(
        "M3 a binary list of 4e9",
        "bad-mesh",
        "face 0",
        {"ground.ply": binary(struct.pack("<I4i", 2**32 - 1, 0, 1, 2, 3), 1, "uint int")},
    ),
    Row(
        "M3 a binary list of -1", "bad-mesh", "face 0", {"ground.ply": binary(struct.pack("<b4i", -1, 0, 1, 2, 3), 1, "char int")}
    ),
    Row(
        "M3 a binary list that counts in nan",
        "bad-mesh",
        "numbers that are not whole",
        {"ground.ply": binary(struct.pack("<f4i", float("nan"), 0, 1, 2, 3), 1, "float int")},
    ),
    Row("M3 binary quads cut off", "bad-mesh", "more than the file has", {"ground.ply": binary(QUAD + QUAD[:6], 2)}),
    Row("M11 a picture by that name", "bad-mesh", "not a .ply file", {"ground.ply": b"\x89PNG\r\n\x1a\n" + bytes(500)}),
    stl("M1 text stl", STL, ""),
    stl("A5 text stl with CRLF", STL.replace(b"\n", b"\r\n"), ""),
    stl("A5 text stl with CR", STL.replace(b"\n", b"\r"), ""),
    stl("M2 upper case", STL.upper(), ""),
    stl("M2 a name that looks like a corner", STL.replace(b"solid ground", b"solid vertex 1 2 3", 1), ""),
    stl("M2 a facet with two corners", STL.replace(b"vertex 100 0 100\n", b"", 1), "bad-mesh", "line 7"),
    stl("M2 a facet with four corners", STL.replace(b"vertex 100 0 100\n", b"vertex 100 0 100\n" * 2, 1), "bad-mesh", "line 9"),
    stl("M2 a corner outside", STL.replace(b"solid ground", b"solid ground\nvertex 0 0 0"), "bad-mesh", "line 2"),
    stl("M2 cut off", STL[: STL.rindex(b"endloop")], "bad-mesh", "a part of it is missing"),
    stl("M2 no facets", b"solid facet\nendsolid\n", "bad-mesh", "no faces"),
    stl("M2 nonsense in a facet", STL.replace(b"outer loop", b"while true", 1), "bad-mesh", "line 3"),
    stl("M2 numbers of 50 digits", STL.replace(b"vertex 100 0 100", b"vertex " + b"1" * 50 + b" 0 100", 1), "bad-mesh", "line 6"),
    stl("M5 nan in a corner", STL.replace(b"-100 0 -100", b"nan 0 -100"), "bad-mesh", "not a finite point"),
    stl("M2 binary of 4e9 faces", bytes(80) + struct.pack("<I", 2**32 - 1) + bytes(50), "bad-mesh", "a part of it is missing"),
    stl(
        "M2 binary that says solid",
        b"solid".ljust(80) + struct.pack("<I12fHi", 1, *range(12), 0, 0),
        "bad-mesh",
        "no face with an area",
    ),
    stl("M2 binary cut off that says solid", b"solid".ljust(80) + struct.pack("<I12f", 2, *range(12)), "bad-mesh", "missing"),
    stl("M2 binary of more faces than it says", bytes(80) + struct.pack("<I24fI", 0, *range(1, 25), 0), "bad-mesh", "and has 2"),
    obj("M1 obj", OBJ, ""),
    obj("A5 obj with CR", OBJ.replace(b"\n", b"\r"), ""),
    obj("M4 a polygon of 20,000 corners", POLYGON, "crossing-face"),
    obj("M4 a line without end", OBJ + b"f " + b"1 " * 600_000, "bad-mesh", "line 7 of more than"),
    obj("M4 no text", OBJ.replace(b"v 100", b"v \xff\x1b[31m", 1), "bad-mesh", "line 3"),
    obj("M7 a library of materials outside", b"mtllib ../../etc/passwd\nusemtl " + b"x" * 5000 + b"\n" + OBJ, ""),
    Row("M8 a zip by the name of a mesh", "bad-mesh", "", {"ground.obj": b"PK\x03\x04" + bytes(200)}, named("ground.obj")),
    Row("M9 a compressed mesh", "bad-mesh", "is not one of", {"ground.obj.gz": b"\x1f\x8b" + bytes(90)}, named("ground.obj.gz")),
    Row("M7 a damaged glTF", "bad-mesh", "is a binary glTF 0", {"ground.glb": b"glTF" + bytes(90)}, named("ground.glb")),
    obj("M4 text in UTF-16", OBJ.decode().encode("utf-16"), "bad-mesh", "UTF-16"),
    obj("M4 decimal commas", OBJ.replace(b"v 100 ", b"v 100,5 ", 1), "bad-mesh", "line 3"),
    Row("M9 a mesh of 20 GB", "too-large", "20,000,000,000 bytes", make=lambda f: os.truncate(f / "ground.ply", 20 * 10**9)),
]
