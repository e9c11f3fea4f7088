"""The foraging study: each run differs from the default in what the thesis names only, and its model does what it claims."""

from __future__ import annotations

import json
import math
import runpy
from pathlib import Path

import numpy as np
import pytest

from antdsl.pipeline import RunChoices, Shot, open_scene
from antdsl.program.types.folding import find_constant
from antdsl.runtime import bind, step

STUDY = Path(__file__).resolve().parents[2] / "examples" / "foraging_study"
RUNS = ("default", "reward_0", "no_decay", "reward_50", "ants_100", "fields", "separation_first", "nearest_source")


def opened(name: str) -> Shot:
    shot, report = open_scene(STUDY / f"{name}.yaml", RunChoices(seed=3))
    assert shot is not None and not report.diagnostics, [(d.code, d.message) for d in report.diagnostics]
    return shot


@pytest.fixture(scope="module")
def shots() -> dict[str, Shot]:
    return {name: opened(name) for name in RUNS}


def test_a_run_differs_from_the_default_in_what_the_thesis_names_only(shots: dict[str, Shot]) -> None:
    base = shots["default"]
    params = {
        "reward_0": {"forager.reward": 0.0}, "reward_50": {"forager.reward": 50.0}, "fields": {"forager.fields": 1.0},
        "nearest_source": {"forager.pooled": 1.0},
    }  # fmt: skip
    for name, shot in shots.items():
        model = shot.scene.model
        assert dict(shot.setting.params) == params.get(name, {}), name
        assert [line.count for line in model.crowd] == [100 if name == "ants_100" else 500], name
        assert list(model.layers) == (["forager"] if name == "separation_first" else []), name
        same = {"world", "units", "fps", "seed", "preroll", "substeps", "fields", "up", "start"}
        assert [key for key in same if getattr(model, key) != getattr(base.scene.model, key)] == [], name
        assert model.frames == (1, 5000)
        trail = shot.program.fields["trail"]
        if name == "no_decay":
            assert trail.half_life is None and trail.evaporate is not None
            assert find_constant(trail.evaporate).number == 0  # type: ignore[union-attr]
        else:
            assert trail.half_life is not None


def test_ninety_percent_are_left_after_two_seconds_and_all_of_it_without_decay(shots: dict[str, Shot]) -> None:
    remaining_shares = {}
    for name in ("default", "no_decay"):
        world = bind(shots[name].plan, shots[name].setting)
        factor, _ = world.field_rates["trail"]
        remaining_shares[name] = float(factor) ** 48
    assert remaining_shares["default"] == pytest.approx(0.9, abs=0.002) and remaining_shares["no_decay"] == 1


def test_food_is_found_carried_and_marked_and_no_crumb_is_lost(shots: dict[str, Shot]) -> None:
    world = bind(shots["default"].plan, shots["default"].setting)
    food, nest = world.items["food"].amounts["load"], world.items["nest"].amounts["load"]
    ants = world.populations["forager"]
    for _ in range(300):
        step(world)
        assert food.sum() + nest.sum() + ants.now["load"].astype(np.float64).sum() == 1000
    assert food[0] < 500 and nest.sum() > 0
    # the greatest value of rule `max` at the food: (plain + reward) of one step
    assert 0.9 * 25 / 24 < float(world.fields["trail"].amounts.max()) <= 25 / 24 * 1.0001


def test_the_scent_may_fall_off_from_the_nearest_source_whichever_the_crumb_came_from(shots: dict[str, Shot]) -> None:
    laid = {}
    for name in ("default", "nearest_source"):
        world = bind(shots[name].plan, shots[name].setting)
        ants, food = world.populations["forager"], world.items["food"].position
        # All have a crumb of the donut and stand about home, which is nearer to the apple.
        ants.now["load"][:], ants.now["source"][:] = 1, 1
        ants.now["main.state"][:] = next(m.states for m in ants.plan.machines).index("seek_home")
        far = np.linalg.norm(food[:, None] - ants.position, axis=2)
        assert (far[0] < far[1]).all()
        step(world)
        laid[name] = float(world.fields["trail"].amounts.max()), 25 / 24 * 30 / (far[1] if name == "default" else far[0]).min()
    assert all(amount == pytest.approx(expected, rel=0.02) for amount, expected in laid.values()), laid
    assert laid["nearest_source"][0] > 1.5 * laid["default"][0]


def test_the_table_beside_the_thesis(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    compare = runpy.run_path(str(STUDY / "compare.py"))
    published = {name: (apple or 900, donut or 2000) for name, (apple, donut) in compare["PUBLISHED"].items()}
    seeds, apple, donut = (1, 2), compare["APPLE"], compare["DONUT"]

    def write(values: dict[str, tuple[float, float]]) -> Path:
        known = {name: [None if math.isinf(v) else v for v in pair] for name, pair in values.items()}
        table = [
            {"label": name, "measure": m, "median": v}
            for name, pair in known.items()
            for m, v in zip((apple, donut), pair, strict=True)
        ]
        runs = [{"label": n, "seed": s, "measures": {apple: p[0], donut: p[1]}} for n, p in known.items() for s in seeds]
        (tmp_path / "sweep.json").write_text(json.dumps({"table": table, "runs": runs}))
        return tmp_path / "sweep.json"

    assert compare["main"](write(published)) == 0
    output = capsys.readouterr().out
    assert "nearest_source" in output
    assert "0.788" in output and "1.175" in output and "1.330" in output and "2 of 2" in output and "FAILS" not in output
    assert compare["main"](write({**published, "reward_50": (900, 3000), "no_decay": (900, 4999)})) == 1
    output = capsys.readouterr().out
    assert output.count("FAILS") == 2 and "FAILS  donut: default < reward 50" in output
