"""The thread that owns a session: what pages ask is done between two steps, what they are shown is what the session holds, and a
run is what it is without them."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from live_client import Page, hashes
from preview_page import few

from antdsl.pipeline import simulate
from antdsl.preview import EditOutcome, LiveSimulation, PreviewSession, QueueFullError, SceneCompiler
from antdsl.runtime import state_hash


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    """A copy of the foraging ants, forty of them."""
    return few(tmp_path, 40)


@pytest.fixture
def live(scene: Path) -> Iterator[LiveSimulation]:
    live = LiveSimulation.open_scene(scene)
    live.start()
    yield live
    live.stop()


def test_a_joining_page_receives_everything(live: LiveSimulation) -> None:
    page = Page(live)
    page.frame_arrays(1)
    ops = [message["op"] for message in page.told[:6]]
    assert ops == ["hello", "scene", "texts", "problems", "status", "curves"]
    page.until(lambda: {"rig:forager", "mesh:ground", "mesh:stones", "item:food:apple"} <= page.make_packets.keys())
    texts = {text["file"]: text["kind"] for text in page.told[2]["texts"]}
    assert texts == {"scene.yaml": "yaml", "forager.ant": "ant", "<steering>": "library"}
    assert page.told[1]["charts"][0]["species"] == "forager" and len(page.told[1]["charts"][0]["boxes"]) > 4
    later = Page(live)
    later.until(lambda: later.make_packets.keys() >= page.make_packets.keys())
    assert later.make_packets == page.make_packets


def test_the_hash_is_that_of_a_run_despite_pages_and_scrubbing(live: LiveSimulation, scene: Path) -> None:
    expected = hashes(scene, 40)
    page, other = Page(live), Page(live)
    page.ask("look", columns=({"species": "forager", "name": "zeal"},), fields=("trail",), solids=True,
             follow={"species": "forager", "agent": 3})  # fmt: skip
    page.ask("step", count=30)
    assert page.hash_at(31) == expected[31]
    page.ask("seek", frame=7, exact=False)
    page.ask("seek", frame=12, exact=True)
    assert page.hash_at(12) == expected[12]
    other.ask("step", count=28)
    assert page.hash_at(40) == expected[40]
    assert not page.last("status")["edited"]


def test_it_plays_and_pauses_and_keeps_the_pace(live: LiveSimulation) -> None:
    page = Page(live)
    page.ask("step", count=20)  # the first ones prepare what the others find ready
    page.ask("speed", times=2.0)
    page.ask("play")
    page.until(lambda: (page.last("status") or {"rate": 0})["rate"] > 0 and page.frames[-1][0] > 120)
    rate = page.last("status")["rate"]
    page.ask("pause")
    status = page.status(playing=False)
    assert status["frame"] > 120 and rate < 60  # twice 24 frames a second; a busy machine has fewer
    assert [frame for frame, _ in page.frames] == sorted(frame for frame, _ in page.frames)


def test_a_saved_edit_goes_on_with_the_ants_and_an_error_leaves_them_running(live: LiveSimulation, scene: Path) -> None:
    page = Page(live)
    page.ask("step", count=5)
    page.frame_arrays(6)
    program = scene.with_name("forager.ant")
    good = program.read_text()
    number = len(page.told)
    program.write_text(good.replace("smell", "smel\N{ANT}l", 1))
    outcome = page.message_after("outcome", number)
    assert not outcome["ok"] and outcome["of"] == "saved"
    problem = page.message_after("problems", number)["problems"][0]
    program_text = {text["file"]: text["text"] for text in page.message_after("texts", number)["texts"]}["forager.ant"]
    assert problem["file"] == "forager.ant" and "\N{ANT}" in program_text
    assert program_text.encode("utf-16-le")[2 * problem["start"] : 2 * problem["end"]].decode("utf-16-le").strip()
    page.ask("step")
    page.frame_arrays(7)
    number = len(page.told)
    program.write_text(good.replace("patience = 36 s", "patience = 30 s"))
    outcome = page.message_after("outcome", number)
    assert outcome["ok"] and "kept 40 agents" in outcome["line"]
    assert page.status(edited=True)["frame"] == 7
    assert page.message_after("problems", number)["problems"] == []


def test_changes_by_hand_are_reported_with_their_line(live: LiveSimulation) -> None:
    page = Page(live)
    page.frame_arrays(1)
    outcome = page.ask_and_wait("set", name="forager.smell", value="60 mm")
    assert outcome["ok"] and outcome["text"] == "set: {forager.smell: 60 mm}" and outcome["file"] == "scene.yaml"
    param = page.until(
        lambda: next((p for p in page.last("scene")["params"] if p["name"] == "forager.smell" and p["number"] == 60), None)
    )
    assert (param["value"], param["written"], param["unit"]) == ("60 mm", "40 mm", "mm")
    layer = page.last("scene")["species"][0]["layers"][1]
    outcome = page.ask_and_wait("layer", species="forager", layer=layer["text"], on=False)
    assert outcome["ok"] and outcome["file"] == "forager.ant"
    page.until(lambda: page.last("scene")["species"][0]["layers"][1] == {**layer, "on": False})
    assert page.ask_and_wait("field", name="trail", on=False)["ok"]
    page.until(lambda: not page.last("scene")["fields"][0]["on"])
    assert not page.ask_and_wait("set", name="forager.smell", value="60 kg")["ok"]


def test_a_bug_in_a_handler_ends_nothing(
    live: LiveSimulation, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    page = Page(live)
    page.frame_arrays(1)
    monkeypatch.setattr(PreviewSession, "switch_layer", lambda *_: 1 / 0)
    refused = page.ask_and_wait("layer", species="forager", layer="x", on=True)
    assert "bug in antdsl" in refused["message"]
    assert "ZeroDivisionError" in capsys.readouterr().err
    page.ask("step")
    page.frame_arrays(2)


def test_a_scene_with_errors_opens_once_they_are_mended(scene: Path) -> None:
    program = scene.with_name("forager.ant")
    good = program.read_text()
    program.write_text(good.replace("species forager", "species forager forager"))
    live = LiveSimulation.open_scene(scene)
    live.start()
    try:
        page = Page(live)
        problems = page.until(lambda: (page.last("problems") or {"problems": []})["problems"])
        assert problems[0]["file"] == "forager.ant"
        assert "errors" in page.ask_and_wait("play")["message"]
        program.write_text(good)
        page.frame_arrays(1)
        assert page.status(agents=40)["frame"] == 1
        assert page.last("problems")["problems"] == []
    finally:
        live.stop()


def test_costs_of_steps_are_sent_to_the_requesting_page_and_change_nothing(scene: Path, live: LiveSimulation) -> None:
    page, other = Page(live), Page(live)
    other.frame_arrays(1)
    page.frame_arrays(1)
    page.ask("profile", on=True)
    page.ask("speed", times=0.0)
    page.ask("play")
    profile = page.until(
        lambda: (profile_message := page.last("profile")) is not None and profile_message["frames"] > 4 and profile_message
    )
    page.ask("pause")
    frame = page.status(playing=False)["frame"]
    assert [each["name"] for each in profile["phases"]][:3] == ["sense", "decide", "claim"]
    assert sum(each["ms"] for each in profile["phases"]) == pytest.approx(profile["total"], abs=0.01)
    first = profile["layers"][0]
    assert (first["species"], first["file"], first["line"]) == ("forager", "forager.ant", 77)
    assert first["text"] == "avoid(stones, feelers: 3, spread: 35 deg, reach: 1.5 * size)"
    lines = {(each["file"], each["line"]): each for each in profile["lines"]}
    assert lines["forager.ant", 33]["text"].startswith("let meal") and lines["forager.ant", 33]["ms"] > 0
    assert any(file == "<steering>" for file, _ in lines)
    assert other.last("profile") is None
    assert page.hash_at(frame) == hashes(scene, frame)[frame]
    page.ask("profile", on=False)
    number = len(page.told)
    page.ask("step")
    page.frame_arrays(frame + 1)
    page.status(frame=frame + 1)
    assert not [message for message in page.told[number:] if message["op"] == "profile"]
    assert live.session.meter is None
    page.ask("profile", on=True)
    page.ask("step")
    page.until(lambda: page.last("profile")["frames"] == 1)
    live.remove_client(page)
    other.ask("step")
    other.status(frame=frame + 3)
    other.until(lambda: live.session.meter is None)


def test_steps_on_end_can_be_paused_and_a_newer_seek_goes_before_an_older_one(live: LiveSimulation) -> None:
    page = Page(live)
    page.frame_arrays(1)
    page.ask("step", count=1000)
    page.until(lambda: page.frames[-1][0] > 60)
    page.ask("pause")
    stopped = page.until(
        lambda: (message := page.last("status")) and message["hash"] and message["frame"] > 1 and message["frame"]
    )
    assert 60 < stopped < 1000 and page.last("status")["head"] == stopped
    number = len(page.frames)
    for frame in range(2, 60):
        page.ask("seek", frame=frame, exact=True)
    page.ask("seek", frame=5, exact=True)
    assert page.hash_at(5)
    assert len({frame for frame, light in page.frames[number:] if not light}) < 30, "most of them were overtaken"


def test_too_much_at_once_is_refused(scene: Path) -> None:
    live = LiveSimulation.open_scene(scene)  # not started: nothing is done
    page = Page(live)
    with pytest.raises(QueueFullError):
        for _ in range(1000):
            page.ask("pause")
    live.remove_client(page)  # always possible


@pytest.mark.parametrize("count", [100, pytest.param(1000, marks=pytest.mark.slow)])
def test_no_sequence_of_requests_breaks_anything(live: LiveSimulation, scene: Path, count: int) -> None:
    """Two pages, a saved file now and then, and in the end the run is that of a fresh one."""
    draw = np.random.Generator(np.random.Philox(5))
    program = scene.with_name("forager.ant")
    good = program.read_text()
    texts = (good, good.replace("patience = 36 s", "patience = 20 s"), good.replace("-> carry", "-> carryy"), good[:900], "")
    layers = [line.strip() for line in good[good.index("  layers {") :].splitlines()[1:4]]
    pages = [Page(live), Page(live)]

    def pick(*of: object) -> object:
        return of[int(draw.integers(len(of)))]

    asks: tuple[Callable[[], tuple[str, dict[str, object]]], ...] = (
        lambda: ("play", {}),
        lambda: ("pause", {}),
        lambda: ("step", {"count": int(draw.integers(1, 9))}),
        lambda: ("speed", {"times": pick(0.0, 1.0, 8.0)}),
        lambda: ("seek", {"frame": int(draw.integers(-5, 90)), "exact": bool(draw.integers(2))}),
        lambda: ("set", {"name": pick("forager.smell", "forager.no", "trail.limit"), "value": pick("60 mm", "3", "30 mm", "x")}),
        lambda: ("layer", {"species": "forager", "layer": pick(*layers, "nothing"), "on": bool(draw.integers(2))}),
        lambda: ("field", {"name": pick("trail", "no"), "on": bool(draw.integers(2))}),
        lambda: ("reload", {}),
        lambda: ("restart", {}),
        lambda: ("look", {"columns": [{"species": "forager", "name": pick("zeal", "no")}], "fields": pick([], ["trail"], ["no"]),
                          "flows": ["no"], "follow": pick(None, {"species": pick("forager", "no"), "agent": 7})}),
        lambda: ("explain", {"species": pick("forager", "no"), "agent": int(draw.integers(60)), "frame": int(draw.integers(60))}),
        lambda: ("breaks", {"breaks": pick([], [{"kind": "fault"}, {"kind": "condition", "text": "count(forager) > 3"}])}),
        lambda: ("profile", {"on": bool(draw.integers(2))}),
    )  # fmt: skip
    for _ in range(count):
        op, what = asks[int(draw.integers(len(asks)))]()
        page = pages[int(draw.integers(2))]
        with contextlib.suppress(QueueFullError):
            page.ask(op, **what)
        if draw.random() < 0.1:
            program.write_text(texts[int(draw.integers(len(texts)))])
        if draw.random() < 0.05:
            live.remove_client(pages[0])
            pages[0] = Page(live)
        time.sleep(float(draw.random()) * 0.02)
    program.write_text(good)
    page = Page(live)
    while True:  # on a slow machine all requests may still be waiting
        try:
            page.ask("pause")
            break
        except QueueFullError:
            time.sleep(0.05)
    page.until(lambda: page.last("problems") is not None and not page.last("problems")["problems"])
    for name in {param["name"] for param in page.last("scene")["params"]}:
        assert name.startswith("forager.")
    said = [message for each in (*pages, page) for message in each.told if message["op"] == "refused"]
    assert not [message for message in said if "bug" in message["message"]], said[:3]
    page.ask("reload")
    assert page.ask_and_wait("restart")["ok"]
    page.ask("step", count=5)
    assert page.hash_at(6) == _fresh(live, 6)


def _fresh(live: LiveSimulation, frame: int) -> str:
    """The hash of a frame in a run of the files with what was set by hand."""
    session = live.session  # it stands still
    compiler = SceneCompiler(live.compiler.scene)
    compiler.replacement_texts = dict(session.compiler.replacement_texts)
    shot, report = compiler.open(session.choices)
    assert shot is not None, [d.message for d in report.errors]
    return next(state_hash(world) for world in simulate(shot) if world.frame == frame)


def test_a_faulty_value_pauses_and_is_reported(live: LiveSimulation, scene: Path) -> None:
    page = Page(live)
    page.frame_arrays(1)
    number = len(page.told)
    program = scene.with_name("forager.ant")
    program.write_text(program.read_text().replace("    steer wander(swing: swing)\n", "    zeal = zeal / load\n"))
    assert page.message_after("outcome", number)["ok"]
    page.ask("play")
    fault = page.until(lambda: page.last("status")["fault"])
    assert "zeal" in fault and not page.last("status")["playing"] and page.last("status")["frame"] == 2


def test_endless_requests_do_not_hold_up_the_ants(live: LiveSimulation, monkeypatch: pytest.MonkeyPatch) -> None:
    page, eager = Page(live), Page(live)
    page.ask("speed", times=0.0)
    page.ask("play")
    page.until(lambda: page.frames and page.frames[-1][0] > 5)
    slow = PreviewSession.switch_field

    def slower(session: PreviewSession, name: str, on: bool) -> EditOutcome:
        time.sleep(0.02)
        return slow(session, name, on)

    monkeypatch.setattr(PreviewSession, "switch_field", slower)
    frame = page.frames[-1][0]
    for _ in range(200):
        eager.ask("field", name="no", on=True)
    page.until(lambda: page.frames[-1][0] > frame + 10)
    assert len([message for message in eager.told if message["op"] == "outcome"]) < 200
