"""Warns about agents that walk farther than their body length in one step although contacts are on."""

from __future__ import annotations

from math import ceil

from antdsl import limits
from antdsl.diagnostics import Label, Report
from antdsl.program.model import AttributeDecl, Constant, Expr, OperationExpr, ParamRef, Program
from antdsl.scene.checks.entry_checks import convert_constant
from antdsl.scene.library_bodies import BODY_WORDS, CAPSULE_BY_BODY, find_body_for_species
from antdsl.scene.load import Scene


def check_step_lengths(scene: Scene, program: Program, report: Report) -> None:
    """Warn once for each species with steps longer than the body, if contacts are on; suggest the number of substeps.

    Steps follow from `fps`, `substeps` and `max_speed`, body lengths from `size` and a body of the library. Species with other
    bodies are not checked, nor values that depend on more than params and draws."""
    model, seen = scene.model, set()
    if model.contacts == "off":
        return
    for number, line in enumerate(model.crowd):
        if line.species in seen or line.species not in program.species:
            continue
        seen.add(line.species)
        attributes = {each.name: each for each in program.species[line.species].attributes}
        body = line.body or find_body_for_species(line.species)
        speed, size = (_compute_typical_value(attributes.get(name), scene, program) for name in ("max_speed", "size"))
        if body not in BODY_WORDS or not speed or not size or min(speed, size) <= 0:
            continue
        frame_step, length = speed * float(1 / model.fps), CAPSULE_BY_BODY[body].length * size
        step, substeps = frame_step / model.substeps, ceil(frame_step / length)
        if step <= length:
            continue
        words = f"a `{line.species}` walks up to {step:,.0f} mm in a step, {step / length:.2g} times the length of its body"
        has_own_line = "substeps" in scene.document.entries
        place = scene.span("substeps") if has_own_line else scene.span("crowd", number, "species")
        slower = f"write a `max_speed` below {_format_limit(length, scene)}"
        advice = f"write `substeps: {substeps}`" if substeps <= limits.MAX_SUBSTEPS else slower
        report.warning("long-step", words, place, advice, labels=(Label(attributes["max_speed"].span, "its speed"),))


def _format_limit(length: float, scene: Scene) -> str:
    """Return the speed (text) at which a step is `length` mm long with the scene's maximum number of substeps."""
    return f"{length * float(scene.model.fps) * limits.MAX_SUBSTEPS / 1000:.3g} m/s"


def _compute_typical_value(attribute: AttributeDecl | None, scene: Scene, program: Program) -> float | None:
    """Return the mean value of an attribute at birth in base units. Return None if it depends on more than params and draws."""
    part: Expr | None = attribute.default if attribute is not None else None
    if isinstance(part, OperationExpr) and part.name in ("uniform", "normal"):
        values = [_find_constant_value(each, scene, program) for each in part.args[:2]]
        if part.name == "normal":
            return values[0]
        return None if None in values else sum(value for value in values if value is not None) / len(values)
    return _find_constant_value(part, scene, program)


def _find_constant_value(part: Expr | None, scene: Scene, program: Program) -> float | None:
    """Return a constant, or the value of a param in this scene, in base units; None for other expressions."""
    if isinstance(part, ParamRef):
        value = scene.model.set.get(part.name)
        if value is not None:
            return value.to_base_units(scene.model.unit_mm, float(1 / scene.model.fps))
        part = program.params[part.name].default
    return convert_constant(part, scene) if isinstance(part, Constant) else None
