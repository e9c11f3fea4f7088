"""Species that a program asks of and no line of the crowd brings."""

from __future__ import annotations

from antdsl.diagnostics import Label, Report
from antdsl.program.model import Program, Thing
from antdsl.program.traverse import parts
from antdsl.scene.load import Scene


def absent_species(scene: Scene, program: Program, report: Report) -> None:
    """Complain about species whom agents look for, or collide with, and nobody says what they are."""
    absent = [name for name, thing in program.world.items() if thing.kind == "species" and name not in program.species]
    if not absent:
        return
    every = list(parts(tuple(program.species.values())))
    asked = {each.name for each in every if isinstance(each, Thing)} | {
        of for each in every if isinstance(of := getattr(each, "of", None), str)
    }
    for name in absent:
        if name in asked:
            message = f"the program asks of the species `{name}`, which no line of the crowd brings"
            advice = f"add to `crowd`: `- {{species: {name}, from: {name}.ant, count: 0}}`"
            label = Label(program.world[name].span, "declared here")
            report.error("missing-thing", message, scene.span("antdsl", key=True), advice, labels=(label,))
