"""`antdsl lsp`: the language server, for an editor to start."""

from __future__ import annotations

from antdsl.cli.exits import CommandError, ExitCode


def run_lsp_command() -> None:
    """Answer an editor over standard input and output (language server protocol). Needs the extra [lsp]."""
    from antdsl.cli.printing.reports import exit_on_errors
    from antdsl.packages import check_extra

    exit_on_errors(check_extra("the language server", "lsp", "pygls"))
    from antdsl.lsp.server import run_server

    try:
        ended_well = run_server()
    except OSError as problem:
        words = (problem.strerror or str(problem)).lower()
        raise CommandError(ExitCode.INPUT_OUTPUT, f"error: cannot write to standard output: {words}") from None
    if not ended_well:
        raise CommandError(ExitCode.FINDINGS)  # required by the protocol for an exit without a shutdown
