"""Tables of a benchmark case for the terminal.

The first table has set-up and the complete step, with one column per backend. The second table has the phases."""

from __future__ import annotations

from collections.abc import Sequence

from rich.console import Console
from rich.table import Table
from rich.text import Text

from antdsl.bench.tables import (
    STEP_COLUMNS,
    BenchCaseResult,
    build_phase_table,
    build_step_rows,
    compare_backends,
    describe_result,
    list_messages,
)
from antdsl.cli.printing.messages import print_result


def print_case_result(result: BenchCaseResult) -> None:
    """Print the result of a benchmark case."""
    console = Console(highlight=False, soft_wrap=True)
    with console.capture() as printed:
        for line in (describe_result(result), *list_messages(result)):
            console.print(Text(line))
        names, *rows = [list(row) for row in zip(STEP_COLUMNS, *build_step_rows(result), strict=True)]
        console.print(_build_table(names, [row for row in rows if any(row[1:])]))
        for line in compare_backends(result):
            console.print(Text(line))
        console.print(_build_table(*build_phase_table(result)))
    print_result(printed.get())


def _build_table(columns: Sequence[str], rows: Sequence[Sequence[str]]) -> Table:
    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0), header_style="")
    for number, head in enumerate(columns):
        table.add_column(head, justify="left" if number == 0 else "right", no_wrap=True)
    for row in rows:
        table.add_row(*map(Text, row))
    return table
