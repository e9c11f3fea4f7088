"""Edits by hand: what a page shows of the simulated frames with edits, and what `antdsl edit` makes of the same lines."""

from __future__ import annotations

import shutil
from collections.abc import Iterator, Mapping
from pathlib import Path

import meshes
import numpy as np
import pytest
import stick_bodies
from commands import run
from directed import PROGRAM, open_directed, write_mesh
from empty_scenes import CASES
from empty_scenes import scene as empty_scene
from live_client import Message, Page
from sampling import sampled

from antdsl.outputs.cache.cache_reader import Cache, open_cache
from antdsl.outputs.edits.edited_cache import load_edits
from antdsl.preview import LiveSimulation
from antdsl.preview.binary_packets import unpack_arrays
from antdsl.preview.directing.recorded_frames import RecordedFrames
from antdsl.runtime import Options

LAST = 30
Arrays = Mapping[str, np.ndarray]


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A scene, and a cache of its frames next to it."""
    folder = tmp_path_factory.mktemp("shown")
    open_directed(folder, count=30, last=LAST)
    stick_bodies.write_body(folder, 6, "stick.json")
    vertices, faces = meshes.terrain(300.0, 24)
    write_mesh(folder / "high.obj", np.add(vertices, [0, 40, 0]), faces)
    assert run("run", str(folder / "scene.yaml"), "--out", str(folder / "cache"), "--quiet", cwd=folder).returncode == 0
    return folder / "scene.yaml"


@pytest.fixture
def page(scene: Path) -> Iterator[Page]:
    live = LiveSimulation.open_scene(scene, None, Options(feet=True), checkpoint_interval=10)
    live.start()
    opened = Page(live)
    opened.ask("step", count=LAST - 1)
    opened.hash_at(LAST)
    yield opened
    live.stop()


def draft(page: Page, verb: str, agents: str, apply: bool = False, **values: str) -> Message:
    """The answer of the server about an edit."""
    number = len(page.told)
    page.ask("direct", list="edits", verb=verb, agents=agents, values=values, apply=apply)
    return page.until(lambda: next((m for m in page.told[number:] if m["op"] in ("directed", "refused")), None))


def read_frame(page: Page, frame: int) -> Arrays:
    """The arrays of a frame, after a visit of the one before: so they are those of all earlier requests."""
    for number in (frame - 1, frame):
        page.ask("seek", frame=number, exact=True)
        page.hash_at(number)
    return page.frame_arrays(frame)


def cached(scene: Path, *lines: str) -> Cache:
    """The cache with these edits."""
    cache = open_cache(scene.with_name("cache"))
    if not lines:
        return cache
    path = scene.with_name("edits.yaml")
    path.write_text("edits:\n" + "".join(f"  - {line}\n" for line in lines))
    loaded, report = load_edits(cache, path)
    assert loaded is not None, [d.message for d in report.errors]
    return loaded.view


def positions(arrays: Arrays) -> np.ndarray:
    return arrays["ant/position"].reshape(-1, 3)


def test_frames_of_a_session_are_those_of_a_cache(page: Page, scene: Path) -> None:
    cache = cached(scene)
    recorded = RecordedFrames.of(page.live.session)
    assert recorded.manifest.species == cache.manifest.species and recorded.manifest.lines == cache.manifest.lines
    assert recorded.frames() == cache.frames()
    for frame in (30, 17, 18, 1, 29, 20):
        own, theirs = recorded.frame(frame), cache.frame(frame)
        for name in theirs:
            assert np.array_equal(own[name], theirs[name], equal_nan=theirs[name].dtype.kind == "f"), (frame, name)


def test_pages_get_how_much_agents_lean_and_feet_after_going_back(tmp_path: Path) -> None:
    program = PROGRAM.replace("play walk; when mood", "play walk(left: run, right: run); when mood")
    open_directed(tmp_path, count=8, last=20, program=program)
    live = LiveSimulation.open_scene(tmp_path / "scene.yaml", None, Options(feet=True), checkpoint_interval=10)
    live.start()
    try:
        page = Page(live)
        page.ask("step", count=16)
        page.hash_at(17)
        first = {name: array.copy() for name, array in page.frame_arrays(17).items()}
        assert np.abs(first["ant/lean"]).max() > 10 and len(first["ant/feet"])
        again = read_frame(page, 17)
        assert np.array_equal(again["ant/feet"], first["ant/feet"]) and np.array_equal(again["ant/lean"], first["ant/lean"])
    finally:
        live.stop()


EDITS = [
    ("kill", "guards.3..9", {}),
    ("kill", "ant", {"share": "30 %", "seed": "4", "frames": "20..30"}),
    ("clip", "guards", {"inside": "{around: leaf, radius: 80 mm}"}),
    ("duplicate", "guards.3", {"by": "[40 mm, 0, 0]", "later": "7", "count": "2"}),
    ("hold", "guards.1", {"frames": "12..20"}),
    ("retime", "guards", {"frames": "10..20", "speed": "50 %", "near": "leaf", "within": "100 mm"}),
    ("move", "guards.5..7", {"by": "[0, 0, 30 mm]", "frames": "24..30"}),
    ("rotate", "guards.5..7", {"by": "90 deg"}),
    ("scale", "guards.2", {"by": "200 %"}),
    ("expand", "guards", {"by": "150 %"}),
    ("face", "guards", {"to": "leaf"}),
    ("pin", "guards.4", {"to": "[[-100, 0, 0], [100, 0, 0]]", "speed": "20 mm/s"}),
    ("drop", "guards.6", {"onto": "ground"}),
    ("offset", "guards.2", {"joint": "head", "rotate": "[0, 30 deg, 0]", "by": "[1 mm, 0, 0]", "frames": "20..30"}),
    ("replace", "guards.8", {"colour": "red"}),
    ("replace", "guards.8", {"body": "spider"}),
    ("replace", "guards.8", {"body": "stick.json"}),
    ("drop", "guards.6", {"onto": "high.obj"}),
    ("smooth", "guards", {"orient": "9", "position": "9"}),
    ("mirror", "guards", {"axis": "x"}),
    ("merge", "cache", {"by": "[0, 0, 40 mm]", "later": "7"}),
]


@pytest.mark.parametrize("case", sampled(EDITS, [EDITS[5], EDITS[13], EDITS[16], EDITS[17], EDITS[20]]))
def test_an_edit_is_shown_as_a_cache_has_it_and_others_keep_their_bits(
    page: Page, scene: Path, case: tuple[str, str, dict[str, str]]
) -> None:
    verb, agents, values = case
    plain_frames = {frame: read_frame(page, frame) for frame in (27, LAST)}
    answer = draft(page, verb, agents, apply=True, **values)
    assert answer["applied"], answer
    changed = False
    for frame in (27, LAST):
        arrays, plain, edited = read_frame(page, frame), plain_frames[frame], cached(scene, answer["line"])
        expected, original = edited.frame(frame), cached(scene).frame(frame)
        ids = arrays["ant/id"]
        assert ids.tolist() == expected["id"].tolist()
        assert np.array_equal(positions(arrays), expected["P"])
        assert np.array_equal(arrays["ant/size"], expected["pscale"])
        assert np.array_equal(arrays["ant/state/main"], expected["state"])
        selected = {int(i) for i in plain["ant/id"] if not _is_same(expected, original, int(i))}
        for name in ("position", "heading", "up", "size", "speed", "born"):
            own, other = (a[f"ant/{name}"].reshape(len(a["ant/id"]), -1) for a in (arrays, plain))
            rows = [k for k, i in enumerate(ids) if int(i) in plain["ant/id"] and int(i) not in selected]
            theirs = np.searchsorted(plain["ant/id"], ids[rows])
            assert np.array_equal(own[rows], other[theirs]), name
        offsets = {name: expected[name] for name in expected if name.startswith("joints.")}
        sent = {name: array for name, array in arrays.items() if name.startswith("ant/offset/")}
        assert [array.tobytes() for array in sent.values()] == [array.tobytes() for array in offsets.values()]
        changed |= (
            bool(selected) or bool(offsets) or len(ids) != len(plain["ant/id"]) or "ant/tint" in arrays or "ant/body" in arrays
        )
        assert ("ant/body" in arrays) == (len(edited.manifest.species[0].bodies) > 1)
    assert changed, "the edit has an effect"
    assert page.last("status")["hash"] == page.hash_at(LAST) and not page.last("status")["edited"]
    page.ask("line", list="edits", key=0, action="off")
    page.until(lambda: page.last("edits")["lines"] and not page.last("edits")["lines"][0]["on"])
    off = read_frame(page, LAST)
    assert {name: a.tobytes() for name, a in off.items()} == {name: a.tobytes() for name, a in plain_frames[LAST].items()}


def _is_same(one: Arrays, other: Arrays, agent: int) -> bool:
    """Whether an agent has the same place, direction and size in two frames."""
    rows = [np.flatnonzero(each["id"] == agent) for each in (one, other)]
    if any(len(row) != 1 for row in rows):
        return False
    return all(np.array_equal(one[name][rows[0]], other[name][rows[1]]) for name in ("P", "orient", "pscale", "v", "Cd"))


def test_lines_apply_in_order_and_are_switched_off_and_removed(page: Page, scene: Path) -> None:
    plain = read_frame(page, LAST)
    lines = [
        draft(page, "move", "guards.1", apply=True, by="[10 mm, 0, 0]")["line"],
        draft(page, "duplicate", "guards.1", apply=True, by="[0, 0, 20 mm]")["line"],
    ]
    assert draft(page, "move", "guards.1", apply=True, by="[10 mm, 0, 0]")["op"] == "refused"
    both = read_frame(page, LAST)
    assert np.array_equal(positions(both), cached(scene, *lines).frame(LAST)["P"])
    assert len(both["ant/id"]) == 31 and both["ant/id"][-1] == 31
    page.ask("line", list="edits", key=0, action="off")
    copied = read_frame(page, LAST)
    assert np.array_equal(positions(copied), cached(scene, lines[1]).frame(LAST)["P"])
    page.ask("line", list="edits", key=0, action="on")
    page.ask("line", list="edits", key=1, action="remove")
    moved = read_frame(page, LAST)
    assert np.array_equal(positions(moved), cached(scene, lines[0]).frame(LAST)["P"])
    assert [line["line"] for line in page.last("edits")["lines"]] == lines[:1]
    page.ask("line", list="edits", key=0, action="remove")
    assert {n: a.tobytes() for n, a in read_frame(page, LAST).items()} == {n: a.tobytes() for n, a in plain.items()}


def test_a_value_that_is_wrong_is_reported_at_its_key(page: Page) -> None:
    cases: list[tuple[str, str, dict[str, str], str, str]] = [
        ("kill", "", {}, "agents", ""),
        ("kill", "gards", {}, "agents", "no crowd line or species is named `gards`"),
        ("kill", "guards", {"frames": "900..905"}, "frames", "the cache has no frames 900 to 905"),
        ("hold", "guards", {}, "frames", "missing"),
        ("move", "guards", {}, "", "`move` needs either `by` or `to`"),
        ("move", "guards", {"by": "[1 kg, 0, 0]"}, "by", "kg"),
        ("rotate", "guards", {"by": "20 mm"}, "by", "is not an angle"),
        ("face", "guards", {"to": "leef"}, "to", "`leef`"),
        ("kill", "guards", {"frames": "1..3, off: yes"}, "frames", "another key, `off`"),
        ("offset", "guards", {"joint": "tail_9", "rotate": "[0, 30 deg, 0]"}, "", "no body has a joint `tail_9`"),
        ("scale", "guards", {"speed": "3"}, "", "has no key `speed`"),
        ("replace", "guards", {"body": "nobody.glb"}, "body", "nobody.glb"),
        ("replace", "guards", {"body": "../outside.json"}, "body", "`../outside.json`"),
        ("drop", "guards", {"onto": "/etc/passwd"}, "onto", "`/etc/passwd`"),
        ("merge", "../cache", {}, "agents", "`../cache` leaves its folder"),
        ("merge", "/tmp", {}, "agents", "`/tmp` is absolute"),
        ("merge", "cache/frames", {}, "agents", "is not a cache"),
    ]
    for verb, agents, values, key, words in cases:
        answer = draft(page, verb, agents, apply=True, **values)
        assert not answer["applied"], answer
        assert any(words in each["message"] for each in answer["problems"] if each["key"] == key), answer
    assert draft(page, "dance", "guards")["op"] == "refused"
    assert page.last("edits")["lines"] == []


def test_the_mesh_of_a_drop_is_drawn_and_taken_away(page: Page) -> None:
    read_frame(page, LAST)
    assert "mesh:high" not in page.make_packets
    draft(page, "drop", "guards.6", apply=True, onto="high.obj")
    header, arrays = page.until(lambda: "mesh:high" in page.make_packets and unpack_arrays(page.make_packets["mesh:high"]))
    assert header["role"] == "ground" and len(arrays["face"])
    assert arrays["position"].reshape(-1, 3)[:, 1].min() > 20
    height = positions(read_frame(page, LAST))[6, 1]
    assert abs(height - 40) < 15
    page.ask("line", list="edits", key=0, action="remove")
    page.until(lambda: not len(unpack_arrays(page.make_packets["mesh:high"])[1]["face"]))


def test_species_of_a_merged_cache_are_shown_too(page: Page, scene: Path) -> None:
    other = scene.parent / "of_beetles"
    open_directed(other, count=4, last=LAST)
    (other / "a.ant").write_text(PROGRAM.replace("species ant", "species beetle").replace("rest", "stop"))
    text = (other / "scene.yaml").read_text()
    (other / "scene.yaml").write_text(text.replace("name: guards, species: ant", "name: beetles, species: beetle"))
    assert run("run", "scene.yaml", "--out", "run", "--quiet", cwd=other).returncode == 0
    page.ask("reload")
    assert page.until(lambda: (page.last("verbs") or {}).get("edits"))
    assert draft(page, "merge", "of_beetles/run", apply=True)["applied"]
    arrays = read_frame(page, LAST)
    expected = cached(scene, "{merge: of_beetles/run}").frame(LAST)
    assert np.array_equal(arrays["beetle/position"].reshape(-1, 3), expected["P"][expected["species"] == 1])
    entry = page.until(lambda: next((s for s in page.last("scene")["species"] if s["name"] == "beetle"), None))
    assert [each["name"] for each in page.last("scene")["species"]] == ["ant", "beetle"]
    assert entry["machines"][0]["states"] == ["walk", "stop"] and f"rig:{entry['bodies'][0]}" in page.make_packets
    page.ask("line", list="edits", key=0, action="remove")
    page.until(lambda: len(page.last("scene")["species"]) == 1)
    shutil.rmtree(other)


def test_caches_near_the_scene_are_offered(page: Page) -> None:
    merge = next(each for each in page.until(lambda: page.last("verbs"))["edits"] if each["verb"] == "merge")
    assert merge["kind"] == "cache" and merge["choices"] == ["cache"]


def test_joints_to_choose_from_are_those_of_the_bodies_of_the_agents(page: Page) -> None:
    own = draft(page, "offset", "guards.8")["choices"]["joint"]
    assert "head" in own and draft(page, "offset", "nobody")["choices"]["joint"] == []
    assert draft(page, "kill", "guards.8")["choices"] == {}
    assert draft(page, "replace", "guards.8", apply=True, body="stick.json")["applied"]
    other = draft(page, "offset", "guards.8")["choices"]["joint"]
    assert "thigh_left_0" in set(other) - set(own) and "head" not in other
    assert draft(page, "offset", "guards.7..8")["choices"]["joint"] == list(dict.fromkeys(own + other))


def test_edits_follow_an_edited_program_and_frames_that_are_simulated_later(page: Page, scene: Path) -> None:
    program = scene.with_name("a.ant")
    text = program.read_text()
    try:
        assert draft(page, "retime", "guards", apply=True, later="-8")["applied"]
        early = positions(read_frame(page, 22))
        page.ask("seek", frame=10, exact=True)
        page.hash_at(10)
        program.write_text(text.replace("max_speed 30 mm/s", "max_speed 50 mm/s"))
        page.until(lambda: page.last("outcome") and page.last("outcome")["of"] in ("saved", "reload"))
        page.ask("step", count=20)
        page.hash_at(30)
        faster = positions(read_frame(page, 22))
        assert np.abs(faster - early).max() > 1
        page.ask("line", list="edits", key=0, action="off")
        assert np.array_equal(positions(read_frame(page, 30)), faster)
    finally:
        program.write_text(text)


@pytest.mark.parametrize("case", sampled(list(CASES), list(CASES)[:1]))
def test_edits_are_possible_where_no_agent_is_there(tmp_path: Path, case: str) -> None:
    live = LiveSimulation.open_scene(empty_scene(tmp_path / "scene", case))
    live.start()
    try:
        page = Page(live)
        page.ask("step", count=6)
        page.until(lambda: (status := page.last("status")) and status["hash"] and status["head"] >= 6)
        for verb, values in (("kill", {}), ("move", {"by": "[1 mm, 0, 0]"}), ("retime", {"speed": "50 %"}), ("duplicate", {})):
            answer = draft(page, verb, "person", apply=True, **values)
            assert answer["op"] == "directed" and (answer["applied"] or answer["problems"]), answer
        assert not [message for message in page.told if message["op"] == "refused"]
    finally:
        live.stop()
