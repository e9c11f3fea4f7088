"""Checks of `wrap`, which makes a world periodic: the axes that wrap, and the things that cannot cross a seam."""

from __future__ import annotations

from typing import TYPE_CHECKING

from antdsl.diagnostics import Label, Report
from antdsl.program.model import OperationExpr, Program
from antdsl.program.tables.things import KIND_BY_WORD
from antdsl.program.traverse import iterate_parts
from antdsl.scene.checks.step_checks import compute_typical_value, find_first_lines
from antdsl.scene.document import PathKey
from antdsl.scene.load import Scene
from antdsl.scene.thing_models import UP_VECTORS

if TYPE_CHECKING:
    from antdsl.numerics.periodic_box import PeriodicBox

_MIN_WIDTH_MM, _MIN_WIDTH_SHARE = 0.001, 1e-4  # mm; share of the greatest coordinate, which float32 must resolve
WRAP_AXES = ("x", "y", "z")


def make_periodic_box(scene: Scene) -> PeriodicBox | None:
    """Return the box of a scene's periodic world in mm, or None if the world is not periodic. Its width is 0 along axes that do
    not wrap."""
    wrap = scene.model.wrap
    if wrap is None:
        return None
    from antdsl.numerics.periodic_box import PeriodicBox  # it imports NumPy

    ranges = (getattr(wrap, axis) for axis in WRAP_AXES)
    ends = [tuple(end.to_millimetres(scene.model.unit_mm) for end in each) if each else (0.0, 0.0) for each in ranges]
    x, y, z = ends
    return PeriodicBox((x[0], y[0], z[0]), (x[1] - x[0], y[1] - y[0], z[1] - z[0]))


def check_wrap(scene: Scene, program: Program, report: Report) -> None:
    """Report axes that cannot wrap, and things that cannot be in a periodic world."""
    wrap, model = scene.model.wrap, scene.model
    if wrap is None:
        return
    up = WRAP_AXES[UP_VECTORS[model.up].index(1.0)]
    level = [axis for axis in WRAP_AXES if axis != up]
    if getattr(wrap, up) is not None:
        words = f"`{up}` points up in this scene, so the world cannot wrap along it"
        report.error("wrong-value", words, scene.find_span("wrap", up, key=True), f"write `{level[0]}` or `{level[1]}`")
    elif not any(getattr(wrap, axis) for axis in level):
        advice = f"write `wrap: {{{level[0]}: -35 mm .. 35 mm, {level[1]}: -35 mm .. 35 mm}}`"
        report.error("missing-key", "`wrap` has no axis", scene.find_span("wrap", key=True), advice)
        return
    box = make_periodic_box(scene)
    assert box is not None
    for k in box.axes:
        least = max(_MIN_WIDTH_MM, _MIN_WIDTH_SHARE * max(abs(box.low[k]), abs(box.low[k] + box.widths[k])))
        if box.widths[k] < least:
            words = f"the world is only {box.widths[k]:.3g} mm wide along `{WRAP_AXES[k]}`, too narrow for precise positions"
            place = scene.find_span("wrap", WRAP_AXES[k])
            report.error("wrong-value", words, place, f"write a range of at least {least:.3g} mm")
    for number, species in find_first_lines(scene, program):
        speed = next((each for each in species.attributes if each.name == "max_speed"), None)
        step = (compute_typical_value(speed, scene, program) or 0.0) * float(1 / model.fps)
        if speed is not None and step >= box.least_width / 2:
            words = f"a `{species.name}` walks up to {step:.3g} mm in a step, half of the world's width or more"
            help = "write a wider range below `wrap`, more `fps`, or a lower `max_speed`"
            place = scene.find_span("crowd", number, "species")
            report.error("wrong-value", words, place, help, labels=(Label(speed.span, "its speed"),))
    for path, what, advice in (*_list_unsupported_keys(scene), *_list_unsupported_things(scene, program)):
        report.error("wrap-unsupported", f"a periodic world cannot have {what} yet", scene.find_span(*path, key=True), advice)
    for species in program.species.values():
        for part in iterate_parts(species):
            if isinstance(part, OperationExpr) and part.name == "light":
                words = "a periodic world cannot have the sense `light` yet: lamps do not shine across the seam"
                report.error("wrap-unsupported", words, part.span, "leave `light` out, or `wrap`")


_Unsupported = tuple[tuple[PathKey, ...], str, str]


def _list_unsupported_keys(scene: Scene) -> list[_Unsupported]:
    """Return the keys of a scene that are not allowed in a periodic world. Each has its path, a description, and what to write
    instead."""
    model = scene.model
    findings: list[_Unsupported] = []
    if model.notes:
        findings.append((("notes",), "notes", "leave `notes` out; their regions and targets end at the seam"))
    if model.lod is not None:
        findings.append((("lod",), "levels of detail", "leave `lod` out"))
    return [(path if path[0] in scene.document.entries else ("wrap",), what, advice) for path, what, advice in findings]


def _list_unsupported_things(scene: Scene, program: Program) -> list[_Unsupported]:
    """Return the things of a scene that are not allowed in a periodic world, in the form of `_list_unsupported_keys`."""
    findings: list[_Unsupported] = []
    for name, value in scene.model.world.items():
        kind = KIND_BY_WORD[program.world[name].kind] if name in program.world else None
        moves = getattr(value, "keys", None) if not isinstance(value, dict) else any(item.keys for item in value.values())
        path = ("world", name)
        if kind is not None and kind.wrap_advice:
            findings.append((path, f"a {kind.word}", kind.wrap_advice))
        elif moves or scene.roots.is_sequence(str(getattr(value, "mesh", ""))):
            findings.append((path, "things that move", "leave `keys` out, and name one file"))
    for number, line in enumerate(scene.model.crowd):
        if line.walk is not None:
            findings.append((("crowd", number, "walk"), "guided walks", "leave `walk` out"))
    return findings
