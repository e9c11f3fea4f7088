"""Notes about parts of pictures, lines of sight, staying in a region, and the last ones of a group."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from directed import PROGRAM, follow, open_directed, start

from antdsl.pipeline import open_scene
from antdsl.runtime import step
from antdsl.runtime.notes.target_findings import report_missed_targets
from antdsl.runtime.sensing.sensed_camera import SensedCamera
from antdsl.runtime.world import World


def project(world: World, position: np.ndarray) -> np.ndarray:
    """Where the picture of the camera `front` shows positions (n, 3), from 0 at its left and bottom edge to 1: (n, 2)."""
    eye, ahead, sides = SensedCamera(world.setting.cameras["front"], world.origin).find_view_pyramid(world.frame)
    offset = position - eye
    depth = offset @ ahead
    return np.stack([(offset @ axis / (depth * tangent) + 1) / 2 for axis, tangent in sides], axis=1)


def test_agents_stay_in_a_box_and_those_outside_go_to_it(tmp_path: Path) -> None:
    note = "{confine: guards, in: {from: [-60, -50, -140], to: [120, 50, 0]}, falloff: 10 mm, frames: 80..160}"
    track = follow(open_directed(tmp_path, note, last=160), 160)
    x, _, z = track.values["position"].transpose(2, 0, 1)
    inside = (x > -60) & (x < 120) & (z > -140) & (z < 0)
    assert inside[30].mean() < 0.6 and inside[-1].mean() > 0.9
    entered = inside[85]
    assert inside[85:, entered].all()


def test_an_agent_stays_in_the_left_third_of_the_picture(tmp_path: Path) -> None:
    note = "{confine: guards, in: {in_view: front, across: [0 %, 33 %], up: [0 %, 100 %]}, frames: 60..140}"
    shares: list[np.ndarray] = []
    shot = open_directed(tmp_path, note, last=140)
    track = follow(shot, 140, lambda world: shares.append(project(world, world.populations["ant"].position)))
    across, up = np.array(shares).transpose(2, 0, 1)
    in_third = (across > 0) & (across < 0.33) & (up > 0) & (up < 1)
    assert in_third[-1].mean() > 2 * in_third[20].mean() and in_third[-1].mean() > 0.3, (in_third[-1].mean(), in_third[20].mean())
    assert in_third[70:, in_third[70]].all()
    findings = report_missed_targets(shot.scene, track.world).diagnostics
    assert len(findings) == 1 and "outside the region in frame 60" in findings[0].message and "ease" in (findings[0].help or "")


def test_a_part_of_the_picture_is_empty_or_thinned(tmp_path: Path) -> None:
    plain = start(open_directed(tmp_path / "plain", count=200))
    across, up = project(plain, plain.populations["ant"].position).T
    in_picture = (across > 0) & (across < 1) & (up > 0) & (up < 1)
    left, low = in_picture & (across < 0.5), in_picture & (up < 0.5)
    assert left.sum() > 8 and low.sum() > 8
    ids = plain.populations["ant"].ids
    part = "in_view: front, across: [0 %, 50 %]"
    for k, note in enumerate((f"{{without: ant, {part}}}", f"{{without: ant, in: {{{part}}}}}")):
        empty = start(open_directed(tmp_path / f"empty_{k}", note, count=200)).populations["ant"]
        assert sorted(empty.ids) == sorted(ids[~left])
    note = "{thin: ant, in_view: front, up: [0 %, 50 %], to: 50 %}"
    thin = start(open_directed(tmp_path / "thin", note, count=200)).populations["ant"].ids
    assert np.isin(ids[~low], thin).all() and np.isin(ids[low], thin).sum() == round(0.5 * low.sum())


def test_agents_form_a_line_along_a_curve_in_a_frame(tmp_path: Path) -> None:
    note = "{reach: guards.0..11, along: [[-60, 0, -70], [70, 0, -70]], frame: 190}"
    shot = open_directed(tmp_path, note, last=191)
    track = follow(shot, 191)
    x, _, z = track.values["position"][track.frames.index(190), :12].T
    goals = -60 + 130 * (np.arange(12) + 0.5) / 12
    assert np.abs(np.sort(x) - goals).max() < 3 and np.abs(z + 70).max() < 3
    starts = track.values["position"][0, :12, 0]  # along the curve at the beginning
    inside = np.flatnonzero((starts > -60) & (starts < 70))
    assert len(inside) > 5 and (np.diff(x[inside[np.argsort(starts[inside])]]) > 0).all()
    assert not report_missed_targets(shot.scene, track.world).diagnostics


def test_agents_of_several_species_share_the_places_along_a_curve(tmp_path: Path) -> None:
    """Each place has one agent, whatever its species."""
    note = "{reach: [guards.0..4, bugs], along: [[-60, 0, -70], [70, 0, -70]], frame: 190}"
    program = PROGRAM + PROGRAM[PROGRAM.index("species ant") :].replace("species ant", "species bug")
    open_directed(tmp_path, last=191, program=program, count=5)
    path = tmp_path / "scene.yaml"
    line = "  - {name: bugs, species: bug, from: a.ant, count: 5, place: {on: ground, radius: 130 mm}, body: ant}\n"
    path.write_text(f"{path.read_text()}{line}notes:\n  - {note}\n")
    shot, report = open_scene(path)
    assert shot is not None, report.diagnostics
    world = start(shot)
    while world.frame < 190:
        step(world)
    x = np.sort(np.concatenate([world.populations[name].position[:, 0] for name in ("ant", "bug")]))
    assert np.abs(x - (-60 + 130 * (np.arange(10) + 0.5) / 10)).max() < 3
    assert not report_missed_targets(shot.scene, world).diagnostics


def test_heads_turn_to_an_agent_while_it_passes(tmp_path: Path) -> None:
    note = "{look: ant, at: {head: guards.7}, inside: {around: guards.7, radius: 60 mm}, frames: 20..120}"
    queen_path = "{path: guards.7, along: [[-120, 0, 0], [120, 0, 0]], frames: 20..120}"
    looks, near = [], []

    def measure(world: World) -> None:
        population = world.populations["ant"]
        rows = population.get_rows_by_id()
        queen = population.position[rows[7]]
        near.append(np.linalg.norm(population.position[rows] - queen, axis=1) <= 60)
        looks.append(population.now["notes_look_head.state"][rows] != 0)

    follow(open_directed(tmp_path, note, queen_path, count=60, last=120), 120, measure)
    is_near, is_looking = np.array(near), np.array(looks)
    is_near[:, 7] = False  # she does not look at herself
    for frame in range(30, 118):  # a step begins where the one before ended
        assert (is_looking[frame] == is_near[frame - 1]).all(), frame
    passed = is_near[30:].any(axis=0) & ~is_near[30:].all(axis=0)
    assert passed.sum() > 10


def test_values_hold_inside_a_region_that_moves(tmp_path: Path) -> None:
    note = "{set: ant, to: {mood: 5}, inside: {around: foot, radius: 30 mm}, frames: 10..60, ease: 0}"
    shot = open_directed(tmp_path, note, count=80, last=60)
    moods = follow(shot, 60, names=("mood",)).values["mood"]
    ever = (moods == 5).any(axis=0)
    assert 3 < ever.sum() < 60 and ((moods == 0) | (moods == 5)).all()
    first = (moods == 5).argmax(axis=0)[ever]
    assert len(set(first.tolist())) > 3 and first.min() >= 9  # one after the other, as the foot moves


def test_a_line_of_sight_to_an_agent_is_clear(tmp_path: Path) -> None:
    population = start(open_directed(tmp_path, count=120)).populations["ant"]
    far = (population.position[:, 2] < -20) & (np.abs(population.position[:, 0]) < 60)  # from the foot, which pushes agents
    queen = int(population.ids[far].min())
    hold = f"{{hold: guards.{queen}}}"
    region = f"{{along: [front, guards.{queen}], width: 40 mm}}"
    sight = f"{{forbid: {{without: guards.{queen}}}, in: {region}, falloff: 20 mm, frames: 60..120, ease: 30}}"

    def measure(*notes: str) -> float:
        nearest: list[float] = []

        def look(world: World) -> None:
            p = world.populations["ant"]
            row = int(p.find_rows(np.array([queen]))[0])
            eye = SensedCamera(world.setting.cameras["front"], world.origin).find_position(world.frame)
            line, offset = p.position[row] - eye, np.delete(p.position, row, axis=0) - eye
            share = np.clip(offset @ line / (line @ line), 0, 1)
            nearest.append(float(np.linalg.norm(offset - share[:, None] * line, axis=1).min()))

        follow(open_directed(tmp_path / str(len(notes)), hold, *notes, count=120, last=120), 120, look)
        return min(nearest[60:])

    assert measure() < 12 < 18 < measure(sight)


def test_the_three_last_stay_behind(tmp_path: Path) -> None:
    shot = open_directed(tmp_path, "{hold: {of: guards, near: [-100, 0, 120], farthest: 3}, frames: 5..60}")
    world = start(shot)
    distance = np.linalg.norm(world.populations["ant"].position - [-100, 0, 120], axis=1)
    last = np.sort(world.populations["ant"].ids[np.argsort(-distance)[:3]])
    track = follow(shot, 60)
    still = np.flatnonzero((track.speeds()[10:55] < 0.1).all(axis=0))
    assert track.ids[still].tolist() == last.tolist()
