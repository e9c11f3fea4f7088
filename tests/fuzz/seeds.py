"""Good and bad files that the mutation of each target begins with, and the words that it inserts. All are small, and most are the
inputs of other tests."""

from __future__ import annotations

import io
import json
import random
import struct
import tempfile
from collections.abc import Iterable
from pathlib import Path

import gltf_bodies
import houdini_files
import numpy as np
from cases.hostile import meshes, numbers, rows, usd, volumes
from fuzz.mutation import Mutator, insert_words
from houdini_files import to_binary, to_text
from random_programs import Author
from random_sensing import Sensing

from antdsl.program.tables.effects import EFFECT_BY_OPERATION
from antdsl.program.tables.senses import SENSE_BY_OPERATION
from antdsl.syntax.words import LINE_WORDS_BY_RULE, UNIT_NAMES

ROOT = Path(__file__).resolve().parents[2]
LARGEST = 40_000  # bytes of a seed


def _files(*patterns: str, cap: int = LARGEST) -> list[bytes]:
    paths = sorted(path for pattern in patterns for path in ROOT.glob(pattern))
    return [path.read_bytes() for path in paths if path.is_file() and path.stat().st_size <= cap]


def _hostile(cases: Iterable[rows.Row], *endings: str) -> list[bytes]:
    """The files with some ending that the rows of bad inputs put into a project."""
    files = [item for row in cases for item in row.files.items()]
    return [data for name, data in files if name.endswith(endings) and isinstance(data, bytes) and len(data) <= LARGEST]


def _words(*lists: Iterable[str]) -> tuple[Mutator, ...]:
    """Three shares of a mutator that inserts words."""
    return (insert_words(sorted({word.encode() for words in lists for word in words})),) * 3


def programs() -> list[bytes]:
    texts = [Author(random.Random(seed)).program().text.encode() for seed in range(12)]
    texts += [Sensing(seed).text.encode() for seed in range(12)]
    return texts + _files("examples/*/*.ant", "tests/programs/*.ant", "tests/cases/**/*.ant", cap=2500) + [rows.PROGRAM]


def program_words() -> tuple[Mutator, ...]:
    lines = [word for words in LINE_WORDS_BY_RULE.values() for word in words]
    numbers_with_units = [f"{n} {unit}" for n in ("0", "1", "2.5", "1e30") for unit in UNIT_NAMES]
    signs = ("->", "{", "}", "(", ")", "held 1 s", "for at least 2 s", "from any", "/s", "%", "# x", '"x"', "=", "+=", "until")
    return _words(lines, numbers_with_units, signs, SENSE_BY_OPERATION, EFFECT_BY_OPERATION)


def scenes() -> list[bytes]:
    return [
        rows.SCENE,
        *_hostile([*numbers.ROWS, *volumes.ROWS, *meshes.ROWS], ".yaml"),
        *_files("tests/cases/scene/*.yaml", "examples/*/*.yaml"),
    ]


def scene_words() -> tuple[Mutator, ...]:
    from antdsl.scene.scene_kinds import SCENE_KINDS

    fields = [name for kind in SCENE_KINDS.values() for each in kind.models for name in getattr(each, "model_fields", ())]
    values = (
        "ground.ply",
        "ground.obj",
        "walker.ant",
        "[0, 0, 1e300]",
        "{mesh: ground.ply}",
        "5 mm",
        "10 deg",
        "&a",
        "*a",
        "!!set",
        "<<:",
        "[",
        "]",
        "{",
        "}",
        "- ",
        "? ",
        "| ",
        "y",
        "-z",
    )
    keys = (
        "world:",
        "crowd:",
        "count: 3",
        "place: {on: ground}",
        "preroll: 2",
        "substeps: 2",
        "camera:",
        "layers:",
        "set:",
        "output:",
        "extends:",
        "start:",
        "lod:",
    )
    return _words(fields, values, keys)


def obj_files() -> list[bytes]:
    extra = b"o a\ng b c\nv 0 0 0 1 1 1\nvt 0 0\nvn 0 1 0\nv 1 0 0\nv 0 0 1\nf 1/1/1 2//1 -1\nl 1 2\nusemtl x\n"
    return [meshes.OBJ, extra, *_hostile(meshes.ROWS, ".obj"), *_files("examples/*/*.obj", cap=8000)]


def ply_files() -> list[bytes]:
    texts = [
        meshes.binary(struct.pack("<B3i", 3, 0, 1, 2) * 2, 2),
        meshes.binary(struct.pack(">B3i", 3, 0, 1, 2) * 2, 2, order="big"),
    ]
    return [rows.GROUND, *texts, *_hostile(meshes.ROWS, ".ply"), *_files("examples/*/*.ply", cap=8000)]


def stl_files() -> list[bytes]:
    corners = (0, 1, 0, 0, 0, 0, 10, 0, 0, 0, 0, 10)
    binary = b"ground".ljust(80) + struct.pack("<I", 2) + (struct.pack("<12f", *corners) + b"\0\0") * 2
    return [meshes.STL, binary, *_hostile(meshes.ROWS, ".stl")]


def geo_files() -> list[bytes]:
    values = [houdini_files.cube(), houdini_files.library()]
    return [form for value in values for form in (to_text(value), to_binary(value), to_binary(value, ">"))]


def geo_words() -> tuple[Mutator, ...]:
    keys = ("pointcount", "pointref", "values", "tuples", "rawpagedata", "pagesize", "packing", "constantpageflags", "run", "p_r")
    return _words([f'"{key}"' for key in keys], ("PackedFragment", "PolySoup", "r_v", "n_p", "embedded", "true", "null", "1e9"))


def clip_files() -> list[bytes]:
    return [houdini_files.CLIP.encode()]


def clip_words() -> tuple[Mutator, ...]:
    return _words(
        ("{", "}", "=", "rate", "tracklength", "tracks", "name", "data", "data_rle", "@2", "@1e9", "nan", "quaternions")
    )


def mesh_words() -> tuple[Mutator, ...]:
    obj = ("v", "vt", "vn", "f", "l", "p", "g", "o", "s", "usemtl", "mtllib", "call", "\\\n", "#")
    ply = (
        "element",
        "property",
        "list",
        "uchar",
        "int",
        "float",
        "double",
        "vertex_indices",
        "tristrips",
        "comment",
        "obj_info",
        "end_header",
        "format",
        "ascii 1.0",
        "binary_little_endian 1.0",
        "binary_big_endian 1.0",
        "vertex",
        "face",
    )
    stl = ("solid", "facet", "normal", "outer loop", "vertex", "endloop", "endfacet", "endsolid")
    return _words(obj, ply, stl)


def gltf_files() -> list[bytes]:
    tree, data = gltf_bodies.arm()
    return [gltf_bodies.binary(tree, data), gltf_bodies.text(tree, data), json.dumps(tree).encode(), *_files("examples/*/*.glb")]


def gltf_words() -> tuple[Mutator, ...]:
    keys = (
        "accessors",
        "bufferViews",
        "buffers",
        "byteOffset",
        "byteLength",
        "byteStride",
        "componentType",
        "count",
        "type",
        "sparse",
        "indices",
        "values",
        "normalized",
        "skins",
        "joints",
        "inverseBindMatrices",
        "animations",
        "channels",
        "samplers",
        "input",
        "output",
        "interpolation",
        "CUBICSPLINE",
        "STEP",
        "target",
        "path",
        "weights",
        "nodes",
        "children",
        "mesh",
        "matrix",
        "rotation",
        "scenes",
        "extensionsRequired",
        "uri",
        "data:;base64,AAAA",
        "../a.bin",
        "file:///etc/passwd",
        "mode",
        "POSITION",
        "JOINTS_0",
        "WEIGHTS_0",
        "VEC3",
        "MAT4",
        "SCALAR",
    )
    return _words(keys)


def usd_files() -> list[bytes]:
    texts = [usd.GOOD.encode(), *_hostile(usd.ROWS, ".usda", ".usdc", ".usdz"), usd.package("set.usda", usd.GOOD.encode())]
    try:
        from pxr import Usd
        from usd_bodies import write
    except ImportError:
        return texts
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "a.usdc"
        layer = Usd.Stage.CreateInMemory()
        layer.GetRootLayer().ImportFromString(usd.GOOD)
        layer.GetRootLayer().Export(str(path))
        write(Path(folder) / "b.usda")
        texts += [path.read_bytes(), usd.package("a.usdc", path.read_bytes()), (Path(folder) / "b.usda").read_bytes()]
    return texts


def usd_words() -> tuple[Mutator, ...]:
    words = (
        "def",
        "over",
        "class",
        "Xform",
        "Mesh",
        "PointInstancer",
        "Points",
        "BasisCurves",
        "Scope",
        "references",
        "payload",
        "subLayers",
        "inherits",
        "specializes",
        "instanceable = true",
        "variants",
        "prepend",
        "@./a.usda@",
        "@/etc/passwd@",
        "@set.usda@</ground>",
        "</ground>",
        "xformOp:translate",
        "xformOpOrder",
        "timeSamples",
        "int[] protoIndices",
        "rel prototypes",
        "None",
        "points",
        "faceVertexIndices",
        "faceVertexCounts",
        "holeIndices",
        "metersPerUnit",
        "upAxis",
        "purpose",
        "visibility",
        "extent",
    )
    return _words(words)


def body_files() -> list[bytes]:
    rig = {
        "rig_version": 1,
        "transforms": {"root": ["hand"], "hand": []},
        "channels": {"fist": {"default_value": 0, "transform": ""}},
    }
    layer = {"version": 2, "name": "armed", "static": [{"transform": "hand", "shape": "sword"}]}
    group = {"version": 2, "name": "arm", "members": [{"name": "hand", "weight": 0.5}], "channels": [{"name": "fist"}]}
    clip = {
        "antdsl_clip": 1,
        "name": "wave",
        "rate": 10,
        "channels": {"hand:tx": [0, 1, 0], "hand:rx": [0, 9, 0], "fist": [0, 1, 2]},
    }
    clip |= {"rotation_order": "xyz", "angles": "degrees", "loop": True, "stride": 2, "marks": {"up": 0.1}, "feet": True}
    complete_body = {
        "antdsl_body": 1, "name": "soldier", "front": "+x", "up": "+z", "units": "cm", "rig": rig, "layers": [layer],
        "shapes": [{"file": "sword.obj", "name": "sword", "units": "mm", "material": "steel"}], "clips": [clip],
        "groups": [group],
        "materials": {"steel": [0.5, 0.5, 0.6]}, "metadata": {"a": {"type": "int", "value": 2}},
    }  # fmt: skip
    outside = {"antdsl_body": 1, "from": "arm.glb", "clips": [{"clip": "bend", "name": "salute", "loop": False}], "length": 4}
    texts = [json.dumps(each).encode() for each in (complete_body, outside, rig, layer, group, clip)]
    return texts + _files("examples/*/*.json") + _legged()


def _legged() -> list[bytes]:
    from stick_bodies import write_body

    with tempfile.TemporaryDirectory() as folder:
        return [write_body(Path(folder), legs).read_bytes() for legs in (2, 6)]


def body_words() -> tuple[Mutator, ...]:
    from antdsl.bodies.files.document_model import BodyForm, list_keys

    extra_words = (
        "null",
        "true",
        "[]",
        "{}",
        '"file": "part.json"',
        '"file": "../x.json"',
        '"file": "/etc/passwd"',
        "1e999",
        "hand:sx",
        "hand:shear1",
        "\\ud800",
        "\\u0000",
        "antdsl_rest",
        "default_value",
        "upper",
        "lower",
        "foot",
        "phases",
        "duty",
        "deforming",
    )
    return _words(list_keys(BodyForm), extra_words)


def image_files() -> list[bytes]:
    from PIL import Image

    images: list[bytes] = []
    samples = (np.arange(48).reshape(6, 8) * 900).astype(np.uint16)
    for image, form in (
        (Image.fromarray(samples), "PNG"),
        (Image.fromarray(samples), "TIFF"),
        (Image.fromarray(samples.astype(np.float32)), "TIFF"),
    ):
        stream = io.BytesIO()
        image.save(stream, form)
        images.append(stream.getvalue())
    for arrays in ({"a": samples.astype(np.float64)}, {"a": samples[None].astype(np.float32), "b": samples}):
        for write in (np.savez, np.savez_compressed):
            stream = io.BytesIO()
            write(stream, **arrays)  # type: ignore[arg-type]
            images.append(stream.getvalue())
    return images
