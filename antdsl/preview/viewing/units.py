"""The units of numbers for the page: the units that authors use."""

from __future__ import annotations

from antdsl.program.model import AttributeDecl, Constant, ItemAttribute, TypeKind
from antdsl.program.tables.units import default_unit, measure
from antdsl.runtime import World
from antdsl.scene.quantities import QuantityError, parse_quantity


def unit_for(declared: AttributeDecl | ItemAttribute) -> str:
    """Return the unit of the declared default value, or else a usual unit."""
    if declared.type.kind is not TypeKind.NUMBER:
        return ""
    default = declared.default
    try:
        written = parse_quantity(default.span.text) if default.span is not None else None
    except QuantityError:
        written = None
    return written.unit if written is not None and written.dim == declared.type.dim else default_unit(declared.type.dim)


def base_units(unit: str, unit_mm: float, dt: float) -> float:
    """Return the number of base units in one `unit`."""
    known = measure(unit) if unit else None
    return 1.0 if known is None else known.factor * unit_mm**known.u * dt**known.step


def constant_in_base_units(value: Constant, unit_mm: float, dt: float) -> float:
    """Return a constant of the program in base units."""
    return float(value.number * unit_mm**value.u * dt**value.step)


def colour_attributes(world: World, species: str, attributes: tuple[AttributeDecl, ...]) -> list[AttributeDecl]:
    """Return the attributes of a species that are one number per agent."""
    registers = world.plan.species[species].registers
    return [each for each in attributes if each.type.kind in (TypeKind.NUMBER, TypeKind.BOOL) and each.name in registers]
