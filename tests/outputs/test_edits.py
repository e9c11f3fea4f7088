"""Edits of a cache: they are stored with it, applied as its frames are read, taken away, and written as a new cache."""

from __future__ import annotations

import json
import shutil
from pathlib import Path
from typing import Any

import edit_scenes
import numpy as np
import pytest
from edit_scenes import fail, run

from antdsl.outputs.cache.cache_reader import open_cache
from antdsl.outputs.edits.edit_lines import read_edits
from antdsl.outputs.edits.edited_cache import open_edited_cache
from antdsl.outputs.edits.frame_rows import SPECIES_PER_KEY, FrameRows
from antdsl.outputs.edits.side_effects import measure_segment_distances
from antdsl.outputs.edits.verb_table import VERB_BY_WORD

KILLS = "edits:\n- {kill: guards}  # they distract\n- {kill: bug, share: 50 %, seed: 4}\n"


@pytest.fixture(scope="module")
def original(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return edit_scenes.simulate(tmp_path_factory.mktemp("edits"))


@pytest.fixture
def cache(original: Path, tmp_path: Path) -> Path:
    """A copy of the cache that a test may change."""
    shutil.copytree(original, tmp_path / "cache")
    return tmp_path / "cache"


def edit(cache: Path, text: str, *flags: object) -> str:
    (cache.parent / "edits.yaml").write_text(text)
    return run("edit", cache, "--edits", cache.parent / "edits.yaml", *flags)


def test_the_scene_has_all_kinds_of_arrays(original: Path) -> None:
    names = {name for number in open_cache(original).frames() for name in open_cache(original).frame(number)}
    expected = ("feet.walker.P", "events.emit.id", "events.contact.other", "clips.bug.main.turns", "species")
    assert names.issuperset(expected), names
    counts = [len(open_cache(original).frame(k)["id"]) for k in open_cache(original).frames()]
    assert counts[0] == 18 < max(counts) and counts[-1] < max(counts)  # some were born, some have died


def test_killed_agents_are_in_no_array_and_all_others_keep_their_bits(cache: Path) -> None:
    assert "2 edits are applied" in edit(cache, KILLS)
    plain, view = open_cache(cache), open_edited_cache(cache)
    killed: set[int] = set()
    for number in plain.frames():
        all_keys = FrameRows(plain.frame(number), plain.manifest).keys
        keys = FrameRows(view.frame(number), view.manifest).keys
        removed = set(all_keys.tolist()) - set(keys.tolist())
        guards = {key for key in all_keys.tolist() if key % SPECIES_PER_KEY == 1 and key // SPECIES_PER_KEY in range(6, 10)}
        assert guards <= removed and all(key % SPECIES_PER_KEY == 0 for key in removed - guards)
        killed |= removed - guards
        left = np.array(sorted(keys.tolist()), np.int64)
        assert edit_scenes.take_agents(plain, number, left) == edit_scenes.take_agents(view, number, left)
        for name, array, own in edit_scenes.iterate_rows(view, view.frame(number)):
            assert len(array) == len(own) and not removed & set(own.tolist()), name
    bugs = {
        k for n in plain.frames() for k in FrameRows(plain.frame(n), plain.manifest).keys.tolist() if k % SPECIES_PER_KEY == 0
    }
    assert 0.2 * len(bugs) < len(killed) < 0.8 * len(bugs)


def test_edits_are_taken_away_without_a_trace(cache: Path, original: Path) -> None:
    manifest = (cache / "manifest.json").read_bytes()
    edit(cache, KILLS)
    assert (cache / "manifest.json").read_bytes() != manifest
    assert "its own frames" in run("edit", cache, "--remove")
    assert open_cache(cache).manifest == open_cache(original).manifest
    edit_scenes.assert_same_frames(open_edited_cache(cache), open_cache(original))
    assert "no edits" in run("edit", cache, "--remove")


def test_a_written_cache_equals_the_view(cache: Path) -> None:
    edit(cache, KILLS)
    run("edit", cache, "--to", cache.parent / "baked", "-q")
    view, baked = open_edited_cache(cache), open_cache(cache.parent / "baked")
    edit_scenes.assert_same_frames(view, baked)
    left, right = (
        [line for line in run("info", folder).splitlines() if not line.startswith(("edits ", "checkpoints "))]
        for folder in (cache, cache.parent / "baked")
    )
    assert left == right and any("kill: guards" in line for line in left)
    for name in ("all.npz", "all.glb", "all.usda", "all.csv"):
        for folder in (cache, cache.parent / "baked"):
            run("export", folder, "--to", folder / name, "-q")
        assert (cache / name).read_bytes() == (cache.parent / "baked" / name).read_bytes(), name
    for folder in (cache, cache.parent / "baked"):
        run("render", folder, "--frames", "12..12", "--width", 240, "--height", 160, "--out", folder / "pictures")
    one, two = ((folder / "pictures" / "picture.0012.png").read_bytes() for folder in (cache, cache.parent / "baked"))
    assert strip_texts(one) == strip_texts(two)
    assert "verified" in run("info", cache.parent / "baked", "--verify") and "verified" in run("info", cache, "--verify")


def strip_texts(png: bytes) -> bytes:
    """The compressed pixels of a PNG file."""
    start = png.index(b"IDAT")
    return png[start : png.index(b"IEND")]


CALLS = {  # mistakes in a line, and what to write instead
    "{VERB: all(bug, within: 9 mm)}": "`{of: bug, near: [0, 0, 0], within: 9 mm}`",
    "{VERB: [all(bug, within: 9 mm, most: 2), guards]}": "`{of: bug, near: [0, 0, 0], within: 9 mm, most: 2}`",
    "{VERB: {of: nearest(bug, within: 9 mm)}}": "`{of: bug, near: [0, 0, 0], within: 9 mm, most: 1}`",
    "VERB: all(bug, within: 9 mm)": "`{of: bug, near: [0, 0, 0], within: 9 mm}`",
    "{VERB: 'all(bug, within: 9 mm)'}": "`{of: bug, near: [0, 0, 0], within: 9 mm}`",
    '{VERB: "all(bug)"}': "write `bug`",
    "{VERB: \"'bug'\"}": "`guards.17`",
    '{VERB: all(bug, with: "load > 0")}': "put it in quotes",
    "{VERB: all(bug, within: '9 mm')}": "`{of: bug, near: [0, 0, 0], within: '9 mm'}`",
    "{VERB:bug}": "write `VERB: bug`",
    "{VERB:bug, frames: 1..2}": "write `VERB: bug`",
    "{VERB: bug, frames:1..2}": "write `frames: 1..2`",
    "{VERB bug, frames: 1..2}": "write `VERB: bug`",
    "{VERB: bug.1, bug.2}": "`VERB: [bug.1, bug.2]`",
    "{VERB: bug[2]}": "write `bug.2`",
    "VERB:bug": "write `VERB: bug`",
}


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("edits:\n  - kill:bug", "write `kill: bug`"),
        ("edits:\n  - kill bug", "write `kill: bug`"),
        ("edits: [{kil: bug}]", "did you mean `kill`"),
        ("edits: [{share: 3 %, kill: bug}]", "write `kill` first"),
        ("edits: [{kill: bugs}]", "did you mean `bug`"),
        ("edits: [{kill: guards.4}]", "0 to 3"),
        ("edits: [{kill: bug, shar: 30 %}]", "did you mean `share`"),
        ("edits: [{kill: bug, share: 130 %}]", "`0 %` to `100 %`"),
        ("edits: [{kill: bug, frames: 90..95}]", "the cache has frames 1 to 24"),
        ("edits: [{kill: bug, frames: 9..5}]", "ends before"),
        ("edits: [{kill: {near: lef, within: 5 mm}}]", "did you mean `leaf`"),
        ("edits: [{kill: {state: fly}}]", "no species has a state"),
        ("edits: [kill]", "expected an edit"),
        ("edits: {kill: bug}", "no list `edits`"),
        ("kill: bug", "is not a key of edits"),
        ("# none yet", "the file of edits is empty"),
        ("# none yet", "write `edits:`"),
        ("edits: [{move: bug, to: lef}]", "did you mean `leaf`"),
        ("edits: [{face: bug, to: nosuch}]", "no item is named `nosuch`"),
        ("edits: [{rotate: bug, by: 9 deg, around: nosuch}]", "known: `food`, `leaf`, `seed`"),
        ("edits: [{expand: bug, by: 2, around: each}]", "no item is named `each`"),
        ("edits: [{clip: bug, inside: {around: sed, radius: 5 mm}}]", "did you mean `seed`"),
        ("edits: [{merge: link}]", "does not follow links"),
        ("edits: [{smooth: bug, orient: 8}]", "write `9`"),
        ("edits: [" + "{kill: bug}," * 1001 + "]", "limit of 1,000"),
    ],
)
def test_mistakes_are_reported_at_their_place_and_change_nothing(cache: Path, text: str, words: str) -> None:
    manifest = (cache / "manifest.json").read_bytes()
    (cache.parent / "edits.yaml").write_text(text)
    (cache.parent / "link").symlink_to(cache)
    assert words in fail("edit", cache, "--edits", cache.parent / "edits.yaml")
    assert (cache / "manifest.json").read_bytes() == manifest


@pytest.mark.parametrize("form", sorted(CALLS))
def test_calls_and_missing_spaces_are_reported_for_each_verb(cache: Path, form: str) -> None:
    manifest = open_cache(cache).manifest
    for verb in VERB_BY_WORD:
        if verb != "merge":  # its value is a folder
            edits, report = read_edits(f"edits:\n  - {form.replace('VERB', verb)}\n".encode(), "edits.yaml", manifest)
            first = report.errors[0]
            assert edits is None and first.span is not None and "\n" in first.span.source.text[: first.span.start]
            assert CALLS[form].replace("VERB", verb) in " ".join(each.help or "" for each in report.errors), (verb, report.errors)


def test_flags_that_contradict_are_usage_errors(cache: Path) -> None:
    (cache.parent / "edits.yaml").write_text(KILLS)
    for flags in ((), ("--remove", "--to", "x"), ("--remove", "--edits", cache.parent / "edits.yaml")):
        assert "--edits" in fail("edit", cache, *flags)
    assert "no file" in fail("edit", cache, "--edits", cache.parent / "other.yaml")


def test_a_merged_cache_is_an_input(cache: Path) -> None:
    other = cache.parent / "other"
    shutil.copytree(cache, other)
    assert "1 edit is applied" in edit(cache, "edits: [{merge: other}]")
    files = sorted(path.name for path in (other / "frames").iterdir())
    for flags in (("edit", cache, "--to", other, "--force"), ("edit", cache, "--smooth", "orient:3", "--to", other, "--force")):
        assert "is an input and would be lost" in fail(*flags)
    assert sorted(path.name for path in (other / "frames").iterdir()) == files
    assert open_cache(other).manifest == open_cache(cache).manifest.model_copy(update={"edits": None})


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"next_ids": {}}, "their ids of `bug` are missing"),
        ({"next_ids": {"bug": 2**80, "walker": 1}}, "is damaged"),
        ({"arrays": None}, "`plain.obj`, which they need, is missing"),
        ({"caches": {}}, "`other`, which they need, is missing"),
        ({"caches": {"other": "/tmp"}}, "the path of `other` does not begin at the cache"),
        ({"caches": {"other": "C:/other"}}, "the path of `other` does not begin at the cache"),
    ],
)
def test_damaged_edits_are_reported(cache: Path, change: dict[str, Any], words: str) -> None:
    shutil.copytree(cache, cache.parent / "other")
    (cache.parent / "plain.obj").write_text("v -99 -40 -99\nv 99 -40 -99\nv 99 -40 99\nf 1 3 2\n")
    edit(cache, "edits: [{merge: other}, {drop: bug, onto: plain.obj}, {duplicate: bug, by: [9 mm, 0, 0]}]")
    manifest = json.loads((cache / "manifest.json").read_text())
    manifest["edits"] |= change
    (cache / "manifest.json").write_text(json.dumps(manifest))
    for command in (
        ("info", cache),
        ("export", cache, "--to", cache.parent / "all.csv"),
        ("edit", cache, "--to", cache.parent / "x"),
    ):
        assert words in fail(*command)


def test_overlaps_and_gaps_that_edits_cause_are_reported(cache: Path) -> None:
    (cache.parent / "edits.yaml").write_text("edits: [{duplicate: walker.7}, {move: walker.2, by: [0, 30 mm, 0], ground: free}]")
    result = edit_scenes.RUN.invoke(edit_scenes.app, ["edit", str(cache), "--edits", str(cache.parent / "edits.yaml")])
    words = result.output + result.stderr
    assert "1 pair of agents overlaps because of edits: `walker.7` and `walker.17` in frame 1" in words, words
    assert "1 agent is off the ground because of edits: `walker.2` in frame 1" in words
    quiet = edit(cache, "edits: [{kill: guards}, {replace: bug, colour: red}]")
    assert "because of edits" not in quiet


def test_distances_of_segments() -> None:
    random = np.random.default_rng(1)
    a, u, b, v = random.normal(size=(4, 40, 3))
    u[:3], v[2:5] = 0, 0
    share = np.linspace(-1, 1, 201)
    one = a[:, None] + share[None, :, None] * u[:, None]
    other = b[:, None] + share[None, :, None] * v[:, None]
    nearest = np.sqrt(((one[:, :, None] - other[:, None]) ** 2).sum(axis=3)).min(axis=(1, 2))
    distance = measure_segment_distances(a, u, b, v)
    assert (distance <= nearest + 1e-9).all() and distance == pytest.approx(nearest, abs=0.02)
