"""Head, abdomen and load take room in contacts, where a species has `body_contacts`."""

from __future__ import annotations

import numpy as np
import pytest
from test_contacts import plan_of, points

from antdsl.bodies.library import load_library_body
from antdsl.runtime import Options, World, bind, state_hash, step
from antdsl.runtime.moving.contacts.capsules import CapsuleCrowd, measure_overlap_depths
from antdsl.scene.library_bodies import CAPSULE_BY_BODY, COMPLETE_CAPSULE_BY_BODY, LOAD_FRONT_BY_BODY
from antdsl.scene.setting import CrowdData, WorldSetting

CRAWLING = ("ant", "ant_queen", "ant_soldier", "roach", "spider")
TRUNK_WORDS = ("thorax", "head", "mandible", "petiole", "gaster", "abdomen")
TEXT = """ant 2
species ant {{
  size 10 mm
  max_speed 30 mm/s
  {line}
  on spawn {{ velocity = 0 * velocity }}
  start rest
  state rest {{ when id == 1 -> carry; steer 0 * heading }}
  state carry {{ wear load; steer 0 * heading }}
}}
"""


def world_of(text: str, *crowds: CrowdData, options: Options | None = None) -> World:
    return bind(plan_of(text), WorldSetting(crowds=crowds, seed=3, contacts="hard"), options or Options(backend="numpy"))


def trunk_points(name: str) -> np.ndarray:
    """The points of head, trunk and abdomen of a body at rest, in body lengths: ahead, up and aside."""
    body = load_library_body(name)
    results = []
    for binding in body.layers["body"].deforming:
        shape = body.shapes[binding.shape]
        assert shape.capture is not None
        joints = shape.capture.joints[np.arange(len(shape.points)), shape.capture.weights.argmax(axis=1)]
        expected = [any(word in name for word in TRUNK_WORDS) for name in shape.capture.names]
        results.append(shape.points[np.array(expected)[joints]] @ body.compute_base_matrix()[:3, :3].T / body.length)
    return np.concatenate(results)


@pytest.mark.parametrize("name", CRAWLING)
def test_the_whole_capsule_holds_head_trunk_and_abdomen_and_little_more(name: str) -> None:
    shape, at = COMPLETE_CAPSULE_BY_BODY[name], trunk_points(name)
    radius = shape.width / 2
    ahead = np.abs(at[:, 0] - shape.forward_offset) - (shape.length / 2 - radius)
    far = np.hypot(np.maximum(ahead, 0), at[:, 2]) - radius  # seen from above
    assert far.max() < 0.09 and (far > 0.02).mean() < 0.12  # the tips of mandibles stand out
    tips = at[:, 0].max(), at[:, 0].min()
    assert np.allclose(tips, (shape.forward_offset + shape.length / 2, shape.forward_offset - shape.length / 2), atol=0.01)
    assert abs(np.abs(at[:, 2]).max() - radius) < 0.03 or name == "ant"
    assert shape.length > CAPSULE_BY_BODY[name].length and shape.width >= CAPSULE_BY_BODY[name].width


@pytest.mark.parametrize("name", [name for name in CRAWLING if name in LOAD_FRONT_BY_BODY])
def test_the_front_of_a_load_is_where_the_layer_has_it(name: str) -> None:
    body = load_library_body(name)
    (binding,) = body.layers["load"].static or body.layers["load"].deforming
    points = body.shapes[binding.shape].points @ body.compute_base_matrix()[:3, :3].T / body.length
    assert LOAD_FRONT_BY_BODY[name] == pytest.approx(points[:, 0].max(), abs=2e-3)
    assert np.abs(points[:, 2]).max() < COMPLETE_CAPSULE_BY_BODY[name].width / 2  # the capsule is as wide


@pytest.mark.parametrize(("line", "capsules"), [("", COMPLETE_CAPSULE_BY_BODY), ("body_contacts false", CAPSULE_BY_BODY)])
def test_the_edition_and_the_setting_choose_the_capsule(line: str, capsules: dict) -> None:
    crowd = CapsuleCrowd(world_of(TEXT.format(line=line), CrowdData("ant", 1, points((0.0, 0.0)), body="ant_soldier")))
    shape = capsules["ant_soldier"]
    assert crowd.radius[0] == pytest.approx(shape.width * 5) and crowd.half[0] == pytest.approx((shape.length - shape.width) * 5)
    assert crowd.ahead[0] == pytest.approx(shape.forward_offset * 10)


def test_a_load_extends_the_capsule_while_it_is_carried() -> None:
    built = world_of(TEXT.format(line=""), CrowdData("ant", 2, points((0.0, 0.0), (90.0, 0.0))))
    for _ in range(2):
        step(built)
    crowd, shape, front = CapsuleCrowd(built), COMPLETE_CAPSULE_BY_BODY["ant"], LOAD_FRONT_BY_BODY["ant"] * 10
    carries = built.populations["ant"].now["wear#load"]
    assert carries.tolist() == [row_id == 1 for row_id in built.populations["ant"].ids] and crowd.bounds is None
    tip, tail = crowd.ahead + crowd.half + crowd.radius, crowd.ahead - crowd.half - crowd.radius
    assert np.allclose(tip, np.where(carries, front, (shape.forward_offset + shape.length / 2) * 10))
    assert np.allclose(tail, (shape.forward_offset - shape.length / 2) * 10) and np.allclose(crowd.radius, shape.width * 5)
    heading = np.stack([built.populations["ant"].now[f"heading.{axis}"] for axis in "xyz"])
    middle = built.populations["ant"].position.T + heading * crowd.ahead
    assert np.allclose(crowd.middle[[0, 2]], middle[[0, 2]], atol=1e-5)
    assert np.allclose(crowd.reach - crowd.half, crowd.radius * 1.6)


def test_soldiers_face_to_face_make_room_for_their_heads_with_any_options() -> None:
    hashes, positions = set(), [(x * 2.2, z * 2.2) for x in range(6) for z in range(6)]
    for options in (
        Options(backend="numpy"),
        Options(backend="reference", shuffle_rows=3),
        Options(backend="native", wait_for_code=True, threads=2, chunk=64),
    ):
        built = world_of(TEXT.format(line=""), CrowdData("ant", 36, points(*positions), body="ant_soldier"), options=options)
        began = (measure_overlap_depths(built) > 0.05).mean()
        for _ in range(24):
            step(built)
        hashes.add(state_hash(built))
        assert began == 1.0 and (measure_overlap_depths(built) > 0.05).mean() == 0.0
    assert len(hashes) == 1
