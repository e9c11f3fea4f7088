"""Processes that run jobs: each starts afresh, imports everything once and takes one job after the other.

A run that fails, or takes its process with it, is told and the others go on. Which process does what changes no result."""

from __future__ import annotations

import multiprocessing
import signal
import sys
import time
import warnings
from collections.abc import Callable, Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from typing import TYPE_CHECKING, Any

from antdsl.sweep.jobs import Job

if TYPE_CHECKING:
    from antdsl.runtime import Built

_TELL = 0.5  # seconds between words about frames
_PATIENCE = 5.0  # seconds for a process to end by itself


@dataclass(frozen=True, slots=True)
class Outcome:
    """What became of a job: measures, or the words for what went wrong."""

    job: Job
    measures: dict[str, Any] | None
    problem: str = ""


def run_all(
    jobs: Sequence[Job],
    processes: int,
    threads: int,
    told: Callable[[Job, int], None] = lambda job, frame: None,
    noted: Callable[[str], None] = lambda sentence: None,
) -> Iterator[Outcome]:
    """Run jobs on so many processes and give each outcome as it comes. `told` hears now and then how far a run is, `noted` what
    was otherwise than asked, a sentence for each run and cause."""
    waiting = list(reversed(jobs))
    workers: list[_Worker] = []
    try:
        for _ in range(min(processes, len(jobs))):
            workers.append(_Worker(threads))
            workers[-1].take(waiting.pop())
        while any(worker.job is not None for worker in workers):
            ready = wait([worker.pipe for worker in workers if worker.job is not None])
            for worker in list(workers):
                if worker.pipe not in ready or worker.job is None:
                    continue
                outcome = worker.listen(told, noted)
                if outcome is None:
                    continue
                yield outcome
                if not worker.alive:
                    workers.remove(worker)
                    worker.end()
                    if waiting:
                        workers.append(_Worker(threads))
                        workers[-1].take(waiting.pop())
                elif waiting:
                    worker.take(waiting.pop())
    finally:
        for worker in workers:
            worker.end()


class _Worker:
    """A process and the job that it has."""

    def __init__(self, threads: int) -> None:
        context = multiprocessing.get_context("spawn")
        self.pipe, other = context.Pipe()
        self.job: Job | None = None
        self.alive = True
        self.process = context.Process(target=_work, args=(other, threads), daemon=True)
        self.process.start()
        other.close()

    def take(self, job: Job) -> None:
        self.job = job
        with suppress(OSError):  # it is dead; `listen` will find out
            self.pipe.send(job)

    def listen(self, told: Callable[[Job, int], None], noted: Callable[[str], None]) -> Outcome | None:
        """What it has to say: the outcome of its job, or None while that is under way."""
        assert self.job is not None
        try:
            word, value = self.pipe.recv()
        except (EOFError, OSError):
            self.alive = False
            self.process.join(_PATIENCE)
            return self._finish(None, _how_it_ended(self.process.exitcode))
        if word == "frame":
            told(self.job, value)
            return None
        if word == "note":
            noted(value)
            return None
        return self._finish(value, "") if word == "done" else self._finish(None, value)

    def _finish(self, measures: dict[str, Any] | None, problem: str) -> Outcome:
        job, self.job = self.job, None
        assert job is not None
        return Outcome(job, measures, problem)

    def end(self) -> None:
        """Let it go: at once when it is busy."""
        if self.job is not None:
            self.process.terminate()
        self.pipe.close()
        self.process.join(_PATIENCE)
        if self.process.is_alive():
            self.process.kill()
            self.process.join()


def _how_it_ended(code: int | None) -> str:
    if code is not None and code < 0:
        name = signal.Signals(-code).name if -code in {s.value for s in signal.Signals} else str(-code)
        more = ", most likely for want of memory" if name == "SIGKILL" else ""
        return f"its process was ended by {name}{more}"
    return f"its process ended with code {code}"


def _work(pipe: Connection, threads: int) -> None:
    """The life of a process: jobs in, measures out, until nobody is at the other end."""
    from antdsl.numerics.compiled import expect_long_runs
    from antdsl.runtime import Built

    built = Built()
    expect_long_runs()
    if not sys.warnoptions:
        warnings.simplefilter("ignore")  # of libraries, as in the process that the terminal has
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # who asked for the sweep is told by Ctrl-C, and ends us
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    with suppress(EOFError, OSError):
        while True:
            job = pipe.recv()
            said = time.monotonic()

            def told(frame: int) -> None:
                nonlocal said
                if time.monotonic() - said > _TELL:
                    said = time.monotonic()
                    pipe.send(("frame", frame))

            pipe.send(_outcome(job, threads, built, told, lambda sentence: pipe.send(("note", sentence))))
            built.forget()


def _outcome(job: Job, threads: int, built: Built, told: Callable[[int], None], noted: Callable[[str], None]) -> tuple[str, Any]:
    from antdsl.outputs.starting import StartError
    from antdsl.runtime import BindError, FaultStop
    from antdsl.sweep.measuring import Unfit, measure

    try:
        return "done", measure(job, threads, built, told, noted)
    except (BindError, StartError) as why:
        return "failed", "; ".join(problem.message for problem in why.report.errors)
    except (Unfit, FaultStop, OSError) as why:
        return "failed", str(why)
    except MemoryError:
        return "failed", "out of memory"
