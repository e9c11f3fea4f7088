"""`antdsl plan FILE`: prints the array operations into which a program is compiled."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import typer

from antdsl.cli.exits import CommandError, ExitCode
from antdsl.cli.printing.messages import print_result

if TYPE_CHECKING:
    from antdsl.plan.ir import Plan
    from antdsl.scene.setting import WorldSetting


def run_plan_command(
    file: Path = typer.Argument(..., help="A program (.ant) or a scene (.yaml)."),
    raw: bool = typer.Option(False, "--raw", help="Print the plan before optimisation."),
    native: bool = typer.Option(
        False, "--native", help="List which parts become machine code: stages, instruction counts, calls of NumPy."
    ),
    code: bool = typer.Option(False, "--ir", help="Like --native, with the machine code as LLVM IR."),
) -> None:
    """Print the array passes that a program became."""
    from antdsl import passes, pipeline
    from antdsl import plan as planning
    from antdsl.cli.printing.reports import exit_on_errors

    setting: WorldSetting | None = None
    final_plan: Plan | None = None
    if file.suffix == ".ant":
        program, report = pipeline.check_path(file)
        if program is not None and report.ok:
            lowered, findings = planning.lower(program)
            report.extend(findings)
            final_plan = lowered if raw else passes.optimise_plan(lowered)
    else:
        shot, report = pipeline.open_scene(file, raw=raw)
        if shot is not None:
            final_plan, setting = shot.plan, shot.setting
    exit_on_errors(report)
    if final_plan is None:
        raise CommandError(ExitCode.FINDINGS)
    print_result(_format_machine_code(final_plan, setting, code) if native or code else planning.format_plan(final_plan))


def _format_machine_code(final_plan: Plan, setting: WorldSetting | None, include_code: bool) -> str:
    """Return a text that describes a plan's machine code. Raises CommandError if the plan cannot be compiled.

    `setting`: the world of the scene, or None for a program without a scene.
    `include_code`: append the text of the code."""
    from antdsl.machine_code import llvm_compiler
    from antdsl.runtime.backends.native import program_listing
    from antdsl.runtime.backends.native.programs import WorldFacts

    if reason := llvm_compiler.find_unavailability_reason():
        raise CommandError(ExitCode.FINDINGS, f"error: this machine cannot make machine code: {reason}")
    code_listing = program_listing.build_program(
        final_plan,
        llvm_compiler.find_host_target(),
        program_listing.STATIC_WORLD_FACTS if setting is None else WorldFacts.from_setting(setting),
    )
    words = (
        "for static ground without `lod`; a scene with moving ground or `lod` may have different code\n"
        if setting is None
        else ""
    )
    return words + program_listing.format_listing(code_listing) + (f"\n{code_listing.text}" if include_code else "")
