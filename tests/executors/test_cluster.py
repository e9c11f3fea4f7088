"""A real Dask cluster on this machine: what is lost is done again, nothing is mixed, and a version that does not fit is
reported."""

from __future__ import annotations

import csv
import os
import shutil
import signal
import subprocess
import time
from collections.abc import Iterator, Mapping
from pathlib import Path

import pytest

pytest.importorskip("distributed")
pytest.importorskip("cryptography")

from cluster_stage import ROOT, Stage, antdsl, staged
from commands import run

from antdsl import __version__
from antdsl.executors import Task, WorkerContext, run_tasks
from antdsl.outputs.provenance import hash_sources

RUNS = 40


@pytest.fixture
def project(tmp_path: Path) -> Path:
    assert run("new", "walkers", cwd=tmp_path).returncode == 0
    return tmp_path


@pytest.fixture
def stage(tmp_path: Path) -> Iterator[Stage]:
    (tmp_path / "cluster").mkdir()
    with staged(tmp_path / "cluster") as new_stage:
        yield new_stage


def ended(process: subprocess.Popen[str], seconds: float = 150) -> tuple[int, str, str]:
    out, err = process.communicate(timeout=seconds)
    return process.returncode, out, err


def until_there(folder: Path, count: int) -> None:
    """Wait until the given number of runs is stored."""
    until = time.monotonic() + 300
    while len(list(folder.glob("runs/*.json"))) < count:
        assert time.monotonic() < until
        time.sleep(0.05)


def rows(folder: Path) -> list[dict[str, str]]:
    with open(folder / "runs.csv", encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def lost_and_done_again(project: Path, stage: Stage, count: int, frames: int) -> None:
    """Kill a worker in mid-run, then the client; the same command again has each run once, as one process gives it."""
    words = ["sweep", "walkers/scene.yaml", "--frames", f"1..{frames}", "--seeds", str(count), "--no-plots"]
    first, _ = stage.worker(), stage.worker()
    client = antdsl(*words, "--out", "swept", *stage.flags(), cwd=project)
    until_there(project / "swept", count // 8)
    first.kill()
    stage.worker()
    until_there(project / "swept", count // 2)
    client.send_signal(signal.SIGKILL)
    client.communicate()
    finish_times = {path.name: path.stat().st_mtime_ns for path in (project / "swept" / "runs").glob("*.json")}
    assert count // 2 <= len(finish_times) < count
    code, out, err = ended(antdsl(*words, "--out", "swept", *stage.flags(), cwd=project))
    assert code == 0, err
    assert f"{len(finish_times)} of {count} runs were finished before" in out or len(finish_times) < count
    assert all((project / "swept" / "runs" / name).stat().st_mtime_ns == when for name, when in finish_times.items())
    code, _, err = ended(antdsl(*words, "--out", "alone", "--jobs", "1", cwd=project))
    assert code == 0, err
    swept_rows = rows(project / "swept")
    assert swept_rows == rows(project / "alone") and [row["seed"] for row in swept_rows] == [str(n + 1) for n in range(count)]
    assert (project / "swept" / "table.csv").read_bytes() == (project / "alone" / "table.csv").read_bytes()
    assert all(row["processor"] and row["antdsl"].startswith("0.") for row in swept_rows)


def test_a_cluster_of_this_machine_listens_on_the_loopback_interface_only() -> None:
    """Its scheduler, workers and nannies, and the HTTP servers that Dask starts in them."""
    psutil = pytest.importorskip("psutil")
    from antdsl.executors.cluster import start_local_cluster

    def listening() -> set[tuple[str, int]]:
        processes = [psutil.Process(), *psutil.Process().children(recursive=True)]
        connections = [each for process in processes for each in process.net_connections("inet")]
        return {tuple(each.laddr) for each in connections if each.status == psutil.CONN_LISTEN}

    old_addresses = listening()
    with start_local_cluster(1, 1):
        new_addresses = listening() - old_addresses
    assert len(new_addresses) >= 4 and {address for address, _ in new_addresses} == {"127.0.0.1"}


def lethal(document: Mapping[str, object], worker: WorkerContext) -> dict[str, object]:
    """Takes its worker with it."""
    os._exit(1)


@pytest.mark.slow
def test_a_task_that_kills_each_worker_is_reported_as_failed(monkeypatch: pytest.MonkeyPatch) -> None:
    from antdsl.executors.cluster import connect_cluster, start_local_cluster

    monkeypatch.setenv(
        "PYTHONPATH", os.pathsep.join((str(ROOT), str(Path(__file__).parent), str(ROOT / "tests"), str(ROOT / "tests/cli")))
    )
    with start_local_cluster(2, 1) as (address, security), connect_cluster(address, security, []) as cluster:
        (answered,) = run_tasks([Task("x", lethal, {})], cluster)
    assert answered.answer is None and "was lost" in answered.problem


@pytest.mark.slow
def test_lost_workers_and_a_killed_client_lose_no_run_and_double_none(project: Path, stage: Stage) -> None:
    lost_and_done_again(project, stage, RUNS, 24)


@pytest.mark.slow
def test_a_lost_scheduler_is_reported_and_the_table_goes_on_without_it(project: Path, stage: Stage) -> None:
    words = ["sweep", "walkers/scene.yaml", "--frames", "1..24", "--seeds", "30", "--no-plots", "--out", "swept"]
    stage.worker()
    client = antdsl(*words, *stage.flags(), cwd=project)
    until_there(project / "swept", 3)
    stage.processes[0].kill()
    code, _, err = ended(client)
    assert code == 3 and "the connection to the scheduler was lost" in err and "of 30 runs are finished and stored" in err
    code, out, _ = ended(antdsl(*words, "--jobs", "1", cwd=project))
    assert code == 0 and "of 30 runs were finished before" in out and len(rows(project / "swept")) == 30


@pytest.mark.slow
def test_workers_with_other_sources_or_without_space_are_reported_and_get_no_task(
    project: Path, stage: Stage, tmp_path: Path
) -> None:
    other = tmp_path / "other"
    for part in ("antdsl", "behaviours", "grammar"):
        shutil.copytree(ROOT / part, other / part, ignore=shutil.ignore_patterns("node_modules", "__pycache__", "web"))
    with open(other / "antdsl" / "numerics" / "noise.py", "a", encoding="utf-8") as file:
        file.write("\n# another version\n")
    words = ["sweep", "walkers/scene.yaml", "--frames", "1..4", "--seeds", "4", "--no-plots", *stage.flags()]
    stage.worker(PYTHONPATH=str(other))
    stage.wait_for(1)
    code, _, err = ended(antdsl(*words, "--out", "a", cwd=project))
    assert code == 3 and "with other sources" in err and "install the same version there" in err
    stage.worker(blocks=1)  # no file of more than 512 bytes can be written: what a full disk is like
    stage.worker()
    stage.wait_for(3)
    code, _, err = ended(antdsl(*words, "--out", "b", cwd=project))
    assert code == 0 and "it does not have the files: its disk: file too large" in err, err
    assert len(rows(project / "b")) == 4 and {row["antdsl"] for row in rows(project / "b")} == {
        f"{__version__} {hash_sources()[:8]}"
    }


@pytest.mark.slow
def test_late_workers_get_the_files(project: Path, stage: Stage) -> None:
    words = ["sweep", "walkers/scene.yaml", "--frames", "1..4", "--seeds", "3", "--no-plots", "--out", "a", *stage.flags()]
    client = antdsl(*words, cwd=project)
    assert client.stderr is not None and "no worker has joined" in client.stderr.readline()
    stage.worker()
    assert ended(client)[0] == 0 and len(rows(project / "a")) == 3


@pytest.mark.slow
def test_a_cluster_of_this_machine_gives_the_same_table(project: Path) -> None:
    words = ["sweep", "walkers/scene.yaml", "--frames", "1..2", "--seeds", "2", "--no-plots"]
    for extra_words in (["--out", "a", "--scheduler", "local", "--jobs", "2"], ["--out", "b", "--jobs", "1"]):
        code, _, err = ended(antdsl(*words, *extra_words, cwd=project))
        assert code == 0, err
    assert rows(project / "a") == rows(project / "b")
