"""The units in which the page displays numbers: those that authors use."""

from __future__ import annotations

from antdsl.program.model import AttributeDecl, Constant, ItemAttribute, TypeKind
from antdsl.program.tables.units import choose_default_unit, find_unit_measure
from antdsl.runtime import World
from antdsl.scene.quantities import QuantityError, parse_quantity


def choose_unit(declaration: AttributeDecl | ItemAttribute) -> str:
    """Return the unit of the declared default value, or a usual unit if there is none."""
    if declaration.type.kind is not TypeKind.NUMBER:
        return ""
    default = declaration.default
    try:
        written = parse_quantity(default.span.text) if default.span is not None else None
    except QuantityError:
        written = None
    return (
        written.unit
        if written is not None and written.dim == declaration.type.dimension
        else choose_default_unit(declaration.type.dimension)
    )


def find_unit_size(unit: str, unit_mm: float, dt: float) -> float:
    """Return the number of base units in one `unit`."""
    known = find_unit_measure(unit) if unit else None
    return 1.0 if known is None else known.factor * unit_mm**known.unit_power * dt**known.step


def convert_constant(value: Constant, unit_mm: float, dt: float) -> float:
    """Return a constant of the program in base units."""
    return float(value.number * unit_mm**value.unit_power * dt**value.step)


def list_colour_attributes(world: World, species: str, attributes: tuple[AttributeDecl, ...]) -> list[AttributeDecl]:
    """Return the attributes by which a page can colour the agents of a species: those with a single number per agent."""
    registers = world.plan.species[species].registers
    return [each for each in attributes if each.type.kind in (TypeKind.NUMBER, TypeKind.BOOL) and each.name in registers]
