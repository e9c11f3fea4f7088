"""`antdsl explain CACHE --agent ID --frame N`: explains why an agent acted as it did."""

from __future__ import annotations

from pathlib import Path

import typer

from antdsl.cli.exits import CommandError, ExitCode, explain_cache_errors
from antdsl.cli.printing.messages import print_result


def run_explain_command(
    cache: Path = typer.Argument(..., help="A folder that `antdsl run` wrote."),
    agent: str = typer.Option(..., "--agent", metavar="ID", help="The agent's id, or its name as in scenes: `guards.17`."),
    frame: int = typer.Option(..., "--frame", metavar="N", help="The frame after the step."),
    species: str = typer.Option(None, "--species", metavar="NAME", help="The agent's species, if the scene has several."),
    scene: Path = typer.Option(None, "--scene", metavar="FILE", help="The scene, if it is not near the cache."),
    root: list[str] = typer.Option([], "--root", metavar="NAME=DIR", help="Grant the scene a folder of assets outside its own."),
    json: bool = typer.Option(False, "--json", help="Print JSON."),
) -> None:
    """Explain an agent's decisions in a frame: transitions, the push of each layer, senses and random draws."""
    from antdsl.cli.arguments import parse_grants
    from antdsl.cli.printing.reports import exit_on_errors, print_report
    from antdsl.explain import ExplainError, explain_agent_in_cache, format_explanation, make_json_document
    from antdsl.numerics.processor.host import count_available_cores
    from antdsl.outputs.cache.cache_reader import open_cache
    from antdsl.outputs.chosen_agents import UnknownAgent, find_agent
    from antdsl.runtime import BindError

    grants = parse_grants(root)
    try:
        with explain_cache_errors(cache, "to compute it again"):
            opened = open_cache(cache)
            chosen = find_agent(agent, opened.manifest)
            if None not in (species, chosen.species) and species != chosen.species:
                raise UnknownAgent(f"`{agent}` is of the species `{chosen.species}`", "leave out `--species`")
            name = chosen.species or species
            threads = count_available_cores()
            explanation = explain_agent_in_cache(
                opened, chosen.id, frame, species=name, scene=scene, grants=grants, threads=threads
            )
    except UnknownAgent as error:
        raise typer.BadParameter(f"{error}: {error.help}", param_hint="--agent") from None
    except BindError as error:
        exit_on_errors(error.report)
        raise CommandError(ExitCode.FINDINGS) from None
    except ExplainError as error:
        if error.report is not None:
            print_report(error.report, to_stderr=True)
        raise CommandError(
            ExitCode.USAGE if error.usage else ExitCode.FINDINGS, f"error: {error}", f"help: {error.help}" if error.help else ""
        ) from None
    if json:
        from json import dumps

        print_result(dumps(make_json_document(explanation), indent=1, ensure_ascii=False, allow_nan=False))
        return
    print_result(format_explanation(explanation), newline=False)
