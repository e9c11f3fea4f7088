"""Work in pieces that a core's cache holds, on several threads where there are."""

from collections.abc import Callable, Iterable
from concurrent.futures import ThreadPoolExecutor
from typing import Any

PIECE = 1 << 16  # samples worked on at once


def pieces(count: int) -> list[slice]:
    """`count` rows cut into pieces."""
    return [slice(start, min(start + PIECE, count)) for start in range(0, count, PIECE)]


def each(work: Callable[[Any], None], parts: Iterable[Any], threads: int) -> None:
    """Does every part of a work, each of which writes to places of its own."""
    if threads == 1:
        for part in parts:
            work(part)
        return
    with ThreadPoolExecutor(threads) as pool:
        for _ in pool.map(work, parts):
            pass
