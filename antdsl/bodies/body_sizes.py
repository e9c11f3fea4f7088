"""Compares the sizes of species with those of their bodies: proportions of standing bodies, and warnings about mismatches."""

from __future__ import annotations

from collections.abc import Mapping

from antdsl.bodies.agents.body_extents import compute_standing_box
from antdsl.bodies.agents.definition import Definition
from antdsl.bodies.library import load_library_body
from antdsl.bodies.posed_body import COLLISION_LAYER_NAME, find_base_layer
from antdsl.diagnostics import Report
from antdsl.plan.lowering.birth import is_standing
from antdsl.plan.lowering.writer import BodyProportions
from antdsl.program.kinds import Dimension
from antdsl.program.model import AttributeDecl, Constant, Expr, OperationExpr, ParamRef, Program, Species
from antdsl.scene.checks.entry_checks import convert_constant
from antdsl.scene.library_bodies import CAPSULE_BY_BODY
from antdsl.scene.load import Scene

_MAX_LENGTH_RATIO = 2.0  # largest ratio of two numbers about one body
_LENGTH_DIMENSION = Dimension(length=1)
_STANDING_BODIES = ("person",)  # library bodies with a fixed size; animals of one kind differ by more


def measure_standing_proportions(
    program: Program, definitions: Mapping[str, Definition], words: Mapping[str, str]
) -> dict[str, BodyProportions]:
    """Return, by species, the proportions of the bodies of all species that set a `height`. `definitions`: bodies from files, by
    species. `words`: names of library bodies, by species."""
    return {
        name: _measure_proportions(definitions.get(name) or load_library_body(words[name]), words.get(name))
        for name, species in program.species.items()
        if is_standing(species) and (name in definitions or name in words)
    }


def _measure_proportions(body: Definition, word: str | None) -> BodyProportions:
    """Return the proportions of a standing body. `word`: its name in the library; None for a body from a file."""
    low, high = compute_standing_box(body, find_base_layer(body))
    if word in CAPSULE_BY_BODY:
        return BodyProportions(1.0 / max(float(high[1] - low[1]), 1e-3), CAPSULE_BY_BODY[word].width / 2)
    least, most = compute_standing_box(body, body.layers.get(COLLISION_LAYER_NAME) or find_base_layer(body))
    return BodyProportions(1.0 / max(float(high[1] - low[1]), 1e-3), max(float(most[2] - least[2]), 1e-3) / 2)


def report_odd_sizes(
    scene: Scene, program: Program, definitions: Mapping[str, Definition], words: Mapping[str, str], report: Report
) -> None:
    """Report a warning where the `size`, `height` or `radius` of a species differs from its body by more than a factor of 2.

    Only constants are compared. For a random value such as `uniform(3 mm, 5 mm)`, the first length is compared."""
    for line in scene.model.crowd:
        species = program.species.get(line.species)
        word = words.get(line.species)
        body = definitions.get(line.species) or (load_library_body(word) if word in _STANDING_BODIES else None)
        if species is not None and body is not None:
            _report_odd_sizes_of_species(scene, program, species, body, word, report)


def _report_odd_sizes_of_species(
    scene: Scene, program: Program, species: Species, body: Definition, word: str | None, report: Report
) -> None:
    """Report a warning where the sizes of a species differ much from the size of its body. `word`: the library's name for the
    body, or None."""
    own = {a.name: a for a in species.attributes if a.is_builtin and a.span != species.span}
    lengths = {
        name: _find_first_length(own[name].default, program, scene) for name in ("size", "height", "radius") if name in own
    }
    proportions, natural = _measure_proportions(body, word), body.length * body.unit
    size = lengths.get("size")
    height = lengths.get("height")
    if height is not None:
        _report_if_different(own["height"], height, natural / proportions.size_per_height, "its body is {} tall", report)
        size = height * proportions.size_per_height
    elif size is not None:
        _report_if_different(own["size"], size, natural, "its body is {} long", report)
    radius = lengths.get("radius")
    if size is not None and radius is not None:
        _report_if_different(
            own["radius"], radius, size * proportions.radius_per_size, "half the width of its body is {}", report
        )


def _report_if_different(attribute: AttributeDecl, length: float, body_length: float, words: str, report: Report) -> None:
    """Report a warning if an attribute's `length` (mm) differs too much from the corresponding length of the body, `body_length`
    (mm).

    `words`: text about the body's length, with `{}` in place of the length."""
    if length > 0 and body_length > 0 and not 1 / _MAX_LENGTH_RATIO <= length / body_length <= _MAX_LENGTH_RATIO:
        has = words.format(_describe_length(body_length))
        message = f"`{attribute.name}` is about {_describe_length(length)}, but {has}"
        if report.diagnostics and any(d.span == attribute.default.span and d.code == "odd-size" for d in report.diagnostics):
            return
        report.warning("odd-size", message, attribute.default.span, f"write `{attribute.name} {_describe_length(body_length)}`")


def _describe_length(length: float) -> str:
    """Return a length (mm) as text in metres or millimetres."""
    return f"{length / 1000:.3g} m" if length >= 300 else f"{length:.3g} mm"


def _find_first_length(expression: Expr, program: Program, scene: Scene) -> float | None:
    """Return the first length in an expression such as `uniform(3 mm, 5 mm)`, in millimetres; None if it contains no length."""
    stack: list[Expr | None] = [expression]
    while stack:
        part = stack.pop()
        if isinstance(part, Constant) and part.type.dimension == _LENGTH_DIMENSION and part.number > 0:
            return convert_constant(part, scene)
        if isinstance(part, ParamRef):
            stack.append(program.params[part.name].default)
        elif isinstance(part, OperationExpr):
            stack.extend(reversed(part.args))
    return None
