"""The bridge of two arms: its meshes are what the script makes, arms have the requested length, ants get across and are
counted."""

from __future__ import annotations

import json
import runpy
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from antdsl.pipeline import RunChoices, open_scene
from antdsl.runtime import World, bind, step

BRIDGE = Path(__file__).resolve().parents[2] / "examples" / "bridge"


@pytest.fixture(scope="module")
def bridge_script() -> dict[str, Any]:
    return runpy.run_path(str(BRIDGE / "make_bridge.py"))


def opened(name: str, **params: str) -> World:
    shot, report = open_scene(BRIDGE / f"{name}.yaml", RunChoices(params={f"ant.{k}": v for k, v in params.items()}))
    assert shot is not None and not report.diagnostics, [(d.code, d.message) for d in report.diagnostics]
    fewer = tuple(replace(crowd, count=12) for crowd in shot.setting.crowds)
    return bind(shot.plan, replace(shot.setting, crowds=fewer))


def test_one_arm_is_twice_as_long_and_both_begin_and_end_alike(bridge_script: dict[str, Any]) -> None:
    short, long = np.array(bridge_script["short"]()), np.array(bridge_script["long"](2.0))
    lengths = [np.linalg.norm(np.diff(arm, axis=0), axis=1).sum() for arm in (short, long)]
    assert lengths[1] / lengths[0] == pytest.approx(2, abs=0.003)
    for arm in (short, long):
        assert np.array_equal(arm[0], [0, 0]) and np.array_equal(arm[-1], [200, 0])
        for piece in (arm[1] - arm[0], arm[-1] - arm[-2]):
            assert np.degrees(np.arctan2(abs(piece[1]), piece[0])) == pytest.approx(30, abs=0.2)


def test_the_meshes_are_those_of_the_script(bridge_script: dict[str, Any]) -> None:
    short = bridge_script["short"]()
    bridge = bridge_script["bridge"](short, bridge_script["long"](2.0))
    alike = bridge_script["bridge"](short, tuple((x, -z) for x, z in short))
    for name, (vertices, faces) in (("bridge", bridge), ("mirrored", bridge_script["mirrored"](bridge)), ("equal", alike)):
        stored_mesh = trimesh.load(BRIDGE / f"{name}.ply", process=False)
        assert np.allclose(stored_mesh.vertices, vertices, atol=1e-3) and np.array_equal(stored_mesh.faces, faces)
        across = np.cross(*(vertices[faces[:, k]] - vertices[faces[:, 0]] for k in (1, 2)))
        assert (across[:, 1] > 0).all() and (np.abs(across[:, [0, 2]]) < 1e-9).all()


@pytest.mark.parametrize("name", ["scene", "mirrored", "equal", "no_scent"])
def test_ants_leave_the_nest_and_lay_scent_if_they_are_to(name: str) -> None:
    world = opened(name, leaving="100 %/s")
    for _ in range(80):
        step(world)
    x = world.populations["ant"].position[:, 0] + world.origin[0]
    assert (x > -40).sum() > 3 and (world.fields["trail"].amounts.sum() > 0) == (name != "no_scent")
    assert world.items["gates"].amounts["passed"].sum() == 0, "they count from `since` on only"


@pytest.mark.slow
def test_ants_come_across_and_each_is_counted_once_at_a_gate() -> None:
    world = opened("scene", since="0 s", leaving="100 %/s")
    ants = world.populations["ant"]
    at = [world.items["gates"].position[world.items["gates"].names.index(name)] for name in ("short", "long")]
    near, passed = np.zeros((2, len(ants)), bool), np.zeros(2)
    for _ in range(440):
        step(world)
        place = ants.position[ants.get_rows_by_id()]
        now = np.stack([np.linalg.norm(place - gate, axis=1) <= 9.0 + 2.0 for gate in at])
        passed += (now & ~near).sum(axis=1)
        near = now
    counted = dict(zip(world.items["gates"].names, world.items["gates"].amounts["passed"].tolist(), strict=True))
    assert sum(counted.values()) > 10 and world.transitions["ant.out->eat"] >= 3
    assert abs(counted["short"] - passed[0]) <= 2 and abs(counted["long"] - passed[1]) <= 2  # one at a gate, not yet counted


def test_the_study_reads_what_a_sweep_writes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    gates = [(30.0, 10.0), (5.0, 5.0), (0.0, 0.0)]
    runs = [
        {"label": "scene", "seed": k, "measures": {"left.gates.short.passed": a, "left.gates.long.passed": b}}
        for k, (a, b) in enumerate(gates)
    ]
    (tmp_path / "sweep.json").write_text(json.dumps({"runs": runs}))
    study = runpy.run_path(str(BRIDGE / "study.py"))
    assert study["shares"](tmp_path / "sweep.json") == {"scene": {0: 0.75, 1: 0.5}}
    assert study["main"](tmp_path / "sweep.json") == 0 and "1 of 2" in capsys.readouterr().out
