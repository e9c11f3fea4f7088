"""What pages are sent of bodies from files: once, again where they are other ones, and what agents play in each frame."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from live_client import Page
from preview_page import copied

from antdsl.bodies.agents.definition import STATE_MATERIAL, Variation
from antdsl.bodies.agents.driving import PoseAdjustments
from antdsl.bodies.agents.varied_bodies import VariationDraws, draw_colour_path_positions
from antdsl.bodies.library import load_library_body
from antdsl.bodies.posed_body import PosedBody
from antdsl.outputs.pictures.light import encode_srgb_values
from antdsl.preview import LiveSimulation, PreviewSession
from antdsl.preview.binary_packets import unpack_arrays
from antdsl.preview.viewing.action_arrays import NO_CLIP_CODE
from antdsl.preview.viewing.body_packets import BodyOutfit, find_traits, make_rig_packet


@pytest.fixture
def scene(tmp_path: Path) -> Path:
    """A copy of the walkers, thirty of them on flat ground."""
    scene_path = copied("walker", tmp_path) / "scene.yaml"
    scene_path.with_name("hill.ply").write_text(
        "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\nelement face 2\n"
        "property list uchar int vertex_indices\nend_header\n-20 0 -20\n-20 0 20\n20 0 20\n20 0 -20\n3 0 1 2\n3 0 2 3\n"
    )
    scene_path.write_text(scene_path.read_text().replace("count: 60", "count: 30"))
    return scene_path


@pytest.fixture
def live(scene: Path) -> Iterator[LiveSimulation]:
    live = LiveSimulation.open_scene(scene)
    live.start()
    yield live
    live.stop()


def test_a_frame_tells_what_agents_play(live: LiveSimulation, scene: Path) -> None:
    page = Page(live)
    page.ask("step", count=60)
    arrays = page.frame_arrays(61)
    session, _ = PreviewSession.open(scene)
    assert session is not None
    for _ in range(60):
        session.step()
    walkers = session.world.populations["walker"]
    rows = walkers.get_rows_by_id()
    clips = [clip.name for clip in walkers.plan.clips]
    playing = set()
    for machine in ("legs", "arms"):
        plays = arrays[f"walker/plays/{machine}"].reshape(30, 3, -1)[:, :, :2].reshape(30, 6)
        now = {name: walkers.now[f"{machine}.{name}"][rows] for name in ("clip", "clip_before", "clip_turns", "clip_fade")}
        assert np.array_equal(plays[:, 0], np.where(now["clip"] < 0, NO_CLIP_CODE, now["clip"]).astype(np.uint16))
        loops = np.array([*(name != "wave" for name in clips), False])[np.minimum(plays[:, 0], len(clips))]
        turns = np.where(loops, now["clip_turns"] % 1, np.minimum(now["clip_turns"], 1))
        assert np.abs(plays[:, 2] / 65535 - turns).max() < 2e-5
        weights = plays[:, 4:] / 65535
        assert np.abs(weights[:, 0] - walkers.now[f"{machine}.clip_weight"][rows] * (1 - now["clip_fade"])).max() < 2e-5
        assert (weights[plays[:, :2] == NO_CLIP_CODE] == 0).all()
        playing |= {clips[each] for each in plays[:, 0] if each != NO_CLIP_CODE}
    assert playing >= {"walk", "run", "idle"}
    page.ask("seek", frame=30, exact=False)
    dragged = {name for name in page.frame_arrays(30, light=True) if "/plays/" in name}
    assert dragged == {"walker/plays/legs", "walker/plays/arms"}, "frames that were stepped while a page was open are kept posed"


def test_a_body_is_sent_once_and_again_when_it_is_another_one(live: LiveSimulation, scene: Path) -> None:
    page = Page(live)
    page.until(lambda: "rig:walker" in page.make_packets)
    header, arrays = unpack_arrays(page.make_packets["rig:walker"])
    assert header["machines"] == ["legs", "arms"] and header["joints"] == 13
    first = page.make_packets["rig:walker"]
    page.ask("step", count=3)
    page.frame_arrays(4)
    assert page.make_packets["rig:walker"] is first
    body = scene.with_name("walker.json")
    definition = json.loads(body.read_text())
    definition["materials"]["skin"] = [0.1, 0.5, 0.1]
    body.write_text(json.dumps(definition))
    page.until(lambda: page.make_packets["rig:walker"] != first)
    _, other = unpack_arrays(page.make_packets["rig:walker"])
    assert not np.array_equal(arrays["fine/colour"], other["fine/colour"])
    assert np.array_equal(arrays["fine/position"], other["fine/position"])
    page.ask("step", count=1)
    page.status(frame=5, hash=page.hash_at(5))


def test_the_packet_of_a_body_has_the_natural_colours_of_pictures() -> None:
    """If the material of states varies, they are those along its path: a trait selects the one that pictures draw."""
    ends = ((0.4, 0.1, 0.0), (0.0, 0.2, 0.6), (0.9, 0.9, 0.9))
    ant = load_library_body("ant")
    varied = replace(ant, variation=Variation({}, {"shell": ends[:2], STATE_MATERIAL: ends}))
    for body in (ant, varied):
        driven = PoseAdjustments(variation_draws=VariationDraws(np.arange(50), 3, "ant"))
        expected = encode_srgb_values(PosedBody(body, ()).compute_natural_colours(driven, 50))
        header, arrays = unpack_arrays(make_rig_packet("ant", BodyOutfit(body)))
        table, steps = arrays["natural"].reshape(-1, 3), np.zeros(50)
        if body is varied:
            trait, per_unit = header["natural"]
            assert trait == len(find_traits(BodyOutfit(body)).targets) + 1, "after that of the shell"
            steps = draw_colour_path_positions(body.variation, STATE_MATERIAL, driven.variation_draws) * per_unit
        assert np.abs(table[np.rint(steps).astype(int)] / 255 - expected).max() < 0.012
        assert (len(table), header["natural"] == []) == ((256, False) if body is varied else (1, True))


def test_errors_in_a_body_are_located_and_the_old_body_stays(live: LiveSimulation, scene: Path) -> None:
    page = Page(live)
    page.until(lambda: "rig:walker" in page.make_packets)
    first = page.make_packets["rig:walker"]
    body = scene.with_name("walker.json")
    good = body.read_text()
    number = len(page.told)
    body.write_text(good.replace('"chest":["head"', '"chest":["heap"', 1))
    said = page.message_after("problems", number)["problems"]
    assert any("heap" in each["message"] or "head" in each["message"] for each in said), said
    assert {each["severity"] for each in said} == {"error"} and all(each["line"] > 0 for each in said)
    page.ask("step", count=2)
    page.status(frame=3)
    assert page.make_packets["rig:walker"] is first
    body.write_text(good)
    page.until(lambda: page.last("problems")["problems"] == [])
    page.ask("step", count=1)
    page.status(frame=4)


def test_a_species_that_loses_its_file_gets_a_body_of_the_library(live: LiveSimulation, scene: Path) -> None:
    page = Page(live)
    page.until(lambda: "rig:walker" in page.make_packets)
    program = scene.with_name("walker.ant")
    program.write_text(program.read_text().replace("play wave(on: arms)", "play look(on: feelers)"))
    scene.write_text(scene.read_text().replace(" body: walker.json,", ""))
    page.until(lambda: unpack_arrays(page.make_packets["rig:walker"])[0]["joints"] == len(load_library_body("ant").rig.names))
