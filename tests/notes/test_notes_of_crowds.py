"""Notes for many agents: regions, lanes, targets, something to make way for, releases, and fewer agents."""

from __future__ import annotations

from pathlib import Path

import meshes
import numpy as np
import pytest
from directed import Track, follow, open_directed, start, write_mesh

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
    (active,) = track.world.notes.active_notes
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
    track = follow(open_directed(tmp_path, "{release: guards, frame: 20, stagger: {random: 10}, ease: 4}"), 50)
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
    (ids,) = (
        array for name, array in world.notes.stored_arrays.items() if name.endswith("ant.ids") and not name.startswith("pace")
    )
    assert 2 < len(ids) < 30
    while world.frame < 40:
        step(world)
    (active,) = world.notes.active_notes
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
                    .find_positions_in_view(world.frame, place, np.zeros(len(place)))
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
        counts.append(int(camera.find_positions_in_view(world.frame, place, np.zeros(len(place))).sum()))
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


def find_look(track: Track, agent: int) -> np.ndarray:
    """The direction of the head of an agent in the last frame, in the scene's axes."""
    heading, up = (track.of(name, agent)[-1].astype(np.float64) for name in ("heading", "up"))
    along = np.array([track.of(f"look#head.{axis}", agent)[-1] for axis in "xyz"], np.float64)
    return along @ np.stack([heading, up, np.cross(heading, up)])


LOOKS = ("look#head.x", "look#head.y", "look#head.z")


def test_heads_look_at_cameras_and_at_meshes_that_move(tmp_path: Path) -> None:
    """A look turns a head up to 60 degrees, so the agents that have the target ahead look exactly at it."""
    for target, point in (("front", (20, 90, -150)), ("foot", (np.interp(40, [20, 80], [-150, 50]), 5, 40))):
        shot = open_directed(tmp_path / target, f"{{look: guards, at: {{head: {target}}}, frames: 5..80}}", count=60)
        track = follow(shot, 40, names=("up.x", "up.y", "up.z", *LOOKS))
        track.values["up"] = np.stack([track.values[f"up.{axis}"] for axis in "xyz"], axis=2)
        offset = np.array(point) - track.values["position"][-2]  # at the start of the step
        direction = offset / np.linalg.norm(offset, axis=1)[:, None]
        cosines = np.array([find_look(track, agent) @ direction[agent] for agent in range(60)])
        ahead = np.einsum("nk,nk->n", track.values["heading"][-2], direction) > 0.6
        assert ahead.sum() > 8 and np.median(cosines[ahead]) > 0.99, (target, np.round(cosines[ahead], 2))


def test_agents_go_to_a_mesh_and_away_from_a_camera(tmp_path: Path) -> None:
    notes = ("{attract: guards.0..19, to: foot, frames: 1..80}", "{repel: guards.20..39, from: front, radius: 400 mm}")
    track, plain = follow(open_directed(tmp_path, *notes), 60), follow(open_directed(tmp_path / "plain"), 60)
    ball = np.array([np.interp(60, [20, 80], [-150, 50]), 5, 40])
    near, usual = (np.linalg.norm(t.values["position"][-1][:20] - ball, axis=1) for t in (track, plain))
    assert near.min() > 24 and np.median(near) < np.median(usual) - 20
    far, usual = (np.linalg.norm(t.values["position"][-1][20:40] - (20, 90, -150), axis=1) for t in (track, plain))
    assert np.median(far) > np.median(usual) + 20


def test_no_agent_comes_near_an_agent_with_a_forbidden_ball_around_it(tmp_path: Path) -> None:
    """The hero walks at half of the speed of 80 others through them, and they keep 25 mm away from it."""
    path = "{path: guards.0, along: [[-40, 0, 0], [40, 0, 0]], frames: 30..150}"
    keep = "{forbid: {without: guards.0}, in: {around: guards.0, radius: 25 mm}, falloff: 25 mm, frames: 24..150}"

    def measure(*notes: str) -> tuple[np.ndarray, Track]:
        track = follow(open_directed(tmp_path / str(len(notes)), path, *notes, count=80, last=150), 150)
        frames = np.array(track.frames)
        place = track.values["position"]
        return np.linalg.norm(place[:, 1:] - place[:, :1], axis=2)[frames >= 48].min(axis=1), track

    nearest, track = measure(keep)
    usual, _ = measure()
    assert nearest.min() > 24 > usual.min() + 8, (nearest.min(), usual.min())
    hero = track.of("position", 0)
    assert np.linalg.norm((hero[-1] - (40, 0, 0))[[0, 2]]) < 4  # its own region does not stop it


def test_the_crowd_parts_for_an_agent_that_walks_through_it(tmp_path: Path) -> None:
    path = "{path: guards.0, along: [[-40, 0, 0], [40, 0, 0]], frames: 30..150}"

    def measure(*notes: str) -> tuple[np.ndarray, Track]:
        track = follow(open_directed(tmp_path / str(len(notes)), path, *notes, count=80, last=150), 150)
        place = track.values["position"][track.frames.index(60) :]
        return np.linalg.norm(place[:, 1:] - place[:, :1], axis=2).min(axis=1), track

    nearest, track = measure("{part: ant, for: guards.0, distance: 40 mm, frames: 24..150}")
    usual, _ = measure()
    assert nearest.min() > 9 > usual.min() + 2 and nearest.mean() > usual.mean() + 5, (nearest.min(), usual.min())
    assert np.linalg.norm((track.of("position", 0)[-1] - (40, 0, 0))[[0, 2]]) < 4  # it does not make way for itself


def test_the_three_nearest_to_a_camera_look_at_it(tmp_path: Path) -> None:
    shot = open_directed(tmp_path, "{look: {of: ant, near: front, most: 3}, at: {head: front}, frames: 5..80}")
    world = start(shot)
    for _ in range(3):
        step(world)
    assert world.notes is not None
    (active,) = world.notes.active_notes
    ants = world.populations["ant"]
    distance = np.linalg.norm(ants.position - (20, 90, -150), axis=1)  # they walk less than 4 mm since the note began
    assert len(active.rows["ant"]) == 3 and distance[active.rows["ant"]].max() < np.sort(distance)[2] + 8


def test_agents_keep_a_distance_from_a_mesh_that_moves(tmp_path: Path) -> None:
    """Those within 60 mm of the ball are slow. It moves 200 mm in 60 frames."""
    track = follow(open_directed(tmp_path, "{slow: ant, in: {around: foot, radius: 60 mm}, speed: 20 %}"), 50)
    frames = np.array(track.frames[5:-1])
    ball = np.stack([np.interp(frames, [20, 80], [-150, 50]), np.full(len(frames), 5.0), np.full(len(frames), 40.0)], axis=1)
    gap = np.linalg.norm(track.values["position"][5:-1] - ball[:, None], axis=2) - 25
    speed = track.speeds()[5:]
    assert speed[gap < 54].mean() < 10 < 18 < speed[gap > 66].mean()


def test_a_ball_follows_several_agents_and_ends_with_them(tmp_path: Path) -> None:
    note = "{slow: guards, in: {around: [guards.1, guards.2], radius: 40 mm}, speed: 10 %}"
    track = follow(open_directed(tmp_path, note, count=60), 30)
    place, speed = track.values["position"][4:-1], track.speeds()[4:]
    gap = np.minimum(*(np.linalg.norm(place - place[:, k : k + 1], axis=2) for k in (1, 2)))
    assert speed[:, [1, 2]].mean() > 15  # these two are not slowed, also not by each other
    others = [k for k in range(60) if k not in (1, 2)]
    assert speed[:, others][gap[:, others] < 36].mean() < 8 < 15 < speed[:, others][gap[:, others] > 44].mean()


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


RAFT = """ant 1
use steering
world { surface ground; surface raft; obstacle foot }
species ant {
  size 5 mm
  max_speed 30 mm/s
  gap = 0 mm
  heeded = 0
  start flee
  state flee { gap = distance(raft); heeded = dot(direction(raft), heading); steer THAT(raft) }
  layers { state }
}
"""


@pytest.mark.parametrize("behaviour", ["flee", "seek"])
def test_a_moving_surface_is_a_target_of_flee_seek_distance_and_direction(tmp_path: Path, behaviour: str) -> None:
    """A raft, 40 mm wide and 2 mm above the ground, moves 100 mm in 50 frames. The ground of the others is flat."""
    write_mesh(tmp_path / "ground.obj", *meshes.grid(400.0, 8))
    write_mesh(tmp_path / "raft.obj", *meshes.grid(40.0, 2))
    (tmp_path / "a.ant").write_text(RAFT.replace("THAT", behaviour))
    (tmp_path / "scene.yaml").write_text(RAFT_SCENE)
    shot, report = open_scene(tmp_path / "scene.yaml")
    assert shot is not None, [d.message for d in report.errors]
    track = follow(shot, 52, names=("gap", "heeded"))
    frames = np.array(track.frames)
    middle = np.interp(frames, [1, 51], [-50, 50])
    place = track.values["position"]
    offset = np.stack([middle, np.full(len(frames), 2.0), np.zeros(len(frames))], axis=1)[:, None] - place
    nearest = np.sign(offset) * np.maximum(np.abs(offset) - (20, 0, 20), 0)  # the offset to the nearest point of the raft
    expected = np.linalg.norm(nearest, axis=2)
    assert np.abs(track.values["gap"][30] - expected[29]).max() < 0.02  # mm: as it was at the start of the step
    across = np.einsum("nk,nk->n", nearest[29] / expected[29][:, None], track.values["heading"][29])
    assert np.abs(track.values["heeded"][30] - across).max() < 0.02
    towards = np.einsum("fnk,fnk->fn", nearest[24:-1], track.values["velocity"][25:])[expected[24:-1] > 10]
    assert (towards > 0).mean() > 0.9 if behaviour == "seek" else (towards < 0).mean() > 0.9


RAFT_SCENE = """antdsl: 1
frames: 1..60
seed: 4
contacts: off
world:
  ground: {mesh: ground.obj}
  raft: {mesh: raft.obj, at: [-50, 2, 0], keys: {1: {at: [-50, 2, 0]}, 51: {at: [50, 2, 0]}}}
  foot: {mesh: raft.obj, at: [500, 0, 0]}
crowd:
  - {species: ant, from: a.ant, count: 40, place: {on: ground, around: [60, 0, 0], radius: 90 mm}}
"""


def test_a_moving_obstacle_is_sought(tmp_path: Path) -> None:
    program = FLEEING.replace("steer flee(foot)", "steer seek(foot)").replace("avoid(foot, reach: 4 * size); ", "")
    track = follow(open_directed(tmp_path, count=60, last=60, program=program), 60, names=("main.state", "across"))
    ball = np.array([np.interp(40, [20, 80], [-150, 50]), 5.0, 40.0])
    row = track.frames.index(40)
    seeking = track.values["main.state"][row] == 1
    toward = np.einsum("nk,nk->n", ball - track.values["position"][row], track.values["velocity"][row]) > 0
    assert seeking.sum() > 2 and toward[seeking].mean() > 0.8
