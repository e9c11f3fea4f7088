"""Notes for single agents: what they do in each frame, and that nothing else changes."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from commands import run
from directed import Track, follow, open_directed, row_of, start
from explained import cached

from antdsl.explain import explain_agent_in_cache
from antdsl.pipeline import open_scene
from antdsl.runtime import Options, World, restore_checkpoint, state_hash, step, take_checkpoint
from antdsl.runtime.notes.target_findings import find_far_targets, report_missed_targets

NAMES = ("main.state", "mood", "max_speed", "size", "brave")


def test_a_held_agent_stands_in_exactly_these_frames_and_looks_up(tmp_path: Path) -> None:
    note = "{hold: guards.17, frames: 30..53, ease: 6, look_at: {head: [0, 100, 0]}}"
    track = follow(open_directed(tmp_path, note), 70, names=("look#head.y", "~look#head.y"))
    speed = np.linalg.norm(track.of("velocity", 17), axis=1)
    frames = np.array(track.frames)
    held = (frames >= 30) & (frames <= 53)
    assert (speed[held] < 0.1).all() and (speed[~held] > 0.1).all()
    position = track.of("position", 17)
    assert (position[held] == position[held][0]).all()  # no contact moves it
    assert (track.of("heading", 17)[held] == track.of("heading", 17)[held][0]).all()
    early, late = speed[(frames >= 20) & (frames < 30)], speed[(frames > 53) & (frames <= 60)]
    assert (np.abs(np.diff(speed)) < 0.3 * speed.max()).all()  # it slows and starts smoothly
    assert early[0] > 10 and late[-1] > 10
    assert track.of("look#head.y", 17)[frames == 50][0] > 0.5 and track.of("look#head.y", 17)[frames == 10][0] == 0
    turn = np.einsum("fk,fk->f", track.of("heading", 17)[1:], track.of("heading", 17)[:-1])
    assert np.degrees(np.arccos(np.clip(turn, -1, 1))).max() < 400 / 24 * 1.01


def test_a_note_changes_no_other_agents_draws(tmp_path: Path) -> None:
    """Far from the held agent, all others do what they did without the note."""
    program_scene = dict(count=8, last=30)
    plain = follow(open_directed(tmp_path / "plain", **program_scene), 30)  # type: ignore[arg-type]
    noted = follow(open_directed(tmp_path / "noted", "{hold: guards.3, frames: 5..20}", **program_scene), 30)  # type: ignore[arg-type]
    others = [k for k in range(8) if k != 3]
    far = np.linalg.norm(plain.values["position"][:, others] - plain.values["position"][:, [3]], axis=2).min(axis=0) > 35
    assert far.sum() >= 3
    for name in ("position", "velocity", "heading"):
        same = plain.values[name][:, others][:, far] == noted.values[name][:, others][:, far]
        assert same.all()


MANY_NOTES = (
    "{hold: guards.17, frames: 10..14, ease: 3, look_at: {head: leaf}, play: run}",
    "{retime: {of: guards, share: 40 %}, frames: 8..30, speed: 50 %}",
    "{reach: guards.3, target: leaf, frame: 40}",
    "{path: guards.5, along: way, frames: 20..40}",
    "{set: guards.7, to: {max_speed: 12 mm/s, brave: true}, frames: 6..20}",
    "{change: guards.8, to: rest, frame: 9}",
    "{without: guards.20..22}",
    "{release: guards.23..30, frame: 6, stagger: {random: 9}}",
    "{hold: guards.50..59, frames: 12..20, ease: 3, stagger: {from: leaf, speed: 200 mm/s}}",
    "{set: ant, share: 50 %, to: {brave: true, mood: 2}, frames: 5..30, stagger: {each: 1, from: [0, 0, 0], ends: together}}",
    "{path: guards.55..59, along: [[0, 0, 60], [60, 0, 60]], frames: 18..30, stagger: {each: 2}}",
    "{change: guards.45..49, to: rest, frame: 12, stagger: {each: 3}}",
    "{confine: guards.51..54, in: {in_view: front, across: [0 %, 50 %]}, falloff: 10 mm, frames: 10..30}",
    "{forbid: guards.31..33, in: {along: [front, guards.0, leaf], width: 20 mm}}",
    "{hold: {of: guards, near: leaf, farthest: 2}, frames: 3..9}",
    "{reach: guards.31..33, target: leaf, frame: 30, stagger: {from: front, speed: 100 mm/s}}",
    "{slow: guards, in: {around: stone, radius: 30 mm}, falloff: 20 mm, painted: mud}",
    "{forbid: {of: guards, state: walk}, in: {from: [20, -50, 20], to: [60, 50, 60]}, falloff: 15 mm}",
    "{attract: {near: leaf, within: 60 mm}, to: leaf, radius: 80 mm, strength: 60 %, frames: 5..30}",
    "{lane: guards, along: way, width: 30 mm, strength: 50 %}",
    "{part: guards, for: foot, distance: 20 mm}",
    "{repel: guards, from: stone, radius: 30 mm}",
    "{forbid: guards, in: {around: [guards.1, guards.2], radius: 12 mm}, falloff: 8 mm}",
    "{repel: guards.40..49, from: foot, radius: 60 mm}",
    "{look: guards.9, at: {head: front}}",
    "{look: guards.10, at: {head: foot}}",
    "{hold: guards, off: yes}",
    "{thin: guards, to: 90 %, in: {from: [0, -50, -150], to: [150, 50, 150]}}",
)  # fmt: skip


@pytest.mark.parametrize(
    "options",
    [
        Options(backend="numpy", chunk=7, threads=2, shuffle_rows=3),
        pytest.param(Options(backend="reference", shuffle_rows=1), marks=pytest.mark.slow),
        pytest.param(Options(threads=2), marks=pytest.mark.slow),
    ],
)
def test_all_notes_together_give_the_same_bits_on_all_backends(tmp_path: Path, options: Options) -> None:
    shot = open_directed(tmp_path, *MANY_NOTES)
    worlds = [
        start(shot),
        start(shot, **{name: getattr(options, name) for name in ("backend", "chunk", "threads", "shuffle_rows")}),
    ]
    for frame in range(2, 16 if options.backend == "reference" else 42):
        hashes = []
        for world in worlds:
            step(world)
            hashes.append(state_hash(world))
        assert hashes[0] == hashes[1], frame


def test_a_run_continues_from_any_frame_with_the_same_bits(tmp_path: Path) -> None:
    shot = open_directed(tmp_path, *MANY_NOTES)
    world = start(shot)
    snapshots = {}
    while world.frame < 34:
        if world.frame in (6, 12, 25):
            snapshots[world.frame] = take_checkpoint(world)
        step(world)
    for arrays in snapshots.values():
        other = start(shot)
        restore_checkpoint(other, arrays)
        while other.frame < 34:
            step(other)
        assert state_hash(other) == state_hash(world)


def find_reachable(folder: Path) -> list[int]:
    """Agents that are 60 to 95 mm from the leaf."""
    world = start(open_directed(folder))
    distance = np.linalg.norm(world.populations["ant"].position - world.items["leaves"].position[0], axis=1)
    ids = world.populations["ant"].ids
    return sorted(int(ids[k]) for k in np.flatnonzero((distance > 60) & (distance < 95)))[:3]


def test_agents_reach_an_item_in_the_frame_within_their_limits(tmp_path: Path) -> None:
    agents = find_reachable(tmp_path / "plain")
    shot = open_directed(tmp_path / "noted", *(f"{{reach: ant.{k}, target: leaf, frame: 100}}" for k in agents[:1]), last=101)
    track = follow(shot, 101)
    leaf = track.world.items["leaves"].position[0]
    for agent in agents[:1]:
        distance = np.linalg.norm(track.of("position", agent) - leaf, axis=1)
        arrival = track.frames[int(np.flatnonzero(distance <= 6 + 0.01)[0])]
        assert abs(arrival - 100) <= 1
        assert (track.speeds()[:, list(track.ids).index(agent)] <= 30 * 1.005).all()
    assert track.world.motion.deep_max < 0.05  # no new overlap
    assert not report_missed_targets(shot.scene, track.world).diagnostics
    assert not find_far_targets(shot.scene, start(shot)).diagnostics


def test_an_agent_that_is_too_late_is_reported_with_the_missing_distance(tmp_path: Path) -> None:
    agent = find_reachable(tmp_path / "plain")[0]
    shot = open_directed(tmp_path / "noted", f"{{reach: ant.{agent}, target: leaf, frame: 30}}")
    world = start(shot)
    (early,) = find_far_targets(shot.scene, world).diagnostics
    place = world.populations["ant"].position[row_of(world, agent)]
    missing = np.linalg.norm(place - world.items["leaves"].position[0]) - 6 - 30 * 29 / 24
    assert early.code == "far-target" and f"`ant.{agent}` cannot reach the target in time" in early.message
    assert f"which is {missing:.1f} mm too short" in early.message and early.span is not None
    track = Track(world, 31)
    (late,) = report_missed_targets(shot.scene, world).diagnostics
    distance = np.linalg.norm(track.at("position", 30, agent) - world.items["leaves"].position[0]) - 6
    assert f"`ant.{agent}` was {distance:.1f} mm away" in late.message


def test_a_path_is_walked_in_time_from_end_to_end(tmp_path: Path) -> None:
    shot = open_directed(
        tmp_path, "{path: guards.39, along: [[40, 0, -20], [20, 0, -40], [20, 0, -70]], frames: 60..140}", last=140
    )
    track = follow(shot, 140)
    place = track.of("position", 39)[:, [0, 2]]
    for frame, goal in ((60, (40, -20)), (100, (20, -40.9)), (140, (20, -70))):
        assert np.linalg.norm(place[track.frames.index(frame)] - goal) < 3, frame
    assert (track.speeds()[:, 39] <= 30 * 1.005).all()
    assert not find_far_targets(shot.scene, start(shot)).diagnostics


def test_agents_apart_on_a_path_walk_in_single_file(tmp_path: Path) -> None:
    note = "{path: guards.36..39, along: [[-40, 0, -20], [60, 0, -20]], frames: 90..210, apart: 9 mm}"
    shot = open_directed(tmp_path, note, last=210)
    track = follow(shot, 210)
    goal = -40 + 100 * (180 - 90) / 120
    for k in range(4):
        x, z = track.at("position", 180, 36 + k)[[0, 2]]
        assert abs(x - (goal - 9 * k)) < 3 and abs(z + 20) < 3, k
    assert (track.speeds()[track.frames.index(90) :, 36:40] <= 30 * 1.005).all()  # the ball pushes no agent any more


def test_agents_that_miss_a_path_are_reported_after_the_run(tmp_path: Path) -> None:
    shot = open_directed(tmp_path, "{path: guards, along: [[0, 0, 0], [20, 0, 0]], frames: 10..20}", last=21)
    world = start(shot)
    for _ in range(20):
        step(world)
    (warning,) = report_missed_targets(shot.scene, world).diagnostics  # one for each note
    assert "missed the target of this note" in warning.message


def test_agents_ignore_a_target_that_does_not_exist(tmp_path: Path) -> None:
    notes = ("{without: [guards.59]}", "{reach: guards.3, target: guards.59, frame: 60}")
    assert np.isfinite(follow(open_directed(tmp_path, *notes), 30).of("position", 3)).all()


def test_equal_notes_count_twice(tmp_path: Path) -> None:
    note = "{retime: guards, frames: 5..30, speed: 50 %}"
    speeds = [np.median(follow(open_directed(tmp_path / str(n), *[note] * n), 25).speeds()[-1]) for n in (1, 2)]
    assert speeds[1] == pytest.approx(speeds[0] / 2, rel=0.15)


@pytest.mark.parametrize(
    ("note", "message"),
    [
        ("{hold: guards, frames: 500..600}", "the scene ends at frame 80, before this note"),
        ("{release: guards, frame: 900000}", "the scene ends at frame 80, before this note"),
        ("{hold: guards, frames: -30..-20}", "the scene begins at frame 1, after this note"),
        ("{change: guards, to: rest, frame: 1}", "agents begin in a state without a change"),
    ],
)
def test_notes_outside_of_the_frames_are_reported(tmp_path: Path, note: str, message: str) -> None:
    open_directed(tmp_path, note)
    _, report = open_scene(tmp_path / "scene.yaml")
    (warning,) = (each for each in report.diagnostics if each.code == "out-of-range")
    assert message in warning.message


def test_heads_look_in_a_direction(tmp_path: Path) -> None:
    track = follow(
        open_directed(tmp_path, "{look: guards.2, at: {head: {direction: [0, 2, 0]}}, frames: 5..20}"), 12, names=("look#head.y",)
    )
    assert track.of("look#head.y", 2)[-1] > 0.5


def test_values_ease_in_and_states_change_with_their_actions(tmp_path: Path) -> None:
    notes = (
        "{set: guards.4, to: {max_speed: 12 mm/s, brave: true}, frames: 20..30, ease: 4}",
        "{change: guards.6, to: rest, frame: 15}",
    )
    track = follow(open_directed(tmp_path, *notes), 40, names=NAMES)
    speed = dict(zip(track.frames, track.of("max_speed", 4).tolist(), strict=True))
    assert [speed[frame] for frame in (15, 20, 25, 40)] == [30, 12, 12, 12]
    assert 30 > speed[16] > speed[17] > speed[18] > speed[19] > 12
    brave = dict(zip(track.frames, track.of("brave", 4).tolist(), strict=True))
    assert not brave[19] and brave[20]
    assert track.at("main.state", 14, 6) == 0 and track.at("main.state", 15, 6) == 1
    assert track.at("mood", 15, 6) == 5  # its `enter` has run
    assert not track.of("main.state", 5).any() and (track.of("max_speed", 5) == 30).all()


def test_a_clip_and_a_look_begin_and_end_with_the_note(tmp_path: Path) -> None:
    shot = open_directed(
        tmp_path, "{play: guards.2, clip: run, frames: 10..20, ease: 4}", "{look: guards.2, at: {head: leaf}, frames: 10..20}"
    )
    track = follow(shot, 40, names=("notes_play.clip", "notes_play.clip_fade", "look#head.x"))
    clips = [each.name for each in shot.plan.species["ant"].clips]
    playing = dict(zip(track.frames, track.of("notes_play.clip", 2).tolist(), strict=True))
    assert playing[5] == -1 and clips[playing[7]] == clips[playing[20]] == "run" and playing[21] == -1
    assert track.at("notes_play.clip_fade", 10, 2) < 0.3 and track.at("notes_play.clip_fade", 30, 2) == 0
    assert track.at("look#head.x", 20, 2) < 0.999 and track.at("look#head.x", 40, 2) > 0.95
    assert (track.of("notes_play.clip", 3) == -1).all()


def test_agents_without_never_appear_and_others_are_the_same(tmp_path: Path) -> None:
    world, noted = start(open_directed(tmp_path / "a")), start(open_directed(tmp_path / "b", "{without: [guards.17, ant.3]}"))
    p, q = world.populations["ant"], noted.populations["ant"]
    assert len(q) == len(p) - 2 and not {3, 17} & set(q.ids.tolist()) and q.next_id == p.next_id
    rows = p.find_rows(q.ids)
    for name in q.now:
        if name in p.now:
            assert np.array_equal(p.now[name][rows], q.now[name], equal_nan=True), name


BIRTHS = """ant 1
world { surface ground; obstacle foot; items leaves; curve way; map mud; items stones }
species ant {
  size 5 mm
  max_speed 1 mm/s
  start go
  state go { when true -> done { spawn ant } }
  state done { when after 60 min -> go }
}
"""


def test_newborn_agents_without_never_appear(tmp_path: Path) -> None:
    worlds: list[World] = [
        start(open_directed(tmp_path / name, *notes, count=4, program=BIRTHS))
        for name, notes in (("a", ()), ("b", ("{without: ant.5}",)))
    ]
    for world in worlds:
        for _ in range(3):
            step(world)
    every, fewer = ({int(k) for k in world.populations["ant"].ids} for world in worlds)
    assert 5 in every and 5 not in fewer and {4, 6, 7} <= fewer


def test_agents_of_a_line_with_a_rate_can_be_without(tmp_path: Path) -> None:
    worlds = []
    for name, notes in (("a", ()), ("b", ("{without: guards.2..4}",))):
        scene = open_directed(tmp_path / name, *notes, count=6)
        text = (tmp_path / name / "scene.yaml").read_text().replace("count: 6,", "count: 6, frames: 2..7,")
        (tmp_path / name / "scene.yaml").write_text(text)
        shot, report = open_scene(tmp_path / name / "scene.yaml")
        assert scene is not None and shot is not None, report.errors
        worlds.append(start(shot))
        while worlds[-1].frame < 9:
            step(worlds[-1])
    every, fewer = (sorted(world.populations["ant"].ids.tolist()) for world in worlds)
    assert every == [0, 1, 2, 3, 4, 5] and fewer == [0, 1, 5]


def test_info_lists_the_notes_that_were_on(tmp_path: Path) -> None:
    open_directed(
        tmp_path,
        "{hold: guards.3,\n      frames: 1..9}",
        "{hold: guards, off: yes}",
        "{retime: ant, speed: 50 %}",
        count=4,
        last=2,
    )
    assert run("run", "scene.yaml", "--out", "cache", "--quiet", cwd=tmp_path).returncode == 0
    lines = run("info", "cache", cwd=tmp_path).stdout.splitlines()
    noted = [line.split(maxsplit=1)[1] for line in lines if line.startswith("note ")]
    assert noted == ["hold: guards.3, frames: 1..9", "retime: ant, speed: 50 %"]


def test_an_explanation_names_the_notes_that_direct_an_agent(tmp_path: Path) -> None:
    open_directed(tmp_path, "{hold: guards.3, frames: 10..20}", count=6, last=24)
    cache = cached(tmp_path / "scene.yaml", 24, tmp_path / "cache")
    held, free, later = (explain_agent_in_cache(cache, agent, frame).notes for agent, frame in ((3, 15), (2, 15), (3, 8)))
    assert held == ("the scene directs it by {hold: guards.3, frames: 10..20} in scene.yaml:16, with weight 1",) and free == ()
    assert "with weight 0." in later[0]
