"""The command line. Each command has one module, which defines its flags, calls the pipeline, prints, and sets the exit code."""

from antdsl.child_processes import isolate_search_paths

isolate_search_paths()  # before another import could search the working directory

import gc  # noqa: E402
import os  # noqa: E402
import shlex  # noqa: E402
import sys  # noqa: E402
import warnings  # noqa: E402
from collections.abc import Callable  # noqa: E402
from typing import Any, NamedTuple  # noqa: E402

# Objects allocated at the start and by a check live until the end. Scanning them for garbage every 700 objects would take 10 % of
# a
gc.set_threshold(100_000, 50, 50)

import typer  # noqa: E402
from typer.core import TyperGroup  # noqa: E402

from antdsl.cli.commands import (  # noqa: E402
    bench,
    body,
    check,
    doctor,
    edit,
    explain,
    export,
    fit,
    fmt,
    graph,
    info,
    jobs,
    new,
    plan,
    preview,
    render,
    run,
    sweep,
    test,
)
from antdsl.cli.commands.manual import docs  # noqa: E402
from antdsl.cli.commands.servers import lsp, mcp  # noqa: E402
from antdsl.cli.defaults_file import run_with_defaults  # noqa: E402
from antdsl.cli.exits import (  # noqa: E402
    CommandError,
    ExitCode,
    find_machine_failure,
    limit_threads,
    make_failure_error,
    make_missing_package_error,
)
from antdsl.cli.printing.messages import close_streams, guard_streams, print_result  # noqa: E402


class GroupedHelp(TyperGroup):
    """A group of commands. Its help lists them under headings (`rich_help_panel`) and never truncates a line."""

    def format_commands(self, ctx: Any, formatter: Any) -> None:
        """Write the commands to the help, below their headings."""
        width = max(map(len, self.commands))
        rows: dict[str, list[tuple[str, str]]] = {}
        for name, command in self.commands.items():
            rows.setdefault(command.rich_help_panel, []).append((name.ljust(width), _get_first_sentence(command)))  # type: ignore[attr-defined]
        for heading, commands in rows.items():
            with formatter.section(heading):
                formatter.write_dl(commands)


def _get_first_sentence(command: Any) -> str:
    """Return the first sentence of a command's help."""
    text = " ".join((command.help or "").split())
    return text.partition(". ")[0].rstrip(".") + "."


class CommandEntry(NamedTuple):
    """An entry in the table of commands: the name, the function that runs it, its heading in the help, and an example of its
    use."""

    name: str
    function: Callable[..., None]
    heading: str
    example: str


WRITE_COMMANDS_HEADING, SIMULATE_COMMANDS_HEADING, RESULT_COMMANDS_HEADING, INSPECTION_COMMANDS_HEADING = (
    "Write programs",
    "Simulate",
    "Use results",
    "Look inside",
)
# In the order of a first project: from a new folder to results.
COMMANDS = (
    CommandEntry("new", new.run_new_command, WRITE_COMMANDS_HEADING, "antdsl new colony --template foraging"),
    CommandEntry("examples", new.run_examples_command, WRITE_COMMANDS_HEADING, "antdsl examples arena"),
    CommandEntry("check", check.run_check_command, WRITE_COMMANDS_HEADING, "antdsl check --strict"),
    CommandEntry("fmt", fmt.run_fmt_command, WRITE_COMMANDS_HEADING, "antdsl fmt ."),
    CommandEntry("run", run.run_run_command, SIMULATE_COMMANDS_HEADING, "antdsl run scene.yaml --frames 1..48 --out walk"),
    CommandEntry("preview", preview.run_preview_command, SIMULATE_COMMANDS_HEADING, "antdsl preview scene.yaml"),
    CommandEntry("test", test.run_test_command, SIMULATE_COMMANDS_HEADING, "antdsl test ."),
    CommandEntry(
        "sweep",
        sweep.run_sweep_command,
        SIMULATE_COMMANDS_HEADING,
        "antdsl sweep scene.yaml --seeds 8 --vary walker.pace=20mm/s,40mm/s --out swept",
    ),
    CommandEntry(
        "fit",
        fit.run_fit_command,
        SIMULATE_COMMANDS_HEADING,
        "antdsl fit scene.yaml --vary walker.pace=20mm/s..40mm/s --to 'half are home after 20 s'",
    ),
    CommandEntry("render", render.run_render_command, RESULT_COMMANDS_HEADING, "antdsl render walk --frames 48..48 --out stills"),
    CommandEntry("edit", edit.run_edit_command, RESULT_COMMANDS_HEADING, "antdsl edit walk --smooth orient:5"),
    CommandEntry("export", export.run_export_command, RESULT_COMMANDS_HEADING, "antdsl export walk --to walk.usdc"),
    CommandEntry(
        "jobs", jobs.run_jobs_command, SIMULATE_COMMANDS_HEADING, "antdsl jobs scene.yaml --chunk 24 --to openjd/scene.yaml"
    ),
    CommandEntry("info", info.run_info_command, RESULT_COMMANDS_HEADING, "antdsl info walk"),
    CommandEntry("body", body.run_body_command, INSPECTION_COMMANDS_HEADING, "antdsl body ant"),
    CommandEntry("explain", explain.run_explain_command, RESULT_COMMANDS_HEADING, "antdsl explain walk --agent 17 --frame 48"),
    CommandEntry("graph", graph.run_graph_command, WRITE_COMMANDS_HEADING, "antdsl graph walker.ant --out states.svg"),
    CommandEntry("plan", plan.run_plan_command, INSPECTION_COMMANDS_HEADING, "antdsl plan walker.ant"),
    CommandEntry("bench", bench.run_bench_command, INSPECTION_COMMANDS_HEADING, "antdsl bench foraging --agents 15000"),
    CommandEntry("docs", docs.run_docs_command, INSPECTION_COMMANDS_HEADING, "antdsl docs"),
    CommandEntry("doctor", doctor.run_doctor_command, INSPECTION_COMMANDS_HEADING, "antdsl doctor"),
    CommandEntry("lsp", lsp.run_lsp_command, WRITE_COMMANDS_HEADING, "antdsl lsp"),
    CommandEntry("mcp", mcp.run_mcp_command, WRITE_COMMANDS_HEADING, "antdsl mcp --root ."),
)

app = typer.Typer(
    name="antdsl",
    cls=GroupedHelp,
    help="Crowds of animals from text: write behaviour in .ant files, simulate them on real ground.",
    no_args_is_help=True,
    pretty_exceptions_enable=False,
    rich_markup_mode=None,
    context_settings={"help_option_names": ["-h", "--help"]},
)
for _command_row in COMMANDS:
    _panel, _example = _command_row.heading, f"Example: {_command_row.example}"
    app.command(_command_row.name, rich_help_panel=_panel, epilog=_example)(_command_row.function)


def _print_version(value: bool) -> None:
    """Print the version and exit if the flag is set."""
    if value:
        from antdsl import __version__

        print_result(f"antdsl {__version__}")
        raise typer.Exit()


def _trust_usd(value: bool) -> None:
    """Allow USD files to be read without a sandbox if the flag is set."""
    if value:
        from antdsl.reader import confinement

        confinement.trust_usd()


@app.callback()
def _set_global_options(
    version: bool = typer.Option(
        False, "--version", "-V", callback=_print_version, is_eager=True, help="Print the version and stop."
    ),
    trust_usd: bool = typer.Option(
        False, "--trust-usd", callback=_trust_usd, help="Read USD files where this system has no sandbox for them."
    ),
) -> None:
    """Crowds of animals from text: write behaviour in .ant files, simulate them on real ground."""
    limit_threads()


def main() -> None:
    """Run a command and exit with its code. No user error ends in a traceback."""
    _restart_with_safe_path()
    guard_streams()
    code = _flush_output(_run_without_warnings())
    # The end of the process frees the rest. Another garbage collection would take 10 % of a check.
    gc.freeze()
    sys.exit(code)


def _restart_with_safe_path() -> None:
    """Restart Python with its safe-path flag if it runs as `python -E`. Child processes of `python -E` ignore the environment
    variable that removes the working directory from the search path."""
    if sys.flags.ignore_environment and not sys.flags.safe_path:
        command = [sys.executable, "-P", *sys.orig_argv[1:]]
        if os.name == "posix":
            os.execv(command[0], command)
        import subprocess

        sys.exit(subprocess.run(command).returncode)


def _flush_output(code: int) -> int:
    """Flush buffered output and return the exit code. This is `code` if all output could be written; otherwise it is the exit
    code for lost output."""
    try:
        loss = close_streams()
    except KeyboardInterrupt:  # the work is complete, and no reader needs the rest
        return code
    if loss is None or code not in (ExitCode.SUCCESS, ExitCode.FINDINGS):
        return code
    print(f"error: cannot write to standard output: {(loss.strerror or str(loss)).lower()}", file=sys.stderr)
    return ExitCode.INPUT_OUTPUT


def _run_without_warnings() -> int:
    """Run the command with warnings of libraries disabled. Return its exit code."""
    with warnings.catch_warnings():
        if not sys.warnoptions:  # warnings of libraries are for developers; `python -W default` shows them
            warnings.simplefilter("ignore")
        return _run_command_line()


def _require_utf8_arguments(words: list[str]) -> None:
    """Reject file names that are not valid UTF-8 before any work is done. Manifests, tables and stages store file names as
    UTF-8."""
    for word in words:
        try:
            word.encode()
        except UnicodeEncodeError:
            from antdsl.diagnostics.model import replace_unprintable

            display_name = replace_unprintable(os.fsencode(word).decode(errors="backslashreplace"))
            message = f"error: the name `{display_name}` is not UTF-8"
            raise CommandError(ExitCode.USAGE, message, "rename the file or folder") from None


def _require_flag_order(words: list[str]) -> None:
    """Raise CommandError if `--trust-usd` follows the command's name. It is a global flag, so it must precede the name."""
    own_words = words[: words.index("--")] if "--" in words else words
    if "--trust-usd" in own_words and not own_words[0].startswith("-"):
        rest = [word for word in words if word != "--trust-usd"]
        message = "error: write `--trust-usd` before the command"
        raise CommandError(ExitCode.USAGE, message, f"write: {shlex.join(['antdsl', '--trust-usd', *rest])}")


def _run_command_line() -> int:
    """Run the command that the arguments name. Return its exit code, even if it ends with an error."""
    try:
        try:
            _require_utf8_arguments(sys.argv[1:])
            _require_flag_order(sys.argv[1:])
            run_with_defaults(app)
        except SystemExit as leave:
            return leave.code if isinstance(leave.code, int) else ExitCode.SUCCESS
        return ExitCode.SUCCESS
    except CommandError as stop:
        for line in (stop.message, stop.hint):
            if line:
                print(line, file=sys.stderr)
        return stop.code
    except KeyboardInterrupt:
        print("interrupted", file=sys.stderr)
        return ExitCode.INTERRUPTED
    except Exception as problem:
        cause = find_machine_failure(problem)
        end = make_missing_package_error(problem) if cause is None else make_failure_error(cause)
        if end is not None:
            print(end.message, end.hint, sep="\n", file=sys.stderr)
            return end.code
        from antdsl.machine_code.llvm_compiler import MachineCodeUnavailableError

        if isinstance(problem, MachineCodeUnavailableError):
            print(f"error: simulation needs machine code: {problem}", file=sys.stderr)
            return ExitCode.INPUT_OUTPUT
        import traceback

        traceback.print_exc()
        print("\nThis is a bug in antdsl, not in your files: please report it with the lines above.", file=sys.stderr)
        return ExitCode.BUG
