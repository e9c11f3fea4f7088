"""Functions of kernels have types, and records in place of long lists of parameters and results."""

from __future__ import annotations

import ast
from collections.abc import Iterator
from pathlib import Path

import pytest

PACKAGE = Path(__file__).resolve().parents[2] / "antdsl"
DECORATORS = frozenset(["kernel", "kernel_helper", "inlined"])
UNTYPED = "no-untyped-def"
MOST_PARAMETERS, MOST_RESULTS = 12, 3


def faults(source: str) -> Iterator[str]:
    """What is wrong with functions of kernels, each with its line."""
    if not any(word in source for word in (*DECORATORS, UNTYPED)):
        return  # parsing all files takes seconds
    tree = ast.parse(source)
    aliases = {
        node.targets[0].id: node.value
        for node in tree.body
        if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name)
    }
    for number, line in enumerate(source.splitlines(), 1):
        if "type: ignore" in line and UNTYPED in line:
            yield f"{number}: ignores {UNTYPED}"
    for function in ast.walk(tree):
        if not isinstance(function, ast.FunctionDef) or not any(map(_is_of_kernels, function.decorator_list)):
            continue
        at, arguments = f"{function.lineno}: `{function.name}`", function.args
        if arguments.posonlyargs or arguments.kwonlyargs or arguments.vararg or arguments.kwarg:
            yield f"{at} has parameters that are not positional"
        if len(arguments.args) > MOST_PARAMETERS:
            yield f"{at} has {len(arguments.args)} parameters"
        if function.returns is None or any(each.annotation is None for each in arguments.args):
            yield f"{at} has no types"
        returned = [node.value for node in ast.walk(function) if isinstance(node, ast.Return)]
        results = max([_length(function.returns, aliases), *(_length(each, {}) for each in returned)])
        if results > MOST_RESULTS:
            yield f"{at} returns {results} values"


def _is_of_kernels(decorator: ast.expr) -> bool:
    name = decorator.attr if isinstance(decorator, ast.Attribute) else decorator.id if isinstance(decorator, ast.Name) else ""
    return name in DECORATORS


def _length(node: ast.expr | None, aliases: dict[str, ast.expr]) -> int:
    """How many values a tuple, or the type of one, has; 1 for anything else."""
    if isinstance(node, ast.Name) and node.id in aliases:
        return _length(aliases[node.id], {})
    if isinstance(node, ast.Subscript) and isinstance(node.value, ast.Name) and node.value.id == "tuple":
        return _length(node.slice, {})
    return len(node.elts) if isinstance(node, ast.Tuple) else 1


def test_functions_of_kernels_have_types_and_few_parameters_and_results() -> None:
    problems = [
        f"{path.relative_to(PACKAGE.parent)}:{fault}"
        for path in sorted(PACKAGE.rglob("*.py"))
        for fault in faults(path.read_text(encoding="utf-8"))
    ]
    assert not problems, "\n".join(problems)


MANY = ", ".join(f"x{k}: F64" for k in range(13))


@pytest.mark.parametrize(
    ("source", "fault"),
    [
        (f"@kernel\ndef f({MANY}) -> F64:\n    return x0", "2: `f` has 13 parameters"),
        ("@kernel_helper\ndef f(x: F64) -> Any:\n    return x, x, x, x", "2: `f` returns 4 values"),
        ("@kernel_helper\ndef f(x: F64) -> tuple[F64, F64, F64, F64]:\n    return g(x)", "2: `f` returns 4 values"),
        ("Four = tuple[F64, F64, F64, F64]\n@inlined\ndef f(x: F64) -> Four:\n    return g(x)", "3: `f` returns 4 values"),
        ("@kernels.inlined\ndef f(x) -> F64:\n    return x", "2: `f` has no types"),
        ("@inlined\ndef f(x: F64):\n    return x", "2: `f` has no types"),
        ("@inlined\ndef f(*x: F64) -> F64:\n    return x[0]", "2: `f` has parameters that are not positional"),
        (f"def f(x):  # type: ignore[{UNTYPED}]\n    return x", f"1: ignores {UNTYPED}"),
        (f"def f(x):  # type: ignore[misc, {UNTYPED}]\n    return x", f"1: ignores {UNTYPED}"),
        (f"@kernel\ndef f({MANY.removesuffix(', x12: F64')}) -> tuple[F64, F64, F64]:\n    return x0, x1, x2", None),
        ("def f(x, *y):\n    return x, x, x, x", None),
    ],
)
def test_each_fault_is_found(source: str, fault: str | None) -> None:
    assert list(faults(source)) == ([] if fault is None else [fault])
