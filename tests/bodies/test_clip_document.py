"""Clips as text: the documented channel names, angles in a stated order, parts that are left out, marks; and mistakes."""

from __future__ import annotations

import numpy as np
import pytest
from body_parts import READERS, clip_reader, read_part

from antdsl import limits
from antdsl.bodies.agents.definition import Channel, Clip, Rig
from antdsl.bodies.agents.transforms import angles_to_quaternion, compose_matrix
from antdsl.bodies.files.clip_document import write_clip
from antdsl.diagnostics import Report

ARM = np.eye(4)
ARM[:3, :3], ARM[:3, 3] = [[0, -2, 0], [1, 0, 0], [0, 0, 1]], (7, 8, 9)  # a quarter about z, y twice as long
RIG = Rig(("root", "arm"), np.array([-1, 0], np.int32), np.array([np.eye(4), ARM]), (Channel("jaw"),))


def clip_of(channels: str, extra_text: str = "", rig: Rig | None = None) -> tuple[Clip | None, Report]:
    text = f'{{"antdsl_clip": 1, "name": "walk", "rate": 10, {extra_text} "channels": {channels}}}'
    return read_part(text.encode(), clip_reader(rig), "walk.json")


TURNS = '"rotation_order": "zyx", "angles": "degrees",'


def test_channels_are_samples_and_one_number_stays_as_it_is() -> None:
    extra_text = f'{TURNS} "stride": 3, "loop": false, "marks": {{"left": 0.1}},'
    clip, report = clip_of(
        '{"arm:tx": [0, 1, 2,], "arm:ry": [0, 45, 90], "arm:rx": 90, "arm:sz": 4, "jaw": [0, 0.5, 1]}', extra_text
    )
    assert clip is not None and not report.diagnostics
    assert (clip.sample_count, clip.duration, clip.stride, clip.loop, clip.marks) == (3, 0.2, 3.0, False, {"left": 0.1})
    assert (clip.joints, clip.channels) == (("arm",), ("jaw",))
    assert clip.translation[:, 0].tolist() == [[0, 0, 0], [1, 0, 0], [2, 0, 0]] and clip.scale[2, 0].tolist() == [1, 1, 4]
    assert clip.values[:, 0].tolist() == [0, 0.5, 1] and clip.shear is None
    expected = angles_to_quaternion(np.radians([[90.0, 0, 0], [90, 45, 0], [90, 90, 0]]), "zyx")
    assert np.abs(clip.rotation[:, 0] - expected).max() < 1e-7


def test_parts_that_are_left_out_are_those_of_the_rest_pose() -> None:
    clip, _ = clip_of('{"arm:tx": [0, 1], "arm:shear2": 0.5}', rig=RIG)
    assert clip is not None and clip.shear is not None
    assert clip.translation[:, 0].tolist() == [[0, 8, 9], [1, 8, 9]] and clip.shear[0, 0].tolist() == [0, 0.5, 0]
    matrices = compose_matrix(np.array([7.0, 8, 9]), clip.rotation[0, 0].astype(float), clip.scale[0, 0].astype(float))
    assert np.abs(matrices - ARM).max() < 1e-6


def test_a_clip_that_is_written_is_read_as_it_was() -> None:
    rng = np.random.default_rng(5)
    turns = angles_to_quaternion(np.cumsum(rng.uniform(-0.6, 0.6, (30, 2, 3)), axis=0), "xyz")
    clip = Clip(
        "walk", 24.0, ("root", "arm"), rng.normal(size=(30, 2, 3)).astype(np.float32), turns.astype(np.float32),
        rng.uniform(0.5, 2, (30, 2, 3)).astype(np.float32), rng.normal(size=(30, 2, 3)).astype(np.float32),
        ("jaw",), rng.uniform(size=(30, 1)).astype(np.float32), False, 2.5, {"left": 0.25},
    )  # fmt: skip
    again, report = read_part(write_clip(clip).encode(), READERS["clip"])
    assert again is not None and again.shear is not None and clip.shear is not None, report.diagnostics
    for a, b in ((clip.translation, again.translation), (clip.scale, again.scale), (clip.shear, again.shear)):
        assert (a == b).all()
    assert (clip.values == again.values).all()
    assert np.abs(clip.rotation * np.sign((clip.rotation * again.rotation).sum(-1))[..., None] - again.rotation).max() < 1e-6
    field_names = ("name", "rate", "joints", "channels", "loop", "stride", "marks")
    assert [getattr(clip, each) for each in field_names] == [getattr(again, each) for each in field_names]


CASES = [
    ('{"arm:tx": [0, 1], "arm:ty": [0, 1, 2]}', "", "wrong-value", '"arm:ty"', 
         "give all channels the same number of samples, or a single sample"),
    ('{"arm:rx": [0, 1]}', "", "missing-key", '"arm:rx"', 'add `"rotation_order": "xyz"`'),
    ('{"arm:rx": [0, 1]}', '"rotation_order": "xyz",', "missing-key", '"arm:rx"', 'add `"angles": "degrees"`'),
    ('{"arm:rx": [0, 1]}', '"rotation_order": "xyx", "angles": "degrees",', "wrong-value", '"xyx"', 'write `"xyz"`'),
    ('{"arm:tq": [0, 1]}', "", "unknown-name", '"arm:tq"', 'write `"tz"`'),
    ('{"arm:tx": []}', "", "wrong-value", "[]", "delete the channel"),
    ('{"arm:tx": [0, 1e39]}', "", "out-of-range", "1e39", None),
    ('{"arm:tx": [0, "1"]}', "", "wrong-value", '"1"', None),
    ("{}", "", "wrong-value", "{", 'write `{"JOINT:tx": [0, 1]}`'),
    ('{"arm:tx": [0, 1]}', '"marks": {"left": 2},', "out-of-range", "2", "write `0.1`"),
    ('{"arm:tx": [0, 1]}', '"stride": -1,', "out-of-range", "-1", "write `0`"),
    ('{"arm:tx": [0, 1]}', '"loop": 1,', "wrong-value", "1", "write `true` or `false`"),
    ('{"arm:tx": [0, 1]}', '"start": 1,', "unknown-key", '"start"', None),
]  # fmt: skip


@pytest.mark.parametrize(("channels", "extra", "code", "marked", "help"), CASES)
def test_a_mistake_is_reported_at_its_place(channels: str, extra: str, code: str, marked: str, help: str | None) -> None:
    clip, report = clip_of(channels, extra)
    assert clip is None
    (error,) = report.errors
    assert error.span is not None and (error.code, error.span.text) == (code, marked), error
    assert help is None or error.help == help, error


def test_joints_and_channels_missing_from_the_rig_are_reported_and_left_out() -> None:
    clip, report = clip_of('{"arm:tx": [0, 1], "am:tx": [0, 1], "jaw": 1, "jew": 1}', rig=RIG)
    assert clip is not None and (clip.joints, clip.channels) == (("arm",), ("jaw",))
    assert [each.span.text for each in report.diagnostics if each.span] == ['"am:tx"', '"jew"'] and report.ok


def test_samples_are_counted_before_they_take_memory(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(limits, "MAX_CLIP_BYTES", 1000)
    clip, report = clip_of("{" + ", ".join(f'"j{n}:tx": [0, 1, 2, 3]' for n in range(10)) + "}")
    assert clip is None and report.errors[0].code == "too-large"
