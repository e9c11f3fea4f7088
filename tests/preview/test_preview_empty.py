"""The preview of a crowd that is not there in some frames: packets, curves, breakpoints, explanations, reloads and going back."""

from __future__ import annotations

from pathlib import Path

import empty_scenes
import numpy as np
import pytest
from empty_scenes import CASES, FIRST, LAST
from live_client import Page, hashes
from sampling import sampled

from antdsl.preview import LiveSimulation, PreviewSession

LOOK = {
    "columns": ({"species": "person", "name": "load"}, {"species": "ant", "name": "soil"}),
    "fields": ("trail",),
    "flows": ("home",),
    "follow": {"species": "person", "agent": 0},
    "planned": ({"species": "ant", "agent": 0},),
}
BREAKS = (
    {"kind": "condition", "text": "count(person) > 100"},
    {"kind": "condition", "text": "mean(ant.speed) > 9 m/s or share(ant.state == roam) > 1"},
    {"kind": "state", "species": "person", "machine": "legs", "state": "gone"},
    {"kind": "spec", "spec": "whoever is there"},
    {"kind": "fault"},
)


@pytest.mark.slow
@pytest.mark.parametrize("case", CASES)
def test_a_page_is_shown_frames_without_agents(tmp_path: Path, case: str) -> None:
    scene = empty_scenes.scene(tmp_path / "scene", case)
    live = LiveSimulation.open_scene(scene)
    live.start()
    try:
        page = Page(live)
        page.ask("look", **LOOK)
        page.ask("profile", on=True)
        page.ask("breaks", breaks=BREAKS[3:])
        page.ask("breaks", breaks=BREAKS)
        for frame in range(FIRST, LAST + 1):
            page.ask("seek", frame=frame, exact=True) if frame == FIRST else page.ask("step", count=1)
            arrays = page.frame_arrays(frame)
            for species in ("person", "ant"):
                count = len(arrays[f"{species}/id"])
                assert len(arrays[f"{species}/position"].reshape(-1, 3)) == count
            page.ask("explain", species="person", agent=0, frame=frame)
        last = page.hash_at(LAST)
        page.ask("seek", frame=FIRST + 4, exact=True)
        page.frame_arrays(FIRST + 4)
        assert page.ask_and_wait("set", name="person.life", value="0.2 s")["ok"]
        assert page.ask_and_wait("restart")["ok"]
        assert not [message for message in page.told if message["op"] == "refused" and "bug" in str(message)]
        assert last == hashes(scene, LAST)[LAST]
    finally:
        live.stop()


@pytest.mark.parametrize("case", sampled(CASES, ["not_in_the_middle"]))
def test_a_program_is_reloaded_from_and_into_nothing(tmp_path: Path, case: str) -> None:
    scene = empty_scenes.scene(tmp_path / "scene", case)
    session, report = PreviewSession.open(scene, checkpoint_interval=2)
    assert session is not None, [each.message for each in report.errors]
    program = scene.with_name("crowd.ant")
    known_hashes = {}
    for number in range(8):
        session.step()
        if number % 2:
            text = program.read_text()
            new = text.replace("load = 0\n", f"load = 0\n  more_{number} = {number}\n")
            program.write_text(new.replace("max_speed 3 m/s", f"max_speed {3 + number} m/s"))
            assert session.reload().is_successful
        known_hashes[session.frame] = session.state_hash
    for frame in (FIRST + 2, FIRST + 7, FIRST + 4):
        session.seek(frame)
        assert session.state_hash == known_hashes[frame]
    assert all(np.isfinite(p.position).all() for p in session.world.populations.values())
