"""Bodies of a crowd that are files: that they are there, and that all agents of a species have the same one."""

from __future__ import annotations

from antdsl import limits
from antdsl.diagnostics import Label, Report
from antdsl.program.model import Program
from antdsl.scene.library_bodies import BODY_WORDS
from antdsl.scene.load import Scene
from antdsl.scene.paths import PathRefused


def bodies(scene: Scene, program: Program, report: Report) -> None:
    """Complains of each line of the crowd whose body cannot be had."""
    first: dict[str, int] = {}
    for number, line in enumerate(scene.model.crowd):
        if line.body is None:
            continue
        place = scene.span("crowd", number, "body")
        earlier = first.setdefault(line.species, number)
        known = scene.model.crowd[earlier].body
        if known != line.body:
            report.error(
                "wrong-value", f"`{line.species}` has another body above", place,
                f"write `{known}` in both, or make it another species",
                labels=(Label(scene.span("crowd", earlier, "body"), "the first one"),),
            )  # fmt: skip
        elif line.body not in BODY_WORDS and earlier == number:
            try:
                size = scene.roots.exists(line.body)
            except PathRefused as refused:
                report.error(refused.code, str(refused), place, refused.help)
                continue
            if size > limits.BODY_BYTES:
                report.error("too-large", f"`{line.body}` has {size:,} bytes, more than {limits.BODY_BYTES:,}", place)
