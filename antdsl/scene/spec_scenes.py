"""Whether the scenes are there that a program's specs run on."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path

from antdsl.diagnostics import Fix, Report
from antdsl.program.consequences import in_one
from antdsl.program.model import Program
from antdsl.scene.paths import PathRefused, Roots

_MEANT = re.compile(r"did you mean `([^`]+)`\?")


def spec_scenes(program: Program | None, grants: Mapping[str, Path] | None = None) -> Report:
    """Complaints about scenes that specs name and that are not there, one for each with all its places. The files are not
    read."""
    report = Report()
    specs = program.specs if program else ()
    named = (text for spec in specs for text in (spec.scene, spec.against.scene if spec.against else None))
    for text in named:
        if text is None or not text.text.endswith((".yaml", ".yml")):
            continue
        roots = Roots(Path(text.span.source.path).resolve().parent, grants or {})
        try:
            roots.exists(text.text)
        except PathRefused as refused:
            near = _MEANT.fullmatch(refused.help or "")
            fix = Fix(text.span, f'"{near[1]}"') if near and "/" not in text.text else None
            advice = refused.help or "name a scene that lies beside this program or below its folder"
            report.error(refused.code, str(refused), text.span, advice, fix=fix)
    return in_one(report)
