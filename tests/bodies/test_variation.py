"""Bodies of one definition that differ by id: parts as large, and materials of the colours, that the definition allows."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from antdsl.bodies.agents.definition import Definition, use_language_names
from antdsl.bodies.agents.driving import PoseAdjustments
from antdsl.bodies.agents.packed import hash_definition, pack_definition
from antdsl.bodies.agents.varied_bodies import VariationDraws
from antdsl.bodies.files.reading import read_definition
from antdsl.bodies.posed_body import PosedBody
from antdsl.diagnostics import Report
from antdsl.outputs.cache.body_arrays import unpack_checked_definition

BLOCK = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
VARIATION = {"scale": {"Head": [0.5, 2.0], "half": [1, 3]}, "materials": {"fur": [[1, 0, 0], [0, 1, 0], [0, 0, 1]]}}
BODY = {
    "antdsl_body": 1, "name": "bug", "length": 1,
    "rig": {
        "rig_version": 1, "transforms": {"root": ["neck", "tail"], "neck": ["nose"], "nose": [], "tail": []},
        "antdsl_rest": {"neck": [[1, 0, 0, 5], [0, 1, 0, 2], [0, 0, 1, 0], [0, 0, 0, 1]],
                        "nose": [[1, 0, 0, 1], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]},
    },
    "shapes": [{"file": "block.obj", "name": "bare", "material": "skin"},
               {"file": "block.obj", "name": "furry", "material": "fur"}],
    "materials": {"fur": [0.2, 0.2, 0.2], "skin": [0.5, 0.4, 0.3]},
    "layers": [{"version": 2, "name": "body", "deforming": [], "static": [
        {"transform": "root", "shape": "bare"}, {"transform": "neck", "shape": "bare"}, {"transform": "nose", "shape": "furry"},
        {"transform": "tail", "shape": "bare"}]}],
    "groups": [{"version": 2, "name": "Head", "members": [{"name": "neck"}, {"name": "nose"}]},
               {"version": 2, "name": "half", "members": [{"name": "tail", "weight": 0.5}]}],
    "variation": VARIATION,
}  # fmt: skip
COUNT = 200


def read(folder: Path, **fields: object) -> tuple[Definition | None, Report]:
    (folder / "block.obj").write_text(BLOCK)
    (folder / "bug.json").write_text(json.dumps({**BODY, **fields}))
    return read_definition(folder / "bug.json")


def posed(body: PosedBody, draws: VariationDraws | None) -> np.ndarray:
    """Points [n, 4 shapes, 4, 3]."""
    points = body.pose_vertices([], COUNT, driven_pose=PoseAdjustments(variation_draws=draws))[0]
    return points.reshape(COUNT, 4, 4, 3)


def test_parts_are_as_large_as_their_agent_has_them(tmp_path: Path) -> None:
    body, report = read(tmp_path)
    assert body is not None and not report.sort_by_place()
    drawn, ids = PosedBody(use_language_names(body), ()), np.arange(COUNT)
    points, rest = posed(drawn, VariationDraws(ids, 3, "bug")), posed(drawn, None)
    # a block with a corner at its joint: its edge ahead says how large it is
    size = np.linalg.norm(points[:, :, 1] - points[:, :, 0], axis=2)
    root, neck, nose, tail = size.T
    assert root == pytest.approx(1, abs=1e-5) and 0.5 <= neck.min() < 0.6 and 1.9 < neck.max() <= 2.0
    assert nose == pytest.approx(neck, abs=1e-5), "it hangs on the neck, and is not scaled twice"
    assert points[:, 2, 0, 0] == pytest.approx(5 + neck, abs=1e-4), "and is as far from it as it is large"
    assert 1 <= tail.min() < 1.1 and 1.9 < tail.max() <= 2, "half of once to three times as large"
    assert abs(np.corrcoef(neck, tail)[0, 1]) < 0.2
    assert (rest == rest[:1]).all() and np.array_equal(points[:, 0], rest[:, 0])
    again = posed(drawn, VariationDraws(ids[::-1], 3, "bug"))
    assert np.array_equal(again[::-1], points), "who else is there changes nothing"
    assert not np.allclose(posed(drawn, VariationDraws(ids, 4, "bug")), points), "another seed, another crowd"


def test_materials_lie_on_the_way_through_their_colours(tmp_path: Path) -> None:
    body, _ = read(tmp_path)
    assert body is not None
    drawn = PosedBody(use_language_names(body), ())
    driven = PoseAdjustments(variation_draws=VariationDraws(np.arange(COUNT), 3, "bug"))
    colours = drawn.compute_colours(driven).reshape(COUNT, 4, 4, 3)
    fur, skin = colours[:, 2, 0], colours[:, [0, 1, 3]]
    assert np.allclose(skin, [0.5, 0.4, 0.3]) and fur.sum(axis=1) == pytest.approx(1, abs=1e-5)
    assert not (fur[:, 0] * fur[:, 2]).any() and fur.max(axis=0).min() > 0.9, "from red through green to blue"
    assert drawn.compute_colours(PoseAdjustments()).shape == (1, 16, 3)


def test_a_cache_keeps_it_and_a_body_without_is_as_it_was(tmp_path: Path) -> None:
    body, _ = read(tmp_path)
    assert body is not None
    again = unpack_checked_definition(pack_definition(use_language_names(body)))
    assert dict(again.variation.scales) == {"head": (0.5, 2.0), "half": (1.0, 3.0)}
    assert again.variation.materials["fur"][1] == (0, 1, 0) and hash_definition(again) == hash_definition(
        use_language_names(body)
    )
    plain, _ = read(tmp_path, variation={})
    assert plain is not None and b"variation" not in pack_definition(plain)["text"].tobytes()


@pytest.mark.parametrize(
    ("variation", "message"),
    [
        ({"scale": {"Heed": [0.5, 2]}}, "there is no transform group `Heed`"),
        ({"materials": {"fir": [[1, 0, 0], [0, 1, 0]]}}, "there is no material `fir`"),
        ({"materials": {"fur": [[1, 0, 0]]}}, "a material needs at least two colours to vary between, but this one has 1"),
        ({"scale": {"Head": [0, 2]}}, None),
        ({"scale": {"Head": [1]}}, None),
        ({"scale": [1, 2]}, None),
        ({"hats": 3}, None),
    ],
)
def test_mistakes_are_reported_at_their_place(variation: object, message: str | None, tmp_path: Path) -> None:
    body, report = read(tmp_path, variation=variation)
    assert body is None and message in (None, report.errors[0].message) and report.errors[0].span is not None
