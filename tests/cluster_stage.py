"""A Dask cluster for tests: a scheduler and workers, processes of this machine that speak mutual TLS on loopback."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]


def certificates(folder: Path) -> Path:
    """A folder with an authority that signs itself, as Dask makes them."""
    from distributed import Security

    config = Security.temporary().get_tls_config_for_role("client")
    folder.mkdir()
    for name, key in (("ca.pem", "ca_file"), ("cert.pem", "cert"), ("key.pem", "key")):
        (folder / name).write_text(str(config[key]))
    return folder


def _python_path() -> str:
    """The checkout's package first, then what the tests were given."""
    return os.pathsep.join(filter(None, (str(ROOT), os.environ.get("PYTHONPATH"))))


def _environment(variables: Mapping[str, str]) -> dict[str, str]:
    routes = {f"DASK_DISTRIBUTED__{who}__HTTP__ROUTES": "[]" for who in ("SCHEDULER", "WORKER", "NANNY")}
    return {**os.environ, "PYTHONPATH": _python_path(), **routes, **variables}


@dataclass
class Stage:
    """`address` of the scheduler, `tls`: the folder of certificates; `processes` that are ended at the end."""

    folder: Path
    tls: Path
    address: str = ""
    processes: list[subprocess.Popen[bytes]] = field(default_factory=list)

    def flags(self) -> list[str]:
        """What a command says to use it."""
        return ["--scheduler", self.address, "--tls", str(self.tls)]

    def scheduler(self) -> None:
        file = self.folder / "scheduler.json"
        words = ["--scheduler-file", str(file), "--port", "0", "--no-dashboard", "--no-show"]
        self._start("dask_scheduler", *words, "--protocol", "tls")
        until = time.monotonic() + 60
        while not file.is_file() or not file.read_text().endswith("}"):
            assert time.monotonic() < until and self.processes[-1].poll() is None, (self.folder / "log").read_text()
            time.sleep(0.1)
        self.address = json.loads(file.read_text())["address"]

    def worker(self, *words: str, blocks: int = 0, **environment: str) -> subprocess.Popen[bytes]:
        """One process with one thread, without anybody who would start it again. `blocks`: of 1024 bytes, the longest file that
        it can write; 0 for any."""
        plain = ["--nthreads", "1", "--no-nanny", "--no-dashboard", "--memory-limit", "0"]
        where = ["--local-directory", str(self.folder / f"worker{len(self.processes)}")]
        return self._start("dask_worker", self.address, *plain, *(words or where), blocks=blocks, **environment)

    def wait_for(self, count: int) -> None:
        """Wait until so many workers have come."""
        from distributed import Client

        from antdsl.executors.cluster import load_security

        with Client(self.address, security=load_security(self.tls), set_as_default=False) as client:
            client.wait_for_workers(count, timeout=60)

    def _start(self, module: str, *words: str, blocks: int = 0, **environment: str) -> subprocess.Popen[bytes]:
        names = (("ca-file", "ca.pem"), ("cert", "cert.pem"), ("key", "key.pem"))
        tls = [part for flag, name in names for part in (f"--tls-{flag}", str(self.tls / name))]
        command = [sys.executable, "-m", f"distributed.cli.{module}", *words, *tls, "--host", "127.0.0.1"]
        if blocks:
            command = ["bash", "-c", f'ulimit -f {blocks}; exec "$@"', "bash", *command]
        with open(self.folder / "log", "ab") as log:
            self.processes.append(
                subprocess.Popen(command, stdout=log, stderr=log, env=_environment(environment), cwd=self.folder)
            )
        return self.processes[-1]


@contextmanager
def staged(folder: Path) -> Iterator[Stage]:
    """A scheduler that runs and has no workers yet."""
    stage = Stage(folder, certificates(folder / "tls"))
    try:
        stage.scheduler()
        yield stage
    finally:
        for process in reversed(stage.processes):
            process.kill()
            process.wait()


def antdsl(*words: str, cwd: Path, **environment: str) -> subprocess.Popen[str]:
    """A command of antdsl in a separate process."""
    command = [sys.executable, "-m", "antdsl", *words]
    env = {**os.environ, "PYTHONPATH": _python_path(), **environment}
    return subprocess.Popen(command, cwd=cwd, env=env, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
