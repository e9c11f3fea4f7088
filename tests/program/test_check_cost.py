"""`antdsl check --cost`: what each state asks for, and the memory of an agent, without running anything."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

import pytest
from children import child_environment

from antdsl import passes, plan
from antdsl.pipeline import compile_files
from antdsl.plan.registers import count_bytes_by_purpose
from antdsl.program.cost import ASSUMED_SET_MEMBERS, StateCost, estimate_costs

ROOT = Path(__file__).resolve().parents[2]
HEAD = "ant 1\nuse steering\nworld { surface ground; obstacle stones; items food { load = 0 } }\n"
FIELD = "field trail on ground { cell 4 mm; half_life 8 s }\n"


def find_costs(tmp_path: Path, text: str) -> dict[str, StateCost]:
    path = tmp_path / "a.ant"
    path.write_text(HEAD + text)
    program, report = compile_files([path])
    assert program is not None and report.ok, [d.message for d in report.diagnostics]
    return {part.name: part for part in estimate_costs(program, program.species["walker"])}


@pytest.mark.parametrize(
    ("push", "words"),
    [
        ("heading", []),
        ("separate(radius: 3 * size)", ["walker within 3 * size"]),
        ("avoid(stones, feelers: 5)", ["5 rays on stones"]),
        ("seek(nearest(food, within: 20 mm))", ["all food within 20 mm"]),
        ("seek(nearest(food)) + seek(nearest(food)) * 0.5", ["all food"]),  # the same sense is computed once
        ("heading * uniform(0, 1) * uniform(0, 1)", ["uniform"]),
    ],
)
def test_what_a_state_asks_for(tmp_path: Path, push: str, words: list[str]) -> None:
    part = find_costs(tmp_path, f"species walker {{ state stroll {{ steer {push} }} }}\n")["stroll"]
    assert [use.description for use in part.cost_entries] == words
    assert part.weight == part.operation_count + sum(use.weight for use in part.cost_entries)


def test_fields_are_smelled_and_laid(tmp_path: Path) -> None:
    text = "species walker { state s { steer climb(trail, nearest: 9); deposit trail 1 /s; when trail > 3 -> s } }\n"
    words = {use.description for use in find_costs(tmp_path, FIELD + text)["s"].cost_entries}
    assert words == {"9 cells of trail", "lays trail", "trail"}


def test_more_rays_and_sums_inside_sets_weigh_more(tmp_path: Path) -> None:
    def weight(push: str) -> float:
        return find_costs(tmp_path, f"species walker {{ state s {{ steer {push} }} }}\n")["s"].weight

    assert weight("avoid(stones, feelers: 7)") > weight("avoid(stones, feelers: 3)") > weight("heading * 0.5")
    one = weight("heading * count(n in neighbours(20 mm): n.speed > 3 mm/s)")
    assert weight("heading * count(n in neighbours(20 mm): n.speed * 2 > 3 mm/s)") == one + ASSUMED_SET_MEMBERS


def test_what_is_done_in_every_state_stands_last(tmp_path: Path) -> None:
    parts = find_costs(tmp_path, "species walker { state s { steer heading }; layers { avoid(stones); state } }\n")
    assert list(parts) == ["s", "every state"]
    assert [use.description for use in parts["every state"].cost_entries] == ["3 rays on stones"]


def test_memory_counts_what_the_plan_keeps(tmp_path: Path) -> None:
    def bytes_of(members: str) -> dict[str, int]:
        path = tmp_path / "a.ant"
        path.write_text(f"ant 1\nspecies walker {{ {members}; state s {{ steer heading; when after 1 s -> s }} }}\n")
        program, _ = compile_files([path])
        assert program is not None
        return count_bytes_by_purpose(passes.optimise_plan(plan.lower(program)[0]).species["walker"])

    none = bytes_of("size 4 mm")
    one = bytes_of("hunger = 0")
    assert one["attribute"] == none["attribute"] + 4 and one["memory"] == none["memory"] > 0


def test_the_command_prints_it_and_loads_no_geometry(tmp_path: Path) -> None:
    check = (
        "import sys; from antdsl.cli import _run_without_warnings as run;"
        "sys.argv = ['antdsl', 'check', 'examples/foraging/forager.ant', '--cost'];"
        "code = run(); print(code, [m for m in ('open3d', 'scipy', 'llvmlite') if m in sys.modules])"
    )
    env = child_environment()
    process = subprocess.run([sys.executable, "-c", check], cwd=ROOT, env=env, capture_output=True, text=True, timeout=60)
    lines = process.stdout.splitlines()
    assert lines[-1] == "0 []", process.stderr
    assert re.match(
        r"examples/foraging/forager.ant: forager, \d+ bytes per agent \(\d+ attributes, \d+ memory\), \d+ more", lines[0]
    )
    names = ["state", "search", "turn_home", "approach", "carry", "set_out", "follow_trail", "every"]
    assert [line.split()[0] for line in lines[1:9]] == names
    assert "3 rays on stones" in lines[8] and "16 cells of trail" in lines[2]


def test_a_program_with_errors_has_no_cost(tmp_path: Path) -> None:
    (tmp_path / "a.ant").write_text("ant 1\nspecies a { state s { steer headin } }\n")
    command = [sys.executable, "-m", "antdsl", "check", "a.ant", "--cost"]
    env = child_environment()
    process = subprocess.run(command, cwd=tmp_path, env=env, capture_output=True, text=True, timeout=60)
    assert process.returncode == 1 and "no program without errors" in process.stdout
