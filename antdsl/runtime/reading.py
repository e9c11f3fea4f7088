"""What a block reads: its nodes in text order, and the reads of registers that must happen early.

A `load` is evaluated where it is first asked for. Where one stands both before and after a store to its register, in regions
that do not share a value, it has to be read before the region that they have in common; `early_loads` says which and where.
"""

from __future__ import annotations

from collections.abc import Iterator

from antdsl.plan import ir
from antdsl.plan.traverse import operands


def reach(roots: tuple[ir.Node, ...]) -> list[ir.Node]:
    """All nodes under some, each once, operands first."""
    found: set[ir.Node] = set()
    pending = list(roots)
    while pending:
        node = pending.pop()
        if node not in found:
            found.add(node)
            pending.extend(node.args)
    return sorted(found, key=lambda node: node.number)


def walk(block: ir.Block, path: tuple[int, ...] = ()) -> Iterator[tuple[tuple[int, ...], ir.Statement]]:
    """All statements in text order, each with its place: the index in every block around it."""
    for k, statement in enumerate(block.statements):
        yield (*path, k), statement
        if isinstance(statement, ir.If):
            yield from walk(statement.then, (*path, k))


def written(statement: ir.Statement) -> str | None:
    """The register that a statement changes at once."""
    if isinstance(statement, ir.Store):
        return statement.register
    return statement.own if isinstance(statement, ir.Give) else None


def early_loads(block: ir.Block) -> dict[tuple[int, ...], list[ir.Node]]:
    """Loads to evaluate just before the statement at a place, in the region that holds it."""
    places: dict[ir.Node, list[tuple[int, ...]]] = {}
    stores: dict[str, list[tuple[int, ...]]] = {}
    for path, statement in walk(block):
        for node in reach(operands(statement)):
            if node.op == "load":
                places.setdefault(node, []).append(path)
        register = written(statement)
        if register is not None:
            stores.setdefault(register, []).append(path)
    found: dict[tuple[int, ...], list[ir.Node]] = {}
    for node, paths in places.items():
        if any(paths[0] <= store < paths[-1] for store in stores.get(node.attrs[0], ())):
            found.setdefault(_meeting(paths), []).append(node)
    return found


def _meeting(paths: list[tuple[int, ...]]) -> tuple[int, ...]:
    """Place of the first statement, in the smallest block around all these places, that holds the first of them."""
    first, depth = paths[0], min(len(p) for p in paths) - 1
    while any(p[:depth] != first[:depth] for p in paths):
        depth -= 1
    return first[: depth + 1]


def places(species: ir.SpeciesPlan) -> dict[ir.Statement, int]:
    """Every statement of a species by its place in the text."""
    blocks = (species.born, species.decide, species.act, species.blend)
    return {statement: k for k, statement in enumerate(statement for block in blocks for _, statement in walk(block))}


def kept_senses(species: ir.SpeciesPlan) -> tuple[ir.Node, ...]:
    """Lazy nodes whose value holds for the whole step: none of its parts is written in between."""
    return tuple(node for node in species.lazy if all(part.op != "load" for part in reach((node,))))
