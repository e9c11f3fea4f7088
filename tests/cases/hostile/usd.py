"""USD scenes: what USD's own reader makes of them is never trusted, and where it falls over another process does."""

from __future__ import annotations

import io
import struct
import zipfile

from cases.hostile.rows import SCENE, Row

HEAD = '#usda 1.0\n(\n    upAxis = "Y"\n    metersPerUnit = 0.001\n    timeCodesPerSecond = 24\n)\n'
MESH = """def Mesh "ground"
{
    point3f[] points = [(-100, 0, -100), (-100, 0, 100), (100, 0, 100), (100, 0, -100)]
    int[] faceVertexCounts = [3, 3]
    int[] faceVertexIndices = [0, 1, 2, 0, 2, 3]
}
"""
GOOD = HEAD + MESH


def usd(
    name: str,
    text: str | bytes,
    verdict: str = "",
    words: str = "",
    prim: str = "/ground",
    file: str = "set.usda",
    frames: int = 0,
) -> Row:
    data = text.encode() if isinstance(text, str) else text
    scene = SCENE.replace(b"{mesh: ground.ply}", f"{{usd: {file}, prim: {prim}}}".encode())
    return Row(name, verdict, words, {"scene.yaml": scene, file: data}, frames=frames)


def within(more: str) -> str:
    """The mesh below a prim with more in it."""
    return HEAD + 'def Xform "set"\n{\n' + more + "\n" + MESH + "}\n"


def placed(row: str) -> str:
    """A transform whose first three rows are these."""
    rows = ", ".join([f"({row})"] * 3)
    return f'matrix4d xformOp:transform = ({rows}, (0, 0, 0, 1))\nuniform token[] xformOpOrder = ["xformOp:transform"]'


def refers(name: str, target: str) -> str:
    return f'def "{name}" (\nreferences = {target}\n)\n{{\n}}\n'


def chain(count: int, twice: bool = False, instanced: bool = False) -> str:
    """Each prim refers to the one before, once or twice: as deep as it is long, or as many as 2 to that power."""
    arcs = "instanceable = true\n" if instanced else ""
    parts = [f'def Xform "p0"\n{{\n{MESH}}}\n']
    for number in range(1, count):
        below = [f'def "{name}" (\n{arcs}references = </p{number - 1}>\n)\n{{\n}}\n' for name in ("xy" if twice else "x")]
        parts.append(f'def Xform "p{number}"\n{{\n{"".join(below)}}}\n')
    return HEAD + "".join(parts)


def package(name: str, data: bytes) -> bytes:
    buffer = io.BytesIO()
    with zipfile.ZipFile(buffer, "w") as file:
        file.writestr(name, data)
    return buffer.getvalue()


def deep(levels: int) -> str:
    return HEAD + 'def Xform "a"\n{\n' * levels + MESH + "}\n" * levels


ROWS = [
    usd("M7 a mesh", GOOD, frames=2),
    usd("A5 CRLF", GOOD.replace("\n", "\r\n")),
    usd("A2 bytes that are no UTF-8", GOOD.replace("int[] faceV", "\u00e9 faceV", 1).encode("latin-1"), "bad-usd", "UTF-8"),
    usd("A2 UTF-16", GOOD.encode("utf-16"), "bad-usd", "cannot be read as USD"),
    usd("A3 zeros at its end", GOOD.encode() + bytes(9), "bad-usd", "cannot be read as USD"),
    usd("A1 nothing", b"", "bad-usd", "cannot be read as USD"),
    usd("A1 a head alone", HEAD, "no-such-prim"),
    usd("A7 200 levels", deep(200), prim="/a"),
    usd("A7 1,000 levels", deep(1000), "bad-usd", "levels deep", "/a"),
    usd("A7 40,000 levels", deep(40_000), "bad-usd", "brings down", "/a"),
    usd(
        "A7 50,000 dictionaries",
        HEAD + 'def Mesh "ground" (\ncustomData = ' + "{dictionary a = " * 50_000 + "{}" + "}" * 50_000 + "\n)\n{\n}\n",
        "bad-usd",
        "brings down",
    ),
    usd("A7 a chain of 300 references", chain(300), "bad-usd", "levels deep", "/p299"),
    usd("M7 a reference to itself", HEAD + refers("ground", "</ground>"), "bad-usd", "does not hold together"),
    usd(
        "M7 two that refer to each other",
        HEAD + refers("ground", "</b>") + refers("b", "</ground>"),
        "bad-usd",
        "does not hold together",
    ),
    usd("M7 a reference within the file", HEAD + refers("ground", "</b>") + 'def Xform "b"\n{\n' + MESH + "}\n"),
    usd("M7 a file outside", HEAD + refers("ground", "@../../etc/passwd.usda@"), "bad-path", "outside"),
    usd("M7 an address", HEAD + refers("ground", "@http://example.com/a.usda@"), "bad-path", "address"),
    usd("M7 an expression", HEAD + refers("ground", '@`"${A}.usda"`@'), "bad-path", "expression"),
    usd("M4 counts of 2^31", GOOD.replace("[3, 3]", "[2147483647, 3]"), "bad-mesh", "number of corners"),
    usd("M4 counts below 0", GOOD.replace("[3, 3]", "[-3, 9]"), "bad-mesh"),
    usd("M4 indices below 0", GOOD.replace("[0, 1, 2,", "[0, -1, 2,"), "bad-mesh", "not there"),
    usd("M4 indices beyond", GOOD.replace("[0, 1, 2,", "[0, 99, 2,"), "bad-mesh", "not there"),
    usd("M5 nan", GOOD.replace("(-100, 0, -100)", "(nan, 0, 0)"), "bad-mesh", "not a finite point"),
    usd("M5 1e999", GOOD.replace("(-100, 0, -100)", "(1e999, 0, 0)"), "bad-mesh", "not a finite point"),
    usd("M5 no points", GOOD.replace("[(-100, 0, -100), (-100, 0, 100), (100, 0, 100), (100, 0, -100)]", "[]"), "bad-mesh"),
    usd("M10 metres a unit: nan", GOOD.replace("0.001", "nan"), "bad-usd", "metersPerUnit"),
    usd("M10 metres a unit: 0", GOOD.replace("0.001", "0"), "bad-usd", "metersPerUnit"),
    usd("M10 metres a unit: -1", GOOD.replace("0.001", "-1"), "bad-usd", "metersPerUnit"),
    usd("N7 time codes a second: 0", GOOD.replace("Second = 24", "Second = 0"), "bad-usd", "timeCodesPerSecond"),
    usd("N7 time codes a second: nan", GOOD.replace("Second = 24", "Second = nan"), "bad-usd", "timeCodesPerSecond"),
    usd("Y18 a matrix of zeros", within(placed("0, 0, 0, 0")), "bad-mesh", "no face with an area", "/set"),
    usd("Y18 a matrix of nan", within(placed("nan, 0, 0, 0")), "bad-mesh", "not a finite point", "/set"),
    usd(
        "Y18 an order of what is not there",
        within('uniform token[] xformOpOrder = ["xformOp:nothing", "garbage"]'),
        "bad-usd",
        "",
        "/set",
    ),
    usd("M8 a package", package("set.usda", GOOD.encode()), file="set.usdz"),
    usd("M8 a package of levels", package("set.usda", deep(40_000).encode()), "bad-usd", "brings down", "/a", "set.usdz"),
    usd("M8 a package with a name that leaves", package("../../set.usda", GOOD.encode()), "bad-usd", "leaves", file="set.usdz"),
    usd("M11 a picture", b"\x89PNG\r\n\x1a\n" + bytes(90), "bad-usd", "cannot be read as USD", file="set.usd"),
    usd(
        "M3 a crate whose table lies",
        b"PXR-USDC" + bytes([0, 8, 0, 0, 0, 0, 0, 0]) + struct.pack("<q", 2**62) + bytes(64),
        "bad-usd",
        "cannot be read as USD",
        file="set.usdc",
    ),
    usd("M3 a crate of nothing else", b"PXR-USDC" + b"\xff" * 80, "bad-usd", "cannot be read as USD", file="set.usdc"),
]
SLOW = [
    usd(
        "A7 100,000 parentheses",
        HEAD + 'def Mesh "ground"\n{\npoint3f[] points = ' + "(" * 100_000 + ")" * 100_000 + "\n}\n",
        "bad-usd",
    ),
    usd("A23 2^23 prims", chain(24, twice=True), "bad-usd", "", "/p23"),
    usd("A23 2^40 instances", chain(41, twice=True, instanced=True), "bad-usd", "", "/p40"),
    usd("A7 a chain of 20,000 references", chain(20_000), "bad-usd", "", "/p19999"),
]
