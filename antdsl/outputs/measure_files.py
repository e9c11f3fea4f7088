"""The measures of each frame of a run, written to `measures.csv` in the cache's folder and, if pyarrow is installed, to
`measures.parquet`."""

from __future__ import annotations

import csv
from collections.abc import Mapping
from contextlib import suppress
from io import StringIO
from pathlib import Path
from types import TracebackType
from typing import TextIO

from antdsl import limits
from antdsl.atomic_write import write_atomically
from antdsl.outputs.cache.cache_reader import MEASURES_FILE_NAME, MEASURES_PARQUET_NAME
from antdsl.outputs.csv_text import format_csv
from antdsl.outputs.parquet_table import encode_parquet
from antdsl.safe_read import read_size_limited

_FIXED_COLUMNS = ("frame", "time")
_MAX_FILE_BYTES = 4 * limits.GIB


class MeasureFile:
    """Writer of `measures.csv`. Each frame's line is written immediately, so that a stopped run has the lines of all its frames.

    Call `write_frame` within the context. The Parquet file is written at the end of the context."""

    def __init__(self, folder: Path, names: tuple[str, ...], last_retained: int | None) -> None:
        """`last_retained`: lines of an earlier run up to this frame stay; None: no line stays."""
        self.folder, self.names, self.last_retained = folder, names, last_retained
        self.file: TextIO | None = None

    def __enter__(self) -> MeasureFile:
        path = self.folder / MEASURES_FILE_NAME
        rows = [] if self.last_retained is None else self._read_rows(self.last_retained)
        for name in (MEASURES_FILE_NAME, MEASURES_PARQUET_NAME):
            (self.folder / name).unlink(missing_ok=True)
        if self.names:
            write_atomically(path, format_csv([self._head, *rows]).encode())
            self.file = path.open("a", encoding="utf-8", newline="")
        return self

    def __exit__(self, kind: type[BaseException] | None, value: BaseException | None, trace: TracebackType | None) -> None:
        if self.file is None:
            return
        self.file.close()
        if kind is None:
            rows = self._read_rows(None)
            columns = {name: [_parse_cell(row[number]) for row in rows] for number, name in enumerate(self._head)}
            parquet = encode_parquet(columns)
            if parquet is not None:
                write_atomically(self.folder / MEASURES_PARQUET_NAME, parquet)

    @property
    def _head(self) -> list[str]:
        return [*_FIXED_COLUMNS, *self.names]

    def _read_rows(self, last: int | None) -> list[list[str]]:
        """Return the lines of the file up to frame `last`, without the header. Empty if the file has other columns."""
        with suppress(OSError, UnicodeDecodeError, csv.Error):
            text = read_size_limited(self.folder / MEASURES_FILE_NAME, _MAX_FILE_BYTES, follows_links=False).decode()
            head, *rows = csv.reader(StringIO(text[: text.rfind("\n") + 1]))
            if head == self._head and all(len(row) == len(head) and _is_integer(row[0]) for row in rows):
                return [row for row in rows if last is None or int(row[0]) <= last]
        return []

    def write_frame(self, frame: int, time: float, values: Mapping[str, float | int | None]) -> None:
        """Write the line of a frame. `time`: seconds since the first frame. A value of None gives an empty cell."""
        if self.file is not None:
            cells = ("" if values[name] is None else values[name] for name in self.names)
            self.file.write(format_csv([[frame, time, *cells]]))
            self.file.flush()


def _is_integer(text: str) -> bool:
    return text.removeprefix("-").isdecimal()


def _parse_cell(text: str) -> float | int | None:
    return None if not text else int(text) if _is_integer(text) else float(text)
