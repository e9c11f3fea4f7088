"""Which senses are worth keeping once computed: those that several regions of a step look at."""

from __future__ import annotations

from collections.abc import Iterable

from antdsl.plan.ir import SENSES, Block, Node
from antdsl.plan.traverse import operands, statements


def lazy(*phases: Block) -> tuple[Node, ...]:
    """Senses that two or more users need, in order of their numbers. A user is a block, or a sense that is kept itself."""
    users: dict[Node, set[object]] = {}
    for phase in phases:
        for block, statement in statements(phase):
            for sense in nearest_senses(operands(statement)):
                users.setdefault(sense, set()).add(block)
    kept: list[Node] = []
    waiting = set(users)
    while waiting:
        sense = max(waiting, key=lambda node: node.number)  # whoever uses it has a greater number and has been here
        waiting.remove(sense)
        alone = len(users[sense]) == 1
        if not alone:
            kept.append(sense)
        for inner in nearest_senses(sense.args):
            users.setdefault(inner, set()).update(users[sense] if alone else (sense,))
            waiting.add(inner)
    return tuple(reversed(kept))


def nearest_senses(roots: Iterable[Node]) -> set[Node]:
    """Senses that are reached from the nodes without passing through another sense."""
    found: set[Node] = set()
    seen: set[Node] = set()
    stack = list(roots)
    while stack:
        node = stack.pop()
        if node in seen:
            continue
        seen.add(node)
        if node.op in SENSES:
            found.add(node)
        else:
            stack += node.args
    return found
