"""Walking a typed tree without recursion: a long chain of names must not become a deep stack."""

from __future__ import annotations

from collections.abc import Iterator

from antdsl.program import model


def inside(expr: model.Expr) -> Iterator[object]:
    """Every expression and binding that an expression is made of, itself first, each once."""
    stack: list[object] = [expr]
    seen: set[int] = set()
    while stack:
        each = stack.pop()
        if each is None or id(each) in seen:
            continue
        seen.add(id(each))
        yield each
        stack += reversed(_parts(each))


def _parts(each: object) -> list[object]:
    """What an expression or a binding is made of."""
    if isinstance(each, tuple):
        return list(each)
    if isinstance(each, model.Local):
        return [each.binding]
    if isinstance(each, model.Binding):
        return [each.value, each.then]
    if isinstance(each, model.Attribute):
        return [each.of]
    if isinstance(each, model.Op):
        return [each.args]
    if isinstance(each, model.SetOf):
        return [each.args, each.where]
    if isinstance(each, model.Reduce):
        return [each.over, each.body]
    if isinstance(each, model.Inline):
        return [each.arguments, each.body, each.result]
    return []
