"""What a value is at birth, as one number: equal where two plans give a newborn the same, whatever else was edited."""

from __future__ import annotations

from collections.abc import Mapping

from antdsl.plan import ir
from antdsl.plan.traverse import needed
from antdsl.runtime.binding.bind_world import run_value
from antdsl.runtime.world import World

_PLACE = frozenset(("snap", "load"))


def birth_values(plan: ir.SpeciesPlan, params: Mapping[str, float]) -> dict[str, int]:
    """By register what is stored in it at birth: a hash of the operations, through other registers that these read, and of the
    params they use."""
    found: dict[str, int] = {}
    _block(plan.born, (), found, params)
    return found


def params_at_birth(world: World) -> dict[str, float]:
    """The params as the scene and the program say them, whatever was set since."""
    given = world.setting.params
    return {name: given[name] if name in given else run_value(world, p.default) for name, p in world.plan.params.items()}


def _block(block: ir.Block, where: tuple[int, ...], found: dict[str, int], params: Mapping[str, float]) -> None:
    for statement in block.statements:
        if isinstance(statement, ir.If):
            _block(statement.then, (*where, _value(statement.condition, found, params)), found, params)
        elif isinstance(statement, ir.Store):
            value = _value(statement.value, found, params)
            before = found.get(statement.register, 0) if where else 0
            found[statement.register] = hash((where, before, value))


def _value(node: ir.Node, found: Mapping[str, int], params: Mapping[str, float]) -> int:
    made: dict[ir.Node, int] = {}
    for each in needed([node]):
        attrs: tuple[object, ...] = each.attrs
        if each.op in _PLACE:
            attrs = (each.attrs[0], found.get(each.attrs[0], 0))
        elif each.op == "param":
            attrs = (each.attrs[0], params.get(each.attrs[0]))
        made[each] = hash((each.op, each.kind.value, repr(attrs), *(made[a] for a in each.args)))
    return made[node]
