"""Writes tables as Apache Parquet files if pyarrow is installed."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from importlib.util import find_spec
from typing import Any


def encode_parquet(columns: Mapping[str, Sequence[Any]]) -> bytes | None:
    """Return columns of equal length as the bytes of a Parquet file. None if pyarrow is not installed."""
    if find_spec("pyarrow") is None:
        return None
    import pyarrow
    import pyarrow.parquet

    sink = pyarrow.BufferOutputStream()
    pyarrow.parquet.write_table(pyarrow.table(dict(columns)), sink)
    return bytes(sink.getvalue().to_pybytes())
