"""Orders declarations so that each comes after the declarations that it uses."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import TypeVar

from antdsl.diagnostics import Report
from antdsl.program.traverse import iterate_names
from antdsl.syntax import nodes

T = TypeVar("T")


def order_declarations(
    report: Report,
    kind_words: str,
    declarations: Mapping[str, T],
    find_used_trees: Callable[[T], Iterable[object]],
    find_name: Callable[[T], nodes.Name],
) -> tuple[list[T], set[str]]:
    """Return the declarations in an order in which each comes after the declarations that it uses. Also return the names that
    are part of a cycle.

    `find_used_trees`: returns the trees in which to search for used names. A cycle is reported once. Then one of its uses is
    ignored, so that an order exists."""
    graph = {name: _find_used_names(each, declarations, find_used_trees) for name, each in declarations.items()}
    ordered_names: set[str] = set()
    circular: set[str] = set()
    order: list[T] = []
    for first in declarations:
        path: list[str] = []
        stack = [] if first in ordered_names else [(first, 0)]
        while stack:
            name, step = stack.pop()
            if step == 0:
                path.append(name)
            if step == len(graph[name]):
                path.pop()
                ordered_names.add(name)
                order.append(declarations[name])
                continue
            stack.append((name, step + 1))
            used = graph[name][step]
            if used in path:
                circle = path[path.index(used) :]
                if not circular & set(circle):
                    _report_cycle(report, kind_words, [find_name(declarations[each]) for each in circle])
                circular |= set(circle)
            elif used not in ordered_names:
                stack.append((used, 0))
    return order, circular


def _find_used_names(
    declaration: T, declarations: Mapping[str, T], find_used_trees: Callable[[T], Iterable[object]]
) -> list[str]:
    return list(
        {name.text: None for tree in find_used_trees(declaration) for name in iterate_names(tree) if name.text in declarations}
    )


def _report_cycle(report: Report, kind_words: str, names: Sequence[nodes.Name]) -> None:
    text = " → ".join(f"`{name.text}`" for name in [*names, names[0]])
    message = f"{kind_words} depend on each other in a circle: {text}"
    report.error("circle", message, names[0].span, "remove one dependency, or make one of them an attribute that statements set")
