"""Each verb of edits, by what it does to the agents that it selects. All others keep their bits."""

from __future__ import annotations

import edit_scenes
import numpy as np
import pytest

from antdsl.bodies.body import rotate_vectors
from antdsl.outputs.cache.cache_reader import Cache, open_cache
from antdsl.outputs.cache.manifest import Manifest, ReplacedBody, SpeciesEntry, WornBodyEntry
from antdsl.outputs.cache_bodies import find_body_numbers
from antdsl.outputs.edits.cache_selection import find_item_points
from antdsl.outputs.edits.edit_files import read_edit_files
from antdsl.outputs.edits.edit_layer import EditInputs, NotEditable
from antdsl.outputs.edits.edit_lines import read_edits
from antdsl.outputs.edits.edited_cache import apply_edits, find_next_ids
from antdsl.outputs.edits.frame_rows import SPECIES_PER_KEY, FrameRows
from antdsl.outputs.edits.verb_table import VERB_BY_WORD
from antdsl.outputs.edits.verbs.terrain import Ground
from antdsl.outputs.gallery import Gallery
from antdsl.program.tables.colours import COLOUR_BY_NAME

WALKER = 1  # the species' number


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Cache:
    return open_cache(edit_scenes.simulate(tmp_path_factory.mktemp("verbs")))


def edited(cache: Cache, *lines: str) -> Cache:
    """The cache with edits."""
    text = "edits:\n" + "".join(f"- {{{line}}}\n" for line in lines)
    edits, report = read_edits(text.encode(), "edits.yaml", cache.manifest)
    assert edits is not None, [each.message for each in report.diagnostics]
    arrays, caches, report = read_edit_files(edits, cache.manifest, cache.folder.parent)
    assert report.ok, report.errors
    return apply_edits(cache, edits, EditInputs(Ground(cache), arrays, caches, find_next_ids(cache)))


def rows_of(cache: Cache, number: int, keys: list[int]) -> dict[str, np.ndarray]:
    """The rows of some agents in all arrays of a frame."""
    arrays = cache.frame(number)
    return {name: array[np.isin(own, keys)] for name, array, own in edit_scenes.iterate_rows(cache, arrays)}


GUARDS = [id * SPECIES_PER_KEY + WALKER for id in range(6, 10)]
ONE_OF_EACH = {
    "kill": "kill: guards",
    "clip": "clip: guards, frames: 6..12",
    "duplicate": "duplicate: guards, by: [9 mm, 0, 0], later: 3",
    "hold": "hold: guards, frames: 8..12",
    "retime": "retime: guards, frames: 5..20, speed: 50 %",
    "move": "move: guards, by: [4 mm, 0, 0]",
    "rotate": "rotate: guards, by: 90 deg",
    "scale": "scale: guards, by: 150 %",
    "expand": "expand: guards, by: 0.5",
    "face": "face: guards, to: leaf",
    "pin": "pin: guards, to: [[-30, 0, 0], [30, 0, 0]]",
    "drop": "drop: guards, onto: ground",
    "replace": "replace: guards, colour: red",
    "merge": "merge: cache",
    "offset": "offset: guards, joint: root, rotate: [0, 90 deg, 0]",
    "mirror": "mirror: guards, axis: x",
    "smooth": "smooth: guards, orient: 5",
}


def test_each_verb_has_a_case() -> None:
    assert set(ONE_OF_EACH) == set(VERB_BY_WORD)


@pytest.mark.parametrize("verb", ONE_OF_EACH)
def test_an_edit_changes_the_selected_agents_and_no_bit_of_others(cache: Cache, verb: str) -> None:
    view, changed = edited(cache, ONE_OF_EACH[verb]), 0
    for number in cache.frames():
        keys = FrameRows(cache.frame(number), cache.manifest).keys
        others = keys[~np.isin(keys, GUARDS)]
        plain, rows = edit_scenes.take_agents(cache, number, others), edit_scenes.take_agents(view, number, others)
        assert plain == {name: rows[name] for name in plain}
        assert [name for name in rows if name not in plain] == (["joints.walker.root"] if verb == "offset" else [])
        new_keys = FrameRows(view.frame(number), view.manifest).keys
        changed += edit_scenes.take_agents(cache, number, keys) != edit_scenes.take_agents(view, number, new_keys)
    assert changed > 3


def test_an_edit_that_is_off_and_one_without_agents_change_nothing(cache: Cache) -> None:
    number = 9
    for verb, line in ONE_OF_EACH.items():
        for end in ("off: yes", *(() if verb == "merge" else ("share: 0 %",))):
            edit_scenes.assert_same_arrays(edited(cache, f"{line}, {end}").frame(number), cache.frame(number), number)


def test_a_hold_stands_still_in_its_frames_and_continues_after_them(cache: Cache) -> None:
    view = edited(cache, "hold: guards, frames: 8..12, ease: 0")
    still = rows_of(cache, 8, GUARDS)
    for number in range(8, 13):
        held = rows_of(view, number, GUARDS)
        assert all(np.array_equal(held[name], still[name]) for name in ("P", "orient", "feet.walker.P")) and not held["v"].any()
    for number in range(13, 25):
        rows, original_rows = rows_of(view, number, GUARDS), rows_of(cache, number - 4, GUARDS)
        assert all(rows[name].tobytes() == original_rows[name].tobytes() for name in rows if not name.startswith("events"))


def test_a_hold_catches_up(cache: Cache) -> None:
    view = edited(cache, "hold: guards, frames: 8..12, ease: 1, catch_up: 6")
    late, now = rows_of(view, 20, GUARDS), rows_of(cache, 20, GUARDS)
    assert late["P"].tobytes() == now["P"].tobytes()
    steps = [np.abs(rows_of(view, k + 1, GUARDS)["P"] - rows_of(view, k, GUARDS)["P"]).max() for k in range(5, 22)]
    assert max(steps) < 4  # no jump


def test_half_the_speed_is_half_the_way(cache: Cache) -> None:
    view = edited(cache, "retime: guards, frames: 5..15, speed: 50 %, ease: 0")
    for number, time in ((5, 5), (7, 6), (15, 10), (24, 19)):
        assert rows_of(view, number, GUARDS)["P"].tobytes() == rows_of(cache, time, GUARDS)["P"].tobytes()
    between, one, two = (rows_of(each, k, GUARDS) for each, k in ((view, 6), (cache, 5), (cache, 6)))
    assert between["P"] == pytest.approx((one["P"].astype(float) + two["P"]) / 2, abs=1e-5)
    assert between["v"] == pytest.approx(np.zeros_like(between["v"]) + 0.5 * (one["v"] + two["v"]) / 2, abs=1e-3)
    assert np.linalg.norm(between["orient"], axis=1) == pytest.approx(np.ones(4), abs=1e-6)


def test_moved_agents_stand_on_the_ground_with_all_feet(cache: Cache) -> None:
    view, ground = edited(cache, "move: guards, by: [14 mm, 0, -9 mm]"), Ground(cache)
    for number in (1, 13, 24):
        terrain = ground.at(number)
        assert terrain is not None
        original_rows, rows = rows_of(cache, number, GUARDS), rows_of(view, number, GUARDS)
        up = np.tile((0.0, 1.0, 0.0), (4, 1))
        wide = np.full(4, 50.0)
        gaps = [
            terrain.find_along(each["P"].astype(float), up, wide, wide).position[:, 1] - each["P"][:, 1]
            for each in (original_rows, rows)
        ]
        assert gaps[1] == pytest.approx(gaps[0], abs=0.05)
        assert (rows["P"] - original_rows["P"])[:, (0, 2)] == pytest.approx(np.tile((14, -9), (4, 1)), abs=4)
        for k in range(6):
            feet = [each["feet.walker.P"][:, k].astype(float) for each in (original_rows, rows)]
            ground_points = [terrain.find_along(each, up, wide, wide) for each in feet]
            gaps = [(each.position - foot)[ground_points[0].is_hit, 1] for each, foot in zip(ground_points, feet, strict=True)]
            assert gaps[1] == pytest.approx(gaps[0], abs=0.3)  # a foot beyond the edge goes with its agent
            assert np.linalg.norm(feet[1] - rows["P"], axis=1) == pytest.approx(
                np.linalg.norm(feet[0] - original_rows["P"], axis=1), rel=0.35
            )


def test_free_moves_are_rigid(cache: Cache) -> None:
    view = edited(cache, "move: guards, by: [0, 7 mm, 1 mm], ground: free")
    original_rows, rows = rows_of(cache, 9, GUARDS), rows_of(view, 9, GUARDS)
    assert rows["P"] - original_rows["P"] == pytest.approx(np.tile((0, 7, 1), (4, 1)), abs=1e-5)
    assert rows["feet.walker.P"] - original_rows["feet.walker.P"] == pytest.approx(np.tile((0, 7, 1), (4, 6, 1)), abs=1e-5)
    assert np.array_equal(rows["orient"], original_rows["orient"]) and np.array_equal(rows["v"], original_rows["v"])


def test_moves_begin_and_end_smoothly(cache: Cache) -> None:
    view = edited(cache, "move: guards, by: [0, 8 mm, 0], frames: 10..14, ease: 3, ground: free")
    lifts = [float((rows_of(view, k, GUARDS)["P"] - rows_of(cache, k, GUARDS)["P"])[0, 1]) for k in range(5, 20)]
    assert lifts[:2] == [0, 0] and lifts[5:10] == pytest.approx([8] * 5, abs=1e-5) and lifts[13:] == [0, 0]
    assert sorted(set(lifts[1:6])) == lifts[1:6]


def test_rotation_scale_and_expansion(cache: Cache) -> None:
    original_rows = rows_of(cache, 4, GUARDS)
    centre = rows_of(cache, 1, GUARDS)["P"].mean(axis=0)
    rows = rows_of(edited(cache, "rotate: guards, by: 90 deg, ground: free"), 4, GUARDS)
    offset, turned = original_rows["P"] - centre, rows["P"] - centre
    assert turned[:, 0] == pytest.approx(offset[:, 2], abs=1e-4) and turned[:, 2] == pytest.approx(-offset[:, 0], abs=1e-4)
    ahead = np.tile((1.0, 0.0, 0.0), (4, 1))
    heading = [rotate_vectors(each["orient"].astype(float), ahead) for each in (original_rows, rows)]
    assert heading[1][:, 0] == pytest.approx(heading[0][:, 2], abs=1e-5)
    each = rows_of(edited(cache, "rotate: guards, by: 90 deg, around: each, ground: free"), 4, GUARDS)
    assert each["P"] == pytest.approx(original_rows["P"], abs=1e-6) and each["orient"] == pytest.approx(rows["orient"], abs=1e-6)
    large = rows_of(edited(cache, "scale: guards, by: 150 %, ground: free"), 4, GUARDS)
    assert large["pscale"] == pytest.approx(1.5 * original_rows["pscale"]) and np.array_equal(large["P"], original_rows["P"])
    arm = original_rows["feet.walker.P"] - original_rows["P"][:, None]
    assert large["feet.walker.P"] - original_rows["P"][:, None] == pytest.approx(1.5 * arm, abs=1e-4)
    wide = rows_of(edited(cache, "expand: guards, by: 2, ground: free"), 4, GUARDS)
    assert wide["P"] - centre == pytest.approx(2 * offset, abs=1e-4)


def test_agents_face_an_item_and_a_curve_leads_them(cache: Cache) -> None:
    view = rows_of(edited(cache, "face: guards, to: leaf, ground: free"), 6, GUARDS)
    direction = np.array([10, 0, 0]) - view["P"]
    heading = rotate_vectors(view["orient"].astype(float), np.tile((1.0, 0.0, 0.0), (4, 1)))
    up = rotate_vectors(view["orient"].astype(float), np.tile((0.0, 1.0, 0.0), (4, 1)))
    level = direction - up * (direction * up).sum(axis=1, keepdims=True)
    assert (heading * level).sum(axis=1) == pytest.approx(np.linalg.norm(level, axis=1), rel=1e-4)
    line = "pin: guards, to: [[-30, 0, 0], [30, 0, 0], [30, 0, 30]], ground: free"
    pinned = rows_of(edited(cache, line), 6, GUARDS)["P"]
    assert (np.isclose(pinned[:, 2], 0) | np.isclose(pinned[:, 0], 30)).all() and np.allclose(pinned[:, 1], 0)
    fast = edited(cache, "pin: guards, to: [[-90, 0, 0], [90, 0, 0]], speed: 24 mm/s, ground: free")
    distances = [rows_of(fast, k, GUARDS)["P"] for k in (1, 7)]
    assert np.abs(distances[1] - distances[0]).sum(axis=1) == pytest.approx(np.full(4, 6.0), abs=1e-3)


def test_a_clip_retains_agents_in_frames_and_regions(cache: Cache) -> None:
    view = edited(cache, "clip: guards, frames: 6..12")
    assert [len(rows_of(view, k, GUARDS)["P"]) for k in (5, 6, 12, 13)] == [0, 4, 4, 0]
    inside = edited(cache, "clip: {}, inside: {from: [0, -99, -99], to: [99, 99, 99]}")
    for number in cache.frames():
        x = cache.frame(number)["P"][:, 0]
        assert np.array_equal(inside.frame(number)["P"][:, 0], x[x >= 0]) and 0 < (x >= 0).sum() < len(x)


def test_copies_have_new_ids_and_live_later(cache: Cache) -> None:
    view = edited(cache, "duplicate: guards, by: [9 mm, 0, 0], later: 3, count: 2, ground: free")
    next_id = 10  # of walkers
    for number in cache.frames():
        arrays, plain = view.frame(number), cache.frame(number)
        assert len(arrays["id"]) == len(plain["id"]) + 8
        keys = FrameRows(arrays, view.manifest).keys
        assert len(np.unique(keys)) == len(keys)
        order = np.lexsort((keys // SPECIES_PER_KEY, keys % SPECIES_PER_KEY))
        assert np.array_equal(order, np.arange(len(keys)))
        for k in (1, 2):
            copies = [key + k * next_id * SPECIES_PER_KEY for key in GUARDS]
            source = rows_of(cache, max(number - 3 * k, 1), GUARDS)
            rows = rows_of(view, number, copies)
            assert rows["P"] - source["P"] == pytest.approx(np.tile((9 * k, 0, 0), (4, 1)), abs=1e-5)
            assert rows["orient"].tobytes() == source["orient"].tobytes()
            assert rows["feet.walker.P"].shape == source["feet.walker.P"].shape
    again = edited(cache, "duplicate: guards.0, by: [9 mm, 0, 0]", "duplicate: walker.16, by: [0, 0, 9 mm]", "kill: walker.6")
    assert set(again.frame(5)["id"].tolist()) - set(cache.frame(5)["id"].tolist()) == {16, 36}


def test_copies_have_the_bodies_of_their_originals() -> None:
    ids = np.arange(40)
    bodies = (WornBodyEntry(body="ant"), WornBodyEntry(body="human"), WornBodyEntry(body="spider", weight=2))
    species = SpeciesEntry(name="walker", bodies=bodies, machines=(), copies=(10, 20))
    manifest = Manifest.model_construct(species=(species,), seed=5)
    numbers = find_body_numbers(manifest, 0, ids)
    assert len(set(numbers[:10].tolist())) > 1 and all(np.array_equal(numbers[:10], numbers[k : k + 10]) for k in (10, 20, 30))
    replaced = species.model_copy(update={"replaced": (ReplacedBody(first=3, count=2, body=2),)})
    changed = find_body_numbers(manifest.model_copy(update={"species": (replaced,)}), 0, ids)
    everywhere = [k + i for k in (0, 10, 20, 30) for i in (3, 4)]
    assert (changed[everywhere] == 2).all() and np.array_equal(np.delete(changed, everywhere), np.delete(numbers, everywhere))
    later = species.model_copy(update={"replaced": (ReplacedBody(first=3, count=2, body=2, level=2),)})
    changed = find_body_numbers(manifest.model_copy(update={"species": (later,)}), 0, ids)
    assert changed[3:5].tolist() == [2, 2] and np.array_equal(np.delete(changed, [3, 4]), np.delete(numbers, [3, 4]))


def test_agents_of_another_cache_have_their_own_bodies() -> None:
    ids = np.arange(200)
    bodies = (WornBodyEntry(body="ant"), WornBodyEntry(body="spider"))
    plain = SpeciesEntry(name="walker", bodies=bodies, machines=())
    manifest = Manifest.model_construct(species=(plain,), seed=5)
    own = find_body_numbers(manifest, 0, ids)
    # 10 agents, 10 copies, 40 agents of another cache, and a copy of each of these 60
    species = plain.model_copy(update={"copies": (10, 20, 60), "merged": (1,)})
    expected = np.tile(np.concatenate([own[:10], own[:10], own[:40]]), 2)
    assert np.array_equal(find_body_numbers(manifest.model_copy(update={"species": (species,)}), 0, ids[:120]), expected)
    renamed = plain.model_copy(update={"name": "walker_2", "drawn_as": "walker"})
    assert np.array_equal(find_body_numbers(manifest.model_copy(update={"species": (renamed,)}), 0, ids), own)


def test_a_copy_and_a_merged_agent_have_the_feet_of_their_bodies(cache: Cache) -> None:
    copied = edited(cache, "replace: guards.0, body: ant", "duplicate: guards.0, by: [9 mm, 0, 0], ground: free").frame(9)
    feet = copied["feet.walker#1.P"]
    assert feet.shape == (2, 6, 3) and feet[1] - feet[0] == pytest.approx(np.tile((9, 0, 0), (6, 1)), abs=1e-5)
    merged = edited(cache, "replace: guards.0, body: ant", "merge: cache", "kill: bug")
    names = [species.name for species in merged.manifest.species]
    arrays = merged.frame(9)
    assert names == ["bug", "walker", "walker_2"]
    assert arrays["feet.walker_2.P"].tobytes() == cache.frame(9)["feet.walker.P"].tobytes()
    assert np.array_equal(arrays["id"][arrays["species"] == 2], np.arange(10))


def test_agents_are_dropped_onto_the_mesh_of_a_file(cache: Cache) -> None:
    (cache.folder.parent / "plain.obj").write_text("v -99 -40 -99\nv 99 -40 -99\nv 99 -40 99\nv -99 -40 99\nf 1 4 3\nf 1 3 2\n")
    view = edited(cache, "drop: guards, onto: plain.obj", "move: guards, by: [3 mm, 0, 0]")
    assert view.manifest.meshes[-1].name == "plain" and view.read_static()["mesh.plain.faces"].shape == (2, 3)
    for number in (1, 20):
        rows, feet = rows_of(view, number, GUARDS), rows_of(cache, number, GUARDS)["feet.walker.down"] > 0
        assert rows["P"][:, 1] == pytest.approx(np.full(4, -40), abs=1.5)
        assert rows["feet.walker.P"][feet][:, 1] == pytest.approx(np.full(feet.sum(), -40), abs=0.05)


def test_a_mirrored_agent_has_its_left_on_the_right(cache: Cache) -> None:
    rows, original_rows = rows_of(edited(cache, "mirror: guards, axis: x, at: 5 mm"), 7, GUARDS), rows_of(cache, 7, GUARDS)
    sign = np.array([-1, 1, 1])
    assert rows["P"][:, (0, 2)] == pytest.approx((original_rows["P"] * sign + (10, 0, 0))[:, (0, 2)], abs=2)
    ahead = np.tile((1.0, 0.0, 0.0), (4, 1))
    headings = [rotate_vectors(each["orient"].astype(float), ahead) for each in (rows, original_rows)]
    assert ((headings[0] * headings[1] * sign).sum(axis=1) > 0.8).all()
    left = rotate_vectors(rows["orient"].astype(float), np.tile((0.0, 0.0, -1.0), (4, 1)))
    front = rows["feet.walker.P"][:, 0] - rows["P"]  # legs of the left side come first
    assert ((front * left).sum(axis=1) > 0).all()


def test_bodies_colours_and_layers_are_replaced(cache: Cache) -> None:
    view = edited(cache, "replace: guards, body: person, colour: red")
    rows = rows_of(view, 9, GUARDS)
    assert rows["Cd"] == pytest.approx(np.tile(np.array(COLOUR_BY_NAME["red"]) / 255, (4, 1)), abs=1e-6)
    arrays = view.frame(9)
    assert "feet.walker.P" not in arrays and arrays["feet.walker#0.P"].shape == (6, 6, 3) and "feet.walker#1.P" not in arrays
    crowds = {(crowd.species, crowd.body.name): len(crowd.position) for crowd in Gallery(view).make_picture(9).crowds}
    assert crowds["walker", "person"] == 4 and sum(count for (name, _), count in crowds.items() if name == "walker") == 10
    six_legs = edited(cache, "replace: walker, body: ant").frame(9)
    assert six_legs["feet.walker#1.P"].tobytes() == cache.frame(9)["feet.walker.P"].tobytes()
    from_file = edited(cache, "replace: bug.2, body: body.json")
    assert from_file.manifest.bodies[-1].name == "body.json"
    assert {crowd.body_key for crowd in Gallery(from_file).make_picture(2).crowds if crowd.species == "bug"} == {"bug#0", "bug#1"}
    with pytest.raises(NotEditable, match="no body of these agents has a layer `hat`"):
        edited(cache, "replace: guards, wear: [hat]")


def test_agents_of_another_cache_are_added(cache: Cache) -> None:
    view = edited(cache, "merge: cache, by: [0, 0, 5 mm], later: 2", "kill: bug")
    for number in (1, 2, 3, 24):
        arrays, other = view.frame(number), cache.frame(number - 2) if number > 2 else None
        keys = FrameRows(arrays, view.manifest).keys
        assert len(np.unique(keys)) == len(keys) == (20 if other is not None else 10)
        if other is not None:
            added = keys[keys // SPECIES_PER_KEY >= 10]
            rows, source = (
                rows_of(view, number, added.tolist()),
                rows_of(cache, number - 2, (added - 10 * SPECIES_PER_KEY).tolist()),
            )
            assert rows["P"] - source["P"] == pytest.approx(np.tile((0, 0, 5), (10, 1)), abs=1e-5)
            assert rows["feet.walker.P"] - source["feet.walker.P"] == pytest.approx(np.tile((0, 0, 5), (10, 6, 1)), abs=1e-5)
            assert rows["orient"].tobytes() == source["orient"].tobytes()
    assert [species.name for species in view.manifest.species] == ["bug", "walker"]


def test_a_joint_is_shifted_and_turned_with_all_below_it(cache: Cache) -> None:
    view = edited(cache, "offset: bug.3, joint: head, rotate: [0, 90 deg, 0], by: [0, 2 mm, 0], frames: 9..9, ease: 0")
    (crowd, plain) = (next(c for c in Gallery(each).make_picture(9).crowds if c.species == "bug") for each in (view, cache))
    assert crowd.ids is not None and plain.ids is not None
    rig, base = crowd.body.definition.rig, crowd.body.definition.compute_base_matrix()[:3, :3]
    poses = [np.asarray(each.compute_poses().world_transforms, float) for each in (crowd, plain)]
    row, head = crowd.ids.tolist().index(3), rig.names.index("head")
    below = rig.find_descendants(head)
    others = np.setdiff1d(np.arange(len(rig.names)), below)
    legs = {joint for leg in crowd.body.definition.legs for joint in rig.find_descendants(rig.find_joint(leg.upper)).tolist()}
    assert np.array_equal(np.delete(poses[0], row, axis=0), np.delete(poses[1], row, axis=0))
    trunk = [joint for joint in others.tolist() if joint not in legs]
    assert np.array_equal(poses[0][row, trunk], poses[1][row, trunk])
    lift = base @ (poses[0] - poses[1])[row, head, :, 3]
    assert lift == pytest.approx([0, 2 / crowd.scale[row], 0], abs=0.02)  # the trunk tilts on its feet
    assert np.linalg.norm(lift) == pytest.approx(2 / crowd.scale[row], rel=1e-4)
    turns = [base @ each[row, head, :, :3] for each in poses]
    assert turns[0][0] == pytest.approx(turns[1][2], abs=0.03) and turns[0][2] == pytest.approx(-turns[1][0], abs=0.03)
    assert not any(name.startswith("joints.") for name in view.frame(8))
    with pytest.raises(NotEditable, match="did you mean `head`"):
        edited(cache, "offset: bug, joint: hed, rotate: [0, 1, 0]")


LINES = [
    "kill: bug.0..2",
    "clip: bug, frames: 1..20",
    "duplicate: hunters.1, by: [6 mm, 0, 0], later: 2",
    "hold: guards.0, frames: 8..12",
    "retime: hunters.4, frames: 5..20, speed: 150 %",
    "move: guards.1, by: [4 mm, 0, 0]",
    "rotate: guards.2, by: 40 deg",
    "scale: hunters.2, by: 150 %",
    "expand: [guards.3, hunters.3], by: 2",
    "face: hunters.5, to: leaf",
    "pin: hunters.0, to: [[-30, 0, 0], [30, 0, 0]]",
    "replace: bug.5, colour: blue",
    "smooth: guards, orient: 5",
    "mirror: guards.3, axis: z",
]


@pytest.mark.parametrize("draws", [7, pytest.param(40, marks=pytest.mark.slow)])
def test_random_subsets_of_edits_equal_those_where_the_others_were_never_written(cache: Cache, draws: int) -> None:
    random = np.random.default_rng(3)
    for _ in range(draws):
        chosen = random.random(len(LINES)) < 0.5
        view = edited(cache, *(line if is_on else f"{line}, off: yes" for line, is_on in zip(LINES, chosen, strict=True)))
        plain = edited(cache, *(line for line, is_on in zip(LINES, chosen, strict=True) if is_on)) if chosen.any() else cache
        number = int(random.integers(1, 25))
        edit_scenes.assert_same_arrays(view.frame(number), plain.frame(number), number)
        untouched = [key for key in FrameRows(cache.frame(number), cache.manifest).keys.tolist() if key % SPECIES_PER_KEY == 0]
        others = np.array([key for key in untouched if key // SPECIES_PER_KEY not in (0, 1, 2, 5)])
        if not chosen[1] or number <= 20:
            assert edit_scenes.take_agents(cache, number, others) == edit_scenes.take_agents(view, number, others)


def test_positions_are_means_and_stay_at_their_height_over_the_ground(cache: Cache) -> None:
    view = edited(cache, "smooth: walker, position: 7")
    ground = Ground(cache)
    number = 12
    old, new = rows_of(cache, number, GUARDS), rows_of(view, number, GUARDS)
    positions = [rows_of(cache, number + k, GUARDS)["P"].astype(np.float64) for k in range(-3, 4)]
    weights = 0.5 + 0.5 * np.cos(np.arange(-3, 4) * np.pi / 4)
    mean = np.einsum("k,kni->ni", weights / weights.sum(), positions)
    assert np.abs(new["P"] - mean)[:, [0, 2]].max() < 0.05 and (new["P"] != old["P"]).any()
    terrain = ground.at(number)
    assert terrain is not None
    up, reach = np.tile([0.0, 1.0, 0.0], (len(GUARDS), 1)), np.full(len(GUARDS), 20.0)
    heights = [p[:, 1] - terrain.find_along(p.astype(np.float64), up, reach, reach).position[:, 1] for p in (old["P"], new["P"])]
    assert np.abs(heights[0] - heights[1]).max() < 0.1
    assert all((old[name] == new[name]).all() for name in old if name.startswith("feet.") or name == "orient")
    step = np.linalg.norm(np.diff([rows_of(view, k, GUARDS)["P"] for k in range(8, 20)], n=2, axis=0), axis=2).mean()
    rough = np.linalg.norm(np.diff([rows_of(cache, k, GUARDS)["P"] for k in range(8, 20)], n=2, axis=0), axis=2).mean()
    assert step < rough
    ends = [rows_of(each, 1, GUARDS)["P"] for each in (view, cache)]
    assert np.abs(ends[0] - ends[1]).max() < 1e-4  # it is the first frame


def test_agents_that_ever_meet_a_condition_are_selected(cache: Cache) -> None:
    region = "{around: leaf, radius: 20 mm}"
    ever = edited(cache, f"kill: bug, in: {region}, ever: 4..14")
    inside: set[int] = set()
    for number in range(4, 15):
        arrays = cache.frame(number)
        place = np.asarray(arrays["P"], np.float64) - np.array(find_item_points(arrays, cache.manifest, 1.0)["leaf"][0])
        near = (np.sqrt((place * place).sum(axis=1)) <= 20) & (arrays["species"] == 0)
        inside |= set(arrays["id"][near].tolist())
    assert len(inside) > 3
    for number in (1, 9, 24):
        plain, left = cache.frame(number), ever.frame(number)
        bugs = set(plain["id"][plain["species"] == 0].tolist())
        assert set(left["id"][left["species"] == 0].tolist()) == bugs - inside
    for line, words in (
        ("kill: bug, ever: 1..4", "`ever` has no effect without a condition"),
        ("kill: bug, state: go, ever: 90..99", "the cache has no frames 90 to 99"),
    ):
        _, report = read_edits(f"edits: [{{{line}}}]".encode(), "edits.yaml", cache.manifest)
        assert words in report.errors[0].message
