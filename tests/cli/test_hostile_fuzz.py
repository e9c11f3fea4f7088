"""Good mesh files damaged at random: bits turned over, cut off, parts doubled, numbers made huge, nan or negative. Each is read
or refused in words, with bounded time; the same seed gives the same files."""

from __future__ import annotations

import random
import tracemalloc
from collections.abc import Iterator
from pathlib import Path
from time import process_time

import pytest
from cases.hostile.meshes import OBJ, STL
from cases.hostile.rows import GROUND, PROJECT, SCENE
from cases.hostile.usd import GOOD

from antdsl.pipeline import check_path
from antdsl.scene.geometry.meshes import MeshError, read_mesh

WORDS = (
    b"nan", b"-inf", b"1e999", b"-1", b"4294967295", b"9" * 60, b"0x10", b"\xff\xfe", b"\xc3\x28", b"\0", b"", b"\x1b[2J", b"1_0",
)  # fmt: skip
ENDS = (b"\r\n", b"\r", b"\n\n", b"\\\n", b" " * 5000 + b"\n", b"\xe2\x80\xa8")
LARGE = 1000  # times: parts that are doubled again and again


def damaged(good: bytes, seed: int) -> bytes:
    """One to three of all that can happen to a file."""
    draw = random.Random(seed)
    data = bytearray(good)
    for _ in range(draw.choice((1, 1, 2, 3))):
        at = draw.randrange(len(data) + 1)
        what = draw.randrange(8)
        if what == 0 and data:
            data[at - 1] ^= 1 << draw.randrange(8)
        elif what == 1:
            del data[at:]
        elif what == 2:
            del data[at : at + draw.randrange(1, 60)]
        elif what == 3:
            data[at:at] = data[at : at + draw.randrange(1, 200)] * draw.choice((1, 2, LARGE))
        elif what == 4:
            words = bytes(data).split(b" ")
            words[draw.randrange(len(words))] = draw.choice(WORDS)
            data = bytearray(b" ".join(words))
        elif what == 5:
            data = bytearray(bytes(data).replace(b"\n", draw.choice(ENDS), draw.choice((1, -1))))
        elif what == 6:
            lines = bytes(data).split(b"\n")
            draw.shuffle(lines)
            data = bytearray(b"\n".join(lines))
        else:
            data[at:at] = draw.randbytes(draw.randrange(1, 30))
    return bytes(data)


def grid(size: int) -> Iterator[tuple[int, int]]:
    return ((x, z) for x in range(size) for z in range(size))


BASES = {"a.ply": GROUND, "a.stl": STL, "a.obj": OBJ}


def read_all(name: str, seeds: range) -> tuple[int, int]:
    """How many are read, and how many refused. Nothing else may happen, and nothing take long."""
    read = 0
    for seed in seeds:
        data, began = damaged(BASES[name], seed), process_time()
        try:
            mesh = read_mesh(data, name)
            assert len(mesh.faces) and mesh.faces.max() < len(mesh.vertices)
            read += 1
        except MeshError as why:
            assert str(why).isprintable() and len(str(why)) < 400, seed
        assert process_time() - began < 2.0 + len(data) / 1e5, (seed, len(data))
    return read, len(seeds) - read


@pytest.mark.parametrize("name", BASES)
def test_damaged_meshes_are_read_or_refused(name: str) -> None:
    read, refused = read_all(name, range(600))
    assert read > 30 and refused > 30


@pytest.mark.slow
@pytest.mark.parametrize("name", BASES)
def test_many_damaged_meshes_are_read_or_refused(name: str) -> None:
    read_all(name, range(1000, 30_000))


def check_all(folder: Path, name: str, good: bytes, seeds: range) -> None:
    """Of a scene that names the file: every complaint has its place in the scene."""
    for file, data in PROJECT.items():
        (folder / file).write_bytes(data)
    value = f"{{usd: {name}, prim: /ground}}" if name.endswith(".usda") else f"{{mesh: {name}}}"
    (folder / "scene.yaml").write_bytes(SCENE.replace(b"{mesh: ground.ply}", value.encode()))
    for seed in seeds:
        (folder / name).write_bytes(damaged(good, seed))
        began = process_time()
        _, report = check_path(folder / "scene.yaml")
        for found in report.diagnostics:
            assert found.span is not None and found.span.source.path.endswith("scene.yaml"), (seed, found.message)
            assert found.message.isprintable(), (seed, found.message)
        assert process_time() - began < 3.0, seed


@pytest.mark.parametrize("name", ["ground.ply", "ground.usda"])
def test_damaged_files_are_told_at_their_place(tmp_path: Path, name: str) -> None:
    check_all(tmp_path, name, GROUND if name.endswith("ply") else GOOD.encode(), range(40))


@pytest.mark.slow
def test_many_damaged_usd_files_are_told_at_their_place(tmp_path: Path) -> None:
    check_all(tmp_path, "ground.usda", GOOD.encode(), range(100, 2000))


@pytest.mark.parametrize("name", BASES)
def test_large_text_meshes_take_memory_as_they_are_large(name: str) -> None:
    """Not a hundred bytes for each number. Lines and words are taken apart one after the other."""
    faces = [(x * 51 + z, x * 51 + z + 1, (x + 1) * 51 + z) for x, z in grid(50)]
    corners = [(float(x), 0.0, float(z)) for x, z in grid(51)]
    if name == "a.obj":
        data = "".join([f"v {x} {y} {z}\n" for x, y, z in corners] + [f"f {a + 1} {b + 1} {c + 1}\n" for a, b, c in faces])
    elif name == "a.ply":
        head = GROUND.decode().split("end_header")[0].replace("vertex 4", f"vertex {len(corners)}")
        data = head.replace("face 2", f"face {len(faces)}") + "end_header\n"
        data += "".join([f"{x} {y} {z}\n" for x, y, z in corners] + [f"3 {a} {b} {c}\n" for a, b, c in faces])
    else:
        facets = ("".join("vertex {} {} {}\n".format(*corners[k]) for k in face) for face in faces)
        data = "solid\n" + "".join(f"facet normal 0 1 0\nouter loop\n{each}endloop\nendfacet\n" for each in facets) + "endsolid\n"
    text = data.encode()
    tracemalloc.start()
    mesh = read_mesh(text, name)
    _, most = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert len(mesh.faces) == len(faces) and most < 12 * len(text) + 1e6
