"""A definition as plain arrays: what comes back is what was there, and nothing else is taken for one."""

from __future__ import annotations

import dataclasses
import json
from dataclasses import replace
from pathlib import Path

import gltf_bodies
import numpy as np
import pytest
import usd_bodies

from antdsl.bodies.agents.blending import blend_poses
from antdsl.bodies.agents.definition import BodyError, Definition, Gait, Leg
from antdsl.bodies.agents.deformers import deform_binding
from antdsl.bodies.agents.machine_clips import MachineClips, build_machine_playback
from antdsl.bodies.agents.packed import ARRAY_NAMES, Arrays, hash_definition, pack_definition
from antdsl.bodies.agents.poses import build_clip_table
from antdsl.bodies.files.reading import read_definition
from antdsl.bodies.posed_body import PosedBody
from antdsl.outputs.cache.body_arrays import unpack_checked_definition


@pytest.fixture(scope="module")
def bodies(tmp_path_factory: pytest.TempPathFactory) -> list[Definition]:
    """A skin with morph targets and animations, a UsdSkel body with in-betweens, and the walker of the example."""
    folder = tmp_path_factory.mktemp("bodies")
    (folder / "arm.glb").write_bytes(gltf_bodies.binary(*gltf_bodies.arm()))
    usd_bodies.write(folder / "body.usda")
    walker = Path(__file__).parents[2] / "examples" / "walker" / "walker.json"
    results = [read_definition(path) for path in (folder / "arm.glb", folder / "body.usda", walker)]
    assert all(body is not None for body, _ in results), [str(report) for _, report in results]
    return [body for body, _ in results if body is not None]


def same(a: object, b: object) -> bool:
    """Equal in every part, arrays to the bit and in their types. Metadata is not stored."""
    if isinstance(a, np.ndarray):
        return isinstance(b, np.ndarray) and a.dtype == b.dtype and a.shape == b.shape and a.tobytes() == b.tobytes()
    if dataclasses.is_dataclass(a):
        names = [each.name for each in dataclasses.fields(a) if each.name != "metadata"]
        return type(a) is type(b) and all(same(getattr(a, name), getattr(b, name)) for name in names)
    if isinstance(a, dict):
        return isinstance(b, dict) and list(a) == list(b) and all(same(a[key], b[key]) for key in a)
    if isinstance(a, tuple):
        return isinstance(b, tuple) and len(a) == len(b) and all(map(same, a, b))
    return type(a) is type(b) and a == b


def test_legs_gaits_and_the_idle_clip_come_back(bodies: list[Definition]) -> None:
    walker = bodies[2]
    legs = (Leg("left", "thigh_l", "shin_l", "foot_l"), Leg("right", "thigh_r", "shin_r", "foot_r", "foot_r"))
    gait = Gait("walk", 1.2, 1.4, 0.6, 0.1, (0.0, 0.5))
    clips = dict(walker.clips) | {"wave": replace(walker.clips["wave"], feet=False)}
    walker = replace(walker, legs=legs, gaits=(gait,), idle="idle", clips=clips)
    back = unpack_checked_definition(pack_definition(walker))
    assert (
        same(walker, back) and back.legs == legs and back.gaits == (gait,) and hash_definition(back) != hash_definition(bodies[2])
    )
    wrong = (
        {"legs": (replace(legs[0], foot="hips"), legs[1])}, {"legs": (legs[0], replace(legs[1], name="left"))},
        {"gaits": (replace(gait, duty=2.0),)}, {"gaits": (replace(gait, phases=(0.0,)),)},
        {"gaits": (replace(gait, stride=0.0),)}, {"idle": "stand"},
    )  # fmt: skip
    for parts in wrong:
        with pytest.raises(BodyError):
            unpack_checked_definition(pack_definition(replace(walker, **parts)))


def test_a_definition_comes_back_as_it_was(bodies: list[Definition]) -> None:
    for body in bodies:
        arrays = pack_definition(body)
        assert tuple(arrays) == ARRAY_NAMES
        back = unpack_checked_definition(arrays)
        assert same(body, back) and hash_definition(back) == hash_definition(body)
        assert build_clip_table(back).sample_rows.tobytes() == build_clip_table(body).sample_rows.tobytes()
    assert len({hash_definition(body) for body in bodies}) == 3


def test_what_is_damaged_is_no_body(bodies: list[Definition]) -> None:
    arrays = pack_definition(bodies[0])
    for part in ARRAY_NAMES:
        with pytest.raises(BodyError):
            unpack_checked_definition({name: array for name, array in arrays.items() if name != part})
        if part != "text" and arrays[part].size:
            with pytest.raises(BodyError):
                unpack_checked_definition({**arrays, part: arrays[part][:-1]})
    with pytest.raises(BodyError):
        unpack_checked_definition({**arrays, "i4": np.full_like(arrays["i4"], 1 << 30)})
    with pytest.raises(BodyError):
        unpack_checked_definition({**arrays, "f4": np.full_like(arrays["f4"], np.nan)})
    with pytest.raises(BodyError):
        unpack_checked_definition({**arrays, "f4": arrays["f4"].astype(np.float64)})


def test_any_change_of_the_text_gives_a_body_or_a_refusal(bodies: list[Definition]) -> None:
    """Values of the document are taken away, made text, negative, huge, or a list: nothing but BodyError comes of it."""
    arrays = pack_definition(bodies[2])
    document = json.loads(arrays["text"].tobytes())
    document["clips"], document["shapes"] = document["clips"][:1], document["shapes"][:1]
    refused = 0
    paths = list(_paths(document))
    for place in paths[:: max(1, len(paths) // 150)]:
        for value in (None, "x", -1, 1 << 60, [], {}, 1.5):
            refused += _refused(arrays, _changed(document, place, value))
    assert refused > 100


def _refused(arrays: Arrays, document: object) -> bool:
    try:
        unpack_checked_definition({**arrays, "text": np.frombuffer(json.dumps(document).encode(), np.uint8)})
    except BodyError:
        return True
    return False


def _paths(value: object, path: tuple[object, ...] = ()):  # type: ignore[no-untyped-def]
    yield path
    for key, inner in value.items() if isinstance(value, dict) else enumerate(value) if isinstance(value, list) else ():
        yield from _paths(inner, (*path, key))


def _changed(document: object, path: tuple[object, ...], value: object) -> object:
    if not path:
        return value
    new_document = json.loads(json.dumps(document))
    inner = new_document
    for key in path[:-1]:
        inner = inner[key]
    inner[path[-1]] = value
    return new_document


def test_a_skin_with_morph_targets_is_posed_as_a_body_of_a_crowd(bodies: list[Definition]) -> None:
    """By its deformers, in body lengths with its front ahead; its coarse form by the same without the blending."""
    body = unpack_checked_definition(pack_definition(bodies[0]))
    clips = tuple((name, "") for name in body.clips)
    posed_body, one = PosedBody(body, clips), np.ones(1, np.float32)
    plays = [MachineClips(np.zeros(1, np.int16), one / 3, one, np.full(1, -1, np.int16), one * 0, one, one * 0)]
    points, normals = posed_body.pose_vertices(plays, 1)
    table = build_clip_table(body)
    poses = blend_poses(table, body.groups, build_machine_playback(table, clips, plays, 1))
    layer = body.layers["body"]
    expected = np.concatenate([deform_binding(body, each, poses).points[0] for each in (*layer.static, *layer.deforming)])
    expected = expected @ body.compute_base_matrix()[:3, :3].T
    assert len(points[0]) and {tuple(p) for p in points[0].round(4)} == {tuple(p) for p in expected.astype(np.float32).round(4)}
    assert np.linalg.norm(normals[0], axis=1) == pytest.approx(1, abs=1e-5)
    rest = posed_body.pose_vertices([], 1)[0]
    assert np.abs(rest - points).max() > 1e-3
    # What has no material, or one without a colour, takes that of the state; so does one that is called `state`.
    named = replace(body, materials={name: (0.1, 0.2, 0.3) for shape in body.shapes.values() for name in shape.materials})
    assert (PosedBody(replace(body, materials={}), clips).tint_weights == 1).all()
    bare = {name: replace(shape, materials=(), material=None) for name, shape in body.shapes.items()}
    assert (PosedBody(replace(named, shapes=bare), clips).tint_weights == 1).all()
    one_material_shapes = {
        name: replace(shape, materials=("state",), material=shape.faces[:, 0] * 0) for name, shape in body.shapes.items()
    }
    assert (
        PosedBody(replace(body, shapes=one_material_shapes, materials={"state": (0.1, 0.2, 0.3)}), clips).tint_weights == 1
    ).all()
    rough = posed_body.coarse_body.pose_vertices(plays, 1)[0]
    assert rough.shape[1] <= points.shape[1] and np.isfinite(rough).all()
