"""Large meshes in text take memory in proportion to the file."""

from __future__ import annotations

import tracemalloc
from collections.abc import Iterator

import pytest
from cases.hostile.rows import GROUND

from antdsl.scene.geometry.mesh_files import read_mesh


def grid(size: int) -> Iterator[tuple[int, int]]:
    return ((x, z) for x in range(size) for z in range(size))


@pytest.mark.parametrize("name", ["a.ply", "a.stl", "a.obj"])
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
