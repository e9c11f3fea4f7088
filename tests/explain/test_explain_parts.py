"""What an explanation says part by part, on a small scene that has every kind of change; and what it refuses."""

from __future__ import annotations

import json
import math
import os
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest
from explained import cached, differences, explanations, facts, shot_of
from sampling import sampled

from antdsl.cli import _run_without_warnings as run_in_process
from antdsl.explain import (
    CacheHistory,
    ExplainError,
    Explanation,
    StepReplay,
    explain_agent_in_cache,
    explain_agents,
    format_explanation,
    make_json_document,
    open_shot,
)
from antdsl.outputs.cache.cache_reader import Cache, open_cache
from antdsl.outputs.cache.manifest import ManifestError, find_relative_path

ROOT = Path(__file__).resolve().parents[2]
BUG = """ant 1
use steering
world { surface ground; items food { load = 0 } }

species bug {
  param brave = 60 %/s in 0 %/s .. 500 %/s "How often it turns"
  size      4 mm
  max_speed 20 mm/s
  energy = 1
  load = 0
  scare = 0
  let weary  = energy < 90 %
  let crumb = nearest(food, with: load > 0)
  on hiss { scare += 0.5 }

  start go
  state go "Goes" amber for at least 0.25 s {
    energy -= 24 %/s
    steer wander() * 0.5
    interrupt when scare > 0.4           -> hide
    when weary held 0.25 s               -> rest
    when crumb take 1 load from crumb    -> full
  }
  state rest "Sits" grey {
    steer halt()
    when chance brave -> choose { go: 1; hide: 3 }
    when after 2 s    -> go
  }
  state full "Has one" green {
    steer seek(crumb)
    when after 0.5 s -> go { emit hiss(within: 30 mm) }
  }
  state hide "Hides" red {
    enter { scare = 0 }
    when after 1 s -> previous
  }
  from any except hide when energy < 20 % -> hide

  layers {
    separate(radius: 8 mm) * 3
    wander() when energy > 95 %
    state
    wander(swing: 20 deg)
  }
}
"""
FLY = """ant 1
use steering
species fly {
  size 3 mm
  start young
  state young amber { steer wander(); when after 0.5 s -> old { spawn fly } }
  state old grey { when after 0.25 s -> done }
  state done red { enter { die } }
  layers { state }
}
"""
SCENE = """antdsl: 1
frames: 1..60
seed: 3
world:
  ground: {mesh: ground.ply}
  food: {crumb: {at: [0, 0, 0], on: ground, load: 3, radius: 5 mm}}
crowd:
  - {species: bug, from: bug.ant, count: 12, place: {on: ground, radius: 20 mm}}
  - {species: fly, from: fly.ant, count: 2, place: {on: ground, radius: 20 mm}}
output: {checkpoint: 20}
"""
LAST = 60


@pytest.fixture(scope="module")
def cache(tmp_path_factory: pytest.TempPathFactory) -> Cache:
    """Twelve bugs and two flies, 60 frames, beside their scene as `antdsl run` puts them."""
    folder = tmp_path_factory.mktemp("odd")
    shutil.copy(ROOT / "examples" / "minimal" / "ground.ply", folder)
    for name, text in (("bug.ant", BUG), ("fly.ant", FLY), ("scene.yaml", SCENE)):
        (folder / name).write_text(text)
    return cached(folder / "scene.yaml", LAST, folder / "out" / "scene")


@pytest.fixture(scope="module")
def bug_explanations(cache: Cache) -> list[Explanation]:
    """Every bug in every step."""
    replay = StepReplay(CacheHistory.from_cache(cache, open_shot(cache)))
    results = [each for frame in range(2, LAST + 1) for each in explain_agents(replay, frame, [("bug", k) for k in range(12)])]
    return [each for each in results if each is not None]


def test_all_kinds_of_changes_agree_with_the_run(cache: Cache, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = cache.folder.parent.parent / "scene.yaml"
    shot = shot_of(scene, LAST)
    run_facts = facts(shot, 200, monkeypatch, seed=1)
    wrong = [
        (fact, differ)
        for fact, explanation in explanations(cache, scene, run_facts)
        if (differ := differences(shot, fact, explanation))
    ]
    assert not wrong
    assert sum(any(fact.pending.values()) for fact in run_facts) > 20


MOODS = """
  machine mood {
    start fine
    state fine teal { when chance 100 %/s -> cross { tense = 1 } }
    state cross red { when after 0.3 s -> fine { tense = 0 } }
  }
"""


@pytest.mark.parametrize("mode", sampled(["sum", "first"], ["first"]))
def test_other_ways_to_blend_and_two_machines_agree_with_the_run(
    mode: str, cache: Cache, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for file in cache.folder.parent.parent.glob("*.*"):
        shutil.copy(file, tmp_path)
    start, end = BUG.index("  start go"), BUG.index("  layers {")
    walk = "  machine walk {\n" + BUG[start:end] + "  }\n"
    text = (
        BUG[:start]
        + "  tense = 0\n"
        + walk
        + MOODS
        + BUG[end:].replace("layers {", f"layers {mode} {{\n wander() when tense > 0")
    )
    (tmp_path / "bug.ant").write_text(text)
    new_cache = cached(tmp_path / "scene.yaml", 30, tmp_path / "out" / "scene")
    shot = shot_of(tmp_path / "scene.yaml", 30)
    run_facts = facts(shot, 60, monkeypatch, seed=2)
    both = list(explanations(new_cache, tmp_path / "scene.yaml", run_facts))
    assert not [(fact, differ) for fact, explanation in both if (differ := differences(shot, fact, explanation))]
    assert {explanation.mode for fact, explanation in both if fact.species == "bug"} == {mode}
    assert {machine.machine for _, explanation in both for machine in explanation.machines} == {"walk", "mood", "main"}
    assert any(explanation.machines[1].changed for fact, explanation in both if fact.species == "bug")


@pytest.mark.slow
def test_tracing_does_not_change_the_run(cache: Cache, bug_explanations: list[Explanation]) -> None:
    """All bugs traced in every step: the hashes are those that the run without any watcher has written."""
    hashes = cache.read_state_hashes()
    assert len(bug_explanations) == 12 * (LAST - 1)
    assert all(each.hash == hashes[each.frame] for each in bug_explanations)
    contents = {path: path.read_bytes() for path in cache.folder.rglob("*") if path.is_file()}
    explain_agent_in_cache(cache, 3, 30, species="bug")
    assert contents == {path: path.read_bytes() for path in cache.folder.rglob("*") if path.is_file()}


def test_parts_have_values_in_the_authors_units(cache: Cache, bug_explanations: list[Explanation]) -> None:
    """Energy falls by 24 % a second from 100 %: after k steps in `go` it is 100 - k % of it."""
    first = [each for each in bug_explanations if each.agent == 0]
    for each in first[:11]:
        weary = next(looked for looked in each.machines[0].looked if "weary" in looked.place.text)
        assert weary.condition is not None and weary.condition.text == "weary"
        energy = next(part for part in weary.condition.parts if part.text == "energy")
        assert energy.unit == "%" and energy.value == pytest.approx(100 - (each.frame - 2))
        assert weary.held == (energy.value < 90)
        held = weary.timers[0]
        assert (held.what, held.needs) == ("held", 6) and held.has == max(0, each.frame - 13)
        rest = {timer.what: timer for timer in weary.timers}["at least"]
        assert rest.needs == 0.25 and rest.holds == (rest.has > 0.25 - 1e-4)


def test_interrupts_come_before_transitions_from_any(bug_explanations: list[Explanation]) -> None:
    kinds = [[looked.kind for looked in e.machines[0].looked] for e in bug_explanations if e.machines[0].before == "go"]
    assert kinds and all(each == ["interrupt", "from any", "when", "when"] for each in kinds)
    for each in bug_explanations:
        firing = [looked for looked in each.machines[0].looked if looked.fires]
        assert [looked.wins for looked in firing] == [True] + [False] * (len(firing) - 1) if firing else True


def test_a_chance_shows_its_draw_and_its_bar(bug_explanations: list[Explanation]) -> None:
    chances = [
        part
        for e in bug_explanations
        for looked in e.machines[0].looked
        if looked.condition
        for part in [looked.condition]
        if "chance" in part.text
    ]
    assert len(chances) > 20
    for each in chances:
        draw, bar = (next(part.value for part in each.parts if part.role == role) for role in ("draw", "bar"))
        assert bar == pytest.approx(1 - math.exp(-0.6 / 24), rel=1e-5)
        assert each.value == (draw < bar)


def test_a_choice_shows_its_draw_and_the_bars(bug_explanations: list[Explanation]) -> None:
    choices = [e.machines[0].choice for e in bug_explanations if e.machines[0].choice is not None]
    assert choices
    for choice in choices:
        assert choice.bars == (("go", 0.25), ("hide", 1.0))
        assert choice.chosen == ("go" if choice.draw < 0.25 else "hide")


def test_claims_name_the_successful_agent(bug_explanations: list[Explanation]) -> None:
    """Three loads, twelve bugs: nine lose, in the order of their turns, and stay where they are."""
    claims = [(e, e.machines[0].claim) for e in bug_explanations if e.machines[0].claim is not None]
    won = [(e, c) for e, c in claims if c.won]
    lost = [(e, c) for e, c in claims if not c.won]
    assert len(won) == 3 and lost
    assert all(e.machines[0].after == "full" for e, _ in won) and all(e.machines[0].after == "go" for e, _ in lost)
    for frame in {e.frame for e, _ in won}:
        turns = [(c.draw, c.won) for e, c in claims if e.frame == frame]
        assert sorted(turns) == sorted(turns, key=lambda turn: (not turn[1], turn[0]))  # the winner had fewer turns
    assert all(("load: 0 -> 1" in format_explanation(e)) and c.item == "crumb" for e, c in won)


def test_layers_use_the_budget_in_order_and_the_rest_is_cut(bug_explanations: list[Explanation]) -> None:
    cut = spent = off = 0
    for each in bug_explanations:
        left = 1.0
        for layer in each.layers:
            assert layer.left == pytest.approx(left, abs=1e-6)
            assert layer.share == pytest.approx(min(layer.length, layer.left), abs=1e-6)
            assert layer.share + layer.cut == pytest.approx(layer.length, abs=1e-6)
            left -= layer.share
            cut, spent, off = cut + (layer.cut > 0.01), spent + (layer.state == "no strength"), off + (layer.state == "off")
    assert cut > 10 and spent > 10 and off > 10


def test_explanations_include_others_items_and_changes(cache: Cache, bug_explanations: list[Explanation]) -> None:
    crowded = max(bug_explanations, key=lambda e: max((group.count for group in e.seen if group.of == "bug"), default=0))
    group = max((g for g in crowded.seen if g.of == "bug"), key=lambda g: g.count)
    distances = [near.distance for near in group.nearest]
    assert distances == sorted(distances) and len(distances) == min(group.count, 10) and max(distances) <= 8
    assert any(near.name == "crumb" for e in bug_explanations for g in e.seen for near in g.nearest)
    for each in bug_explanations[:50]:
        arrays = cache.frame(each.frame)
        row = int((arrays["id"] == each.agent).nonzero()[0][0])  # species by name: bugs come first
        moved = {change.name: change for change in each.changes}["position"]
        assert moved.after == pytest.approx([float(x) for x in arrays["P"][row]], abs=1e-3)
        assert each.velocity[1] == pytest.approx([float(x) for x in arrays["v"][row]], rel=1e-5)
    assert any(e.handlers for e in bug_explanations) and any("emit hiss within 30 mm" in e.did for e in bug_explanations)


def test_every_step_from_birth_to_death_is_explained(cache: Cache) -> None:
    last = explain_agent_in_cache(cache, 0, 15, species="fly")
    assert [stretch.state for stretch in last.strip] == ["young", "old"] or last.strip[-1].last >= 15
    died = next(frame for frame in range(2, LAST) if frame > (last.alive or (0, 0))[1])
    end = explain_agent_in_cache(cache, 0, died, species="fly")
    assert end.notes == (f"it died in this step, so frame {died} does not contain it",) and "die" in end.did
    assert json.loads(json.dumps(make_json_document(end), allow_nan=False))["velocity"][1] is None


def test_a_seed_and_values_given_to_the_run_are_known_from_the_cache(copy: Cache) -> None:
    scene = copy.folder.parent.parent / "scene.yaml"
    new_cache = cached(scene, 45, copy.folder.parent / "other", seed=11, params={"bug.brave": "400 %/s"})
    assert new_cache.read_state_hashes()[40] != copy.read_state_hashes()[40]
    resting = next(
        looked
        for k in range(12)
        for looked in explain_agent_in_cache(new_cache, k, 22, species="bug").machines[0].looked
        if "chance brave" in looked.place.text and looked.condition is not None
    )
    bar = next(part.value for part in resting.condition.parts if part.role == "bar")
    brave = next(part for part in resting.condition.parts if part.text == "brave")
    assert bar == pytest.approx(1 - math.exp(-4 / 24), rel=1e-5) and (brave.value, brave.unit) == (pytest.approx(400), "%/s")


def refused(cache: Cache, *words: object) -> ExplainError:
    with pytest.raises(ExplainError) as why:
        explain_agent_in_cache(cache, *words[:2], species=words[2] if len(words) > 2 else None)  # type: ignore[arg-type]
    return why.value


def test_unexplainable_requests_are_errors(cache: Cache) -> None:
    assert "`bug`, `fly`" in refused(cache, 1, 10).help
    assert refused(cache, 1, 10, "bag").help == "did you mean `bug`?"
    assert "from 0 to 11" in refused(cache, 99, 10, "bug").help
    assert refused(cache, 1, 1, "bug").help == "ask for a later one: `--frame 2`"
    assert str(refused(cache, 1, 61, "bug")) == "no frame 61" and "2 to 60" in refused(cache, 1, 61, "bug").help
    refusal = refused(cache, 0, 50, "fly")
    assert str(refusal) == "fly 0 does not exist at frame 50" and "from frame 1 to" in refusal.help
    born = next(k for k in range(2, 9) if "had not decided" in str(refused(cache, k, 3, "fly")))
    assert "its first step leads to" in refused(cache, born, 3, "fly").help


@pytest.fixture
def copy(cache: Cache, tmp_path: Path) -> Iterator[Cache]:
    """A separate folder, to be spoiled."""
    folder = tmp_path / "copy"
    shutil.copytree(cache.folder.parent.parent, folder)
    yield open_cache(folder / "out" / "scene")


def test_changed_programs_are_rejected(copy: Cache) -> None:
    program = copy.folder.parent.parent / "bug.ant"
    program.write_text(BUG.replace("24 %/s", "25 %/s"))
    assert str(refused(copy, 1, 10, "bug")).startswith("the cache was made from other inputs: ") and "bug.ant" in str(
        refused(copy, 1, 10, "bug")
    )
    program.write_text(BUG.replace("energy -=", "energie -="))
    assert refused(copy, 1, 10, "bug").report is not None
    (copy.folder.parent.parent / "scene.yaml").unlink()
    assert "--scene" in refused(copy, 1, 10, "bug").help


def test_other_hash_versions_are_rejected(copy: Cache) -> None:
    path = copy.folder / "manifest.json"
    path.write_text(path.read_text().replace('"state_hash": 2', '"state_hash": 1'))
    assert "computes state hashes in another way" in str(refused(open_cache(copy.folder), 1, 10, "bug"))


def test_damaged_checkpoints_are_skipped_and_missing_ones_reported(copy: Cache) -> None:
    points = copy.checkpoints()
    assert explain_agent_in_cache(copy, 1, 50, species="bug").checkpoint == 41
    explanation_text = format_explanation(explain_agent_in_cache(copy, 1, 50, species="bug"))
    path = copy.folder / "checkpoints" / "checkpoint.0041.npz"
    path.write_bytes(path.read_bytes()[:-40])
    again = explain_agent_in_cache(copy, 1, 50, species="bug")
    assert again.checkpoint == 21 and format_explanation(again) == explanation_text
    for point in points:
        (copy.folder / "checkpoints" / f"checkpoint.{point:04d}.npz").unlink()
    assert "no checkpoint up to frame 49" in str(refused(copy, 1, 50, "bug"))


def test_differing_replays_are_rejected(copy: Cache) -> None:
    path = copy.folder / "hashes.jsonl"
    path.write_text(path.read_text().replace(copy.read_state_hashes()[30], "0" * 32))
    assert str(refused(copy, 1, 30, "bug")).startswith("frame 30 is computed differently")


@pytest.mark.parametrize(
    ("words", "code", "said"),
    [
        (["--agent", "3", "--frame", "30", "--species", "bug"], 0, "bug 3, the step to frame 30 of scene.yaml"),
        (["--agent", "3", "--frame", "30", "--species", "bag"], 2, "help: did you mean `bug`?"),
        (["--agent", "3", "--frame", "99", "--species", "bug"], 2, "error: no frame 99"),
        (["--agent", "three", "--frame", "30"], 2, "--agent"),
        (["--frame", "30"], 2, "--agent"),
    ],
)
def test_the_explain_command(
    cache: Cache, words: list[str], code: int, said: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr("sys.argv", ["antdsl", "explain", os.fspath(cache.folder), *words])
    assert run_in_process() == code
    printed = capsys.readouterr()
    assert said in printed.out + printed.err and "Traceback" not in printed.err


def test_json_has_the_same_content(cache: Cache, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(
        "sys.argv", ["antdsl", "explain", os.fspath(cache.folder), "--agent", "3", "--frame", "30", "--species", "bug", "--json"]
    )
    assert run_in_process() == 0
    document = json.loads(capsys.readouterr().out)
    assert document == json.loads(json.dumps(make_json_document(explain_agent_in_cache(cache, 3, 30, species="bug"))))
    assert document["format"] == 1 and document["machines"][0]["looked"][0]["place"]["line"] > 0


def test_the_scene_is_found_relative_to_the_cache(cache: Cache, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A cache of `--out`, far from its scene; with the two of them moved together; and another scene of that name nearer by."""
    home = cache.folder.parent.parent
    shutil.copytree(home, tmp_path / "work" / "shots" / "a" / "b", ignore=shutil.ignore_patterns("out"))
    new_cache = cached(tmp_path / "work" / "shots" / "a" / "b" / "scene.yaml", 12, tmp_path / "work" / "out" / "b")
    assert new_cache.manifest.scene_path == "../../shots/a/b/scene.yaml"
    (tmp_path / "work" / "scene.yaml").write_text("antdsl: 1\n")
    (tmp_path / "elsewhere").mkdir()
    (tmp_path / "work").rename(tmp_path / "moved")
    for folder in (tmp_path / "moved" / "out", tmp_path / "elsewhere", tmp_path / "moved" / "shots", tmp_path):
        monkeypatch.chdir(folder)
        moved_cache = open_cache(Path(os.path.relpath(tmp_path / "moved" / "out" / "b")))
        assert explain_agent_in_cache(moved_cache, 1, 10, species="bug").frame == 10
    shutil.rmtree(tmp_path / "moved" / "shots")
    (tmp_path / "moved" / "scene.yaml").unlink()
    refusal = refused(moved_cache, 1, 10, "bug")
    assert refusal.usage and "`../../shots/a/b/scene.yaml`" in str(refusal) and "--scene" in refusal.help
    scene = explain_agent_in_cache(moved_cache, 1, 10, species="bug", scene=home / "scene.yaml")
    assert scene.frame == 10


def test_no_folder_of_the_machine_is_written_into_a_cache(tmp_path: Path) -> None:
    (tmp_path / "scene.yaml").write_text("antdsl: 1\n")
    assert find_relative_path(tmp_path / "scene.yaml", tmp_path / "out" / "scene") == "../../scene.yaml"
    assert find_relative_path(tmp_path / "scene.yaml", tmp_path) == "scene.yaml"
    top = Path(tmp_path.anchor)
    assert find_relative_path(tmp_path / "scene.yaml", top / "cache") is None
    assert find_relative_path(top / "scene.yaml", tmp_path) is None
    assert find_relative_path(tmp_path / ("x" * 250) / ("y" * 250) / "scene.yaml", tmp_path / "out") is None
    (tmp_path / "link").symlink_to(tmp_path / "far" / "away", target_is_directory=True)
    assert find_relative_path(tmp_path / "link" / "scene.yaml", tmp_path / "out") == "../link/scene.yaml"


@pytest.mark.parametrize(
    "path", ["/etc/scene.yaml", "..\\\\scene.yaml", "C:/scene.yaml", "scene.yaml\\n", "../out", "a//b.yaml", ""]
)
def test_a_manifest_with_another_kind_of_path_is_damaged(copy: Cache, path: str) -> None:
    file = copy.folder / "manifest.json"
    text = file.read_text()
    assert '"scene_path": "../../scene.yaml"' in text
    file.write_text(text.replace('"../../scene.yaml"', f'"{path}"'))
    with pytest.raises(ManifestError, match="damaged"):
        open_cache(copy.folder)
