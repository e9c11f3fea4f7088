"""What pages are shown of a session: agents, items, fields, solids, curves, what moves, and frames that are remembered."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from digging_shots import folder as digging
from live_client import EXAMPLES, Page, agent_positions, hashes
from preview_page import few

from antdsl.preview import LiveSimulation, PreviewSession
from antdsl.preview.binary_packets import unpack_arrays
from antdsl.preview.viewing.agent_packets import make_feeler_arrays
from antdsl.scene.looks import SURFACE_KINDS


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


def test_a_frame_shows_what_the_session_holds(live: LiveSimulation, scene: Path) -> None:
    page = Page(live)
    page.ask("look", columns=({"species": "forager", "name": "max_speed"},), fields=("trail",), follow=None)
    page.ask("step", count=20)
    arrays = page.frame_arrays(21)
    session, _ = PreviewSession.open(scene)
    assert session is not None
    for _ in range(20):
        session.step()
    ants = session.world.populations["forager"]
    assert list(arrays["forager/id"]) == sorted(ants.ids)
    rows = ants.get_rows_by_id()
    assert np.array_equal(agent_positions(arrays, "forager"), ants.position[rows].astype(np.float32))
    assert np.allclose(arrays["forager/heading"].reshape(-1, 3) / 127, ants.read_vector("heading")[rows], atol=0.004)
    assert np.array_equal(arrays["forager/state/main"], ants.now["main.state"][rows])
    assert np.allclose(arrays["forager/speed"], np.linalg.norm(ants.read_vector("velocity"), axis=1)[rows], rtol=1e-5)
    assert np.array_equal(arrays["forager/column/max_speed"], ants.now["max_speed"][rows])
    assert np.allclose(arrays["item/food/amount/load"], session.world.items["food"].amounts["load"])
    assert {"fieldmesh:trail", "field:trail"} <= page.make_packets.keys()


def test_items_have_the_shape_and_colour_of_their_look_also_after_a_change(live: LiveSimulation, scene: Path) -> None:
    def read_body(name: str) -> tuple[str, object, list[float]]:
        header, arrays = unpack_arrays(page.make_packets[f"item:food:{name}"])
        return header["shape"], header.get("look"), [round(float(x), 3) for x in arrays.get("colour", np.zeros(0))[:3]]

    page = Page(live)
    page.until(lambda: "item:food:donut" in page.make_packets)
    apple, donut = read_body("apple"), read_body("donut")
    assert apple[:2] == ("apple", None) and donut[:2] == ("ring", None)
    text = scene.read_text()
    assert "apple: {" in text
    for look, expected in (
        ("leaf", ("apple", "leaf", list(SURFACE_KINDS["leaf"].colour))),
        ("none", ("none", None, [])),
        ("", apple),
    ):
        scene.write_text(text.replace("apple: {", f"apple: {{look: {look}, ") if look else text)
        page.until(lambda expected=expected: read_body("apple") == expected)
        assert read_body("donut") == donut


def test_a_reduced_frame_shows_turned_bodies_and_simulates_nothing(live: LiveSimulation) -> None:
    page = Page(live)
    page.ask("step", count=9)
    exact = page.frame_arrays(10)
    page.ask("step", count=5)
    page.frame_arrays(15)
    page.ask("seek", frame=10, exact=False)
    light = page.frame_arrays(10, light=True)
    assert page.status(frame=10, light=True)["hash"] is None
    for name, array in light.items():
        assert np.array_equal(array, exact[name]), name
    assert {"forager/heading", "forager/up", "forager/size", "forager/state/main"} <= light.keys()
    assert {"forager/plays/main", "forager/wears"} <= light.keys(), "bodies are posed as they were then"
    page.ask("step")
    page.frame_arrays(11)
    assert page.status(frame=11, light=False)["head"] == 15


def test_solids_come_in_pieces_and_are_whole_again_after_going_back(tmp_path: Path) -> None:
    scene = digging(tmp_path)
    live = LiveSimulation.open_scene(scene)
    live.start()
    try:
        page = Page(live)
        page.ask("look", columns=(), fields=(), flows=(), solids=True, follow=None)
        page.frame_arrays(1)
        initial_pieces = pieces(page)
        assert initial_pieces and all(len(faces) for _, _, faces in initial_pieces.values())
        for slot, (positions, normals, faces) in initial_pieces.items():
            assert np.allclose(np.linalg.norm(normals, axis=1), 1, atol=0.01), slot
            assert faces.max() < len(positions)
            a, b, c = (positions[faces[:, k]] for k in range(3))
            out = np.cross(b - a, c - a)
            assert (np.einsum("nk,nk->n", out, normals[faces[:, 0]]) > 0).mean() > 0.98, "both say which side the air is on"
        page.ask("step", count=30)
        expected = page.hash_at(31)
        page.frame_arrays(31)
        dug = page.until(lambda: changed(initial_pieces, pieces(page)))
        assert dug < set(pieces(page)) | set(initial_pieces), "most of the hill is as it was, and not sent again"
        page.ask("seek", frame=1, exact=True)
        page.frame_arrays(1)
        page.until(lambda: not changed(initial_pieces, pieces(page)))
        page.ask("seek", frame=31, exact=True)
        assert page.hash_at(31) == expected
        assert expected == hashes(scene, 31)[31]
    finally:
        live.stop()


Shape = tuple[np.ndarray, np.ndarray, np.ndarray]


def pieces(page: Page) -> dict[str, Shape]:
    """The pieces of solids that a page has, with places, normals and faces."""
    shapes = {}
    for slot, packet in dict(page.make_packets).items():
        if slot.startswith("solid:"):
            _, arrays = unpack_arrays(packet)
            shapes[slot] = tuple(arrays[name].reshape(-1, 3) for name in ("position", "normal", "face"))
    return shapes  # type: ignore[return-value]


def changed(old_pieces: dict[str, Shape], now: dict[str, Shape]) -> set[str]:
    """Which pieces look other than before."""
    nothing = (np.empty((0, 3)),) * 3
    return {
        slot
        for slot in old_pieces.keys() | now.keys()
        if not all(np.array_equal(a, b) for a, b in zip(old_pieces.get(slot, nothing), now.get(slot, nothing), strict=True))
    }


def test_a_field_is_shown_on_its_ground(live: LiveSimulation) -> None:
    page = Page(live)
    page.ask("look", columns=(), fields=("trail",), flows=(), solids=True, follow=None)
    page.ask("step", count=60)
    page.status(frame=61)
    page.until(lambda: unpack_arrays(page.make_packets["field:trail"])[0]["frame"] == 61)
    _, mesh = unpack_arrays(page.make_packets["fieldmesh:trail"])
    header, field_arrays = unpack_arrays(page.make_packets["field:trail"])
    world = live.session.world  # it stands still
    cells, values = world.fields["trail"].cells.position, world.fields["trail"].amounts
    positions = mesh["position"].reshape(-1, 3)
    assert len(field_arrays["value"]) == len(positions) and mesh["face"].max() < len(positions)
    assert "full" not in header  # one scale for all frames
    strong = cells[values > np.percentile(values[values > 0], 90)]
    weak = cells[values == 0]
    level = np.where(field_arrays["value"] > 0, 1e-8 * 10 ** ((field_arrays["value"] - 1.0) * 16 / 254), 0)
    near_strong = level[[np.linalg.norm(positions - place, axis=1).argmin() for place in strong[:20]]]
    near_weak = level[[np.linalg.norm(positions - place, axis=1).argmin() for place in weak[:: len(weak) // 50]]]
    assert near_strong.mean() > values[values > 0].mean() / 2 and np.median(near_weak) == 0
    packet = page.make_packets["field:trail"]
    page.ask("step", count=80)  # until there is much more scent
    page.status(frame=141)
    page.ask("seek", frame=61, exact=True)
    page.until(lambda: unpack_arrays(page.make_packets["field:trail"])[0]["frame"] == 61)
    page.status(frame=61, light=False)
    assert page.make_packets["field:trail"] == packet, "the same frame is the same picture"


def test_curves_grow_and_a_branch_is_stored_beside_them(live: LiveSimulation, scene: Path) -> None:
    page = Page(live)
    page.ask("step", count=30)
    page.status(frame=31)
    assert joined_curves(page)[0] == list(range(1, 32))
    page.ask("seek", frame=10, exact=True)
    page.status(frame=10)
    assert page.ask_and_wait("set", name="forager.smell", value="90 mm")["ok"]
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
    """What a page makes of all messages about curves."""
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


def test_what_moves_is_shown_where_it_is(live: LiveSimulation, scene: Path) -> None:
    scene.write_text(scene.read_text().replace(
        "stones:  {mesh: stones.ply}",
        "stones:  {mesh: stones.ply, keys: {1: {at: [0, 0, 0]}, 11: {at: [50, 0, 0]}}}",
    ))  # fmt: skip
    page = Page(live)
    page.until(lambda: "mesh:stones" in page.make_packets and unpack_arrays(page.make_packets["mesh:stones"])[0]["moves"])
    initial_positions = unpack_arrays(page.make_packets["mesh:stones"])[1]["position"].reshape(-1, 3)
    ground = page.make_packets["mesh:ground"]
    page.ask("step", count=4)
    page.frame_arrays(5)
    page.until(
        lambda: np.allclose(
            unpack_arrays(page.make_packets["mesh:stones"])[1]["position"].reshape(-1, 3) - initial_positions,
            (20, 0, 0),
            atol=0.01,
        )
    )
    assert page.make_packets["mesh:ground"] is ground, "what stands still is not sent again"


def test_a_mesh_that_an_edit_takes_away_is_gone(live: LiveSimulation, scene: Path) -> None:
    page = Page(live)
    page.until(lambda: "mesh:boulder" in page.make_packets)
    program = scene.parent / "forager.ant"
    lines = [line for line in program.read_text().splitlines() if "surface  boulder" not in line]
    scene.write_text(scene.read_text().replace("  boulder: {mesh: boulder.ply}\n", ""))
    program.write_text("\n".join(lines).replace("trail on ground, boulder", "trail on ground") + "\n")
    page.until(lambda: not unpack_arrays(page.make_packets["mesh:boulder"])[1]["face"].size)
    assert unpack_arrays(page.make_packets["mesh:ground"])[1]["face"].size
    later = Page(live)
    later.until(lambda: "mesh:stones" in later.make_packets)
    assert "mesh:boulder" not in later.make_packets or not unpack_arrays(later.make_packets["mesh:boulder"])[1]["face"].size


def test_feelers_of_who_is_followed_end_where_they_hit(live: LiveSimulation) -> None:
    page = Page(live)
    page.ask("look", columns=[], fields=[], flows=[], follow={"species": "forager", "agent": 3})
    page.ask("step", count=3)
    arrays = page.frame_arrays(4)
    lines, hit = arrays["feelers"].reshape(-1, 2, 3), arrays["feelers/hit"]
    row = list(arrays["forager/id"]).index(3)
    assert len(lines) == 3 and np.allclose(lines[:, 0], agent_positions(arrays, "forager")[row], atol=1e-3)
    reach = np.linalg.norm(lines[:, 1] - lines[:, 0], axis=1)
    assert np.allclose(reach[hit == 0], 1.5 * arrays["forager/size"][row], rtol=1e-3)
    # one that faces a wall a body ahead: the same agent, put before the stones, is requested directly
    population = live.session.world.populations["forager"]  # it stands still
    stones = live.session.world.setting.obstacles["stones"].vertices - live.session.world.origin
    at = int(population.find_rows(np.array([3]))[0])
    population.position[at] = stones[0] - 2.0 * population.read_vector("heading")[at]
    feelers = make_feeler_arrays(live.session.world, live.session.shot.program, "forager", 3)
    assert feelers["feelers/hit"].any()
    lengths = np.linalg.norm(np.diff(feelers["feelers"].reshape(-1, 2, 3), axis=1)[:, 0], axis=1)
    assert (lengths[feelers["feelers/hit"] == 1] < 1.5 * arrays["forager/size"][row]).all()


def test_a_field_goes_with_ground_that_moves(live: LiveSimulation, scene: Path) -> None:
    scene.write_text(scene.read_text().replace(
        "boulder: {mesh: boulder.ply}",
        "boulder: {mesh: boulder.ply, keys: {1: {at: [0, 0, 0]}, 11: {at: [0, 50, 0], rotate: [0, 90, 0]}}}",
    ))  # fmt: skip
    page = Page(live)
    page.ask("look", columns=[], fields=["trail"], flows=[], follow=None)
    page.until(lambda: "mesh:boulder" in page.make_packets and unpack_arrays(page.make_packets["mesh:boulder"])[0]["moves"])
    page.ask("step", count=10)
    page.frame_arrays(11)
    page.until(lambda: unpack_arrays(page.make_packets["field:trail"])[0]["frame"] == 11)
    field = unpack_arrays(page.make_packets["fieldmesh:trail"])[1]["position"].reshape(-1, 3)
    for name in ("ground", "boulder"):
        mesh = unpack_arrays(page.make_packets[f"mesh:{name}"])[1]["position"].reshape(-1, 3)
        assert all(np.linalg.norm(field - vertex, axis=1).min() < 0.01 for vertex in mesh[::97]), name


@pytest.mark.parametrize(
    "example", ["thesis/base.yaml", "tunnel/led.yaml", "minimal/scene.yaml", "alarm/scene.yaml", "flow/scene.yaml"]
)
def test_everything_in_a_scene_is_sent_and_shown(example: str) -> None:
    live = LiveSimulation.open_scene(EXAMPLES / example, watch=False)
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
        arrays = page.frame_arrays(first + 3)
        page.hash_at(first + 3)
        json.dumps(page.told, allow_nan=False)
        assert not [message for message in page.told if message["op"] == "refused"]
        for each in columns:
            assert np.isfinite(arrays[f"{each['species']}/column/{each['name']}"]).all() or each["name"] == "max_turn"
        expected_slots = {f"field:{name}" for name in fields} | {f"flow:{name}" for name in scene["flows"]}
        expected_slots |= {f"curve:{name}" for name in scene["curves"]} | {f"rig:{each['name']}" for each in scene["species"]}
        page.until(lambda: expected_slots <= page.make_packets.keys())
        for param in scene["params"]:
            assert param["low"] is None or param["low"] <= param["number"] <= param["high"], param
    finally:
        live.stop()
