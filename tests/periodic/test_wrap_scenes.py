"""`wrap` in scenes: what it accepts, what it reports, and surfaces with heights."""

from __future__ import annotations

from itertools import product
from pathlib import Path

import numpy as np
import pytest
from periodic_scenes import FLOCK, HALF, PLAIN_FLOCK, open_world, read_vector, run, wrapped, write_plane

from antdsl.pipeline import open_scene
from antdsl.runtime import BindError, Options, bind, state_hash

WRAP = "{x: -8 mm .. 8 mm, z: -8 mm .. 8 mm}"
GROUND = "{ground: {mesh: ground.ply}}"
CROWD = "[{species: bird, from: p.ant, body: arrow, count: 3, place: {on: ground}}]"


def report_of(folder: Path, text: str, program: str = FLOCK) -> list[tuple[str, str, str]]:
    """The code, message and help of each error of a scene, which all have a location."""
    write_plane(folder / "ground.ply", 20)
    (folder / "p.ant").write_text(program)
    (folder / "scene.yaml").write_text(f"antdsl: 1\nfps: 1\n{text}")
    shot, report = open_scene(folder / "scene.yaml")
    errors = list(report.errors)
    if shot is not None:
        try:
            bind(shot.plan, shot.setting)
        except BindError as error:
            errors += list(error.report.errors)
    assert all(each.span is not None and each.help for each in errors)
    return [(each.code, each.message, each.help or "") for each in errors]


@pytest.mark.parametrize(
    ("wrap", "keys", "code", "words", "advice"),
    [
        ("{x: 8 mm .. -8 mm}", "", "wrong-value", "does not end above its start", "smaller number first"),
        ("{x: 8 mm}", "", "wrong-value", "not a range of lengths", "-35 mm .. 35 mm"),
        ("{x: 1 .. 5 mm}", "", "wrong-value", "only one end", "both ends"),
        ("{x: 1 s .. 5 s}", "", "wrong-value", "is not a length", "50 mm"),
        ("{y: -8 mm .. 8 mm}", "", "wrong-value", "`y` points up", "`x` or `z`"),
        ("{}", "", "missing-key", "no axis", "wrap: {x: -35 mm .. 35 mm, z: -35 mm .. 35 mm}"),
        ("{w: 1 mm .. 2 mm}", "", "unknown-key", "`w`", ""),
        ("{x: -30 mm .. 30 mm}", "", "bad-seam", "reaches from -20 to 20 mm along x", "`x: -20 mm .. 20 mm`"),
        (
            "{x: -8 mm .. 8 mm}",
            "lod: {near: 5 mm}\ncamera: {at: [0, 9, 9], look_at: [0, 0, 0]}\n",
            "wrap-unsupported",
            "detail",
            "`lod`",
        ),
        ("{x: -8 mm .. 8 mm}", "notes: [{hold: bird, frames: 1..2}]\n", "wrap-unsupported", "notes", "leave `notes` out"),
        ("{x: -8.25 mm .. 8 mm}", "", "field-setting", "16.25 mm wide", "cell 1.01562 mm"),
        ("{x: -1.25 mm .. 1.25 mm}", "", "field-setting", "2.5 mm wide", "cell 0.833333 mm"),
    ],
)
def test_mistakes(tmp_path: Path, wrap: str, keys: str, code: str, words: str, advice: str) -> None:
    errors = report_of(tmp_path, f"wrap: {wrap}\nworld: {GROUND}\ncrowd: {CROWD}\n{keys}")
    assert any(code == each[0] and words in each[1] and advice in each[2] for each in errors), errors


def test_extreme_ranges(tmp_path: Path) -> None:
    """Each range is an error with a location, or makes a world that runs."""
    for low, high in product(
        ("-8 mm", "-1e300", "-1e5", "-0.0", "0", "1e12", "1e-12", "5e-324"), ("8 mm", "1e300", "1e38", "1e-12")
    ):
        write_plane(tmp_path / "ground.ply", 20)
        (tmp_path / "p.ant").write_text(PLAIN_FLOCK)
        text = (
            f"antdsl: 1\nfps: 1\nwrap: {{x: {low} .. {high}}}\ncrowd: [{{species: bird, from: p.ant, body: arrow, count: 3}}]\n"
        )
        (tmp_path / "scene.yaml").write_text(text)
        shot, report = open_scene(tmp_path / "scene.yaml")
        assert all(each.span is not None for each in report.errors)
        if shot is not None:
            assert np.isfinite(read_vector(run(shot, 2), "position")).all()


@pytest.mark.parametrize(
    ("declared", "thing", "words"),
    [
        ("solid hill", "hill: {mesh: ground.ply, voxel: 1 mm}", "a solid"),
        ("curve way", "way: {curve: way.json}", "a curve"),
        ("flow drift", "drift: {toward: [0, 0, 0]}", "a flow"),
        ("obstacle wall", "wall: {mesh: ground.ply, keys: {1: {at: [0, 0, 0]}}}", "things that move"),
        ("items food", "food: {a: {at: [0, 0, 0], keys: {1: {at: [1, 0, 0]}}}}", "things that move"),
    ],
)
def test_things_that_cannot_wrap(tmp_path: Path, declared: str, thing: str, words: str) -> None:
    (tmp_path / "way.json").write_text("[[0, 0, 0], [1, 0, 0]]")
    program = FLOCK.replace("surface ground", f"surface ground; {declared}")
    errors = report_of(tmp_path, f"wrap: {WRAP}\nworld:\n  ground: {{mesh: ground.ply}}\n  {thing}\ncrowd: {CROWD}\n", program)
    assert any(each[0] == "wrap-unsupported" and words in each[1] for each in errors), errors


def test_steps_of_half_a_width_are_reported(tmp_path: Path) -> None:
    text = f"wrap: {WRAP}\nworld: {GROUND}\ncrowd: {CROWD}\n"
    errors = report_of(tmp_path, text, FLOCK.replace("max_speed 1 mm/step", "max_speed 8 mm/step"))
    assert [each[0] for each in errors] == ["wrong-value"] and "walks up to 8 mm in a step" in errors[0][1], errors
    assert not report_of(tmp_path, text, FLOCK.replace("max_speed 1 mm/step", "max_speed 7.9 mm/step"))


def test_light_cannot_wrap(tmp_path: Path) -> None:
    program = FLOCK.replace("surface ground", "surface ground; items bulb").replace("start fly", "lit = 0\n  start fly")
    program = program.replace("deposit trail", "lit = light(bulb)\n    deposit trail")
    errors = report_of(
        tmp_path,
        f"wrap: {WRAP}\nworld: {{ground: {{mesh: ground.ply}}, bulb: {{a: {{at: [0, 5, 0]}}}}}}\ncrowd: {CROWD}\n",
        program,
    )
    assert [each[0] for each in errors] == ["wrap-unsupported"], errors


# --- heights and obstacles -------------------------------------------------------------------------------------------


def write_heights(path: Path, *, even: bool = True) -> None:
    """Samples of waves with a whole number of periods in each direction; not `even`: the last row is higher."""
    angle = np.linspace(0, 2 * np.pi, 33)
    heights = np.round(0.4 * np.sin(angle)[:, None] + 0.3 * np.cos(2 * angle)[None, :], 6)
    heights[-1], heights[:, -1] = heights[0], heights[:, 0]
    if not even:
        heights[-1] += 0.1
    np.savez(path, heights=heights)


HILLS = "{ground: {height: hills.npz, extent: [16 mm, 16 mm], scale: 1 mm}}"


def test_heights_continue_across_the_seam(tmp_path: Path) -> None:
    """Agents keep their speed and stay on the surface, which is a function of x and z here."""
    write_heights(tmp_path / "hills.npz")
    program = FLOCK.replace("diffuse 0.2", "diffuse 0.1")
    shot = open_world(tmp_path, program, "count: 80, place: {on: ground}", world=HILLS)
    world = run(shot, 12)
    place, unwrapped = read_vector(world, "position"), read_vector(world, "unwrapped")
    assert (np.abs(place[:, [0, 2]]) <= HALF).all() and np.abs(unwrapped).max() > HALF + 2
    assert np.abs(wrapped(unwrapped - place)).max() < 1e-4
    expected = 0.3 * np.cos(4 * np.pi * (place[:, 0] + 8) / 16) + 0.4 * np.sin(2 * np.pi * (place[:, 2] + 8) / 16)
    np.testing.assert_allclose(place[:, 1], expected, atol=0.03)
    assert world.motion.summarise()["step_max"] == pytest.approx(1, abs=1e-3)
    assert state_hash(run(shot, 3, Options(backend="reference"))) == state_hash(run(shot, 3, Options(threads=2, shuffle_rows=1)))


def test_heights_that_differ_at_the_seam_are_reported(tmp_path: Path) -> None:
    write_heights(tmp_path / "hills.npz", even=False)
    errors = report_of(tmp_path, f"wrap: {WRAP}\nworld: {HILLS}\ncrowd: {CROWD}\n")
    assert [each[0] for each in errors] == ["bad-seam"] and "differ by up to 0.1 mm" in errors[0][1], errors


SIGHT = """ant 2
world { surface ground; obstacle wall }
species bird {
  size 0.1 mm; max_speed 0.5 mm/step; response 1 step; max_turn none
  gap = 0 mm; ahead = 0 mm
  start look
  state look {
    gap = distance(wall)
    ahead = min(ray(heading, reach: 30 mm, on: wall).distance, 99 mm)
    steer match(heading * 0.5 mm/step)
  }
  layers { state }
}
"""


def test_obstacles_are_seen_and_block_across_the_seam(tmp_path: Path) -> None:
    """A wall across x at the seam, which reaches 0.25 mm into either side."""
    from periodic_scenes import write_ply

    x, y, z = (np.array(v, float) for v in ((-0.25, 0.25), (-2, 2), (-30, 30)))
    corners = np.array([[a, b, c] for a in x for b in y for c in z])
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    write_ply(tmp_path / "wall.ply", corners + np.array([8, 0, 0]), [f for a, b, c, d in quads for f in ((a, b, c), (a, c, d))])
    world_of = "{ground: {mesh: ground.ply}, wall: {mesh: wall.ply}}"
    shot = open_world(tmp_path, SIGHT, "count: 40, place: {on: ground}", world=world_of, wrap="{x: -8 mm .. 8 mm}")
    start = bind(shot.plan, shot.setting)
    place, heading = read_vector(start, "position"), read_vector(start, "heading")
    world = run(shot, 1)
    (population,) = world.populations.values()
    rows = population.get_rows_by_id()
    np.testing.assert_allclose(population.now["gap"][rows], 7.75 - np.abs(place[:, 0]), atol=1e-4)
    far = (7.75 - np.sign(heading[:, 0]) * place[:, 0]) / np.abs(heading[:, 0])
    np.testing.assert_allclose(population.now["ahead"][rows], np.where(far <= 8, far, 99), rtol=1e-4)
    later = read_vector(run(shot, 60), "position")
    assert np.abs(later[:, 0]).max() < 7.75, "no agent is in the wall or has passed it"


def test_a_scene_without_wrap_has_no_period(tmp_path: Path) -> None:
    write_plane(tmp_path / "ground.ply", 20)
    (tmp_path / "p.ant").write_text(PLAIN_FLOCK.replace("match(", "match((unwrapped - position) / 1 step + "))
    (tmp_path / "scene.yaml").write_text("antdsl: 1\nfps: 1\ncrowd: [{species: bird, from: p.ant, count: 3}]\n")
    shot, report = open_scene(tmp_path / "scene.yaml")
    assert shot is not None, report
    world = run(shot, 2)
    assert world.periodic is None and shot.plan.period is None
    assert "unwrapped.x" not in world.populations["bird"].now
