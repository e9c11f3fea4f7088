"""Runs one target: forks a worker for each batch of inputs, restarts it after a crash, and saves what it finds.

A worker mutates inputs of the pool and adds those that reach new call sites or give a report of a new form. The parent reads
messages from a pipe, watches the CPU time of the worker, and attributes an abort or an endless loop to the input that ran."""

from __future__ import annotations

import faulthandler
import json
import mmap
import os
import random
import re
import resource
import select
import shutil
import signal
import sys
import tempfile
import traceback
from base64 import b64decode, b64encode
from collections import deque
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field
from hashlib import blake2b
from pathlib import Path
from time import monotonic, process_time
from typing import TYPE_CHECKING, Any

from fuzz.mutation import mutate
from fuzz.oracle import CPU_SECONDS, Finding, Oracle, Outcome, Paths, machine_scale

from antdsl.limits import GIB

if TYPE_CHECKING:
    from fuzz.targets import Target

BATCH_SECONDS = 60.0  # CPU seconds of one worker
HANG_SECONDS = 30.0  # CPU seconds of one input after which its worker is killed
IDLE = 3  # workers in a row that end before their first input, after which a run ends
STALL_SECONDS = 300.0  # seconds without any CPU time or message: a worker that waits for something
ADDRESS_BYTES = 3 * GIB  # above the address space at the start
POOL = 4000  # inputs
REPEAT = 8  # one input in so many is fed twice and must give the same report
TRACED = 0.2  # share of inputs with recorded call sites, which takes three times as long
_SKELETON = re.compile(r"`[^`]*`|'[^']*'|\"[^\"]*\"|[0-9]+(?:\.[0-9]+)?")


@dataclass
class Result:
    """What a run of one target amounts to."""

    target: str
    executions: int = 0
    cpu_seconds: float = 0.0
    call_sites: int = 0
    report_forms: int = 0
    pool: int = 0
    crashes: int = 0
    hangs: int = 0
    slowest_ms: float = 0.0
    slowest_input: str = ""
    peak_memory_mib: float = 0.0
    peak_above_start_mib: float = 0.0
    workers: int = 0
    findings: dict[str, dict[str, Any]] = field(default_factory=dict)  # by signature


@dataclass
class Campaign:
    """One target with its pool. `saves`: the folder for inputs with findings and the slowest one; `corpus`: a folder that keeps
    the pool for the next run."""

    target: Target
    seed: int = 1
    saves: Path | None = None
    corpus: Path | None = None
    say: Callable[[str], None] = lambda text: None
    hang_seconds: float = HANG_SECONDS

    def __post_init__(self) -> None:
        self.result = Result(self.target.name)
        self.pool = list(dict.fromkeys(each[: self.target.cap] for each in self.target.seeds()))
        if self.corpus is not None and self.corpus.is_dir():
            self.pool += [path.read_bytes() for path in sorted(self.corpus.iterdir()) if path.is_file()]
        self.sites: set[int] = set()
        self.forms: set[int] = set()

    def run(self, cpu_minutes: float | None = None, executions: int | None = None) -> Result:
        """Feed inputs until so many CPU minutes of workers, or executions, are spent."""
        batch = idle = 0
        while (cpu_minutes is None or self.result.cpu_seconds < 60 * cpu_minutes) and (
            executions is None or self.result.executions < executions
        ):
            left = None if executions is None else executions - self.result.executions
            seconds = BATCH_SECONDS if cpu_minutes is None else min(BATCH_SECONDS, 60 * cpu_minutes - self.result.cpu_seconds)
            first = self.pool if batch == 0 and executions is None else ()
            idle = 0 if self._batch(batch, seconds, left, first) else idle + 1
            batch += 1
            if idle >= IDLE:
                break
        return self._finish(batch)

    def feed(self, inputs: Sequence[bytes]) -> Result:
        """Feed these inputs and nothing else; after a crash a new worker goes on with the next one."""
        batch = idle = 0
        while self.result.executions < len(inputs) and idle < IDLE:
            left = inputs[self.result.executions :]
            idle = 0 if self._batch(batch, 1e9, len(left), left) else idle + 1
            batch += 1
        return self._finish(batch)

    def _finish(self, batches: int) -> Result:
        self.result.call_sites, self.result.report_forms = len(self.sites), len(self.forms)
        self.result.pool, self.result.workers = len(self.pool), batches
        return self.result

    # --- the parent -------------------------------------------------------------------------------------------------------

    def _batch(self, number: int, seconds: float, executions: int | None, first: Sequence[bytes]) -> bool:
        """One worker, which feeds the inputs `first` before mutated ones; whether it got as far as an input."""
        folder = Path(os.path.realpath(tempfile.mkdtemp(prefix=f"antdsl-fuzz-{self.target.name}-")))
        current = mmap.mmap(-1, self.target.cap + 16)
        reader, writer = os.pipe()
        previous_count = self.result.executions
        sys.stdout.flush()
        child = os.fork()
        if child == 0:
            os.close(reader)
            _Worker(self, folder, current, writer).main(number, seconds, executions, first)
        os.close(writer)
        killed = self._listen(reader, child, current)
        os.close(reader)
        _, status, usage = os.wait4(child, 0)
        self.result.cpu_seconds += usage.ru_utime + usage.ru_stime
        code = os.waitstatus_to_exitcode(status)
        if code != 0:
            data = _read_current(current)
            name = killed or (signal.Signals(-code).name if code < 0 else f"exit {code}")
            kind = "hang" if killed else "abort"
            if data is not None:
                self.result.executions += 1
                self._note(Finding(kind, f"{kind} {name}", f"the worker ended with {name}"), data)
            elif not killed:
                self._note(Finding("abort", f"abort {name} between inputs", f"the worker ended with {name}"), b"")
        shutil.rmtree(folder, ignore_errors=True)
        current.close()
        return self.result.executions > previous_count

    def _listen(self, reader: int, child: int, current: mmap.mmap) -> str:
        """Take messages until the worker ends; why it was killed, or nothing."""
        buffer = b""
        last, last_cpu, input_cpu, input_number = monotonic(), 0.0, 0.0, -1
        while True:
            ready, _, _ = select.select([reader], [], [], 1.0)
            if ready:
                block = os.read(reader, 1 << 20)
                if not block:
                    return ""
                buffer += block
                *lines, buffer = buffer.split(b"\n")
                for line in lines:
                    self._take(json.loads(line))
            cpu, number = _cpu_of(child), int.from_bytes(current[8:16], "little")
            if cpu != last_cpu or ready:
                last, last_cpu = monotonic(), cpu
            if number != input_number:
                input_number, input_cpu = number, cpu
            if cpu - input_cpu > self.hang_seconds or monotonic() - last > STALL_SECONDS:
                os.kill(child, signal.SIGKILL)
                return "too much CPU time" if cpu - input_cpu > self.hang_seconds else "no progress"

    def _take(self, message: dict[str, Any]) -> None:
        result = self.result
        if "executions" in message:
            result.executions += message["executions"]
            result.peak_memory_mib = max(result.peak_memory_mib, message["peak"])
            result.peak_above_start_mib = max(result.peak_above_start_mib, message["above"])
        elif "new" in message:
            self.sites.update(message["sites"])
            self.forms.update(message["forms"])
            data = b64decode(message["new"])
            if len(self.pool) < POOL:
                self.pool.append(data)
            if self.corpus is not None and len(self.pool) < POOL:
                _save(self.corpus, data)
        elif "slow" in message:
            if message["ms"] > result.slowest_ms:
                result.slowest_ms = message["ms"]
                if self.saves is not None:
                    result.slowest_input = _save(self.saves, b64decode(message["slow"]), "slowest").name
        else:
            self._note(Finding(message["kind"], message["signature"], message["detail"]), b64decode(message["input"]))

    def _note(self, finding: Finding, data: bytes) -> None:
        known = self.result.findings.get(finding.signature)
        if finding.kind == "hang":
            self.result.hangs += 1
        else:
            self.result.crashes += 1
        if known is not None:
            known["count"] += 1
            if len(data) >= known["bytes"]:
                return
        count = 1 if known is None else known["count"]
        entry = {"kind": finding.kind, "count": count, "bytes": len(data), "detail": finding.detail, "input": ""}
        if self.saves is not None:
            entry["input"] = _save(self.saves, data, _slug(finding.signature)).name
        self.result.findings[finding.signature] = entry
        if known is None:
            self.say(f"{self.target.name}: {finding.signature} ({entry['input'] or len(data)})")


class _Worker:
    """The child's side: feeds inputs and writes messages. `main` never returns."""

    def __init__(self, campaign: Campaign, folder: Path, current: mmap.mmap, writer: int) -> None:
        self.campaign, self.folder, self.current, self.writer = campaign, folder, current, writer
        self.target = campaign.target
        self.peak = self.above = self.slowest = 0.0
        self.unsent = self.number = 0

    def main(self, batch: int, seconds: float, executions: int | None, first: Sequence[bytes]) -> None:
        code = 70
        faulthandler.disable()
        try:
            use_folder(self.folder)
            with open(os.devnull, "r+b") as null:
                for stream in (0, 1, 2):
                    os.dup2(null.fileno(), stream)
            limit_memory(ADDRESS_BYTES)
            self._run(batch, seconds, executions, first)
            code = 0
        except BaseException:
            self._send({"kind": "engine", "signature": "engine", "detail": traceback.format_exc()[-4000:], "input": ""})
        finally:
            os._exit(code)

    def _run(self, batch: int, seconds: float, executions: int | None, first: Sequence[bytes]) -> None:
        rng = random.Random(f"{self.campaign.seed} {self.target.name} {batch}")
        pool, paths = self.campaign.pool, Paths(self.campaign.sites)
        feed = self.target.open(self.folder)
        with suppress(Exception):
            feed(pool[0])  # what is imported for the first input is no business of that input
        oracle = Oracle(feed, self.folder, self.target.allowed)
        began, count = process_time(), 0
        waiting = deque(first)
        while process_time() - began < seconds and (executions is None or count < executions):
            data = waiting.popleft() if waiting else mutate(rng, self.target.mutators, pool, self.target.cap)
            traced = count < len(first) or rng.random() < TRACED
            self._one(oracle, paths if traced else None, data, again=count % REPEAT == 0)
            count += 1
        self._flush()

    def _one(self, oracle: Oracle, paths: Paths | None, data: bytes, again: bool) -> None:
        self._begin(data)
        outcome = oracle.run(data, paths)
        fresh = paths.stop() if paths is not None else []
        forms = [each for each in skeletons(outcome.report) if each not in self.campaign.forms]
        self.campaign.forms.update(forms)
        if (fresh or forms) and not outcome.findings:
            self.campaign.pool.append(data)
            self._send({"new": _text(data), "sites": fresh, "forms": forms})
        findings = list(outcome.findings)
        if outcome.seconds > CPU_SECONDS:
            outcome, slow = self._timed(oracle, data, outcome)
            findings += slow
        elif again and not findings:
            second = oracle.run(data)
            if second.report != outcome.report:
                words = f"{outcome.report[:1500]}\n--- the second time ---\n{second.report[:1500]}"
                findings.append(Finding("differs", "differs", words))
        for each in findings:
            self._send({"kind": each.kind, "signature": each.signature, "detail": each.detail, "input": _text(data)})
        if outcome.seconds > self.slowest:
            self.slowest = outcome.seconds
            self._send({"slow": _text(data), "ms": round(1000 * outcome.seconds, 1)})
        self.above = max(self.above, outcome.memory)
        self.unsent += 1
        self._end()
        if self.unsent >= 50:
            self._flush()

    def _timed(self, oracle: Oracle, data: bytes, first: Outcome) -> tuple[Outcome, list[Finding]]:
        """A slow input again, without noting call sites: the least of 3 runs counts."""
        scale = machine_scale()
        runs = [oracle.run(data)]
        while len(runs) < 3 and runs[-1].seconds > CPU_SECONDS * scale:
            runs.append(oracle.run(data))
        least = min(runs, key=lambda each: each.seconds)
        if least.seconds <= CPU_SECONDS * scale:
            return least, []
        words = f"{least.seconds:.1f} s of CPU on a machine {scale:.1f} times as slow as the standard one"
        return least, [Finding("hang", f"hang {next(iter(least.report.splitlines()), '')[:60]}", words)]

    def _begin(self, data: bytes) -> None:
        self.number += 1
        self.current[16 : 16 + len(data)] = data
        self.current[8:16] = self.number.to_bytes(8, "little")
        self.current[:8] = (len(data) + 1).to_bytes(8, "little")

    def _end(self) -> None:
        self.current[:8] = bytes(8)

    def _flush(self) -> None:
        peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
        self.peak = max(self.peak, peak)
        self._send({"executions": self.unsent, "peak": round(self.peak, 1), "above": round(self.above / 1048576, 1)})
        self.unsent = 0

    def _send(self, message: dict[str, Any]) -> None:
        data = memoryview(json.dumps(message).encode() + b"\n")
        while data:
            data = data[os.write(self.writer, data) :]


def replay(target: Target, data: bytes) -> Outcome:
    """Feed one input in this process, in a separate folder."""
    place, temporary = os.getcwd(), tempfile.tempdir
    with tempfile.TemporaryDirectory() as name:
        folder = Path(os.path.realpath(name))
        use_folder(folder)
        try:
            return Oracle(target.open(folder), folder, target.allowed).run(data)
        finally:
            os.chdir(place)
            tempfile.tempdir = temporary


def use_folder(folder: Path) -> None:
    """Make a folder the working directory, with the folder for temporary files in it."""
    os.chdir(folder)
    (folder / "temporary").mkdir()
    tempfile.tempdir = str(folder / "temporary")


def skeletons(report: str) -> list[int]:
    """The forms of a report's lines: without numbers and quoted text."""
    lines = (_SKELETON.sub("_", line)[:160] for line in report.splitlines()[:60])
    return [
        int.from_bytes(blake2b(line.encode("utf-8", "replace"), digest_size=6).digest(), "little")
        for line in dict.fromkeys(lines)
    ]


def limit_memory(above: int) -> None:
    """Let this process have so many bytes of address space more than it has."""
    try:
        with open("/proc/self/statm") as file:
            now = int(file.read().split()[0]) * resource.getpagesize()
        resource.setrlimit(resource.RLIMIT_AS, (now + above, resource.RLIM_INFINITY))
    except (OSError, ValueError):
        pass
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def _cpu_of(process: int) -> float:
    """CPU seconds of a process and of its children that have ended."""
    try:
        with open(f"/proc/{process}/stat") as file:
            words = file.read().rpartition(")")[2].split()
        return sum(int(each) for each in words[11:15]) / os.sysconf("SC_CLK_TCK")
    except (OSError, ValueError, IndexError):
        return 0.0


def _read_current(current: mmap.mmap) -> bytes | None:
    size = int.from_bytes(current[:8], "little")
    return current[16 : 15 + size] if size else None


def _text(data: bytes) -> str:
    return b64encode(data).decode()


def _slug(words: str) -> str:
    return re.sub(r"[^A-Za-z0-9.]+", "-", words).strip("-")[:60]


def _save(folder: Path, data: bytes, name: str = "") -> Path:
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / (name or blake2b(data, digest_size=8).hexdigest())
    path.write_bytes(data)
    return path
