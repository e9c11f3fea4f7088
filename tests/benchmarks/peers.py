"""Other programs for crowds beside antdsl, in the same run: million agent-steps a second of one core.

`python tests/benchmarks/peers.py` prints a table of all that are here, `peers.py rvo2 mesa` of some. Each program is a separate
process on one thread that takes its turns with ours: some steps, in CPU time, after steps that are not counted. Programs are in
`peers/`; you install what they need by hand; the script prints how:

- `krabmaga`: cargo, which fetches krABMaga from crates.io; `--target` is where it builds
- `rvo2`, `jupedsim`, `mesa`: packages of the Python that `--python` names
- `mason`: the library's classes, which `--mason` names, and Java 17

`--json FILE` keeps the rows for `page.py --peers FILE`."""

from __future__ import annotations

import argparse
import json
import os
import shutil
import subprocess
import sys
from collections.abc import Callable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from statistics import median
from typing import NamedTuple

from page_tables import markdown_table

from antdsl.bench.tables import describe_machine, format_ratios

PEERS_FOLDER = Path(__file__).parent / "peers"
ROOT = Path(__file__).resolve().parents[2]
SIZES = (1_000, 15_000, 100_000)
TURNS = 20
LARGE, FEWER = 50_000, 8  # from so many agents on there are fewer turns at most, which are seconds each
WARM = 3  # turns of each that are not counted: Java compiles while it runs
AGENT_STEPS = 60_000  # of a turn, as far as STEPS allow
STEPS = (2, 8)
SLOW = (1_000, 15_000)  # agents up to which a slow program takes all turns, and two of one step each; beyond it takes none
COLUMNS = ("case", "agents", "program", "million agent-steps/s", "neighbours", "antdsl", "neighbours", "its time over antdsl's")
ONE_THREAD = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "RAYON_NUM_THREADS", "NUMBA_NUM_THREADS")


class Missing(Exception):
    """A program cannot be run here; the message says what would help."""


@dataclass(frozen=True, slots=True)
class Installations:
    """Where things are that others wrote: a folder for cargo, a Python with packages, MASON's classes."""

    target: Path
    python: str
    mason: Path | None


@dataclass(frozen=True, slots=True)
class Peer:
    """A program beside a case of `antdsl bench`. `words` start it, but for AGENTS and STEPS; `slow`: a
    step of many takes it seconds."""

    option: str
    name: str
    case: str
    words: Callable[[Installations], list[str]]
    slow: bool = False


def _cargo(program: str) -> Callable[[Installations], list[str]]:
    def words(installations: Installations) -> list[str]:
        cargo = shutil.which("cargo")
        if cargo is None:
            raise Missing("install Rust, whose cargo builds it")
        environment = {**os.environ, "CARGO_TARGET_DIR": str(installations.target)}
        built = subprocess.run(
            [cargo, "build", "--release", "--locked", "--quiet"], cwd=PEERS_FOLDER / "krabmaga", env=environment
        )
        if built.returncode:
            raise Missing("cargo could not build it")
        return [str(installations.target / "release" / program)]

    return words


def _python(program: str, module: str, packages: str) -> Callable[[Installations], list[str]]:
    def words(installations: Installations) -> list[str]:
        if subprocess.run([installations.python, "-c", f"import {module}"], capture_output=True).returncode:
            raise Missing(f"`{installations.python} -m pip install {packages}`, or name another one with --python")
        return [installations.python, str(PEERS_FOLDER / program)]

    return words


def _java(model: str) -> Callable[[Installations], list[str]]:
    def words(installations: Installations) -> list[str]:
        java = shutil.which("java")
        if java is None or installations.mason is None:
            raise Missing("install Java 17, and name the library's mason.jar (cs.gmu.edu/~eclab/projects/mason) with --mason")
        return [java, "-XX:+UseSerialGC", "-cp", str(installations.mason), str(PEERS_FOLDER / "Mason.java"), model]

    return words


PEERS = (
    Peer("krabmaga", "krABMaga 0.5.3 (Rust)", "trails", _cargo("ants")),
    Peer("mason", "MASON 22 (Java)", "trails", _java("foraging")),
    Peer("krabmaga", "krABMaga 0.5.3 (Rust)", "foraging", _cargo("ants")),
    Peer("mason", "MASON 22 (Java)", "foraging", _java("foraging")),
    Peer("krabmaga", "krABMaga 0.5.3 (Rust)", "boids", _cargo("flockers")),
    Peer("mason", "MASON 22 (Java)", "boids", _java("boids")),
    Peer(
        "mesa", "Mesa 3.3 (Python)", "boids", _python("boids_mesa.py", "mesa.examples", "mesa==3.3.1 networkx scipy"), slow=True
    ),
    Peer("rvo2", "RVO2 (C++)", "crowd", _python("crowd_rvo2.py", "pyrvo, scipy", "--no-deps pyrvo==0.4.3 numpy scipy")),
    Peer("jupedsim", "JuPedSim 1.4 (C++)", "crowd", _python("crowd_jupedsim.py", "jupedsim, scipy", "jupedsim==1.4.2 scipy")),
)


class Took(NamedTuple):
    """Of a turn: CPU seconds of a step, and neighbours in the mean where they matter."""

    step: float
    neighbours: float | None


class Runner:
    """A program that runs, waiting for its turns."""

    def __init__(self, name: str, words: Sequence[str], turns: int, warm: int = WARM, own: bool = False) -> None:
        environment = {**os.environ, **dict.fromkeys(ONE_THREAD, "1")}
        environment["PYTHONPATH"] = str(ROOT) if own else ""
        self.name, self.took = name, list[Took]()
        self._warm, self._left = warm, turns + warm
        self._process = subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=environment)

    def turn(self) -> None:
        """Take one, if any is left. Raises RuntimeError where the program has ended."""
        if not self._left:
            return
        assert self._process.stdin is not None and self._process.stdout is not None
        self._process.stdin.write("\n")
        self._process.stdin.flush()
        line = self._process.stdout.readline()
        if not line:
            raise RuntimeError(f"{self.name} ended with {self._process.wait()}")
        self._left -= 1
        if self._warm:
            self._warm -= 1
        else:
            self.took.append(Took(**json.loads(line)))

    def __enter__(self) -> Runner:
        return self

    def __exit__(self, *raised: object) -> None:
        self._process.kill()
        self._process.communicate()


def compared(case: str, backend: str, agents: int, peers: Sequence[tuple[Peer, list[str]]], turns: int) -> list[list[str]]:
    """A row for each program beside a case with so many agents."""
    steps = max(STEPS[0], min(STEPS[1], AGENT_STEPS // agents))
    turns = min(turns, FEWER) if agents >= LARGE else turns
    with ExitStack() as running:
        own = [sys.executable, str(PEERS_FOLDER / "ours.py"), case, backend, str(agents), str(steps)]
        runners = [running.enter_context(Runner("antdsl", own, turns, own=True))]
        for peer, words in peers:
            few = peer.slow and agents > SLOW[0]
            sized = [*words, str(agents), "1" if few else str(steps)]
            runners.append(running.enter_context(Runner(peer.name, sized, *((2, 0) if few else (turns, WARM)))))
        for number in range(WARM + turns):
            for k in range(len(runners)):
                runners[(number + k) % len(runners)].turn()
    ours, *others = (runner.took for runner in runners)
    return [
        [case, f"{agents:,}", peer.name, *_speed(agents, theirs), *_speed(agents, ours), format_ratios(_ratios(theirs, ours))]
        for (peer, _), theirs in zip(peers, others, strict=True)
    ]


def _speed(agents: int, took: Sequence[Took]) -> list[str]:
    """Million agent-steps a second, and neighbours."""
    rate = agents / median(each.step for each in took) / 1e6
    neighbour_counts = [each.neighbours for each in took if each.neighbours is not None]
    return [f"{rate:.2g}" if rate < 0.1 else f"{rate:.2f}", f"{median(neighbour_counts):.1f}" if neighbour_counts else ""]


def _ratios(theirs: Sequence[Took], ours: Sequence[Took]) -> list[float]:
    """Of turns that both took."""
    return [their.step / our.step for their, our in zip(theirs, ours, strict=False)]


def rows(installations: Installations, options: Sequence[str], backend: str, turns: int, sizes: Sequence[int]) -> list[list[str]]:
    """A row for each program that is here and each number of agents; programs that are missing are reported."""
    ready: list[tuple[Peer, list[str]]] = []
    for peer in PEERS:
        if peer.option in options:
            try:
                ready.append((peer, peer.words(installations)))
            except Missing as why:
                print(f"without {peer.name} beside `{peer.case}`: {why}", file=sys.stderr)
    table_rows = []
    for case in dict.fromkeys(peer.case for peer, _ in ready):
        for agents in sizes:
            runnable = [(peer, words) for peer, words in ready if peer.case == case and not (peer.slow and agents > SLOW[1])]
            if runnable:
                table_rows += compared(case, backend, agents, runnable, turns)
                print(*(" ".join(row) for row in table_rows[-len(runnable) :]), sep="\n", file=sys.stderr, flush=True)
    return table_rows


def main() -> None:
    """Print the table."""
    names = list(dict.fromkeys(peer.option for peer in PEERS))
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("peers", nargs="*", choices=[*names, []], help="all, if none is named")
    parser.add_argument("--target", type=Path, default=PEERS_FOLDER / "krabmaga" / "target")
    parser.add_argument("--python", default=sys.executable)
    parser.add_argument("--mason", type=Path, default=None)
    parser.add_argument("--backend", default="native")
    parser.add_argument("--turns", type=int, default=TURNS)
    parser.add_argument("--agents", type=int, action="append")
    parser.add_argument("--json", type=Path, default=None)
    options = parser.parse_args()
    installations = Installations(options.target.resolve(), options.python, options.mason)
    table_rows = rows(installations, options.peers or names, options.backend, options.turns, options.agents or SIZES)
    print(markdown_table(COLUMNS, table_rows), end="")
    if options.json is not None:
        options.json.write_text(json.dumps({"machine": describe_machine(), "rows": table_rows}) + "\n", encoding="utf-8")


if __name__ == "__main__":
    main()
