"""Mutation testing of kernels: how many small changes of a kernel do its tests notice?

`python tests/mutants.py antdsl/ground/plane.py --tests tests/ground/test_ground.py` changes one place of a `@kernel`, `@inlined`
or `@kernel_helper` function of the file, runs the tests, restores the file, and repeats that for `--count` places.
`--kernel NAME` takes functions of that name only. It prints each mutant that survives as a diff, and the share of killed
mutants. Mutants that no kernel can be made of, or with kernels of the same text or machine code, are not counted. Do not edit
the file meanwhile."""

from __future__ import annotations

import argparse
import ast
import difflib
import json
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from copy import deepcopy
from dataclasses import dataclass
from hashlib import blake2b
from pathlib import Path
from typing import Any

from antdsl.machine_code import library, llvm_compiler
from antdsl.machine_code.kernels import source_key
from antdsl.machine_code.kernels.kernel import Kernel

ROOT = Path(__file__).resolve().parent.parent
DECORATORS = {"kernel", "inlined", "kernel_helper"}
ARITHMETIC: dict[type, type] = {ast.Add: ast.Sub, ast.Sub: ast.Add, ast.Mult: ast.Div, ast.Div: ast.Mult}
COMPARED: dict[type, type] = {
    ast.Lt: ast.LtE,
    ast.LtE: ast.Lt,
    ast.Gt: ast.GtE,
    ast.GtE: ast.Gt,
    ast.Eq: ast.NotEq,
    ast.NotEq: ast.Eq,
}
PREFETCH = "fetch"  # in the names of functions that only prefetch: `prefetch`, `prefetch_columns`, `prefetch_rays`
TIMES, LEAST_SECONDS = 5, 60  # a mutant with tests that take longer than both counts as endless


@dataclass(frozen=True, slots=True)
class Mutation:
    """A node of the source, and what replaces it."""

    node: ast.expr | ast.stmt
    text: str
    function: str
    description: str

    def apply(self, source: str) -> str:
        """The source with the replacement, on as many lines as before."""
        lines = source.encode().splitlines(keepends=True)
        begin = sum(map(len, lines[: self.node.lineno - 1])) + self.node.col_offset
        assert self.node.end_lineno is not None and self.node.end_col_offset is not None
        end = sum(map(len, lines[: self.node.end_lineno - 1])) + self.node.end_col_offset
        text = self.text
        if isinstance(self.node, ast.expr):
            text = f"({text}" + "\n" * (self.node.end_lineno - self.node.lineno) + ")"
        elif self.node.end_lineno > self.node.lineno:
            text += "\n" * (self.node.end_lineno - self.node.lineno)
        data = source.encode()
        return (data[:begin] + text.encode() + data[end:]).decode()


def mutations(source: str, kernel: str | None) -> list[Mutation]:
    """All mutations of the kernels and their helpers in a source."""
    changes: list[Mutation] = []
    for function in ast.walk(ast.parse(source)):
        if not isinstance(function, ast.FunctionDef) or kernel not in (None, function.name) or PREFETCH in function.name:
            continue
        if any(isinstance(each, ast.Name) and each.id in DECORATORS for each in function.decorator_list):
            for statement in function.body[1:] if ast.get_docstring(function) else function.body:
                for node in _nodes(statement):
                    if isinstance(node, ast.If | ast.While):
                        changes.append(Mutation(node.test, f"not ({ast.unparse(node.test)})", function.name, "condition"))
                    if isinstance(node, ast.expr | ast.stmt):
                        changes += [Mutation(node, text, function.name, description) for text, description in _replaced(node)]
    return changes


def _nodes(node: ast.AST) -> Iterator[ast.AST]:
    """A node and all below it, without prefetches, which change no result."""
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and PREFETCH in node.func.id:
        return
    yield node
    for each in ast.iter_child_nodes(node):
        yield from _nodes(each)


def _replaced(node: ast.AST) -> Iterator[tuple[str, str]]:
    """What may stand for a node, and what kind of change it is."""
    if isinstance(node, ast.BinOp | ast.AugAssign) and type(node.op) in ARITHMETIC:
        yield _changed(node, op=ARITHMETIC[type(node.op)]()), "operator"
    if isinstance(node, ast.Compare) and type(node.ops[0]) in COMPARED:
        yield _changed(node, ops=[COMPARED[type(node.ops[0])](), *node.ops[1:]]), "comparison"
    if isinstance(node, ast.BoolOp):
        yield _changed(node, op=ast.Or() if isinstance(node.op, ast.And) else ast.And()), "and/or"
    if isinstance(node, ast.Constant) and type(node.value) is int:
        yield str(node.value + 1), "constant"
        yield str(node.value - 1), "constant"
    if isinstance(node, ast.Constant) and type(node.value) is float:
        yield repr(node.value * 2.0 or 1.0), "constant"
    if isinstance(node, ast.Call) and isinstance(node.func, ast.Name) and node.func.id in ("min", "max") and len(node.args) > 1:
        yield _changed(node, args=node.args[::-1]), "arguments"
        yield _changed(node, func=ast.Name("max" if node.func.id == "min" else "min")), "min/max"
    fetches = isinstance(node, ast.Expr) and not list(_nodes(node.value))
    if not fetches and isinstance(node, ast.Assign | ast.AugAssign | ast.Expr | ast.Break | ast.Continue):
        yield "pass", "statement"
    if isinstance(node, ast.IfExp):
        yield _changed(node, test=ast.UnaryOp(ast.Not(), node.test)), "condition"


def _changed(node: ast.AST, **fields: Any) -> str:
    copy = deepcopy(node)
    for name, value in fields.items():
        setattr(copy, name, value)
    return ast.unparse(ast.fix_missing_locations(copy))


def texts(file: Path) -> dict[str, str]:
    """The texts of all kernels that are made of functions of a file."""
    module = ".".join(file.resolve().relative_to(ROOT).with_suffix("").parts)
    kernel_texts = {}
    for each in library.load_entries():
        if isinstance(each, Kernel):
            source_lines: list[str] = []
            source_key._describe_function(each.part, source_lines, {})
            if any(line.startswith(f"{module} ") for line in source_lines):
                kernel_texts[f"{each.__module__}.{each.__name__}"] = each.text(llvm_compiler.find_host_target())
    return kernel_texts


def digests(file: Path, compiled: bool = False) -> dict[str, str] | None:
    """The hashes of these texts in a separate process, or those of their machine code; None where they cannot be made."""
    words = [sys.executable, __file__, str(file), "--digests", "code" if compiled else "text"]
    process = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, env=_environment())
    return json.loads(process.stdout) if process.returncode == 0 else None


def _print_digests(file: Path, compiled: bool) -> None:
    kernel_texts = texts(file)
    code = {
        name: llvm_compiler.compile_object(text, llvm_compiler.find_host_target()) if compiled else text.encode()
        for name, text in kernel_texts.items()
    }
    print(json.dumps({name: blake2b(each, digest_size=16).hexdigest() for name, each in code.items()}))


def _environment() -> dict[str, str]:
    return {**os.environ, "PYTHONDONTWRITEBYTECODE": "1", "PYTHONPATH": str(ROOT)}


def passes(tests: list[str], seconds: float, cache: str) -> bool:
    """Whether all tests pass within this time."""
    words = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", *tests]
    # Importing plugins takes as long as most tests of a kernel.
    environment = {**_environment(), "ANTDSL_NATIVE_CACHE": cache, "PYTEST_DISABLE_PLUGIN_AUTOLOAD": "1"}
    with subprocess.Popen(
        words, cwd=ROOT, env=environment, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True
    ) as run:
        try:
            return run.wait(seconds) == 0
        except BaseException as problem:
            os.killpg(run.pid, signal.SIGKILL)
            if isinstance(problem, subprocess.TimeoutExpired):
                return False
            raise


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("file", type=Path)
    parser.add_argument("--tests", nargs="+", default=[])
    parser.add_argument("--count", type=int, default=20)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--kernel")
    parser.add_argument("--digests", choices=("text", "code"), help=argparse.SUPPRESS)
    options = parser.parse_args()
    if options.digests:
        _print_digests(options.file, options.digests == "code")
        return 0
    if not options.tests:
        parser.error("--tests is missing")
    signal.signal(signal.SIGTERM, signal.default_int_handler)
    source = options.file.read_bytes()
    with tempfile.TemporaryDirectory(prefix="antdsl-mutants-") as cache:
        try:
            return _run(options, source.decode(), cache)
        finally:
            options.file.write_bytes(source)


def _run(options: argparse.Namespace, source: str, cache: str) -> int:
    start = time.monotonic()
    if not passes(options.tests, 3600, cache):
        sys.exit("the tests fail without a mutation")
    seconds = max(LEAST_SECONDS, TIMES * (time.monotonic() - start))
    text, code = digests(options.file), digests(options.file, compiled=True)
    sites = mutations(source, options.kernel)
    if not text or not sites:
        sys.exit("no kernel of the package is made of this file, or none of this name")
    random.Random(options.seed).shuffle(sites)
    killed, survived, left_out = 0, 0, 0
    for mutation in sites:
        if killed + survived == options.count:
            break
        mutant = mutation.apply(source)
        options.file.write_text(mutant, encoding="utf-8")
        mutant_digests = digests(options.file)
        if mutant_digests is None or mutant_digests == text:
            left_out += 1
            continue
        place = f"{mutation.function}:{mutation.node.lineno} ({mutation.description})"
        if not passes(options.tests, seconds, cache):
            killed += 1
            print(f"killed    {place}", flush=True)
        elif digests(options.file, compiled=True) == code:
            left_out += 1
        else:
            survived += 1
            lines = difflib.unified_diff(source.splitlines(), mutant.splitlines(), lineterm="", n=0)
            print(f"survived  {place}", *(f"    {line}" for line in list(lines)[3:]), sep="\n", flush=True)
    share = killed / max(1, killed + survived)
    print(
        f"{options.file}: {killed} of {killed + survived} killed ({share:.0%}); {left_out} not counted, of {len(sites)} mutations"
    )
    return 0


if __name__ == "__main__":
    sys.exit(main())
