"""Fuzzes the readers of the product: `python tests/fuzz/run.py TARGET|all --minutes 20 --seed 1 --saves DIR`.

Minutes are CPU minutes of the worker processes, so that a busy machine gives the same amount of work. Each target writes
`DIR/TARGET.json` and the inputs with findings below `DIR/TARGET/`. Exit code 1 where there is a finding."""

from __future__ import annotations

import argparse
import atexit
import json
import os
import shutil
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict
from pathlib import Path
from typing import Any

TESTS = Path(__file__).resolve().parents[1]
COLUMNS = (
    ("target", "target"), ("executions", "executions"), ("CPU s", "cpu_seconds"), ("call sites", "call_sites"),
    ("report forms", "report_forms"), ("crashes", "crashes"), ("hangs", "hangs"), ("slowest ms", "slowest_ms"),
    ("peak MiB", "peak_memory_mib"), ("above start MiB", "peak_above_start_mib"), ("causes", "findings"),
)  # fmt: skip


def main(words: list[str] | None = None) -> int:
    options = _parser().parse_args(words)
    sys.path[:] = [str(TESTS), str(TESTS.parent), *(path for path in sys.path if Path(path or ".").resolve() != TESTS / "fuzz")]
    if options.nice:
        os.nice(max(0, options.nice - os.nice(0)))
    if options.replay is not None:
        return _replay(options.target, options.replay)
    if options.target == "all":
        return _run_all(options)
    return _run_one(options)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="run.py", description="Fuzz the readers of antdsl.")
    parser.add_argument("target", help="the name of a target, or `all`")
    parser.add_argument("--minutes", type=float, default=1.0, help="CPU minutes for each target")
    parser.add_argument("--executions", type=int, help="inputs for each target, instead of minutes")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument(
        "--saves", type=Path, default=Path("fuzz-results"), help="the folder for results and inputs with findings"
    )
    parser.add_argument("--corpus", type=Path, help="a folder that keeps the inputs that reached something new, for a next run")
    parser.add_argument("--replay", type=Path, nargs="+", help="feed these files instead, and print what they do")
    parser.add_argument("--jobs", type=int, default=1, help="targets at the same time, of `all`")
    parser.add_argument("--nice", type=int, nargs="?", const=19, default=0, help="a lower priority")
    return parser


def _run_all(options: argparse.Namespace) -> int:
    """Each target in a separate process, so that none ends the others."""
    from fuzz.targets import TARGETS

    words = ["--minutes", str(options.minutes), "--seed", str(options.seed), "--saves", str(options.saves)]
    words += ["--executions", str(options.executions)] if options.executions else []
    words += ["--corpus", str(options.corpus)] if options.corpus else []

    def one(name: str) -> int:
        return subprocess.run([sys.executable, str(Path(__file__).resolve()), name, *words], check=False).returncode

    with ThreadPoolExecutor(options.jobs) as pool:
        codes = dict(zip(TARGETS, pool.map(one, TARGETS), strict=True))
    results = []
    for name in TARGETS:
        path = options.saves / f"{name}.json"
        results.append(json.loads(path.read_text()) if path.is_file() else {"target": name, "findings": {"no result": {}}})
    print_table(results)
    failed = [name for name, code in codes.items() if code not in (0, 1)]
    if failed:
        print(f"without a result of this run: {', '.join(failed)}")
    return max(codes.values(), default=0)


def _run_one(options: argparse.Namespace) -> int:
    from fuzz.engine import Campaign
    from fuzz.targets import TARGETS

    _use_private_code_cache()
    if options.target not in TARGETS:
        print(f"there is no target `{options.target}`: {', '.join(TARGETS)}", file=sys.stderr)
        return 2
    folder = options.saves / options.target
    corpus = options.corpus / options.target if options.corpus else None
    campaign = Campaign(TARGETS[options.target], options.seed, folder, corpus, lambda text: print(text, flush=True))
    result = campaign.run(None if options.executions else options.minutes, options.executions)
    options.saves.mkdir(parents=True, exist_ok=True)
    (options.saves / f"{options.target}.json").write_text(json.dumps(asdict(result), indent=1) + "\n")
    print_table([asdict(result)])
    return int(bool(result.findings))


def _replay(name: str, files: list[Path]) -> int:
    """Feed saved inputs in this process. Whatever a library does to the process, it does here."""
    from fuzz.engine import replay
    from fuzz.targets import TARGETS

    _use_private_code_cache()
    bad = 0
    for file in files:
        outcome = replay(TARGETS[name], file.read_bytes())
        print(f"{file}: {outcome.seconds:.3f} s, {outcome.memory / 1048576:.0f} MiB")
        print(outcome.report[:2000])
        for each in outcome.findings:
            bad += 1
            print(f"{each.kind}: {each.signature}\n{each.detail}")
    return int(bad > 0)


def _use_private_code_cache() -> None:
    """Compiled code of this run goes into a separate folder; tables of meshes are computed each time."""
    os.environ.setdefault("ANTDSL_TABLE_CACHE", "")
    if "ANTDSL_NATIVE_CACHE" not in os.environ:
        os.environ["ANTDSL_NATIVE_CACHE"] = tempfile.mkdtemp(prefix="antdsl-code-")
        atexit.register(shutil.rmtree, os.environ["ANTDSL_NATIVE_CACHE"], ignore_errors=True)


def print_table(results: list[dict[str, Any]]) -> None:
    table = [[head for head, _ in COLUMNS]]
    for each in results:
        row = [each.get(key, "-") for _, key in COLUMNS]
        table.append([str(len(v)) if isinstance(v, dict) else f"{v:.0f}" if isinstance(v, float) else str(v) for v in row])
    widths = [max(len(row[k]) for row in table) for k in range(len(COLUMNS))]
    for line in table:
        print(
            "  ".join(
                word.ljust(width) if k == 0 else word.rjust(width)
                for k, (word, width) in enumerate(zip(line, widths, strict=True))
            )
        )
    for each in results:
        for signature, finding in each["findings"].items():
            print(f"{each['target']}: {signature} ({finding.get('count')} times, {finding.get('input')})")


if __name__ == "__main__":
    sys.exit(main())
