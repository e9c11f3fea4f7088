"""glTF files as agent definitions: what is in them by hand, the three kinds of keys, and files that are damaged."""

from __future__ import annotations

import copy
import io
import json
import random
import struct
from dataclasses import replace
from pathlib import Path
from typing import Any

import gltf_bodies
import numpy as np
import pytest
from PIL import Image

from antdsl import limits
from antdsl.bodies.agents.boxes import compute_rest_box
from antdsl.bodies.agents.definition import Binding, BodyError, Definition
from antdsl.bodies.files.gltf.gltf_body import read_gltf
from antdsl.bodies.files.reading import read_definition
from antdsl.bodies.files.writing import write_gltf
from antdsl.bodies.posed_body import PosedBody
from antdsl.scene.paths import PathRefused


def nothing_beside(path: str, cap: int) -> bytes:
    raise PathRefused("no-such-file", f"there is no file `{path}`")


def body_of(tree: dict[str, Any], data: bytes) -> Definition:
    return read_gltf(gltf_bodies.binary(tree, data), "arm", nothing_beside, 20.0)[0]


@pytest.fixture(scope="module")
def arm() -> Definition:
    return body_of(*gltf_bodies.arm())


def test_nodes_are_joints_and_the_node_of_a_skin_is_none(arm: Definition) -> None:
    assert arm.rig.names == ("root", "elbow") and arm.rig.parents.tolist() == [-1, 0]
    assert arm.rig.rest_matrices[:, :3, 3].tolist() == [[0, 1, 0], [0, 2, 0]]
    assert [(each.name, each.default) for each in arm.rig.channels] == [("arm.smile", 0.25)]
    assert (arm.front, arm.up, arm.unit) == ((0.0, 0.0, 1.0), (0.0, 1.0, 0.0), 1000.0)


def test_a_mesh_is_a_shape_with_all_that_deformers_need(arm: Definition) -> None:
    shape = arm.shapes["arm"]
    assert (shape.points == gltf_bodies.POINTS).all() and shape.faces.tolist() == [[0, 1, 2], [1, 3, 2], [2, 3, 4]]
    assert shape.normals is not None and shape.uvs is not None and shape.uvs[3].tolist() == [0.25, 0.5]
    assert shape.attributes["id"].tolist() == [10, 11, 12, 13, 14] and shape.attributes["id"].dtype == np.int64
    assert shape.materials == ("shell",) and arm.materials["shell"] == pytest.approx((0.8, 0.4, 0.2))
    capture = shape.capture
    assert capture is not None and capture.names == ("root", "elbow")
    assert capture.weights.tolist() == [[1, 0], [0.75, 0.25], [0.5, 0.5], [1, 0], [1, 0]]  # made to add up to 1
    assert capture.joints[3].tolist() == [1, 0] and capture.inverse_matrices[1, :3, 3].tolist() == [0, -2, 0]
    assert arm.layers["body"].deforming == (Binding("", "arm", deformer="blendshape+linearskinning"),)
    assert [part.tolist() for part in compute_rest_box(arm)] == [[0, 1, 0], [1, 5, 1]]  # the skin, where the joints put it


def test_values_may_lie_between_others_and_stand_for_shares() -> None:
    row = np.dtype([("P", "<i2", 3), ("pad", "<i2"), ("W", "u1", 4), ("J", "u1", 4)])
    rows = np.zeros(3, row)
    rows["P"], rows["W"], rows["J"] = [[0, 0, 0], [32767, 0, 0], [0, -32768, 16384]], [255, 0, 0, 0], [1, 0, 0, 0]
    rows["W"][2] = (51, 204, 0, 0)
    data = rows.tobytes()
    view = {"buffer": 0, "byteLength": len(data), "byteStride": row.itemsize}

    def accessor(start: int, kind: int, width: str, shares: bool) -> dict[str, Any]:
        return {"bufferView": 0, "byteOffset": start, "componentType": kind, "count": 3, "type": width, "normalized": shares}

    tree = {
        "asset": {"version": "2.0"}, "extensionsRequired": ["KHR_mesh_quantization"], "buffers": [{"byteLength": len(data)}],
        "bufferViews": [view],
        "accessors": [accessor(0, 5122, "VEC3", True), accessor(8, 5121, "VEC4", True), accessor(12, 5121, "VEC4", False)],
        "meshes": [{"name": "m", "primitives": [{"attributes": {"POSITION": 0, "WEIGHTS_0": 1, "JOINTS_0": 2}}]}],
        "skins": [{"joints": [0, 1]}], "nodes": [{"name": "a"}, {"name": "b"}, {"mesh": 0, "skin": 0}],
    }  # fmt: skip
    shape = body_of(tree, data).shapes["m"]
    assert shape.points == pytest.approx(np.array([[0, 0, 0], [1, 0, 0], [0, -1, 16384 / 32767]]))
    assert shape.capture is not None and shape.capture.joints[:, 0].tolist() == [1, 1, 1]
    assert shape.capture.weights == pytest.approx(np.array([[1, 0], [1, 0], [0.2, 0.8]]))


def textured(tree: dict[str, Any], data: bytes, image: bytes) -> bytes:
    """The file with an image as the base colour texture of its first material."""
    start = len(data) + -len(data) % 4
    tree["bufferViews"].append({"buffer": 0, "byteOffset": start, "byteLength": len(image)})
    tree["images"] = [{"bufferView": len(tree["bufferViews"]) - 1, "mimeType": "image/png"}]
    tree["textures"] = [{"source": 0}]
    tree["materials"][0]["pbrMetallicRoughness"]["baseColorTexture"] = {"index": 0}
    data = data.ljust(start, b"\0") + image
    tree["buffers"] = [{"byteLength": len(data)}]
    return gltf_bodies.binary(tree, data)


def png(colours: list[list[tuple[int, int, int]]]) -> bytes:
    file = io.BytesIO()
    Image.fromarray(np.array(colours, np.uint8)).save(file, "PNG")
    return file.getvalue()


def test_a_texture_becomes_the_colours_of_points() -> None:
    tree, data = gltf_bodies.arm()
    plain, _ = read_gltf(gltf_bodies.binary(*gltf_bodies.arm()), "arm", nothing_beside, 20.0)
    body, notes = read_gltf(textured(tree, data, png([[(255, 0, 0)] * 4] * 4)), "arm", nothing_beside, 20.0)
    assert not notes and "Cd" not in plain.shapes["arm"].attributes
    assert body.shapes["arm"].attributes["Cd"] == pytest.approx(np.tile([1.0, 0.0, 0.0], (len(body.shapes["arm"].points), 1)))
    body = replace(body, length=1.0)
    worn = PosedBody(body, ())
    red = worn.material_colours[worn.material_names == "shell"]
    assert len(red) and red == pytest.approx(np.tile([body.materials["shell"][0], 0.0, 0.0], (len(red), 1)), abs=1e-6)
    again, _ = read_gltf(write_gltf(body, body.layers["body"], text=False)[0], "arm", nothing_beside, 20.0)
    assert again.shapes["arm"].attributes["Cd"] == pytest.approx(body.shapes["arm"].attributes["Cd"])


@pytest.mark.parametrize(
    ("image", "says"), [(b"GIF89a", "neither PNG nor JPEG"), (b"\x89PNG\r\n\x1a\n damaged", "cannot be read as PNG")]
)
def test_a_texture_that_cannot_be_read_is_reported(image: bytes, says: str) -> None:
    body, notes = read_gltf(textured(*gltf_bodies.arm(), image), "arm", nothing_beside, 20.0)
    assert len(notes) == 1 and notes[0].startswith("the texture of `shell` is not read") and says in notes[0]
    assert "Cd" not in body.shapes["arm"].attributes


def test_a_texture_with_too_many_pixels_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("antdsl.limits.MAX_TEXTURE_PIXELS", 10)
    tree, data = gltf_bodies.arm()
    notes = read_gltf(textured(tree, data, png([[(255, 0, 0)] * 4] * 4)), "arm", nothing_beside, 20.0)[1]
    assert len(notes) == 1 and "16 pixels, which is too many" in notes[0]


def test_a_morph_target_is_a_shape_to_blend_with(arm: Definition) -> None:
    blend = arm.shapes["arm"].blend
    assert blend is not None and (blend.shapes, blend.channels) == (("arm.smile",), ("arm.smile",))
    assert (arm.shapes["arm.smile"].points - arm.shapes["arm"].points).tolist() == gltf_bodies.SMILE


def test_keys_are_sampled_by_their_kind(arm: Definition) -> None:
    bend, hop, smile = (arm.clips[name] for name in ("bend", "hop", "smile"))
    assert (bend.sample_count, bend.rate, bend.duration, bend.joints) == (21, 20.0, 1.0, ("elbow",))
    angle = 2 * np.arctan2(bend.rotation[:, 0, 2], bend.rotation[:, 0, 3])
    assert np.abs(angle - np.linspace(0, np.pi / 2, 21)).max() < 1e-6  # evenly, not along the chord
    assert (bend.translation[:, 0] == (0, 2, 0)).all()  # what is not animated is the node's own
    assert hop.translation[:20, 0, 1].tolist() == [1] * 20 and hop.translation[20, 0, 1] == 3
    t = np.linspace(0, 1, 21)
    assert np.abs(hop.translation[:, 1, 0] - (t**3 - 2 * t**2 + t)).max() < 1e-6  # leaves with a tangent of 1 a second
    assert (smile.joints, smile.channels) == ((), ("arm.smile",))
    assert smile.values[[0, 10, 15, 20], 0].tolist() == [0, 1, 0.75, 0.5]


def apply_body_extras(extras: Any) -> Definition:
    tree, data = gltf_bodies.arm()
    tree["animations"][0]["extras"] = {"antdsl": extras}
    return body_of(tree, data)


def test_extras_of_an_animation_hold_what_gltf_has_no_place_for(arm: Definition) -> None:
    rate = 20 * (1 + 1e-9)  # float32 keys do not tell it from 20
    bend = apply_body_extras({"rate": rate, "loop": False, "stride": 1.5, "marks": {"top": 0.25}, "feet": False}).clips["bend"]
    assert (bend.rate, bend.loop, bend.stride, bend.marks, bend.feet) == (rate, False, 1.5, {"top": 0.25}, False)
    assert bend.sample_count == 21 and bend.duration == 20 / rate
    assert apply_body_extras({"rate": 10}).clips["bend"].sample_count == 11
    plain = arm.clips["bend"]
    assert (plain.rate, plain.loop, plain.stride, plain.marks, plain.feet) == (20.0, True, 0.0, {}, True)


@pytest.mark.parametrize(
    "extras", [7, {"rate": "fast"}, {"rate": 0}, {"stride": -1}, {"loop": 1}, {"marks": [1]}, {"marks": {"a": "b"}}]
)
def test_extras_that_are_none_of_ours_are_refused(extras: Any) -> None:
    with pytest.raises(BodyError, match="unknown extras `antdsl` in the clip `bend`"):
        apply_body_extras(extras)


def test_keys_at_the_samples_are_taken_as_they_are() -> None:
    values = np.array([[0.1, 0.7, 0.3], [0.9, 0.2, 0.6], [0.4, 0.5, 0.8]], np.float32)
    tree, data = gltf_bodies.arm()
    times = (np.arange(3) / 90).astype(np.float32)
    for array in (times, values):
        tree["bufferViews"].append({"buffer": 0, "byteOffset": len(data), "byteLength": array.nbytes})
        kind = "VEC3" if array.ndim == 2 else "SCALAR"
        view = len(tree["bufferViews"]) - 1
        tree["accessors"].append({"bufferView": view, "componentType": 5126, "count": 3, "type": kind})
        data += array.tobytes()
    sampler = {"input": len(tree["accessors"]) - 2, "output": len(tree["accessors"]) - 1}
    channel = {"sampler": 0, "target": {"node": 0, "path": "translation"}}
    tree["animations"] = [{"name": "shake", "samplers": [sampler], "channels": [channel], "extras": {"antdsl": {"rate": 90}}}]
    tree["buffers"][0]["byteLength"] = len(data)
    assert body_of(tree, data).clips["shake"].translation[:, 0].tobytes() == values.tobytes()


def test_normals_have_length_1_and_the_material_state_has_no_colour() -> None:
    tree, data = gltf_bodies.arm()
    tree["materials"][0]["name"] = "state"
    normals = np.array([[0, 0, 127, 0], [90, 90, 0, 0], [0, -127, 0, 0], [73, 73, 74, 0], [0, 0, 0, 0]], np.int8)
    tree["bufferViews"].append({"buffer": 0, "byteOffset": len(data), "byteLength": 20, "byteStride": 4})
    view = len(tree["bufferViews"]) - 1
    accessor = {"bufferView": view, "componentType": 5120, "normalized": True, "count": 5, "type": "VEC3"}
    tree["accessors"].append(accessor)
    tree["buffers"][0]["byteLength"] = len(data) + 20
    tree["meshes"][0]["primitives"][0]["attributes"]["NORMAL"] = len(tree["accessors"]) - 1
    body = body_of(tree, data + normals.tobytes())
    shape = body.shapes["arm"]
    assert shape.normals is not None
    assert np.abs(np.linalg.norm(shape.normals, axis=1) - 1).max() < 1e-6
    assert shape.normals[4].tolist() == [0, 1, 0], "a normal without length points up"
    assert shape.materials == ("state",) and "state" not in body.materials


def test_text_and_binary_say_the_same_and_buffers_may_lie_beside(arm: Definition, tmp_path: Path) -> None:
    tree, data = gltf_bodies.arm()
    (tmp_path / "inside.gltf").write_bytes(gltf_bodies.text(tree, data))
    (tmp_path / "beside.gltf").write_text(
        json.dumps({**tree, "buffers": [{"byteLength": len(data), "uri": "parts/my%20arm.bin"}]})
    )
    (tmp_path / "parts").mkdir()
    (tmp_path / "parts" / "my arm.bin").write_bytes(data)
    for name in ("inside.gltf", "beside.gltf"):
        definition, report = read_definition(tmp_path / name)
        assert definition is not None and not report.diagnostics, report.diagnostics
        assert (definition.shapes["arm"].points == arm.shapes["arm"].points).all() and definition.length == 1.0
    (tmp_path / "beside.gltf").write_text(json.dumps({**tree, "buffers": [{"byteLength": 4, "uri": "../arm.bin"}]}))
    definition, report = read_definition(tmp_path / "beside.gltf")
    assert definition is None and [each.code for each in report.errors] == ["bad-path"]


def test_strips_fans_shared_meshes_and_mirrored_nodes() -> None:
    writer = gltf_bodies.Writer()
    corners = writer.add([[0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 1, 0], [0, 2, 0]])
    primitives = [{"attributes": {"POSITION": corners}, "mode": mode} for mode in (5, 6)]
    nodes = [{"name": "a", "mesh": 0}, {"name": "a", "mesh": 0, "scale": [-1, 1, 1]}]
    definition = body_of(writer.tree({"nodes": nodes, "meshes": [{"primitives": primitives}]}), bytes(writer.data))
    shape = definition.shapes["a"]
    assert shape.faces.tolist() == [[0, 1, 2], [2, 1, 3], [2, 3, 4], [1, 2, 0], [2, 3, 0], [3, 4, 0]]
    assert definition.rig.names == ("a", "a_2") and definition.rig.rest_matrices[1, 0, 0] == -1
    assert definition.layers["body"].static == (Binding("a", "a"), Binding("a_2", "a"))


def test_a_mesh_with_morph_targets_at_a_node_is_blended_and_follows_that_node() -> None:
    tree, data = gltf_bodies.arm()
    tree["nodes"] = [{"name": "stand", "translation": [0, 7, 0], "mesh": 0, "weights": [0.5]}]
    tree |= {"skins": [], "animations": [], "scenes": [{"nodes": [0]}]}
    definition = body_of(tree, data)
    assert definition.layers["body"].deforming == (Binding("", "arm", deformer="blendshape+linearskinning"),)
    capture = definition.shapes["arm"].capture
    assert capture is not None and capture.names == ("stand",) and (capture.weights == 1).all()
    assert [part.tolist() for part in compute_rest_box(definition)] == [[0, 7, 0], [1, 11, 1]]
    assert definition.rig.channels[0].default == 0.5


def changed(change: Any) -> str:
    tree, data = gltf_bodies.arm()
    change(tree)
    with pytest.raises(BodyError) as why:
        body_of(tree, data)
    return str(why.value)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda t: t["asset"].update(version="1.0"), "is glTF 1.0"),
        (lambda t: t.update(extensionsRequired=["KHR_draco_mesh_compression"]), "is compressed with Draco"),
        (lambda t: t.update(extensionsRequired=["ACME_bones"]), "needs the extension `ACME_bones`"),
        (lambda t: t["nodes"][1].update(children=[0]), "circle"),
        (lambda t: t["nodes"][2].update(children=[1]), "two parents"),
        (lambda t: t["skins"][0].update(joints=[0, 7]), "names `node` 7, but has only 3"),
        (lambda t: t["accessors"][0].update(count=10**9), "more than the limit"),
        (lambda t: t["accessors"][0].update(count=500), "too few for its content"),
        (lambda t: t["bufferViews"][0].update(byteLength=10**9), "has a buffer of"),
        (lambda t: t["meshes"][0]["primitives"][0]["attributes"].update(POSITION=5), "1 numbers where 3 are needed"),
        (lambda t: t["meshes"][0]["primitives"][0].update(indices=0), "3 numbers where 1 are needed"),
        (lambda t: t["skins"][0].update(joints=[0]), "a joint outside of its skin, which has 1 joint"),
        (
            lambda t: t["animations"][0]["samplers"][0].update(output=0),
            "has an animation with 15 values for 2 keys of 4 numbers each",
        ),
        (lambda t: t["animations"][0]["samplers"][0].update(interpolation="BOUNCE"), "`BOUNCE`"),
        (lambda t: t["scenes"][0].update(nodes=[0, 1]), "names a node twice"),
        (lambda t: t.update(nodes=[]), "names `node`"),
    ],
)
def test_what_does_not_fit_together_is_reported(change: Any, words: str) -> None:
    assert words in changed(change)


def test_keys_that_go_on_for_too_long_are_refused_before_they_are_sampled(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(limits, "MAX_CLIP_BYTES", 3000)
    assert "clips of more than" in changed(lambda tree: None)
    monkeypatch.setattr(limits, "MAX_CLIP_SAMPLES", 10)
    assert "longer than the limit" in changed(lambda tree: None)
    monkeypatch.setattr(limits, "MAX_BODY_POINTS", 9)
    assert "more than 9 points" in changed(lambda tree: None)


ODD: tuple[Any, ...] = (
    None, -1, 0, 1, 2, 5, 99999999999, 1e300, -0.5, "x", [], {}, [1], {"a": 1}, True, "weights", "translation", 2**31, "MAT4",
)  # fmt: skip


def spots(tree: Any, entries: list[tuple[Any, Any]]) -> list[tuple[Any, Any]]:
    """Every place of a tree as (holder, key)."""
    for key in list(tree) if isinstance(tree, dict) else range(len(tree)) if isinstance(tree, list) else ():
        entries.append((tree, key))
        spots(tree[key], entries)
    return entries


def damaged(draw: random.Random, tree: dict[str, Any], data: bytes) -> bytes:
    """A file with a few values, bytes or ends that are not as they were."""
    tree = copy.deepcopy(tree)
    for _ in range(draw.choice([0, 1, 1, 2, 3])):
        holder, key = draw.choice(spots(tree, []))
        if draw.random() < 0.3 and isinstance(holder, dict):
            del holder[key]
        elif draw.random() < 0.3 and isinstance(holder, list):
            holder.append(copy.deepcopy(holder[key]))
        else:
            holder[key] = copy.deepcopy(draw.choice(ODD))
    contents = bytearray(gltf_bodies.binary(tree, data))
    for _ in range(draw.choice([0, 0, 20])):
        contents[draw.randrange(len(contents) - len(data), len(contents))] = draw.randrange(256)
    return bytes(contents[: draw.randrange(len(contents))] if draw.random() < 0.1 else contents)


def test_damaged_files_are_read_or_reported() -> None:
    read = 0
    for seed in range(400):
        try:
            definition, _ = read_gltf(damaged(random.Random(seed), *gltf_bodies.arm()), "arm", nothing_beside, 20.0)
        except (BodyError, PathRefused):
            continue
        read += 1
        for shape in definition.shapes.values():
            assert np.isfinite(shape.points).all() and (shape.faces < len(shape.points)).all()
        for clip in definition.clips.values():
            assert np.isfinite(clip.translation).all() and np.isfinite(clip.rotation).all() and np.isfinite(clip.values).all()
    assert 50 < read < 350


def test_a_binary_file_that_lies_about_its_size_is_refused(tmp_path: Path) -> None:
    tree, data = gltf_bodies.arm()
    complete_file = gltf_bodies.binary(tree, data)
    for contents in (
        complete_file[:-8],
        complete_file[:15],
        complete_file[:8] + struct.pack("<I", 2**31) + complete_file[12:],
        complete_file[:12] + b"\xff" * 8 + complete_file[20:],
    ):
        (tmp_path / "arm.glb").write_bytes(contents)
        definition, report = read_definition(tmp_path / "arm.glb")
        assert definition is None and [each.code for each in report.errors] == ["bad-body"]
