"""Each fuzz target for a few inputs, all inputs that once found something, and whether the engine sees what it looks for."""

from __future__ import annotations

import os
import random
import socket
from pathlib import Path

import pytest
from fuzz import run
from fuzz.engine import Campaign, Result
from fuzz.mutation import BINARY, TEXT, mutate
from fuzz.oracle import Feed, Violation
from fuzz.targets import TARGETS, Target

FEW = {"obj": 120, "ply": 120, "stl": 120, "gltf": 60, "body": 20, "websocket": 40}
ORDER = sorted(TARGETS, key=lambda name: name != "cache")  # its seeds import what other targets need too


def causes(result: Result) -> str:
    return "\n".join(f"{name}: {each['detail']}" for name, each in result.findings.items())


@pytest.mark.parametrize("name", ORDER)
def test_a_few_inputs_of_each_target_find_nothing(name: str) -> None:
    count = FEW.get(name, 4)
    result = Campaign(TARGETS[name], seed=5).run(executions=count)
    assert result.executions == count and result.report_forms > 1
    assert not result.findings, causes(result)


@pytest.mark.slow
@pytest.mark.parametrize("name", TARGETS)
def test_many_inputs_of_each_target_find_nothing(name: str) -> None:
    result = Campaign(TARGETS[name], seed=6).run(cpu_minutes=2)
    assert not result.findings, causes(result)


@pytest.mark.parametrize("name", [name for name, target in TARGETS.items() if target.regressions()])
def test_inputs_that_once_found_something_find_nothing(name: str) -> None:
    inputs = list(TARGETS[name].regressions().values())
    result = Campaign(TARGETS[name]).feed(inputs)
    assert result.executions == len(inputs)
    assert not result.findings, causes(result)


def test_the_inputs_in_the_repository_are_few() -> None:
    assert sum(len(data) for target in TARGETS.values() for data in target.regressions().values()) < 300_000


# --- whether the engine sees what it looks for


def bad(folder: Path) -> Feed:
    """A reader with every kind of mistake, chosen by the input."""
    count = 0

    def feed(data: bytes) -> str:
        nonlocal count
        count += 1
        if data == b"exception":
            raise KeyError(data)
        if data == b"abort":
            os.abort()
        if data == b"hang":
            while True:
                count += 1
        if data == b"memory":
            return str(len(bytearray(os.urandom(1) * (300 << 20))))
        if data == b"open":
            Path("/etc/hostname-of-others").open("rb")  # noqa: SIM115
        if data == b"write":
            Path(folder / "../beside").open("w")  # noqa: SIM115
        if data == b"connect":
            socket.socket().connect_ex(("127.0.0.1", 1))
        if data == b"start":
            os.system("true")
        if data == b"layout":
            raise Violation("layout", "a second layout differs")
        return f"report {data.decode()}" + (f" {count}" if data == b"differs" else "")

    return feed


KINDS = {
    b"exception": "exception", b"abort": "abort", b"hang": "hang", b"memory": "memory", b"open": "outside", b"write": "outside",
    b"connect": "outside", b"start": "outside", b"layout": "layout", b"differs": "differs",
}  # fmt: skip


@pytest.mark.parametrize("data", KINDS)
def test_each_kind_of_mistake_is_found_and_its_input_saved(data: bytes, tmp_path: Path) -> None:
    target = Target("bad", lambda: [b"good"], TEXT, bad, cap=100)
    result = Campaign(target, saves=tmp_path, hang_seconds=0.3 if data == b"hang" else 60.0).feed([data, b"good"])
    inputs_by_kind = {each["kind"]: each["input"] for each in result.findings.values()}
    assert KINDS[data] in inputs_by_kind
    assert result.executions == 2
    assert (tmp_path / inputs_by_kind[KINDS[data]]).read_bytes() == data


def test_good_inputs_find_nothing() -> None:
    target = Target("bad", lambda: [b"good"], TEXT, bad, cap=100)
    result = Campaign(target).feed([b"good", b"better"])
    assert not result.findings and result.report_forms == 2 and result.workers == 1


def test_the_same_seed_gives_the_same_inputs() -> None:
    pool = TARGETS["ply"].seeds()
    drawn = [[mutate(random.Random(seed), (*TEXT, *BINARY), pool, 4000) for seed in range(300)] for _ in range(2)]
    assert drawn[0] == drawn[1] and len(set(drawn[0])) > 250
    assert max(map(len, drawn[0])) <= 4000


def test_the_script_prints_a_table_and_replays(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert run.main(["obj", "--executions", "20", "--saves", str(tmp_path)]) == 0
    assert (tmp_path / "obj.json").is_file()
    file = tmp_path / "a.obj"
    file.write_bytes(b"v 0 0 0\n")
    assert run.main(["obj", "--replay", str(file)]) == 0
    printed = capsys.readouterr().out
    assert "executions" in printed and "refused has no faces" in printed
