"""The thread that owns a session: what pages ask is done between two steps, what they are shown is what the session holds, and a
run is what it is without them."""

from __future__ import annotations

import contextlib
import json
import shutil
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from live_client import Page, places

from antdsl.pipeline import open_scene, simulate
from antdsl.preview import Busy, Compiler, Live, Session
from antdsl.preview.packing import unpack
from antdsl.preview.viewing.feelers import felt
from antdsl.runtime import state_hash

EXAMPLES = Path(__file__).parents[1] / "examples"


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    """A copy of the foraging ants, forty of them."""
    folder = tmp_path / "foraging"
    shutil.copytree(EXAMPLES / "foraging", folder)
    scene = folder / "scene.yaml"
    scene.write_text(scene.read_text().replace("count: 500", "count: 40"))
    return scene


@pytest.fixture
def live(scene: Path) -> Iterator[Live]:
    live = Live.open(scene)
    live.start()
    yield live
    live.stop()


def hashes(scene: Path, last: int) -> dict[int, str]:
    shot, report = open_scene(scene)
    assert shot is not None, [d.message for d in report.errors]
    found = {}
    for world in simulate(shot):
        found[world.frame] = state_hash(world)
        if world.frame == last:
            break
    return found


def test_whoever_joins_is_told_and_shown_everything(live: Live) -> None:
    page = Page(live)
    page.shown(1)
    ops = [message["op"] for message in page.told[:6]]
    assert ops == ["hello", "scene", "texts", "problems", "status", "curves"]
    page.until(lambda: {"body:ant", "body:ant:fine", "mesh:ground", "mesh:stones", "item:food:apple"} <= page.packets.keys())
    texts = {text["file"]: text["kind"] for text in page.told[2]["texts"]}
    assert texts == {"scene.yaml": "yaml", "forager.ant": "ant", "<steering>": "library"}
    assert page.told[1]["charts"][0]["species"] == "forager" and len(page.told[1]["charts"][0]["boxes"]) > 4
    later = Page(live)
    later.until(lambda: later.packets.keys() >= page.packets.keys())
    assert later.packets == page.packets


def test_the_hash_is_that_of_a_run_whoever_looks_on_and_scrubs(live: Live, scene: Path) -> None:
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


def test_a_frame_shows_what_the_session_holds(live: Live, scene: Path) -> None:
    page = Page(live)
    page.ask("look", columns=({"species": "forager", "name": "max_speed"},), fields=("trail",), follow=None)
    page.ask("step", count=20)
    arrays = page.shown(21)
    session, _ = Session.open(scene)
    assert session is not None
    for _ in range(20):
        session.step()
    ants = session.world.populations["forager"]
    assert list(arrays["forager/id"]) == sorted(ants.ids)
    rows = ants.in_id_order()
    assert np.array_equal(places(arrays, "forager"), ants.position[rows].astype(np.float32))
    assert np.allclose(arrays["forager/heading"].reshape(-1, 3) / 127, ants.vector("heading")[rows], atol=0.004)
    assert np.array_equal(arrays["forager/state/main"], ants.now["main.state"][rows])
    assert np.allclose(arrays["forager/speed"], np.linalg.norm(ants.vector("velocity"), axis=1)[rows], rtol=1e-5)
    assert np.array_equal(arrays["forager/column/max_speed"], ants.now["max_speed"][rows])
    assert np.allclose(arrays["item/food/amount/load"], session.world.items["food"].amounts["load"])
    assert {"fieldmesh:trail", "field:trail"} <= page.packets.keys()


def test_a_light_frame_shows_turned_bodies_and_simulates_nothing(live: Live) -> None:
    page = Page(live)
    page.ask("step", count=9)
    exact = page.shown(10)
    page.ask("step", count=5)
    page.shown(15)
    page.ask("seek", frame=10, exact=False)
    light = page.shown(10, light=True)
    assert page.status(frame=10, light=True)["hash"] is None
    for name, array in light.items():
        assert np.array_equal(array, exact[name]), name
    assert {"forager/heading", "forager/up", "forager/size", "forager/state/main"} <= light.keys()
    page.ask("step")
    page.shown(11)
    assert page.status(frame=11, light=False)["head"] == 15


def test_it_plays_and_pauses_and_keeps_the_pace(live: Live) -> None:
    page = Page(live)
    page.ask("step", count=20)  # the first ones prepare what the others find ready
    page.ask("speed", times=2.0)
    page.ask("play")
    page.until(lambda: (page.last("status") or {"rate": 0})["rate"] > 0 and page.frames[-1][0] > 120)
    rate = page.last("status")["rate"]
    page.ask("pause")
    status = page.status(playing=False)
    assert status["frame"] > 120 and 24 < rate < 60  # twice 24 frames a second, on a machine with other things to do
    assert [frame for frame, _ in page.frames] == sorted(frame for frame, _ in page.frames)


def test_a_saved_edit_goes_on_with_the_ants_and_an_error_leaves_them_running(live: Live, scene: Path) -> None:
    page = Page(live)
    page.ask("step", count=5)
    page.shown(6)
    program = scene.with_name("forager.ant")
    good = program.read_text()
    number = len(page.told)
    program.write_text(good.replace("smell", "smel\N{ANT}l", 1))
    outcome = page.told_after("outcome", number)
    assert not outcome["ok"] and outcome["of"] == "saved"
    problem = page.told_after("problems", number)["problems"][0]
    shown = {text["file"]: text["text"] for text in page.told_after("texts", number)["texts"]}["forager.ant"]
    assert problem["file"] == "forager.ant" and "\N{ANT}" in shown
    assert shown.encode("utf-16-le")[2 * problem["start"] : 2 * problem["end"]].decode("utf-16-le").strip()
    page.ask("step")
    page.shown(7)
    number = len(page.told)
    program.write_text(good.replace("patience = 36 s", "patience = 30 s"))
    outcome = page.told_after("outcome", number)
    assert outcome["ok"] and "kept 40 agents" in outcome["line"]
    assert page.status(edited=True)["frame"] == 7
    assert page.told_after("problems", number)["problems"] == []


def test_what_is_set_by_hand_is_told_with_its_line(live: Live) -> None:
    page = Page(live)
    page.shown(1)
    done = page.done("set", name="forager.smell", value="60 mm")
    assert done["ok"] and done["text"] == "set: {forager.smell: 60 mm}" and done["file"] == "scene.yaml"
    param = page.until(
        lambda: next((p for p in page.last("scene")["params"] if p["name"] == "forager.smell" and p["number"] == 60), None)
    )
    assert (param["value"], param["written"], param["unit"]) == ("60 mm", "40 mm", "mm")
    layer = page.last("scene")["species"][0]["layers"][1]
    done = page.done("layer", species="forager", layer=layer["text"], on=False)
    assert done["ok"] and done["file"] == "forager.ant"
    page.until(lambda: page.last("scene")["species"][0]["layers"][1] == {**layer, "on": False})
    assert page.done("field", name="trail", on=False)["ok"]
    page.until(lambda: not page.last("scene")["fields"][0]["on"])
    assert not page.done("set", name="forager.smell", value="60 kg")["ok"]


def test_a_bug_in_a_handler_ends_nothing(live: Live, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    page = Page(live)
    page.shown(1)
    monkeypatch.setattr(Session, "layer", lambda *_: 1 / 0)
    refused = page.done("layer", species="forager", layer="x", on=True)
    assert "bug in antdsl" in refused["message"]
    assert "ZeroDivisionError" in capsys.readouterr().err
    page.ask("step")
    page.shown(2)


def test_a_scene_with_errors_opens_once_they_are_mended(scene: Path) -> None:
    program = scene.with_name("forager.ant")
    good = program.read_text()
    program.write_text(good.replace("species forager", "species forager forager"))
    live = Live.open(scene)
    live.start()
    try:
        page = Page(live)
        found = page.until(lambda: (page.last("problems") or {"problems": []})["problems"])
        assert found[0]["file"] == "forager.ant"
        assert "errors" in page.done("play")["message"]
        program.write_text(good)
        page.shown(1)
        assert page.status(agents=40)["frame"] == 1
        assert page.last("problems")["problems"] == []
    finally:
        live.stop()


def test_what_steps_spend_their_time_on_is_told_to_the_page_that_asks_and_changes_nothing(scene: Path, live: Live) -> None:
    page, other = Page(live), Page(live)
    other.shown(1)
    page.shown(1)
    page.ask("profile", on=True)
    page.ask("speed", times=0.0)
    page.ask("play")
    told = page.until(lambda: (found := page.last("profile")) is not None and found["frames"] > 4 and found)
    page.ask("pause")
    frame = page.status(playing=False)["frame"]
    assert [each["name"] for each in told["phases"]][:3] == ["sense", "decide", "claim"]
    assert sum(each["ms"] for each in told["phases"]) == pytest.approx(told["total"], abs=0.01)
    first = told["layers"][0]
    assert (first["species"], first["file"], first["line"]) == ("forager", "forager.ant", 73)
    assert first["text"] == "avoid(stones, feelers: 3, spread: 35 deg, reach: 1.5 * size)"
    lines = {(each["file"], each["line"]): each for each in told["lines"]}
    assert lines["forager.ant", 31]["text"].startswith("let meal") and lines["forager.ant", 31]["ms"] > 0
    assert any(file == "<steering>" for file, _ in lines)
    assert other.last("profile") is None
    assert page.hash_at(frame) == hashes(scene, frame)[frame]
    page.ask("profile", on=False)
    number = len(page.told)
    page.ask("step")
    page.shown(frame + 1)
    page.status(frame=frame + 1)
    assert not [message for message in page.told[number:] if message["op"] == "profile"]
    assert live.session.meter is None
    page.ask("profile", on=True)
    page.ask("step")
    page.until(lambda: page.last("profile")["frames"] == 1)
    live.leave(page)
    other.ask("step")
    other.status(frame=frame + 3)
    other.until(lambda: live.session.meter is None)


def test_steps_on_end_can_be_paused_and_a_newer_seek_goes_before_an_older_one(live: Live) -> None:
    page = Page(live)
    page.shown(1)
    page.ask("step", count=1000)
    page.until(lambda: page.frames[-1][0] > 60)
    page.ask("pause")
    stopped = page.until(lambda: (found := page.last("status")) and found["hash"] and found["frame"] > 1 and found["frame"])
    assert 60 < stopped < 1000 and page.last("status")["head"] == stopped
    number = len(page.frames)
    for frame in range(2, 60):
        page.ask("seek", frame=frame, exact=True)
    page.ask("seek", frame=5, exact=True)
    assert page.hash_at(5)
    assert len({frame for frame, light in page.frames[number:] if not light}) < 30, "most of them were overtaken"


def test_too_much_at_once_is_refused(scene: Path) -> None:
    live = Live.open(scene)  # not started: nothing is done
    page = Page(live)
    with pytest.raises(Busy):
        for _ in range(1000):
            page.ask("pause")
    live.leave(page)  # always possible


def test_solids_come_in_pieces_and_are_whole_again_after_going_back(tmp_path: Path) -> None:
    folder = tmp_path / "tunnel"
    shutil.copytree(EXAMPLES / "tunnel", folder)
    live = Live.open(folder / "scene.yaml")
    live.start()
    try:
        page = Page(live)
        page.ask("look", columns=(), fields=("dug",), flows=(), solids=True, follow=None)
        page.shown(1)
        whole = pieces(page)
        assert whole and all(len(faces) for _, _, faces in whole.values())
        for slot, (places, normals, faces) in whole.items():
            assert np.allclose(np.linalg.norm(normals, axis=1), 1, atol=0.01), slot
            assert faces.max() < len(places)
            a, b, c = (places[faces[:, k]] for k in range(3))
            out = np.cross(b - a, c - a)
            assert (np.einsum("nk,nk->n", out, normals[faces[:, 0]]) > 0).mean() > 0.98, "both say which side the air is on"
        page.ask("step", count=120)
        expected = page.hash_at(121)
        page.shown(121)
        dug = page.until(lambda: changed(whole, pieces(page)))
        assert dug < set(pieces(page)) | set(whole), "most of the hill is as it was, and not sent again"
        page.ask("seek", frame=1, exact=True)
        page.shown(1)
        page.until(lambda: not changed(whole, pieces(page)))
        page.ask("seek", frame=121, exact=True)
        assert page.hash_at(121) == expected
        assert expected == hashes(folder / "scene.yaml", 121)[121]
    finally:
        live.stop()


Shape = tuple[np.ndarray, np.ndarray, np.ndarray]


def pieces(page: Page) -> dict[str, Shape]:
    """The pieces of solids that a page has, with places, normals and faces."""
    found = {}
    for slot, packet in dict(page.packets).items():
        if slot.startswith("solid:"):
            _, arrays = unpack(packet)
            found[slot] = tuple(arrays[name].reshape(-1, 3) for name in ("position", "normal", "face"))
    return found  # type: ignore[return-value]


def changed(before: dict[str, Shape], now: dict[str, Shape]) -> set[str]:
    """Which pieces look other than before."""
    nothing = (np.empty((0, 3)),) * 3
    return {
        slot
        for slot in before.keys() | now.keys()
        if not all(np.array_equal(a, b) for a, b in zip(before.get(slot, nothing), now.get(slot, nothing), strict=True))
    }


def test_a_field_is_shown_on_its_ground(live: Live) -> None:
    page = Page(live)
    page.ask("look", columns=(), fields=("trail",), flows=(), solids=True, follow=None)
    page.ask("step", count=60)
    page.status(frame=61)
    page.until(lambda: unpack(page.packets["field:trail"])[0]["frame"] == 61)
    _, mesh = unpack(page.packets["fieldmesh:trail"])
    header, shown = unpack(page.packets["field:trail"])
    world = live.session.world  # it stands still
    cells, values = world.fields["trail"].cells.position, world.fields["trail"].values
    places = mesh["position"].reshape(-1, 3)
    assert len(shown["value"]) == len(places) and mesh["face"].max() < len(places)
    strong = cells[values > header["full"] / 2]
    weak = cells[values == 0]
    level = shown["value"] / 255 * header["full"]
    near_strong = level[[np.linalg.norm(places - place, axis=1).argmin() for place in strong[:20]]]
    near_weak = level[[np.linalg.norm(places - place, axis=1).argmin() for place in weak[:: len(weak) // 50]]]
    assert near_strong.mean() > header["full"] / 4 and np.median(near_weak) == 0


def test_curves_grow_and_a_branch_is_kept_beside(live: Live, scene: Path) -> None:
    page = Page(live)
    page.ask("step", count=30)
    page.status(frame=31)
    assert joined_curves(page)[0] == list(range(1, 32))
    page.ask("seek", frame=10, exact=True)
    page.status(frame=10)
    assert page.done("set", name="forager.smell", value="90 mm")["ok"]
    page.ask("step", count=3)
    page.status(frame=13)
    page.until(lambda: joined_curves(page)[0] == list(range(1, 14)))
    _, values, branches = joined_curves(page)
    assert [branch["first"] for branch in branches] == [10] and branches[0]["frames"] == list(range(11, 32))
    assert values["forager"] == [40] * 13
    later = Page(live)
    page.ask("step", count=2)
    later.until(lambda: joined_curves(later)[0] == list(range(1, 16)))
    page.until(lambda: joined_curves(page) == joined_curves(later))


def joined_curves(page: Page) -> tuple[list[int], dict[str, list[float]], list[dict[str, object]]]:
    """What a page makes of all it was told about curves."""
    if page.last("curves") is None:
        return [], {}, []
    rows: dict[int, dict[str, float]] = {}
    branches: list[dict[str, object]] = []
    for message in [message for message in page.told if message["op"] == "curves"]:
        if message["reset"]:
            first = message["frames"][0] if message["frames"] else -1
            rows = {frame: row for frame, row in rows.items() if frame < first}
        for number, frame in enumerate(message["frames"]):
            rows[frame] = {name: values[number] for name, values in message["values"].items()}
        branches = branches if message["branches"] is None else message["branches"]
    frames = sorted(rows)
    return frames, {name: [rows[frame].get(name) for frame in frames] for name in rows[frames[0]]}, branches


def test_whatever_is_asked_in_whatever_order_nothing_breaks(live: Live, scene: Path) -> None:
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
    for _ in range(250):
        op, what = asks[int(draw.integers(len(asks)))]()
        page = pages[int(draw.integers(2))]
        with contextlib.suppress(Busy):
            page.ask(op, **what)
        if draw.random() < 0.1:
            program.write_text(texts[int(draw.integers(len(texts)))])
        if draw.random() < 0.05:
            live.leave(pages[0])
            pages[0] = Page(live)
        time.sleep(float(draw.random()) * 0.02)
    program.write_text(good)
    page = Page(live)
    page.ask("pause")
    page.until(lambda: page.last("problems") is not None and not page.last("problems")["problems"])
    for name in {param["name"] for param in page.last("scene")["params"]}:
        assert name.startswith("forager.")
    said = [message for each in (*pages, page) for message in each.told if message["op"] == "refused"]
    assert not [message for message in said if "bug" in message["message"]], said[:3]
    page.ask("reload")
    assert page.done("restart")["ok"]
    page.ask("step", count=5)
    assert page.hash_at(6) == _fresh(live, 6)


def _fresh(live: Live, frame: int) -> str:
    """The hash of a frame in a run of the files with what was set by hand."""
    session = live.session  # it stands still
    compiler = Compiler(live.compiler.scene)
    compiler.instead = dict(session.compiler.instead)
    shot, report = compiler.open(session.choices)
    assert shot is not None, [d.message for d in report.errors]
    return next(state_hash(world) for world in simulate(shot) if world.frame == frame)


def test_a_value_at_fault_pauses_and_is_told(live: Live, scene: Path) -> None:
    page = Page(live)
    page.shown(1)
    number = len(page.told)
    program = scene.with_name("forager.ant")
    program.write_text(program.read_text().replace("    steer wander(swing: swing)\n", "    zeal = zeal / load\n"))
    assert page.told_after("outcome", number)["ok"]
    page.ask("play")
    fault = page.until(lambda: page.last("status")["fault"])
    assert "zeal" in fault and not page.last("status")["playing"] and page.last("status")["frame"] == 2


def test_what_moves_is_shown_where_it_is(live: Live, scene: Path) -> None:
    scene.write_text(scene.read_text().replace(
        "stones:  {mesh: stones.ply}",
        "stones:  {mesh: stones.ply, keys: {1: {at: [0, 0, 0]}, 11: {at: [50, 0, 0]}}}",
    ))  # fmt: skip
    page = Page(live)
    page.until(lambda: "mesh:stones" in page.packets and unpack(page.packets["mesh:stones"])[0]["moves"])
    before = unpack(page.packets["mesh:stones"])[1]["position"].reshape(-1, 3)
    ground = page.packets["mesh:ground"]
    page.ask("step", count=4)
    page.shown(5)
    page.until(
        lambda: np.allclose(unpack(page.packets["mesh:stones"])[1]["position"].reshape(-1, 3) - before, (20, 0, 0), atol=0.01)
    )
    assert page.packets["mesh:ground"] is ground, "what stands still is not sent again"


def test_feelers_of_who_is_followed_end_where_they_hit(live: Live) -> None:
    page = Page(live)
    page.ask("look", columns=[], fields=[], flows=[], follow={"species": "forager", "agent": 3})
    page.ask("step", count=3)
    arrays = page.shown(4)
    lines, hit = arrays["feelers"].reshape(-1, 2, 3), arrays["feelers/hit"]
    row = list(arrays["forager/id"]).index(3)
    assert len(lines) == 3 and np.allclose(lines[:, 0], places(arrays, "forager")[row], atol=1e-3)
    reach = np.linalg.norm(lines[:, 1] - lines[:, 0], axis=1)
    assert np.allclose(reach[hit == 0], 1.5 * arrays["forager/size"][row], rtol=1e-3)
    # one that faces a wall a body ahead: the same agent, put before the stones, is asked for directly
    population = live.session.world.populations["forager"]  # it stands still
    stones = live.session.world.setting.obstacles["stones"].vertices - live.session.world.origin
    at = int(population.rows_of(np.array([3]))[0])
    population.position[at] = stones[0] - 2.0 * population.vector("heading")[at]
    found = felt(live.session.world, live.session.shot.program, "forager", 3)
    assert found["feelers/hit"].any()
    met = np.linalg.norm(np.diff(found["feelers"].reshape(-1, 2, 3), axis=1)[:, 0], axis=1)
    assert (met[found["feelers/hit"] == 1] < 1.5 * arrays["forager/size"][row]).all()


def test_a_field_goes_with_ground_that_moves(live: Live, scene: Path) -> None:
    scene.write_text(scene.read_text().replace(
        "boulder: {mesh: boulder.ply}",
        "boulder: {mesh: boulder.ply, keys: {1: {at: [0, 0, 0]}, 11: {at: [0, 50, 0], rotate: [0, 90, 0]}}}",
    ))  # fmt: skip
    page = Page(live)
    page.ask("look", columns=[], fields=["trail"], flows=[], follow=None)
    page.until(lambda: "mesh:boulder" in page.packets and unpack(page.packets["mesh:boulder"])[0]["moves"])
    page.ask("step", count=10)
    page.shown(11)
    page.until(lambda: unpack(page.packets["field:trail"])[0]["frame"] == 11)
    field = unpack(page.packets["fieldmesh:trail"])[1]["position"].reshape(-1, 3)
    for name in ("ground", "boulder"):
        mesh = unpack(page.packets[f"mesh:{name}"])[1]["position"].reshape(-1, 3)
        assert all(np.linalg.norm(field - vertex, axis=1).min() < 0.01 for vertex in mesh[::97]), name


@pytest.mark.parametrize(
    "example", ["thesis/base.yaml", "tunnel/led.yaml", "minimal/scene.yaml", "alarm/scene.yaml", "flow/scene.yaml"]
)
def test_all_that_a_scene_has_is_told_and_shown(example: str) -> None:
    live = Live.open(EXAMPLES / example, watch=False)
    live.start()
    try:
        page = Page(live)
        page.until(lambda: page.last("curves"))
        scene, first = page.last("scene"), page.last("status")["first"]
        columns = [{"species": each["name"], "name": a["name"]} for each in scene["species"] for a in each["attributes"]]
        fields = [field["name"] for field in scene["fields"]]
        follow = {"species": scene["species"][0]["name"], "agent": 1}
        page.ask("look", columns=columns, fields=fields, flows=scene["flows"], follow=follow)
        page.ask("step", count=3)
        arrays = page.shown(first + 3)
        page.hash_at(first + 3)
        json.dumps(page.told, allow_nan=False)
        assert not [message for message in page.told if message["op"] == "refused"]
        for each in columns:
            assert np.isfinite(arrays[f"{each['species']}/column/{each['name']}"]).all() or each["name"] == "max_turn"
        wanted = {f"field:{name}" for name in fields} | {f"flow:{name}" for name in scene["flows"]}
        wanted |= {f"curve:{name}" for name in scene["curves"]} | {f"body:{each['body']}" for each in scene["species"]}
        page.until(lambda: wanted <= page.packets.keys())
        for param in scene["params"]:
            assert param["low"] is None or param["low"] <= param["number"] <= param["high"], param
    finally:
        live.stop()
