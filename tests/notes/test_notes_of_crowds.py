"""Notes for many agents: regions, lanes, targets, something to make way for, releases, and fewer agents."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from directed import Track, follow, open_directed, start

from antdsl.pipeline import open_scene
from antdsl.runtime import World, step
from antdsl.runtime.sensing.sensed_camera import SensedCamera


def mean_speed(track: Track, first: int, last: int, chosen: np.ndarray | slice = slice(None)) -> float:
    """The mean distance over time (mm/s) of agents between two frames."""
    frames = np.array(track.frames[1:])
    return float(track.speeds()[(frames > first) & (frames <= last)][:, chosen].mean())


def test_slower_by_half_in_these_frames(tmp_path: Path) -> None:
    plain = follow(open_directed(tmp_path / "plain"), 70)
    track = follow(open_directed(tmp_path / "noted", "{retime: ant, frames: 30..50, speed: 50 %}"), 70)
    for first, last, share in ((0, 22, 1.0), (29, 50, 0.5), (57, 70, 1.0)):
        assert abs(mean_speed(track, first, last) / mean_speed(plain, first, last) - share) < 0.06, first
    mean = track.speeds().mean(axis=1)
    assert np.abs(np.diff(mean)).max() < 3.5  # mm/s: no jerk


def test_a_share_is_slowed_and_the_others_are_not(tmp_path: Path) -> None:
    shot = open_directed(tmp_path, "{retime: guards, share: 40 %, seed: 9, speed: 20 %}", count=60)
    track = follow(shot, 30)
    assert track.world.notes is not None
    (active,) = track.world.notes.active
    slow = np.isin(track.ids, track.world.populations["ant"].ids[active.rows["ant"]])
    assert 12 <= slow.sum() <= 36
    assert mean_speed(track, 3, 30, slow) < 0.3 * mean_speed(track, 3, 30, ~slow)


def test_no_agent_enters_a_forbidden_box_and_those_inside_leave_it(tmp_path: Path) -> None:
    note = "{forbid: ant, in: {from: [-40, -50, -40], to: [40, 50, 40]}, falloff: 15 mm, frames: 10..160}"
    track = follow(open_directed(tmp_path, note, count=40, last=160), 160)
    inside = (np.abs(track.values["position"][:, :, [0, 2]]) < 40).all(axis=2)
    assert inside[0].sum() > 3
    assert not inside[-30:].any()
    entering = ~inside[12:-1] & inside[13:]
    assert not entering.any()


def test_a_region_slows_by_its_distance_and_its_map(tmp_path: Path) -> None:
    note = "{slow: ant, in: {around: [0, 0, 0], radius: 60 mm}, speed: 30 %, painted: mud}"
    track = follow(open_directed(tmp_path, note), 24)
    place, speed = track.values["position"][:-1], track.speeds()
    near = np.linalg.norm(place[:, :, [0, 2]], axis=2) < 50
    muddy = place[:, :, 0] < -12
    dry = place[:, :, 0] > 12
    usual = speed[dry].mean()
    assert speed[near & muddy].mean() < 0.45 * usual and speed[near & dry].mean() > 0.9 * usual


def test_agents_go_to_a_target_and_away_from_another(tmp_path: Path) -> None:
    notes = ("{attract: guards.0..19, to: leaf}", "{repel: guards.20..59, from: stone, radius: 60 mm}")
    track = follow(open_directed(tmp_path, *notes), 80)
    leaf, stone = (track.world.items[name].position[0] for name in ("leaves", "stones"))
    to_leaf = np.linalg.norm(track.values["position"][:, :20] - leaf, axis=2).mean(axis=1)
    assert to_leaf[-1] < to_leaf[0] - 40
    to_stone = np.linalg.norm(track.values["position"][:, 20:] - stone, axis=2)
    assert (to_stone[0] < 40).sum() > (to_stone[-1] < 40).sum() == 0


def test_a_lane_leads_agents_along_its_curve(tmp_path: Path) -> None:
    track = follow(open_directed(tmp_path, "{lane: ant, along: [[-100, 0, 0], [100, 0, 0]], width: 80 mm, falloff: 20 mm}"), 40)
    plain = follow(open_directed(tmp_path / "plain"), 40)
    in_lane = np.abs(track.values["position"][20:-1, :, 2]) < 30
    forward, usual = (each.values["velocity"][20:-1, :, 0][in_lane].mean() for each in (track, plain))
    assert forward > 15 > usual + 10
    width = np.abs(track.values["position"][:, :, 2])
    chosen = width[0] < 35
    assert width[-1][chosen].mean() < 0.6 * width[0][chosen].mean()


def test_the_crowd_parts_for_a_moving_foot(tmp_path: Path) -> None:
    """The ball of the scene has a radius of 25 mm and goes 200 mm in 60 frames, nearly three times as fast as an ant."""

    def count_inside(*notes: str) -> int:
        inside: list[int] = []

        def look(world: World) -> None:
            x = np.interp(world.frame, [20, 80], [-150, 50])
            offset = world.populations["ant"].position[:, [0, 2]] - (x, 40)
            inside.append(int((np.linalg.norm(offset, axis=1) < 24.9).sum()))

        follow(open_directed(tmp_path / str(len(notes)), *notes), 84, each=look)
        return sum(inside)

    assert count_inside() > 20
    assert count_inside("{part: ant, for: foot, distance: 40 mm}") == 0


def test_the_crowd_parts_for_an_item(tmp_path: Path) -> None:
    track = follow(open_directed(tmp_path, "{part: ant, for: stone, distance: 20 mm}"), 60)
    stone = track.world.items["stones"].position[0]
    level = np.linalg.norm((track.values["position"] - stone)[:, :, [0, 2]], axis=2)
    assert (level[30:] > 10).all()


def test_agents_start_when_they_are_released(tmp_path: Path) -> None:
    track = follow(open_directed(tmp_path, "{release: guards, frame: 20, spread: 10, ease: 4}"), 50)
    moving = track.speeds() > 1e-6
    first = np.array(track.frames[1:])[moving.argmax(axis=0)]
    assert first.min() == 20 and first.max() == 30 and len(set(first.tolist())) > 5
    assert mean_speed(track, 40, 50) > 15


def test_half_as_many_agents_at_the_start_of_a_region(tmp_path: Path) -> None:
    plain = start(open_directed(tmp_path / "plain", count=120))
    noted = start(
        open_directed(tmp_path / "noted", "{thin: ant, to: 50 %, in: {from: [-200, -50, 0], to: [200, 50, 200]}}", count=120)
    )
    starts = [world.populations["ant"].position for world in (plain, noted)]
    front, back = ([int((place[:, 2] >= 0).sum()), int((place[:, 2] < 0).sum())] for place in starts)
    assert back[0] == round(front[0] / 2) and back[1] == front[1]
    rows = plain.populations["ant"].find_rows(noted.populations["ant"].ids)
    assert (starts[0][rows] == starts[1]).all()


def test_memory_and_selections_follow_agents_through_deaths(tmp_path: Path) -> None:
    """Agents that a note selects by position keep their role, wherever they go, and dead ones are forgotten."""
    shot = open_directed(tmp_path, "{retime: ant, near: leaf, within: 60 mm, frames: 10..60, speed: 10 %}")
    world = start(shot)
    while world.frame < 12:
        step(world)
    assert world.notes is not None
    (ids,) = (array for name, array in world.notes.memory.items() if name.endswith("ant.ids") and not name.startswith("pace"))
    assert 2 < len(ids) < 30
    while world.frame < 40:
        step(world)
    (active,) = world.notes.active
    assert np.array_equal(np.sort(world.populations["ant"].ids[active.rows["ant"]]), ids)


def test_no_agent_is_in_view_before_a_frame(tmp_path: Path) -> None:
    """Agents that would begin in view never appear, and the others stay outside until frame 50."""

    def count_in_view(*notes: str) -> list[int]:
        counts: list[int] = []

        def look(world: World) -> None:
            place = world.populations["ant"].position
            counts.append(
                int(
                    SensedCamera(world.setting.cameras["front"], world.origin)
                    .find_in_view(world.frame, place, np.zeros(len(place)))
                    .sum()
                )
            )

        world = start(open_directed(tmp_path / str(len(notes)), *notes, count=120, last=110))
        look(world)
        while world.frame < 110:
            step(world)
            look(world)
        return counts

    assert min(count_in_view()) > 3
    counts = count_in_view("{without: ant, in_view: front}", "{forbid: ant, in: {in_view: front}, falloff: 15 mm, frames: 1..49}")
    assert counts[:49] == [0] * 49 and max(counts[49:]) > 2


def test_half_as_many_in_the_foreground(tmp_path: Path) -> None:
    worlds = [
        start(open_directed(tmp_path / str(len(notes)), *notes, count=120))
        for notes in ((), ("{thin: ant, to: 50 %, in_view: front}",))
    ]
    counts = []
    for world in worlds:
        place = world.populations["ant"].position
        camera = SensedCamera(world.setting.cameras["front"], world.origin)
        counts.append(int(camera.find_in_view(world.frame, place, np.zeros(len(place))).sum()))
    assert counts[0] > 10 and counts[1] == round(counts[0] / 2)


def test_a_pressing_crowd_pushes_no_agent_into_a_forbidden_region(tmp_path: Path) -> None:
    """All go to the middle of a box that they must not enter. Without the note's part after contacts, five are pushed in."""
    open_directed(tmp_path, count=120, last=100)
    scene = tmp_path / "scene.yaml"
    text = scene.read_text().replace(", keys: {20: {at: [-150, 5, 40]}, 80: {at: [50, 5, 40]}}", "")  # the ball stands
    note = "{forbid: ant, in: {from: [-30, -50, -30], to: [30, 50, 30]}, falloff: 10 mm}"
    scene.write_text(f"{text}notes:\n  - {note}\n  - {{attract: ant, to: [0, 0, 0]}}\n")
    shot, report = open_scene(scene)
    assert shot is not None, report.errors
    track = follow(shot, 100)
    inside = np.abs(track.values["position"][:, :, [0, 2]]).max(axis=2) < 30 - 0.01
    assert not (~inside[:-1] & inside[1:]).any()
    near = np.abs(track.values["position"][-1][:, [0, 2]]).max(axis=1) < 36
    assert near.sum() > 20  # they press


def test_a_look_changes_no_path(tmp_path: Path) -> None:
    plain = follow(open_directed(tmp_path / "plain"), 16)
    looks = follow(open_directed(tmp_path / "looks", "{look: guards.2, at: {head: leaf}, frames: 5..20}"), 16)
    for name in ("position", "velocity", "heading"):
        assert (plain.values[name] == looks.values[name]).all()


FLEEING = """ant 1
use steering
world { surface ground; obstacle foot; items leaves; curve way; map mud; items stones }
species ant {
  size 5 mm
  max_speed 30 mm/s
  gap = 0 mm
  across = 0
  start walk
  state walk {
    gap = distance(foot)
    across = dot(direction(foot), heading)
    play walk
    when distance(foot) < 60 mm -> away
    when age > 9 min -> rest
  }
  state away { gap = distance(foot); steer flee(foot); play walk; when distance(foot) > 80 mm -> walk }
  state rest { play walk; when age > 9 min -> walk }
  layers { avoid(foot, reach: 4 * size); state }
}
"""


def test_a_moving_obstacle_is_avoided_and_fled_from_at_once(tmp_path: Path) -> None:
    shot = open_directed(tmp_path, count=60, last=60, program=FLEEING)
    track = follow(shot, 60, names=("gap", "main.state"))
    ball = np.stack(
        [np.interp(track.frames, [20, 80], [-150, 50]), np.full(len(track.frames), 5.0), np.full(len(track.frames), 40.0)]
    )
    centre = np.linalg.norm(track.values["position"] - ball.T[:, None], axis=2)
    gap, state = track.values["gap"], track.values["main.state"]
    row = track.frames.index(40)
    assert np.abs(gap[row] - (centre[row - 1] - 25)).max() < 3.0  # the distance to its surface, where it was
    fleeing = state[row] == 1
    assert 2 < fleeing.sum() < 60 and (centre > 24).all()
    away = track.values["position"][row] - ball.T[row]
    outward = np.einsum("nk,nk->n", away, track.values["velocity"][row]) > 0
    assert outward[fleeing].mean() > 0.8
