"""A statement that antdsl does not have, from its rows to a run: `python tests/effect_of_a_row.py` adds its rows before anything
is made from the tables, generates the grammar in a separate folder, and prints as JSON what every part makes of the line
`scratch ground(depth: 1 mm)`. `tests/program/test_an_effect_of_a_row.py` holds that against what it should be."""

from __future__ import annotations

import json
import shutil
import sys
import tempfile
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from typing import Any

from antdsl import resources

FOLDER = Path(tempfile.mkdtemp(prefix="antdsl-effect-"))
shutil.copytree(resources.grammar_folder(), FOLDER / "grammar")
resources.grammar_folder = lambda: FOLDER / "grammar"  # before any module reads it


def first(name: str) -> Any:
    """A module before the room around it, which makes more of its rows as it is imported."""
    path = Path(resources.__file__).parent.joinpath(*name.split(".")[1:]).with_suffix(".py")
    spec = spec_from_file_location(name, path)
    assert spec is not None and spec.loader is not None
    sys.modules[name] = module_from_spec(spec)
    spec.loader.exec_module(sys.modules[name])
    return sys.modules[name]


# Two rows, how it is written and what it means; below who settles it.
VERBS = first("antdsl.syntax.verbs")
VERBS.VERB_BY_WORD["scratch"] = VERBS.Verb("scratch", "arguments", "scratch ground(depth: 1 mm)", "the name of a surface")

from antdsl.program.tables.effects import EFFECT_BY_OPERATION, EffectRow  # noqa: E402
from antdsl.program.tables.rows import ArgumentRow, UseCost  # noqa: E402

EFFECT_BY_OPERATION["scratch"] = EffectRow(
    "scratch",
    "surface",
    (
        ArgumentRow("depth", "length", lower_bound=0, display_name="depth of a scratch", sample="1 mm"),
        ArgumentRow("width", "length", default="2 mm"),
        ArgumentRow("into", "own mm^2", is_optional=True, display_name="an area", sample="dust"),
    ),
    "effects",
    "scratches a surface",
    "takes depth times width off a surface and gives it to the agent's own register",
    "scratch {of} {depth} by {width}[ -> {own}]",
    "scratch {of}, {depth} mm deep",
    fault_name="scratch {of}",
    needs_positive_operand=True,
    cost=UseCost(30, "scratches {thing}"),
)

from explained import cached, shot_of  # noqa: E402

from antdsl.explain import explain_agent_in_cache  # noqa: E402
from antdsl.highlighting.lexer import AntLexer  # noqa: E402
from antdsl.lsp.features.completion import complete_program  # noqa: E402
from antdsl.lsp.features.tokens import list_keywords  # noqa: E402
from antdsl.lsp.word_help import explain_word  # noqa: E402
from antdsl.lsp.workspace import Workspace  # noqa: E402
from antdsl.plan.show import format_plan  # noqa: E402
from antdsl.program import check  # noqa: E402
from antdsl.program.cost import estimate_costs  # noqa: E402
from antdsl.runtime import Options, bind, phases, step  # noqa: E402
from antdsl.runtime.world import World  # noqa: E402
from antdsl.source import Source  # noqa: E402
from antdsl.syntax import format, parse  # noqa: E402
from antdsl.syntax.grammar import write_tables  # noqa: E402


def scratched(world: World) -> None:
    """Give all who scratch what comes of it."""
    for population in world.populations.values():
        for entry in population.effects.pop_requests("scratch"):
            if entry.request.register is not None:
                population.now[entry.request.register][entry.rows] += entry.get_required_operand(0) * entry.get_required_operand(
                    1
                )


phases.RESOLVER_BY_EFFECT["scratch"] = scratched

PROGRAM = """ant 1
world { surface ground }
species ant {
  dust = 0 mm^2
  claw = 1 mm
  start dig
  state dig {
    scratch ground(depth: claw, into: dust)
    when dust > 7 mm^2 -> rest { scratch ground(3 mm, width: 4 mm, into: dust) }
  }
  state rest { when after 9 s -> dig }
}
"""
SCENE = """antdsl: 1
units: mm
fps: 24
frames: 1..8
world:
  ground: {mesh: ground.ply}
crowd:
  - {species: ant, from: ant.ant, count: 3, place: {on: ground, radius: 30 mm}}
"""
LINES = (
    "scratch",
    "scratch ground",
    "scratch ground()",
    "scratc ground(depth: 1 mm)",
    "scratch floor(depth: 1 mm)",
    "scratch ground(depth: 1 s)",
    "scratch ground(depht: 1 mm)",
    "scratch ground(depth: 0 mm)",
    "scratch ground(depth: 1 mm, into: claw)",
    "scratch ground(depth: 1 mm, into: sand)",
)


def complaints(line: str) -> list[tuple[str, str, str]]:
    file, report = parse(Source("ant.ant", PROGRAM.replace("start dig", "start dig\n  on spawn { " + line + " }")))
    report.extend(check(file, lambda name: None)[1])
    return [(d.code, d.message, d.help or "") for d in report.diagnostics]


def proposals(typed_text: str) -> list[str]:
    """What an editor proposes behind a text at the beginning of the state's body."""
    text = PROGRAM.replace("scratch ground(depth: claw, into: dust)", typed_text)
    workspace = Workspace()
    document = workspace.put_document(FOLDER / "other.ant", text)
    return [item.label for item in complete_program(workspace, document, text.index(typed_text) + len(typed_text))]


def meanings() -> list[tuple[str, ...]]:
    """What the names of a line stand for in an editor."""
    document = Workspace().put_document(FOLDER / "other.ant", PROGRAM)
    start = PROGRAM.index("scratch")
    end = PROGRAM.index("\n", start)
    return [each.key for each in document.index.occurrences if start <= document.find_start(each.span) < end]


def main() -> None:
    write_tables()
    scene = FOLDER / "scene.yaml"
    shutil.copy(Path(__file__).resolve().parents[1] / "examples" / "minimal" / "ground.ply", FOLDER)
    (FOLDER / "ant.ant").write_text(PROGRAM, encoding="utf-8")
    scene.write_text(SCENE, encoding="utf-8")
    shot = shot_of(scene, 8)
    dust = {}
    for backend in ("reference", "numpy"):
        world = bind(shot.plan, shot.setting, Options(backend=backend))
        frames = []
        for _ in range(5):
            step(world)
            frames.append(world.populations["ant"].now["dust"].tolist())
        dust[backend] = frames
    cache = cached(scene, 8, FOLDER / "out")
    species = shot.program.species["ant"]
    loose = PROGRAM.replace("ground(3 mm, width: 4 mm", "ground( 3 mm ,width:4 mm")
    labels = {
        "plan": format_plan(shot.plan),
        "dust": dust,
        "did": [explain_agent_in_cache(cache, 0, frame).did for frame in (2, 5, 6)],
        "costs": [use.description for part in estimate_costs(shot.program, species) for use in part.cost_entries],
        "complaints": {line: complaints(line) for line in LINES}
        | {"misplaced": complaints("die }\n  scratch ground(depth: 1 mm)\n  on collision(other) { die")},
        "formatted": format(Source("ant.ant", loose))[0] == PROGRAM,
        "proposals": {
            typed_text: proposals(typed_text)
            for typed_text in ("scr", "scratch ", "scratch ground(", "scratch ground(depth: 1 mm, into: ")
        },
        "meanings": meanings(),
        "about": explain_word("scratch"),
        "keyword": "scratch" in list_keywords(),
        "colour": [
            str(kind) for _, kind, word in AntLexer().get_tokens_unprocessed("  scratch ground(depth: 1 mm)") if word == "scratch"
        ],
    }
    print(json.dumps(labels))


if __name__ == "__main__":
    try:
        main()
    finally:
        shutil.rmtree(FOLDER)
