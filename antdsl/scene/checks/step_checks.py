"""Warns about time steps that are too long: agents would pass through each other in one step, or avoid each other too late."""

from __future__ import annotations

from collections.abc import Iterator
from math import ceil

from antdsl import limits
from antdsl.diagnostics import Label, Report
from antdsl.program.model import AttributeDecl, Constant, Expr, OperationExpr, ParamRef, Program, Species
from antdsl.program.traverse import iterate_parts
from antdsl.scene.checks.entry_checks import convert_constant
from antdsl.scene.library_bodies import BODY_WORDS, CAPSULE_BY_BODY, find_body_for_species
from antdsl.scene.load import Scene

_MAX_AVOIDANCE_SHARE = 0.7  # of an agent's collision radius in a step; above it, people in a corridor lose a tenth of their pace


def check_avoidance_steps(scene: Scene, program: Program, report: Report) -> None:
    """Warn once for each species that avoids others by `clear_velocity` and covers too much ground between two decisions.

    Substeps do not help, because agents decide once per frame."""
    for number, species in find_first_lines(scene, program):
        if not any(isinstance(each, OperationExpr) and each.name == "clear_velocity" for each in iterate_parts(species)):
            continue
        attributes = {each.name: each for each in species.attributes}
        speed, radius, size = (
            compute_typical_value(attributes.get(name), scene, program) for name in ("max_speed", "radius", "size")
        )
        radius = radius or (size or 0.0) / 2
        frame_step = (speed or 0.0) * float(1 / scene.model.fps)
        if not speed or radius <= 0 or frame_step <= _MAX_AVOIDANCE_SHARE * radius:
            continue
        distance = f"{frame_step / radius:.2g} times its radius"
        words = f"a `{species.name}` walks {distance} between two decisions, so it avoids others too late"
        place = scene.find_span("fps") if "fps" in scene.document.entries else scene.find_span("crowd", number, "species")
        fps = ceil(speed / (_MAX_AVOIDANCE_SHARE * radius))
        advice = f"write `fps: {fps}` or more" if fps <= limits.MAX_FPS else "write a greater `radius`, or a lower `max_speed`"
        report.warning("late-avoidance", words, place, advice, labels=(Label(attributes["max_speed"].span, "its speed"),))


def find_first_lines(scene: Scene, program: Program) -> Iterator[tuple[int, Species]]:
    """Yield, for each species in the crowd, the index of its first crowd line and the species."""
    seen: set[str] = set()
    for number, line in enumerate(scene.model.crowd):
        if line.species not in seen and line.species in program.species:
            seen.add(line.species)
            yield number, program.species[line.species]


def check_step_lengths(scene: Scene, program: Program, report: Report) -> None:
    """Warn once for each species that moves more than a body length per step, if contacts are on. Suggest the number of
    substeps.

    The distance per step depends on `fps`, `substeps` and `max_speed`. The body length depends on `size` and on the library's
    body. Species with other bodies are not checked. Values that depend on anything except params and random draws are not
    checked either."""
    model = scene.model
    if model.contacts == "off":
        return
    for number, species in find_first_lines(scene, program):
        line = model.crowd[number]
        attributes = {each.name: each for each in species.attributes}
        body = line.body or find_body_for_species(line.species)
        speed, size = (compute_typical_value(attributes.get(name), scene, program) for name in ("max_speed", "size"))
        if body not in BODY_WORDS or not speed or not size or min(speed, size) <= 0:
            continue
        frame_step, length = speed * float(1 / model.fps), CAPSULE_BY_BODY[body].length * size
        step, substeps = frame_step / model.substeps, ceil(frame_step / length)
        if step <= length:
            continue
        words = f"a `{line.species}` walks up to {step:,.0f} mm in a step, {step / length:.2g} times the length of its body"
        has_own_line = "substeps" in scene.document.entries
        place = scene.find_span("substeps") if has_own_line else scene.find_span("crowd", number, "species")
        slower = f"write a `max_speed` below {_format_limit(length, scene)}"
        advice = f"write `substeps: {substeps}`" if substeps <= limits.MAX_SUBSTEPS else slower
        report.warning("long-step", words, place, advice, labels=(Label(attributes["max_speed"].span, "its speed"),))


def _format_limit(length: float, scene: Scene) -> str:
    """Return the text of the speed at which agents move `length` mm per substep with the maximum number of substeps."""
    return f"{length * float(scene.model.fps) * limits.MAX_SUBSTEPS / 1000:.3g} m/s"


def compute_typical_value(attribute: AttributeDecl | None, scene: Scene, program: Program) -> float | None:
    """Return the mean value that an attribute has at birth, in base units. Return None if the value depends on anything except
    params and random draws."""
    part: Expr | None = attribute.default if attribute is not None else None
    if isinstance(part, OperationExpr) and part.name in ("uniform", "normal"):
        values = [_find_constant_value(each, scene, program) for each in part.args[:2]]
        if part.name == "normal":
            return values[0]
        return None if None in values else sum(value for value in values if value is not None) / len(values)
    return _find_constant_value(part, scene, program)


def _find_constant_value(part: Expr | None, scene: Scene, program: Program) -> float | None:
    """Return the value of a constant, or the value of a param in this scene, in base units. Return None for other expressions."""
    if isinstance(part, ParamRef):
        value = scene.model.set.get(part.name)
        if value is not None:
            return value.to_base_units(scene.model.unit_mm, float(1 / scene.model.fps))
        part = program.params[part.name].default
    return convert_constant(part, scene) if isinstance(part, Constant) else None
