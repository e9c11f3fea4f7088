"""The interface for Python: what is read equals a run's cache, what is set has an effect, and mistakes say what to write."""

from __future__ import annotations

import shutil
import subprocess
import sys
from collections import deque
from pathlib import Path

import numpy as np
import pandas
import pytest
from children import child_environment

import antdsl
from antdsl.api.crowds import Crowd
from antdsl.outputs.cache.cache_reader import open_cache
from antdsl.outputs.recording import begin_recording, record_frames
from antdsl.pipeline import RunChoices
from antdsl.pipeline import open_scene as open_shot
from antdsl.runtime import Options
from antdsl.scene.values import FrameRange

ROOT = Path(__file__).resolve().parents[2]
FORAGING, MINIMAL, ARENA = (ROOT / "examples" / name / "scene.yaml" for name in ("foraging", "minimal", "arena"))


def test_arrays_are_those_of_a_cache_in_the_order_of_ids(tmp_path: Path) -> None:
    shot, _ = open_shot(FORAGING, RunChoices(seed=4, frames=FrameRange(1, 7)))
    assert shot is not None
    recording = begin_recording(shot, tmp_path / "cache", Options(), resume=False, force=False)
    deque(record_frames(recording), maxlen=0)
    cache = open_cache(tmp_path / "cache")
    simulation = antdsl.open_scene(FORAGING, seed=4, threads=2)
    ants = simulation["forager"]
    for frame in range(1, 7):
        arrays = cache.frame(frame)
        assert simulation.frame == frame and simulation.time == pytest.approx((frame - 1) / 24)
        assert (ants.ids == arrays["id"]).all() and (ants["position"].astype(np.float32) == arrays["P"]).all()
        assert simulation.state_hash == cache.read_state_hashes()[frame]
        simulation.step()


def test_what_is_returned_are_copies_that_cannot_be_written() -> None:
    simulation = antdsl.open_scene(FORAGING)
    ants, start_hash = simulation["forager"], simulation.state_hash
    for array in (ants.ids, *(ants[name] for name in ants), *(g[n] for g in simulation.items.values() for n in g.names),
                  simulation.fields["trail"].values, simulation.fields["trail"].positions):  # fmt: skip
        with pytest.raises(ValueError, match="read-only"):
            array[...] = array
    held = ants["position"]
    simulation.step()
    assert (held != ants["position"]).any() and start_hash != simulation.state_hash


def test_an_attribute_that_is_set_is_what_agents_have_and_act_on() -> None:
    simulation = antdsl.open_scene(FORAGING, seed=1)
    ants = simulation["forager"]
    slow = np.where(np.arange(len(ants)) % 2 == 0, 1.0, 60.0)
    ants["max_speed"] = slow
    simulation.step(24)
    assert (ants["max_speed"] == slow.astype(np.float32)).all()
    speed = np.linalg.norm(ants["velocity"], axis=1)
    assert speed[slow == 1].max() < 1.01 and speed[slow == 60].mean() > 3
    ants["load"] = 2
    assert ants["load"].tolist() == [2.0] * len(ants)


def test_setting_changes_no_random_draw_of_others() -> None:
    one, other = (antdsl.open_scene(MINIMAL, seed=7) for _ in range(2))
    size = other["walker"]["size"].copy()
    size[0] *= 1
    other["walker"]["size"] = size
    assert one.step(5).state_hash == other.step(5).state_hash


def test_what_a_crowd_has_can_be_set_again_and_nothing_internal_is_listed() -> None:
    one, other = (antdsl.open_scene(MINIMAL, seed=np.int64(7), frames=(np.int32(1), np.int32(4))) for _ in range(2))
    walkers = other["walker"]
    for name in walkers.attributes:
        walkers[name] = walkers[name]
    assert not any(name.startswith("~") for name in walkers)
    assert one.run().state_hash == other.run().state_hash
    walkers["max_turn"] = np.inf
    assert np.isinf(walkers["max_turn"]).all() and np.isfinite(other.step()["walker"]["position"]).all()


MISTAKES = [
    (lambda s: s["foragers"], "there is no species `foragers`; did you mean `forager`?"),
    (lambda s: s["forager"].__setitem__("size", 0), "`size` cannot be 0; write more than 0"),
    (lambda s: s["forager"].__setitem__("max_speed", -5), "`max_speed` cannot be -5"),
    (lambda s: s.set_param("trail.half_life", 3.0), "`trail.half_life` is a setting of a field; write text with a unit"),
    (lambda s: s["forager"]["lood"], "there is no array of `forager` `lood`; did you mean `load`?"),
    (lambda s: s["forager"].__setitem__("position", 0), "`position` is computed by steps and cannot be set; set one of: size"),
    (lambda s: s["forager"].__setitem__("state", 0), "`state` is computed by steps"),
    (lambda s: s["forager"].__setitem__("lood", 0), "did you mean `load`?"),
    (lambda s: s["forager"].__setitem__("load", [1, 2]), "`load` needs numbers of the shape (500,)"),
    (lambda s: s["forager"].__setitem__("load", "much"), "`load` needs numbers"),
    (lambda s: s["forager"].__setitem__("load", float("nan")), "`load` needs finite numbers, without nan and inf"),
    (lambda s: s["forager"].__setitem__("load", 1e300), "`load` needs finite numbers, without nan and inf"),
    (lambda s: s.items["food"]["lood"], "there is no array of the items `food` `lood`; did you mean `load`?"),
    (lambda s: s.set_param("forager.smel", 1), "there is no param `forager.smel`; did you mean `forager.smell`?"),
    (lambda s: s.set_param("forager.smell", "3 s"), "is a length, not a time"),
    (lambda s: s.set_param("forager.smell", 1e9), "out-of-range"),
    (lambda s: s.stop_observing(print), "not an observer"),
    (lambda s: s.step(-1), "-1 frames cannot be simulated"),
]


@pytest.fixture(scope="module")
def foraging() -> antdsl.Simulation:
    return antdsl.open_scene(FORAGING)


@pytest.mark.parametrize(("use", "message"), MISTAKES, ids=[message[:40] for _, message in MISTAKES])
def test_mistakes_say_what_to_write(foraging: antdsl.Simulation, use: object, message: str) -> None:
    start_hash = foraging.state_hash
    with pytest.raises(antdsl.AntdslError) as error:
        use(foraging)  # type: ignore[operator]
    assert message in str(error.value) and foraging.state_hash == start_hash


@pytest.mark.parametrize(
    ("arguments", "code"),
    [
        ({"path": "no.yaml"}, "no-such-file"),
        ({"set": {"forager.smell": "3 s"}}, "wrong-unit"),
        ({"set": {"forager.smel": "3 mm"}}, "unknown-thing"),
        ({"frames": (5, 2)}, ""),
        ({"seed": -1}, ""),
        ({"seed": "a"}, ""),
    ],
)
def test_a_scene_with_mistakes_raises_with_its_report(arguments: dict[str, object], code: str) -> None:
    with pytest.raises(antdsl.AntdslError) as error:
        antdsl.open_scene(**{"path": FORAGING, **arguments})  # type: ignore[arg-type]
    assert [finding.code for finding in error.value.report.errors] == ([code] if code else [])


def test_params_are_read_and_set_with_units() -> None:
    simulation = antdsl.open_scene(FORAGING, set={"forager.smell": "3 cm", "forager.reward": 12})
    assert simulation.params["forager.smell"] == 30 and simulation.params["forager.reward"] == 12
    simulation.set_param("forager.smell", 25.0)
    simulation.set_param("forager.swing", "60 deg")
    assert simulation.params["forager.smell"] == 25 and simulation.params["forager.swing"] == pytest.approx(np.pi / 3)


def test_observers_are_called_after_each_step_until_they_are_removed() -> None:
    simulation, frames = antdsl.open_scene(MINIMAL, frames=(1, 12)), list[int]()

    @simulation.observe
    def record(world: antdsl.Simulation) -> None:
        frames.append(world.frame)

    simulation.run(until=lambda world: world.frame >= 5)
    simulation.stop_observing(record)
    simulation.run()
    assert frames == [2, 3, 4, 5] and simulation.frame == simulation.last_frame == 12


def test_tables_have_a_row_for_each_agent_and_item() -> None:
    simulation = antdsl.open_scene(FORAGING).step()
    table = simulation["forager"].to_pandas()
    assert isinstance(table, pandas.DataFrame) and table.index.tolist() == simulation["forager"].ids.tolist()
    assert {"position.x", "velocity.z", "state", "load", "age"} <= set(table.columns) and table["state"].iloc[0] == "search"
    assert simulation.items["food"].to_pandas().loc["apple" if "apple" in simulation.items["food"].members
                                                    else simulation.items["food"].members[0], "load"] > 0  # fmt: skip


def test_several_species_and_machines(tmp_path: Path) -> None:
    simulation = antdsl.open_scene(ARENA, frames=(1, 3)).run()
    assert list(simulation) == ["hunter", "rabbit"] and "rabbit" in simulation and "fox" not in simulation
    roaches = antdsl.open_scene(ROOT / "examples" / "roaches" / "scene.yaml")
    name = next(iter(roaches))
    states = [column for column in roaches[name] if column.rpartition(".")[2] == "state"]
    assert len(states) == len(roaches.world.populations[name].plan.machines)
    assert all(roaches[name][column].dtype.kind == "U" for column in states)


KINDS = """ant 2
use steering
world { items food { load = 1 } }
species a {
  size 4 mm
  keen = true
  here = position
  meal = none of food
  mate = none of a
  start s
  state s {
    steer wander()
    meal = nearest(food); mate = nearest(neighbours(200 mm)); here = position
    when keen and time_in_state > 0.03 s and distance(here) + distance(meal) + distance(mate) > 1 mm -> t
  }
  state t { when not keen -> s }
}
"""


def test_attributes_of_every_type_are_read_also_far_from_zero(tmp_path: Path) -> None:
    (tmp_path / "a.ant").write_text(KINDS, encoding="utf-8")
    (tmp_path / "scene.yaml").write_text(
        "antdsl: 1\nframes: 1..9\nworld:\n  food: {one: {at: [1000000, 0, 0]}, two: {at: [1000020, 0, 10]}}\n"
        "crowd: [{species: a, from: a.ant, count: 3, place: {around: [1000000, 0, 0], radius: 20 mm}}]\n",
        encoding="utf-8",
    )
    simulation = antdsl.open_scene(tmp_path / "scene.yaml").step(2)
    agents = simulation["a"]
    assert set(agents["meal"]) <= {"one", "two"} and (agents["mate"] != agents.ids).all() and set(agents["mate"]) <= {0, 1, 2}
    assert np.abs(agents["here"] + simulation.origin - agents["position"]).max() < 5 and max(simulation.origin) > 9e5
    assert agents["keen"].tolist() == [True] * 3 and set(agents["state"]) == {"t"}
    agents["keen"] = [True, False, True]
    assert simulation.step()["a"]["state"].tolist() == ["t", "s", "t"]
    for name in ("meal", "mate"):
        with pytest.raises(antdsl.AntdslError, match="cannot be set"):
            agents[name] = 0


def test_empty_crowds_have_empty_arrays(tmp_path: Path) -> None:
    shutil.copytree(MINIMAL.parent, tmp_path / "minimal")
    scene = tmp_path / "minimal" / "scene.yaml"
    scene.write_text(scene.read_text(encoding="utf-8").replace("count: 50", "count: 0"), encoding="utf-8")
    simulation = antdsl.open_scene(scene).step(2)
    walkers = simulation["walker"]
    walkers["size"] = 3.0
    assert len(walkers) == 0 and all(len(walkers[name]) == 0 for name in walkers) and walkers.to_pandas().empty
    assert "0 agents" in repr(walkers) and "<table>" in walkers._repr_html_()


def test_names_are_short_and_listed() -> None:
    simulation = antdsl.open_scene(MINIMAL)
    assert repr(simulation) == "<simulation of 'scene.yaml', frame 1 of 240: 50 walker>"
    assert set(antdsl.__all__) <= set(dir(antdsl)) and "pipeline" not in dir(antdsl)
    assert isinstance(simulation["walker"], Crowd) and simulation._ipython_key_completions_() == ["walker"]
    assert "<script" not in simulation["walker"]._repr_html_() and "45 more" in simulation["walker"]._repr_html_()


def test_a_failed_step_is_not_continued() -> None:
    simulation = antdsl.open_scene(MINIMAL)

    @simulation.observe
    def stop(world: antdsl.Simulation) -> None:
        raise KeyError("mine")

    with pytest.raises(KeyError, match="mine"):
        simulation.step()
    simulation.stop_observing(stop)
    assert simulation.step().frame == 3  # an error of an observer is no error of the step


def test_a_sweep_gives_a_row_for_each_run_also_from_a_plain_script(tmp_path: Path) -> None:
    script = tmp_path / "study.py"
    script.write_text(
        "import antdsl\n"
        f"result = antdsl.sweep({str(FORAGING)!r}, seeds=[3, 8], frames=(1, 3),\n"
        "                      vary={'forager.smell': ['20 mm', '40 mm']})\n"
        "table = result.to_pandas()\n"
        "print(table[['forager.smell', 'seed', 'agents']].to_csv(index=False))\n",
        encoding="utf-8",
    )
    result = subprocess.run([sys.executable, script], capture_output=True, text=True, timeout=300, env=child_environment())
    assert result.stdout.split() == [
        "forager.smell,seed,agents", "20", "mm,3,500", "40", "mm,3,500", "20", "mm,8,500", "40", "mm,8,500"
    ], result.stderr  # fmt: skip


def test_a_sweep_checks_everything_before_it_runs() -> None:
    with pytest.raises(antdsl.AntdslError) as error:
        antdsl.sweep(FORAGING, vary={"forager.smel": ["20 mm"]})
    assert [finding.code for finding in error.value.report.errors] == ["unknown-thing"]
    for wrong, message in (
        ({"frames": (5, 2)}, "not a range"), ({"frames": 5}, "not a range"), ({"seeds": [-1]}, "not a seed"),
        ({"seeds": "12"}, "not a seed"), ({"processes": -1}, "processes"),
        ({"until": "total(food.lood) == 0"}, "`--until`"),
        ({"vary": {"forager.smell": "20 mm"}}, "list of values; write \\['20 mm'\\]"),
    ):  # fmt: skip
        with pytest.raises(antdsl.AntdslError, match=message):
            antdsl.sweep(FORAGING, **wrong)  # type: ignore[arg-type]
    for empty in ({"seeds": []}, {"seeds": 0}, {"vary": {"forager.smell": []}}):
        with pytest.raises(antdsl.AntdslError, match="this sweep has no runs"):
            antdsl.sweep(FORAGING, **empty)  # type: ignore[arg-type]
